"""Writes binary glTF 2.0 (Khronos) of named parts, and compares such files.

Models are made with z up and written with y up, as the format asks: (x, y, z) becomes (x, z, -y).
"""

from __future__ import annotations

import io
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray
from PIL import Image

from scenec.schemas.glb import ARRAY, INDICES, GlbBuffer, decode_glb
from scenec.schemas.quaternions import rotation_entries

#: Decimals that coordinates are rounded to, so that the last bit of a sine reaches no byte.
_DECIMALS = {"POSITION": 5, "TEXCOORD_0": 4, "TRANSLATION": 4, "SCALE": 3}
_BYTES, _SPECULAR = "KHR_mesh_quantization", "KHR_materials_specular"
_THROUGH = "KHR_materials_diffuse_transmission"
_COPIES = "EXT_mesh_gpu_instancing"
#: Whose materials are smoother than this mirrors: coarse normals would show in it.
_MIRROR = 0.1
#: Attributes of instances, not of vertices.
_PLACES = ("TRANSLATION", "SCALE")
#: By how much values of two machines may differ: integers that stand for normals.
_ROUNDING = {"|i1": 1.0, "<i2": 8.0}


@dataclass(frozen=True)
class Look:
    """A material: metallic-roughness of glTF.

    Attributes:
        color: Base color, linear Rec.709.
        roughness: As glTF has it: GGX's alpha is its square.
        metallic: From 0 to 1.
        picture: PNG that multiplies the color, or None.
        specular: Factor on what a dielectric reflects (KHR_materials_specular): 0 is diffuse alone.
        through: Share of the diffuse light that leaves a sheet on its far side, of the same color.
    """

    color: tuple[float, float, float]
    roughness: float
    metallic: float = 0.0
    picture: bytes | None = None
    specular: float = 1.0
    through: float = 0.0


@dataclass(frozen=True)
class Part:
    """One mesh of one material; meters, z up.

    Attributes:
        points: float64 [n, 3].
        faces: int64 [m, 3], counter-clockwise seen from outside.
        normals: Shading normals, float64 [n, 3].
        material: Name of a look.
        uv: Texture coordinates, v down as in glTF, float64 [n, 2], or None.
    """

    points: NDArray[np.float64]
    faces: NDArray[np.int64]
    normals: NDArray[np.float64]
    material: str
    uv: NDArray[np.float64] | None = None


class Places(NamedTuple):
    """Where copies of a mesh stand.

    Attributes:
        positions: Of their origins, float64 [k, 3].
        turns: Quaternions (x, y, z, w), float64 [k, 4].
        sizes: Scales, float64 [k].
    """

    positions: NDArray[np.float64]
    turns: NDArray[np.float64]
    sizes: NDArray[np.float64]

    def applied(self, points: NDArray[np.float64]) -> NDArray[np.float64]:
        """Points of one copy as those of all, float64 [k, n, 3]."""
        x, y, z, w = self.turns.T
        rows = np.reshape(rotation_entries(x, y, z, w, 2.0), (3, 3, -1))
        turned = np.einsum("ijk,nj->kni", rows, points)
        return turned * self.sizes[:, None, None] + self.positions[:, None]


class Copies(NamedTuple):
    """A mesh that stands in many places; several may share a name, and so make one part."""

    name: str
    part: Part
    places: Places


@dataclass(frozen=True)
class Model:
    """What one file holds: parts by name, looks by name, and parts that are copies of a mesh."""

    parts: dict[str, Part]
    looks: dict[str, Look]
    copies: tuple[Copies, ...] = ()

    def meshes(self) -> list[tuple[str, Part, Places | None]]:
        """All meshes: name, one of it, and where its copies stand."""
        return [*((name, part, None) for name, part in self.parts.items()), *self.copies]

    def size(self) -> NDArray[np.float64]:
        """Extents along x, y and z, float64 [3]."""
        points = np.concatenate(
            [
                part.points if places is None else places.applied(part.points).reshape(-1, 3)
                for _, part, places in self.meshes()
            ]
        )
        return np.ptp(points, axis=0)


@dataclass(frozen=True)
class Card:
    """What a file says of itself.

    Attributes:
        about: What it is, one sentence.
        label: Suggested label of the whole on the level ``class``.
        license: SPDX identifier.
    """

    about: str
    label: str
    license: str = "CC0-1.0"


def triangles(model: Model) -> int:
    """How many of them a model has."""
    return sum(
        len(part.faces) * (1 if places is None else len(places.sizes))
        for _, part, places in model.meshes()
    )


class _Buffer(GlbBuffer):
    """Values as these files have them: rounded, and small."""

    def floats(self, name: str, values: NDArray[np.float64]) -> int:
        # Adding zero turns -0 into 0.
        rows = (np.round(values, _DECIMALS[name]) + 0.0).astype("<f4")
        return self.accessor(rows, None if name in _PLACES else ARRAY, bounds=name == "POSITION")

    def directions(self, normals: NDArray[np.float64], fine: bool) -> int:
        """Normals as signed integers (KHR_mesh_quantization).

        Of eight bits, to a quarter of a degree or so; ``fine`` ones, for mirrors, of sixteen.
        """
        most, stored = (32767.0, "<i2") if fine else (127.0, "i1")
        return self.accessor(np.round(most * normals).astype(stored), ARRAY, normalized=True)

    def places(self, places: Places) -> dict[str, int]:
        """The attributes of instances: turns of 16 bits, as the extension allows."""
        x, y, z, w = places.turns.T
        turns = np.round(32767.0 * np.stack([x, z, -y, w], axis=1)).astype("<i2")
        stored = self.view(turns.tobytes())
        return {
            "TRANSLATION": self.floats("TRANSLATION", _y_up(places.positions)),
            "ROTATION": self.accessor(turns, normalized=True, view=stored),
            "SCALE": self.floats("SCALE", np.repeat(places.sizes[:, None], 3, axis=1)),
        }

    def indices(self, faces: NDArray[np.int64], points: int) -> int:
        if points > 65535:
            raise ValueError(f"{points} points in one part: 16-bit indices reach 65535")
        return self.accessor(faces.ravel().astype("<u2"), INDICES)


def encode(model: Model, card: Card) -> bytes:
    """The file of a model: one node, one mesh and one primitive a part, all of the part's name."""
    buffer = _Buffer()
    extras: dict[str, Any] = {"about": card.about, "label": card.label, "license": card.license}
    extensions, meshes = [_BYTES], model.meshes()
    if model.copies:
        extensions.append(_COPIES)
        # Extents of the whole: those of accessors are of one copy.
        extras["size_m"] = [round(float(extent), 3) for extent in model.size()]
    document: dict[str, Any] = {
        "asset": {
            "version": "2.0",
            # As it stands in the files that ship: their bytes stay.
            "generator": "scenec tools/models",
            "copyright": f"The scenec authors, {card.license}",
            "extras": extras,
        },
        "extensionsUsed": list(extensions),
        "extensionsRequired": list(extensions),
        "scene": 0,
        "scenes": [{"nodes": list(range(len(meshes)))}],
        "nodes": [],
        "meshes": [],
        "materials": [],
    }
    used = list(dict.fromkeys(part.material for _, part, _ in meshes))
    #: Twigs and their leaves stand in the same places.
    stored: dict[int, dict[str, int]] = {}
    for number, (name, part, places) in enumerate(meshes):
        attributes = {
            "POSITION": buffer.floats("POSITION", _y_up(part.points)),
            "NORMAL": buffer.directions(
                _y_up(part.normals), model.looks[part.material].roughness < _MIRROR
            ),
        }
        if part.uv is not None:
            attributes["TEXCOORD_0"] = buffer.floats("TEXCOORD_0", part.uv)
        primitive = {
            "attributes": attributes,
            "indices": buffer.indices(part.faces, len(part.points)),
            "material": used.index(part.material),
        }
        document["meshes"].append({"name": name, "primitives": [primitive]})
        node: dict[str, Any] = {"name": name, "mesh": number}
        if places is not None:
            if id(places) not in stored:
                stored[id(places)] = buffer.places(places)
            node["extensions"] = {_COPIES: {"attributes": stored[id(places)]}}
        document["nodes"].append(node)
    pictures: list[bytes] = []
    for name in used:
        look = model.looks[name]
        surface: dict[str, Any] = {
            "baseColorFactor": [*look.color, 1.0],
            "metallicFactor": look.metallic,
            "roughnessFactor": look.roughness,
        }
        if look.picture is not None:
            if look.picture not in pictures:
                pictures.append(look.picture)
                view = buffer.view(look.picture)
                image = {"bufferView": view, "mimeType": "image/png", "name": name}
                document.setdefault("images", []).append(image)
                document.setdefault("textures", []).append({"source": len(pictures) - 1})
            surface["baseColorTexture"] = {"index": pictures.index(look.picture)}
        material = {"name": name, "pbrMetallicRoughness": surface, "doubleSided": True}
        more: dict[str, Any] = {}
        if look.specular != 1.0:
            more[_SPECULAR] = {"specularFactor": look.specular}
        if look.through > 0.0:
            more[_THROUGH] = {
                "diffuseTransmissionFactor": look.through,
                "diffuseTransmissionColorFactor": list(look.color),
            }
        if more:
            material["extensions"] = more
            document["extensionsUsed"] += [n for n in more if n not in document["extensionsUsed"]]
        document["materials"].append(material)
    return b"".join(buffer.chunks(document))


def decode(data: bytes) -> tuple[dict[str, Any], list[NDArray[Any]], list[NDArray[np.uint8]]]:
    """Of a file that ``encode`` made: its JSON, its accessors' values, its pictures."""
    document, views, values = decode_glb(data)
    pictures = [
        np.asarray(Image.open(io.BytesIO(views[image["bufferView"]])))
        for image in document.get("images", [])
    ]
    return document, values, pictures


def same(one: bytes, other: bytes) -> bool:
    """Whether two files of ``encode`` hold the same model: equal, or one step of rounding apart."""
    if one == other:
        return True
    (a, a_values, a_pictures), (b, b_values, b_pictures) = decode(one), decode(other)
    return (
        _structure(a) == _structure(b)
        and all(
            x.shape == y.shape
            and np.abs(x.astype(np.float64) - y).max() <= _ROUNDING.get(x.dtype.str, 2e-4)
            for x, y in zip(a_values, b_values, strict=True)
        )
        and all(np.array_equal(x, y) for x, y in zip(a_pictures, b_pictures, strict=True))
    )


def _structure(document: dict[str, Any]) -> dict[str, Any]:
    """What must be equal: all but extents, and the places that the length of a PNG moves."""
    out = {key: value for key, value in document.items() if key not in ("bufferViews", "buffers")}
    out["accessors"] = [
        {key: value for key, value in accessor.items() if key not in ("min", "max")}
        for accessor in document["accessors"]
    ]
    return out


def _y_up(vectors: NDArray[np.float64]) -> NDArray[np.float64]:
    return np.stack([vectors[:, 0], vectors[:, 2], -vectors[:, 1]], axis=1)
