"""Networks of MaterialX's nodes, as far as they are a constant, or a picture scaled and shifted."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import Any

from scenec.schemas.udim import UDIM

_IMAGES = (
    *("image", "tiledimage", "UsdUVTexture"),
    *("gltf_image", "gltf_colorimage", "gltf_normalmap"),
)
_PASSED = ("dot", "convert", "normalmap", "extract", "separate2", "separate3", "separate4")
#: Of nodes of arithmetic: the second input, and its value where it is not authored.
_ARITHMETIC = {
    "multiply": ("in2", 1.0),
    "divide": ("in2", 1.0),
    "add": ("in2", 0.0),
    "subtract": ("in2", 0.0),
    "invert": ("amount", 1.0),
}
_PLACING = ("place2d", "UsdTransform2d", "UsdPrimvarReader", "geompropvalue", "texcoord")
#: Names of nodes that are read.
KNOWN_NODES = (*_IMAGES, *_PASSED, *_ARITHMETIC, "constant", *_PLACING)
#: Whether a color space is sRGB's, or linear.
SPACES = {
    **dict.fromkeys(("srgb_texture", "srgb_rec709_scene"), True),
    **dict.fromkeys(("lin_rec709", "lin_rec709_scene", "raw", "none", ""), False),
}
_ACESCG = ("acescg", "lin_ap1", "lin_ap1_scene")
#: From ACEScg to linear Rec. 709, by Bradford's adaptation from D60 to D65, to five digits.
_TO_REC709 = (
    (1.70505, -0.62179, -0.08326),
    (-0.13026, 1.14080, -0.01055),
    (-0.02400, -0.12897, 1.15297),
)
DEEPEST = 32

#: Of red, green, blue and alpha.
_Four = tuple[float, ...]
ONES: _Four = (1.0, 1.0, 1.0, 1.0)
ZEROS: _Four = (0.0, 0.0, 0.0, 0.0)


class UnreadNodeError(Exception):
    """Says which node or value of a network is not read."""


@dataclass(frozen=True)
class NodeValue:
    """What an input is: ``bias``, plus ``scale`` times a picture's channel where it has one."""

    bias: _Four = ZEROS
    scale: _Four = ONES
    image: Any = None
    channel: str = "rgb"

    def affine(self, scale: _Four, bias: _Four) -> NodeValue:
        """Scales and then shifts, each of four numbers by its own."""
        old = (self.scale, self.bias)
        scaled, moved = (tuple(a * b for a, b in zip(o, scale, strict=True)) for o in old)
        shifted = tuple(a + b for a, b in zip(moved, bias, strict=True))
        return replace(self, scale=scaled, bias=shifted)

    def component(self, index: int) -> NodeValue:
        """Takes one of four numbers for all of them."""
        if self.image is not None and self.channel != "rgb":
            return self
        return replace(
            self,
            bias=(self.bias[index],) * 4,
            scale=(self.scale[index],) * 4,
            channel="rgba"[index],
        )


def _linear(code: float) -> float:
    return code / 12.92 if code <= 0.04045 else ((code + 0.055) / 1.055) ** 2.4


def constant_of(port: Any) -> NodeValue:
    """Reads a value, of a color in linear Rec. 709.

    Raises:
        UnreadNodeError: It is no number, or a color of another space.
    """
    text = port.getValueString().replace(",", " ").split()
    try:
        numbers = tuple(float(word) for word in text) or (0.0,)
    except ValueError:
        raise UnreadNodeError(f"{port.getName()} = {' '.join(text)}") from None
    if len(numbers) == 1:
        return NodeValue(numbers * 4)
    if port.getType() in ("color3", "color4"):
        space = port.getActiveColorSpace()
        if space in _ACESCG:
            # What Rec. 709 cannot show is clipped.
            turned = (sum(a * b for a, b in zip(row, numbers, strict=False)) for row in _TO_REC709)
            numbers = (*(max(number, 0.0) for number in turned), *numbers[3:])
        elif space not in SPACES:
            raise UnreadNodeError(f"a color in the space {space}")
        elif SPACES[space]:
            numbers = (*(_linear(number) for number in numbers[:3]), *numbers[3:])
    return NodeValue((*numbers, 0.0, 1.0)[:4] if len(numbers) == 2 else (*numbers, 1.0)[:4])


def source_of(port: Any) -> tuple[Any, Any]:
    """Finds what a port stands for, through graphs and their interfaces, and the node of that.

    Raises:
        UnreadNodeError: It leads nowhere.
    """
    for _ in range(DEEPEST):
        if port.hasAttribute("interfacename"):
            inner = port.getInterfaceInput()
        elif port.hasAttribute("nodegraph"):
            inner = port.getConnectedOutput()
        else:
            return port, port.getConnectedNode()
        if inner is None:
            break
        port = inner
    raise UnreadNodeError(f"what {port.getName()} is connected to")


def followed(port: Any, deepest: int = DEEPEST) -> NodeValue:
    """Follows what a port is connected to; a port that is not has its value.

    Raises:
        UnreadNodeError: Something that is neither a constant nor one picture scaled and shifted.
    """
    port, node = source_of(port)
    if node is None:
        return constant_of(port)
    kind, told = node.getCategory(), f"the node {node.getName()} ({node.getCategory()})"
    first = node.getInput({"constant": "value", "subtract": "in1"}.get(kind, "in"))
    first = node.getInput("in1") if first is None else first
    if deepest == 0:
        raise UnreadNodeError(f"{told} of a network this deep")
    if kind in _IMAGES:
        return _image(node, port.getOutputString())
    if first is None or kind not in (*_PASSED, *_ARITHMETIC, "constant"):
        raise UnreadNodeError(told)
    found = followed(first, deepest - 1)
    if kind in _ARITHMETIC:
        name, neutral = _ARITHMETIC[kind]
        other = node.getInput(name)
        second = NodeValue((neutral,) * 4) if other is None else followed(other, deepest - 1)
        return _combined(kind, found, second, told)
    if kind == "normalmap":
        scale = node.getInput("scale")
        if scale is not None and set(followed(scale, deepest - 1).bias[:2]) != {1.0}:
            raise UnreadNodeError(f"the scale of {told}")
    if kind == "extract":
        index = node.getInput("index")
        return found.component(0 if index is None else int(constant_of(index).bias[0]))
    if kind.startswith("separate"):
        letter = port.getOutputString()[-1:]
        return found.component(max("rgba".find(letter), "xyzw".find(letter), 0))
    return found


def _combined(kind: str, first: NodeValue, second: NodeValue, told: str) -> NodeValue:
    if second.image is not None and first.image is None and kind in ("multiply", "add"):
        first, second = second, first
    by = second.bias
    if second.image is not None or (kind == "divide" and 0.0 in by):
        raise UnreadNodeError(told)
    x, y, z, w = by
    if kind == "multiply":
        return first.affine(by, ZEROS)
    if kind == "divide":
        return first.affine((1.0 / x, 1.0 / y, 1.0 / z, 1.0 / w), ZEROS)
    if kind == "add":
        return first.affine(ONES, by)
    if kind == "subtract":
        return first.affine(ONES, (-x, -y, -z, -w))
    return first.affine((-1.0, -1.0, -1.0, -1.0), by)


def _image(node: Any, output: str) -> NodeValue:
    channel = {"r": "r", "g": "g", "b": "b", "a": "a", "outa": "a"}.get(output, "rgb")
    if node.getType() == "float":
        channel = "r"
    file = node.getInput("file")
    if file is None or "<" in source_of(file)[0].getValueString().replace(UDIM, ""):
        raise UnreadNodeError(f"the file, or the tiles, of the node {node.getName()}")
    placing(node)
    value = NodeValue(image=node, channel="rgb")
    for name in ("color", "geomcolor", "factor", "scale", "bias"):
        factor = node.getInput(name)
        if factor is None or (name in ("scale", "bias") and node.getCategory() != "UsdUVTexture"):
            continue
        found = followed(factor)
        if found.image is not None:
            raise UnreadNodeError(f"{name} of the node {node.getName()} from a picture")
        scale, bias = (ONES, found.bias) if name == "bias" else (found.bias, ZEROS)
        value = value.affine(scale, bias)
    return value if channel == "rgb" else value.component("rgba".index(channel))


_Pair = tuple[float, float]
#: As of UsdTransform2d: scale, rotation (degrees, counter-clockwise), translation.
_Step = tuple[_Pair, float, _Pair]


def placing(image: Any) -> tuple[str, list[_Step]]:
    """Reads the primvar of coordinates, and the steps from there.

    Raises:
        UnreadNodeError: Coordinates of a second set, or of another node.
    """
    steps: list[_Step] = []
    own = image.getCategory()
    if own == "tiledimage":
        (across, up), (right, top) = _pair(image, "uvtiling", 1.0), _pair(image, "uvoffset", 0.0)
        tile, size = (_pair(image, f"realworld{kind}size", 1.0) for kind in ("tile", "image"))
        ports = (image.getInput(f"realworld{kind}size") for kind in ("tile", "image"))
        units = {"" if port is None else port.getAttribute("unit") for port in ports}
        if len(units) > 1 or 0.0 in size:
            raise UnreadNodeError(f"the size in the world of the node {image.getName()}")
        x, y = tile[0] / size[0], tile[1] / size[1]
        steps.append(((across * x, up * y), 0.0, (-right * x, -top * y)))
    elif own.startswith("gltf_"):
        _require_unplaced(image, "scale", 1.0)
        _require_unplaced(image, "offset", 0.0)
        _require_unplaced(image, "rotate", 0.0)
    port = image.getInput("st" if own == "UsdUVTexture" else "texcoord")
    while port is not None and len(steps) < DEEPEST:
        _, node = source_of(port)
        kind = "" if node is None else node.getCategory()
        told = "coordinates" if node is None else f"the node {node.getName()} ({kind})"
        port = None
        if kind == "place2d":
            steps += _placed(node)
            port = node.getInput("texcoord")
        elif kind == "UsdTransform2d":
            turn, translation = _pair(node, "rotation", 0.0)[0], _pair(node, "translation", 0.0)
            steps.append((_pair(node, "scale", 1.0), turn, translation))
            port = node.getInput("in")
        elif kind in ("UsdPrimvarReader", "geompropvalue"):
            name = node.getInput("varname" if kind == "UsdPrimvarReader" else "geomprop")
            if name is not None:
                return source_of(name)[0].getValueString() or "st", steps[::-1]
        elif kind != "texcoord" or _pair(node, "index", 0.0)[0] != 0.0:
            raise UnreadNodeError(told)
    return "st", steps[::-1]


def _placed(node: Any) -> list[_Step]:
    """Steps of place2d, the last first: R((x - pivot) / scale) - offset + pivot.

    Or R(x - pivot - offset) / scale + pivot. R turns clockwise.
    """
    scale, offset = _pair(node, "scale", 1.0), _pair(node, "offset", 0.0)
    pivot, after = _pair(node, "pivot", 0.0), _pair(node, "operationorder", 0.0)[0] == 0.0
    turn = -_pair(node, "rotate", 0.0)[0]
    if 0.0 in scale:
        raise UnreadNodeError(f"the scale of the node {node.getName()}")
    by = (1.0 / scale[0], 1.0 / scale[1])
    (px, py), (ox, oy) = pivot, offset
    if after:
        x, y = _turned((-px * by[0], -py * by[1]), turn)
        return [(by, turn, (x - ox + px, y - oy + py))]
    return [(by, 0.0, pivot), ((1.0, 1.0), turn, _turned((-px - ox, -py - oy), turn))]


def _turned(pair: _Pair, turn_deg: float) -> _Pair:
    angle = math.radians(turn_deg)
    c, s = (math.cos(angle), math.sin(angle)) if turn_deg else (1.0, 0.0)
    return c * pair[0] - s * pair[1], s * pair[0] + c * pair[1]


def _pair(node: Any, name: str, default: float) -> _Pair:
    port = node.getInput(name)
    value = NodeValue((default,) * 4) if port is None else followed(port)
    if value.image is not None:
        raise UnreadNodeError(f"{name} of the node {node.getName()}")
    return value.bias[0], value.bias[1]


def _require_unplaced(node: Any, name: str, neutral: float) -> None:
    if set(_pair(node, name, neutral)) != {neutral}:
        raise UnreadNodeError(f"{name} of the node {node.getName()}")
