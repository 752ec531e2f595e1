"""glTF 2.0: one binary file a batch.

Instances by EXT_mesh_gpu_instancing, the first sample's suns by KHR_lights_punctual. Ids stand in
custom attributes, as EXT_instance_features and EXT_mesh_features have them: ``_FEATURE_ID_0`` of an
instance is the lowest 24 bits of its frame id (what float32 holds), ``_FEATURE_ID_1`` the others
where there are any; ``_FEATURE_ID_i`` of a vertex is its label of level i (in alphabetical order).
Vertices are split where labels or texture coordinates change. The root node turns z up into y up.
"""

from __future__ import annotations

import io
import math
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray
from PIL import Image

from scenec.schemas.codec import encode
from scenec.schemas.errors import OutputError
from scenec.schemas.files import atomic
from scenec.schemas.glb import ARRAY, INDICES, GlbBuffer
from scenec.schemas.model import Look, Mask, Model, Part, Placement, View
from scenec.schemas.picture import luminance
from scenec.schemas.quaternions import quaternions
from scenec.schemas.versions import version_of

_WRAPS = {"repeat": 10497, "clamp": 33071, "mirror": 33648}
#: Bits of an id that float32 holds.
_ID_BITS = 24
#: Cosine between axes of a matrix above which it is no rotation and scale.
_SHEAR = 1e-4
#: Pixels that a principal point may be off the middle without being said.
_OFF_CENTER = 0.5
#: A quarter turn about x: z up becomes y up.
_Y_UP = [-math.sqrt(0.5), 0.0, 0.0, math.sqrt(0.5)]


class ModelContent(NamedTuple):
    """Reports the content of a file.

    Attributes:
        triangles: Drawn, with those of each instance.
        instances: Of objects.
        losses: A line for each thing of the stage that it does not hold.
    """

    triangles: int
    instances: int
    losses: tuple[str, ...]


def write_gltf(model: Model, path: Path) -> ModelContent:
    """Writes ``path``, a .glb.

    Raises:
        OutputError: The file cannot be written, or would be larger than 4 GiB.
    """
    file = _GltfFile(model)
    file.build()
    try:
        chunks = file.buffer.chunks(file.json)
    except OutputError as error:
        raise OutputError(f"{path}: {error}") from None
    with atomic(path) as temporary, temporary.open("wb") as out:
        out.writelines(chunks)
    return ModelContent(model.triangles, model.instances, (*model.losses, *file.losses))


class _GltfFile:
    """A file in the making."""

    def __init__(self, model: Model) -> None:
        self._model = model
        self._levels = sorted(model.label_names)
        self.buffer = GlbBuffer()
        self.losses: list[str] = []
        self.json: dict[str, Any] = {
            "asset": {"version": "2.0", "generator": f"scenec {version_of()}"},
            "scene": 0,
            "scenes": [{"nodes": [0]}],
            "nodes": [],
            "meshes": [],
            "accessors": self.buffer.accessors,
            "bufferViews": self.buffer.views,
            "materials": [],
        }

    def build(self) -> None:
        """Fills ``json`` and ``buffer``."""
        model = self._model
        origin = model.origin.tolist()
        extras: dict[str, Any] = {
            "taxonomies": {
                level: {str(i): text for i, text in sorted(model.label_names[level].items())}
                for level in self._levels
            },
        }
        if model.georeference is not None:
            # Of the world, whose origin and axes the root's children have after its own turn.
            extras["georeference"] = encode(model.georeference)
        root: dict[str, Any] = {
            "name": model.name,
            "rotation": _Y_UP,
            "translation": [origin[0], origin[2], -origin[1]],
            "extras": extras,
        }
        self.json["nodes"].append(root)
        self._materials()
        primitives = [self._primitive(part) for part in model.parts]
        for placement in model.placements:
            self._placement(placement, primitives)
        self._suns()
        self._cameras()
        extras["losses"] = [*model.losses, *self.losses]
        root["children"] = list(range(1, len(self.json["nodes"])))
        self.json = {name: value for name, value in self.json.items() if value != []}

    def _uses(self, extension: str) -> None:
        used = self.json.setdefault("extensionsUsed", [])
        if extension not in used:
            used.append(extension)
            used.sort()

    def _floats(self, values: NDArray[Any], target: int | None = None) -> int:
        return self.buffer.accessor(np.asarray(values, np.float32), target)

    # Looks.

    def _materials(self) -> None:
        for look in self._model.looks:
            rough: dict[str, Any] = {
                "baseColorFactor": [*np.clip(look.base_color, 0, 1).tolist(), 1.0],
                "metallicFactor": _unit(look.metallic),
                "roughnessFactor": _unit(look.roughness),
            }
            if look.picture is not None or look.mask is not None:
                rough["baseColorTexture"] = {"index": self._texture(look)}
            material = {
                "name": look.name,
                "pbrMetallicRoughness": rough,
                "doubleSided": True,
            }
            if look.mask is not None:
                material |= {"alphaMode": "MASK", "alphaCutoff": look.mask.threshold}
            extensions: dict[str, Any] = {}
            strength = max(look.emission)
            if strength > 0.0:
                material["emissiveFactor"] = [v / max(strength, 1.0) for v in look.emission]
            if strength > 1.0:
                extensions["KHR_materials_emissive_strength"] = {"emissiveStrength": strength}
            if look.diffuse_transmission > 0.0:
                through: dict[str, Any] = {
                    "diffuseTransmissionFactor": _unit(look.diffuse_transmission),
                    "diffuseTransmissionColorFactor": rough["baseColorFactor"][:3],
                }
                if "baseColorTexture" in rough:
                    through["diffuseTransmissionColorTexture"] = rough["baseColorTexture"]
                extensions["KHR_materials_diffuse_transmission"] = through
            if extensions:
                material["extensions"] = extensions
            for extension in extensions:
                self._uses(extension)
            self.json["materials"].append(material)

    def _texture(self, look: Look) -> int:
        wrap, kind = ("repeat", "repeat"), "image/png"
        if look.mask is not None:
            data, wrap = _png(self._masked(look, look.mask)), look.mask.wrap
        elif isinstance(look.picture, Path):
            data, kind = _picture_file(look.picture)
        else:
            assert look.picture is not None
            data, wrap = _png(Image.fromarray(look.picture)), ("clamp", "clamp")
        samplers = self.json.setdefault("samplers", [])
        across, up = (_WRAPS[side] for side in wrap)
        sampler = {"magFilter": 9729, "minFilter": 9987, "wrapS": across, "wrapT": up}
        if sampler not in samplers:
            samplers.append(sampler)
        images = self.json.setdefault("images", [])
        images.append({"name": look.name, "bufferView": self.buffer.view(data), "mimeType": kind})
        textures = self.json.setdefault("textures", [])
        textures.append({"sampler": samplers.index(sampler), "source": len(images) - 1})
        return len(textures) - 1

    def _masked(self, look: Look, mask: Mask) -> Image.Image:
        """The look's colors with its mask as alpha, of as many texels as the larger of the two."""
        alpha = Image.fromarray(mask.opacity)
        if isinstance(look.picture, Path):
            with Image.open(look.picture) as picture:
                colors = picture.convert("RGB")
        elif look.picture is not None:
            colors = Image.fromarray(look.picture)
        else:
            colors = Image.new("RGB", alpha.size, (255, 255, 255))
        size = max(alpha.width, colors.width), max(alpha.height, colors.height)
        if size != alpha.size:
            self.losses.append(
                f"opacity: the mask of {look.name}, {alpha.width} x {alpha.height} texels, is "
                f"resampled to {size[0]} x {size[1]}: its contour moves by less than a texel"
            )
        found = colors.resize(size, Image.Resampling.BILINEAR)
        found.putalpha(alpha.resize(size, Image.Resampling.BILINEAR))
        return found

    # Geometry.

    def _primitive(self, part: Part) -> dict[str, Any] | None:
        """A part as a primitive; None where it has no triangles."""
        if not len(part.faces):
            return None
        vertex, corner, faces = split(part, self._levels)
        narrow = np.uint16 if len(vertex) < 65535 else np.uint32
        attributes = {
            "POSITION": self.buffer.accessor(
                part.points[vertex].astype(np.float32), ARRAY, bounds=True
            )
        }
        if part.normals is not None:
            normals = part.normals[vertex].astype(np.float64)
            length = np.sqrt((normals * normals).sum(axis=1, keepdims=True))
            if (length > 0.0).all():
                attributes["NORMAL"] = self._floats(normals / length, ARRAY)
        if part.uv is not None:
            # glTF's v runs down.
            uv = part.uv.reshape(-1, 2)[corner]
            uv = np.column_stack([uv[:, 0], 1.0 - uv[:, 1]])
            attributes["TEXCOORD_0"] = self._floats(uv, ARRAY)
        if part.colors is not None:
            attributes["COLOR_0"] = self._floats(np.clip(part.colors[vertex], 0, 1), ARRAY)
        sets = []
        for number, level in enumerate(self._levels):
            if level in part.labels:
                ids = part.labels[level][corner // 3]
                attributes[f"_FEATURE_ID_{number}"] = self._floats(ids, ARRAY)
                count = int(ids.max()) + 1
                sets.append({"featureCount": count, "attribute": number, "label": level})
        primitive: dict[str, Any] = {
            "attributes": attributes,
            "indices": self.buffer.accessor(faces.ravel().astype(narrow), INDICES),
            "material": part.look,
        }
        if sets:
            self._uses("EXT_mesh_features")
            primitive["extensions"] = {"EXT_mesh_features": {"featureIds": sets}}
        return primitive

    def _placement(self, placement: Placement, primitives: list[dict[str, Any] | None]) -> None:
        own = [primitives[part] for part in placement.parts if primitives[part] is not None]
        if not own:
            return
        path = self._model.parts[placement.parts[0]].path
        self.json["meshes"].append({"name": path, "primitives": own})
        node: dict[str, Any] = {"name": path, "mesh": len(self.json["meshes"]) - 1}
        position, turn, scale, sheared = decomposed(placement.to_world)
        if sheared:
            self.losses.append(
                f"{path}: {sheared:,} of its places are sheared: the nearest turn and scale stand "
                "for them"
            )
        if not placement.owner:
            node |= {
                "translation": position[0].tolist(),
                "rotation": turn[0].tolist(),
                "scale": scale[0].tolist(),
            }
            self.json["nodes"].append(node)
            return
        ids = placement.ids.astype(np.uint32)
        attributes = {
            "TRANSLATION": self._floats(position),
            "ROTATION": self._floats(turn),
            "SCALE": self._floats(scale),
            "_FEATURE_ID_0": self._floats(ids & ((1 << _ID_BITS) - 1)),
        }
        if (ids >> _ID_BITS).any():
            attributes["_FEATURE_ID_1"] = self._floats(ids >> _ID_BITS)
        self._uses("EXT_mesh_gpu_instancing")
        # Who does not know it would show one instance at the origin.
        self.json["extensionsRequired"] = ["EXT_mesh_gpu_instancing"]
        node["extras"] = {"owner": placement.owner}
        node["extensions"] = {"EXT_mesh_gpu_instancing": {"attributes": attributes}}
        if count := len(np.unique(ids[ids > 0])):
            self._uses("EXT_instance_features")
            feature = {"attribute": 0, "featureCount": count, "nullFeatureId": 0}
            node["extensions"]["EXT_instance_features"] = {
                "featureIds": [{**feature, "label": "instance"}]
            }
        self.json["nodes"].append(node)

    # Suns and cameras.

    def _suns(self) -> None:
        suns = self._model.suns[0] if self._model.suns else ()
        if not suns:
            return
        if any(
            len(others) != len(suns)
            or any(not np.array_equal(a, b) for (a, _), (b, _) in zip(others, suns, strict=True))
            for others in self._model.suns
        ):
            self.losses.append("light: suns stand where they are at the first sample")
        lights = []
        total = sum(float(luminance(irradiance)) for _, irradiance in suns)
        for number, (to_light, irradiance) in enumerate(suns):
            most = float(irradiance.max())
            own = float(luminance(irradiance))
            color = irradiance / most if most > 0.0 else np.ones(3)
            shown = own / total * math.pi / float(luminance(color)) if total > 0.0 else 0.0
            lights.append({"type": "directional", "color": color.tolist(), "intensity": shown})
            self.json["nodes"].append(
                {
                    "name": f"sun_{number}",
                    "rotation": _toward(to_light).tolist(),
                    "extensions": {"KHR_lights_punctual": {"light": number}},
                    "extras": {"irradiance": irradiance.tolist()},
                }
            )
        self._uses("KHR_lights_punctual")
        self.json["extensions"] = {"KHR_lights_punctual": {"lights": lights}}
        self.losses.append(
            f"light: suns together are scaled from {total:.4g} to pi, so that what is white and "
            "faces them shows 1; their true irradiance is in extras"
        )

    def _cameras(self) -> None:
        off = [view.name for view in self._model.views if _off_center(view) > _OFF_CENTER]
        if off:
            self.losses.append(
                f"cameras: principal points off the middle are in extras alone ({', '.join(off)})"
            )
        channels: list[dict[str, Any]] = []
        samplers: list[dict[str, Any]] = []
        moving = any(len(view.poses) > 1 for view in self._model.views)
        times = self.buffer.accessor(self._times(), bounds=True) if moving else -1
        for view in self._model.views:
            k = view.intrinsics
            cameras = self.json.setdefault("cameras", [])
            cameras.append(
                {
                    "name": view.name,
                    "type": "perspective",
                    "perspective": {
                        "yfov": 2.0 * math.atan(view.height / (2.0 * k[1, 1])),
                        "aspectRatio": view.width * k[1, 1] / (view.height * k[0, 0]),
                        "znear": 0.01,
                    },
                    "extras": {"resolution": [view.width, view.height], "K": k.tolist()},
                }
            )
            # glTF's cameras look along -z with y up, ours along z with y down.
            poses = view.poses[:, :3] * np.array([1.0, -1.0, -1.0, 1.0])
            position, turn, _, _ = decomposed(poses)
            node = len(self.json["nodes"])
            self.json["nodes"].append(
                {
                    "name": view.name,
                    "camera": len(cameras) - 1,
                    "translation": position[0].tolist(),
                    "rotation": turn[0].tolist(),
                }
            )
            if len(poses) < 2:
                continue
            for name, values in (("translation", position), ("rotation", turn)):
                target = {"node": node, "path": name}
                channels.append({"sampler": len(samplers), "target": target})
                samplers.append(
                    {"input": times, "output": self._floats(values), "interpolation": "STEP"}
                )
        if channels:
            self.json["animations"] = [
                {"name": "samples", "channels": channels, "samplers": samplers}
            ]

    def _times(self) -> NDArray[np.float32]:
        """Seconds from the first sample; numbers of samples where float32 does not tell them."""
        times = (self._model.times - self._model.times[:1]).astype(np.float32)
        if (np.diff(times) > 0.0).all():
            return times
        self.losses.append("cameras: the animation's seconds are numbers of samples")
        return np.arange(len(times), dtype=np.float32)


def _unit(value: float) -> float:
    return min(1.0, max(0.0, value))


def _off_center(view: View) -> float:
    k = view.intrinsics
    return max(abs(float(k[0, 2]) - view.width / 2), abs(float(k[1, 2]) - view.height / 2))


def split(
    part: Part, levels: list[str]
) -> tuple[NDArray[np.int64], NDArray[np.int64], NDArray[np.int64]]:
    """Vertices apart where labels or texture coordinates differ.

    Returns:
        Of each new vertex the old one and one of its corners (3 * face + corner), [k]; the faces
        with new vertices, [m, 3].
    """
    key = part.faces.ravel().astype(np.int64)
    per_corner: list[NDArray[Any]]
    per_corner = [np.repeat(part.labels[level], 3) for level in levels if level in part.labels]
    if part.uv is not None:
        per_corner.append(np.ascontiguousarray(part.uv.reshape(-1, 2)).view(np.int64).ravel())
    for values in per_corner:
        if (values == values[0]).all():
            continue
        _, number = np.unique(values, return_inverse=True)
        _, key = np.unique(key * (int(number.max()) + 1) + number, return_inverse=True)
    _, corner, faces = np.unique(key, return_index=True, return_inverse=True)
    return part.faces.ravel()[corner].astype(np.int64), corner, faces.reshape(-1, 3)


def decomposed(
    matrices: NDArray[np.float64],
) -> tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.float64], int]:
    """Positions [n, 3], unit quaternions (x, y, z, w) [n, 4] and scales [n, 3] of [n, 3, 4].

    A mirrored matrix has a negative first scale. The last value counts matrices that are sheared,
    of which this is not all.
    """
    linear = matrices[:, :, :3]
    scale = np.sqrt((linear * linear).sum(axis=1))
    axes = np.where(scale[:, None, :] > 0.0, linear / np.where(scale, scale, 1.0)[:, None, :], 0.0)
    flat = (scale == 0.0).any(axis=1)
    axes[flat] = np.eye(3)
    cosines = [
        np.abs((axes[:, :, i] * axes[:, :, j]).sum(axis=1)) for i, j in ((0, 1), (0, 2), (1, 2))
    ]
    sheared = np.max(cosines, axis=0) > _SHEAR
    if sheared.any():
        # The nearest rotation.
        u, _, vt = np.linalg.svd(axes[sheared])
        axes[sheared] = u @ vt
    mirrored = (np.cross(axes[:, :, 0], axes[:, :, 1]) * axes[:, :, 2]).sum(axis=1) < 0.0
    axes[mirrored, :, 0] *= -1.0
    scale = np.where(mirrored[:, None] & (np.arange(3) == 0), -scale, scale)
    return matrices[:, :, 3], quaternions(axes), scale, int(sheared.sum())


def _toward(to_light: NDArray[np.float64]) -> NDArray[np.float64]:
    """The turn that brings +z to a direction: lights shine along -z."""
    z = to_light / np.linalg.norm(to_light)
    aside = np.array([1.0, 0.0, 0.0]) if abs(z[0]) < 0.9 else np.array([0.0, 1.0, 0.0])
    x = np.cross(aside, z)
    x /= np.linalg.norm(x)
    return quaternions(np.stack([x, np.cross(z, x), z], axis=1)[None])[0]


def _png(picture: Image.Image) -> bytes:
    held = io.BytesIO()
    picture.save(held, "PNG")
    return held.getvalue()


def _picture_file(path: Path) -> tuple[bytes, str]:
    """A file as it is, where it is what glTF takes: PNG or JPEG of 8 bits."""
    with Image.open(path) as picture:
        if picture.mode in ("L", "RGB", "RGBA") and picture.format in ("PNG", "JPEG"):
            kind = "image/png" if picture.format == "PNG" else "image/jpeg"
            return path.read_bytes(), kind
        return _png(picture.convert("RGB")), "image/png"
