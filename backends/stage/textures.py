"""Textures of a foreign UsdPreviewSurface as maps."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import Any, NamedTuple

from pxr import Usd, UsdShade

from scenec.backends.stage import values
from scenec.backends.stage.scene import Maps, Reading
from scenec.backends.stage.sources import Sources
from scenec.schemas import stage as names
from scenec.schemas.maps import COLORS
from scenec.schemas.udim import grid_of

#: Of a value that changes, the first.
FIRST = Usd.TimeCode.EarliestTime()
#: Inputs of UsdPreviewSurface by the kind of map they are.
INPUTS = {
    "base_color": "diffuseColor",
    "roughness": "roughness",
    "metallic": "metallic",
    "normal": "normal",
    "emission": "emissiveColor",
    "opacity": "opacity",
}
_CHANNELS = {"r": "r", "g": "g", "b": "b", "rgb": "r", "a": "a"}
_WRAPS = {"clamp": "clamp", "black": "clamp", "mirror": "mirror"}
_IDENTITY: tuple[float, ...] = (1.0, 0.0, 0.0, 0.0, 1.0, 0.0)
#: Of links from node to node: a network that goes in circles ends.
_DEEPEST = 8


class _TextureUv(NamedTuple):
    """Names a texture's primvar and the transform of its coordinates."""

    primvar: str
    transform: tuple[float, ...]


def texture_maps(shader: UsdShade.Shader, specular: bool, sources: Sources) -> Maps | None:
    """Maps of the textures that a UsdPreviewSurface reads, or None.

    A mesh has one set of texture coordinates here: textures at others than the first one's are left
    out. They repeat, whatever their wrap modes; only one of opacity goes on as it says.

    Args:
        shader: The surface.
        specular: Whether it is of the specular workflow, where ``metallic`` says nothing.
        sources: Of the stage. A texture that is missing is left out.

    Raises:
        StageError: A texture's file stands inside a package (usdz), or an input is not what it can
            be.
    """
    files: dict[str, Any] = {}
    readings: dict[str, Reading] = {}
    coordinates: _TextureUv | None = None
    flip_green = False
    wrap = ("repeat", "repeat")
    for kind, name in INPUTS.items():
        if kind == "metallic" and specular:
            continue
        texture, output = connected(shader, name)
        if texture is None or values.word(texture.GetIdAttr(), "") != "UsdUVTexture":
            continue
        own = _coordinates(texture)
        file = sources.picture(constant(texture, "file"), FIRST)
        if file is None or output not in _CHANNELS or coordinates not in (None, own):
            continue
        if output == "a" and kind != "opacity":
            continue
        coordinates = own
        files[kind] = file
        if kind == "normal":
            # Scale and bias say how 8 bits hold [-1, 1], and so which way y is.
            flip_green = _numbers(texture, "scale", (1.0, 1.0, 1.0))[1] < 0.0
        else:
            readings[kind] = _reading(texture, kind, _CHANNELS[output])
        if kind == "opacity":
            wrap = (_wrap(texture, "wrapS"), _wrap(texture, "wrapT"))
    if not files or coordinates is None:
        return None
    transform = coordinates.transform
    columns, rows = tiles = grid_of(files.values())
    if tiles != (1, 1):
        readings = {kind: replace(readings.get(kind, Reading()), tiles=tiles) for kind in files}
        transform = _after((1.0 / columns, 0.0, 0.0, 0.0, 1.0 / rows, 0.0), transform)
    return Maps(
        size_m=1.0,
        flip_green=flip_green,
        projection="uv",
        readings=tuple((k, reading) for k, reading in readings.items() if reading != Reading()),
        primvar=coordinates.primvar,
        uv_transform=transform,
        opacity_threshold=opacity_threshold(shader)[0] if "opacity" in files else 0.0,
        opacity_wrap=wrap,
        **files,
    )


def opacity_threshold(shader: UsdShade.Shader) -> tuple[float, bool]:
    """The least opacity that is not cut out, and whether the surface says so itself."""
    found = min(_numbers(shader, "opacityThreshold", (0.0,))[0], 1.0)
    return (found, True) if found > 0.0 else (names.OPACITY_THRESHOLD, False)


def _wrap(texture: UsdShade.Shader, name: str) -> str:
    return _WRAPS.get(values.word(constant(texture, name), "", FIRST), "repeat")


def _reading(texture: UsdShade.Shader, kind: str, channel: str) -> Reading:
    space = values.word(constant(texture, "sourceColorSpace"), "", FIRST)
    srgb = {"raw": False, "sRGB": True}.get(space)
    # Numbers are raw unless it is said that they are not; colors are where they are not floating.
    if srgb == (False if kind not in COLORS else None):
        srgb = None
    return Reading(
        channel,
        srgb,
        _numbers(texture, "scale", (1.0, 1.0, 1.0)),
        _numbers(texture, "bias", (0.0, 0.0, 0.0)),
    )


def _coordinates(texture: UsdShade.Shader) -> _TextureUv:
    """The primvar that a texture's ``st`` comes from, through any UsdTransform2d."""
    transform = _IDENTITY
    node, _ = connected(texture, "st")
    for _ in range(_DEEPEST):
        if node is None:
            break
        kind = values.word(node.GetIdAttr(), "")
        if kind == "UsdTransform2d":
            transform = _after(transform, _transform(node))
            node, _ = connected(node, "in")
        elif kind == "UsdPrimvarReader_float2":
            return _TextureUv(values.word(constant(node, "varname"), "st", FIRST), transform)
        else:
            break
    return _TextureUv("st", transform)


def _transform(node: UsdShade.Shader) -> tuple[float, ...]:
    """Its input * scale, turned counter-clockwise by rotation (degrees), + translation."""
    angle = math.radians(_numbers(node, "rotation", (0.0,))[0])
    across, up = _numbers(node, "scale", (1.0, 1.0))
    x, y = _numbers(node, "translation", (0.0, 0.0))
    cosine, sine = math.cos(angle), math.sin(angle)
    return (cosine * across, -sine * up, x, sine * across, cosine * up, y)


def _after(last: tuple[float, ...], first: tuple[float, ...]) -> tuple[float, ...]:
    a, b, c, d, e, f = last
    p, q, r, s, t, u = first
    return (a * p + b * s, a * q + b * t, a * r + b * u + c,
            d * p + e * s, d * q + e * t, d * r + e * u + f)  # fmt: skip


def connected(shader: UsdShade.Shader, name: str) -> tuple[UsdShade.Shader | None, str]:
    """The node that an input reads, and which output of it."""
    found = shader.GetInput(name)
    for attribute in UsdShade.Utils.GetValueProducingAttributes(found) if found else ():
        if UsdShade.Utils.GetType(attribute.GetName()) == UsdShade.AttributeType.Output:
            node = UsdShade.Shader(attribute.GetPrim())
            return (node or None), UsdShade.Utils.GetBaseNameAndType(attribute.GetName())[0]
    return None, ""


def constant(shader: UsdShade.Shader, name: str) -> Usd.Attribute | None:
    """An input, or the input of a material or node graph that it is connected to."""
    found = shader.GetInput(name)
    for attribute in UsdShade.Utils.GetValueProducingAttributes(found) if found else ():
        if UsdShade.Utils.GetType(attribute.GetName()) == UsdShade.AttributeType.Input:
            return attribute
    return None


def _numbers[T: tuple[float, ...]](shader: UsdShade.Shader, name: str, default: T) -> T:
    """Reads as many numbers of an input as the default has; returns that if there is no value."""
    attribute = constant(shader, name)
    if attribute is None:
        return default
    if len(default) == 1:
        return (values.number(attribute, default[0], FIRST),)  # type: ignore[return-value]
    # Scales and biases are of four, for textures without an alpha, too.
    found = values.vector(attribute, len(default), FIRST, of_more=True)
    return default if found is None else found  # type: ignore[return-value]
