"""glTF 2.0 files (Khronos) as models: what of their meshes is seen, and where nodes put it.

The format's unit is the meter and its upward axis y. What moves (skins, morph targets, animations)
is left at rest.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from scenec.compiler.assets.gltf_file import FOLLOWED, OF_LOOKS, GltfFile, natural
from scenec.compiler.assets.gltf_looks import GltfLooks
from scenec.compiler.assets.looks import NOT_FOLLOWED, VERTEX_ALPHA
from scenec.compiler.assets.parts import MeshFileError
from scenec.compiler.assets.shells import ParsedModel, Shell, placed, repeated
from scenec.compiler.assets.trimesh_file import sound
from scenec.compiler.geometry import affine
from scenec.compiler.geometry.poses import compose

_TRIANGLES, _STRIP, _FAN = 4, 5, 6


def read_gltf(file: Path, looks: bool) -> ParsedModel:
    """Reads a ``.glb`` or ``.gltf`` file with its buffers and, with its looks, its pictures.

    A part's path is the names of the nodes down to it.

    Raises:
        MeshFileError: It is not sound, needs what is not known, or a file is missing.
    """
    with sound(file.suffix.lower()):
        return _GltfScene(file).model(looks)


class _GltfScene(GltfFile):
    """A glTF document's meshes where its nodes put them."""

    def model(self, with_looks: bool) -> ParsedModel:
        """Its parts and materials, or its parts alone."""
        document = self.document
        notes = [
            f"its {what} are left out: it stands as at rest"
            for key, what in (("animations", "animations"), ("skins", "skins"))
            if document.get(key)
        ]
        notes += [
            f"its extension {name} {NOT_FOLLOWED}"
            for name in sorted(set(map(str, document.get("extensionsUsed", []))))
            if name not in FOLLOWED | OF_LOOKS
        ]
        looks = GltfLooks(self) if with_looks else None
        shells: dict[int, list[Shell]] = {}
        parts: list[Shell] = []
        for path, own, matrix, copies in _placed_meshes(document):
            if own not in shells:
                mesh = document["meshes"][own]
                shells[own] = [s for p in mesh["primitives"] for s in self._shell(p, looks, notes)]
            for shell in shells[own]:
                part = replace(shell, path=path)
                if copies is not None:
                    part = self._instances(part, copies)
                parts.append(placed(part, matrix))
        known = tuple(looks.known) if looks else ()
        companions, notes = tuple(self.companions), list(dict.fromkeys(notes))
        return ParsedModel(tuple(parts), known, 1.0, "y", companions, tuple(notes))

    def _instances(self, shell: Shell, attributes: dict[str, Any]) -> Shell:
        """Copies of a mesh in one, by the attributes of EXT_mesh_gpu_instancing."""
        counts = {self.document["accessors"][natural(i)]["count"] for i in attributes.values()}
        if len(counts) != 1:
            raise MeshFileError("a broken glTF file: attributes of instances of unequal number")
        (count,) = counts
        self._left -= count * len(shell.points)
        if self._left < 0:
            raise MeshFileError(f"a broken glTF file: {count} instances of {len(shell.points)}")
        columns = {
            key: self.values(attributes[key], kind).astype(np.float64)
            if key in attributes
            else rest
            for key, kind, rest in (
                ("TRANSLATION", "VEC3", np.zeros((count, 3))),
                ("ROTATION", "VEC4", np.tile([0.0, 0.0, 0.0, 1.0], (count, 1))),
                ("SCALE", "VEC3", np.ones((count, 3))),
            )
        }
        turns = columns["ROTATION"]
        if not (turns != 0.0).any(axis=1).all():
            raise MeshFileError("a broken glTF file: a rotation is 0 0 0 0, expected a quaternion")
        return repeated(shell, columns["TRANSLATION"], turns, columns["SCALE"])

    def _shell(
        self, primitive: dict[str, Any], looks: GltfLooks | None, notes: list[str]
    ) -> list[Shell]:
        mode, attributes = primitive.get("mode", _TRIANGLES), primitive["attributes"]
        if mode not in (_TRIANGLES, _STRIP, _FAN) or "POSITION" not in attributes:
            return []
        if primitive.get("targets"):
            notes.append("its morph targets are left out: it stands as at rest")
        self.unpack(primitive)
        points = self.values(attributes["POSITION"], "VEC3").astype(np.float64)
        if "indices" in primitive:
            corners = self.values(primitive["indices"], "SCALAR")[:, 0].astype(np.int64)
        else:
            corners = np.arange(len(points))
        faces = _triangles(corners, mode)
        if len(faces) and faces.max() >= len(points):
            raise MeshFileError(f"a face uses vertex {faces.max()} (from 0) of {len(points)}")
        if looks is None:
            return [Shell("", points, faces).compact()]
        uv: dict[str, NDArray] = {}
        sets = sorted(k for k in attributes if k.startswith("TEXCOORD_"))
        for key in sets:
            stored = self._per_point(attributes[key], len(points), "VEC2")
            # Theirs run down the picture.
            uv[key] = np.stack([stored[:, 0], 1.0 - stored[:, 1]], axis=1)[faces]
        normals = colors = None
        if "NORMAL" in attributes:
            normals = self._per_point(attributes["NORMAL"], len(points), "VEC3")[faces]
        if "COLOR_0" in attributes:
            colors = self._per_point(attributes["COLOR_0"], len(points), "VEC3", "VEC4")
            if colors.shape[1] == 4 and (colors[:, 3] < 1.0).any() and looks.sees_alpha(primitive):
                notes.append(VERTEX_ALPHA)
            colors = np.clip(np.nan_to_num(colors[:, :3]), 0.0, 1.0)[faces]
        number = looks.number(primitive["material"]) if "material" in primitive else -1
        owners = np.full(len(faces), number, np.int64)
        return [Shell("", points, faces, uv, normals, colors, owners).compact()]

    def _per_point(self, index: Any, count: int, *kinds: str) -> NDArray[np.float64]:
        values = self.values(index, *kinds).astype(np.float64)
        if len(values) != count:
            raise MeshFileError(
                f"a broken glTF file: {len(values)} values of an attribute for {count} vertices"
            )
        return values


def _triangles(corners: NDArray[np.int64], mode: int) -> NDArray[np.int64]:
    if mode == _TRIANGLES:
        return corners[: len(corners) - len(corners) % 3].reshape(-1, 3)
    i = np.arange(max(len(corners) - 2, 0))
    if mode == _STRIP:
        # Every other one is turned (glTF 2.0, 3.7.2.1).
        return np.stack([corners[i], corners[i + 1 + i % 2], corners[i + 2 - i % 2]], axis=1)
    return np.stack([corners[i + 1], corners[i + 2], corners[0 * i]], axis=1)


def _placed_meshes(
    document: dict[str, Any],
) -> Iterator[tuple[str, int, NDArray[np.float64], dict[str, Any] | None]]:
    """The meshes of the default scene, in the order of its nodes.

    Yields:
        Names of the nodes down to it, joined by ``/``; its index; where it stands, [4, 4]; the
        attributes of its instances, or None where it is one.

    Raises:
        MeshFileError: The nodes are no tree.
    """
    nodes = document.get("nodes", [])
    scenes = document.get("scenes")
    if scenes:
        roots = scenes[document.get("scene", 0)].get("nodes", [])
    else:
        children = {c for node in nodes for c in node.get("children", [])}
        roots = [i for i in range(len(nodes)) if i not in children]
    visited: set[int] = set()
    waiting = [(root, np.eye(4), "") for root in reversed(roots)]
    while waiting:
        index, parent, path = waiting.pop()
        if index in visited:
            raise MeshFileError(f"a broken glTF file: node {index} is in two places")
        visited.add(index)
        node = nodes[natural(index)]
        if node.get("extensions", {}).get("KHR_node_visibility", {}).get("visible") is False:
            continue
        matrix = compose(parent, _local(node))
        own = natural(node["mesh"]) if "mesh" in node else None
        name = node.get("name")
        if own is not None:
            name = name or document["meshes"][own].get("name")
        path = f"{path}/{name or f'node_{index}'}"
        if own is not None:
            told = node.get("extensions", {}).get("EXT_mesh_gpu_instancing")
            yield path, own, matrix, None if told is None else told["attributes"]
        waiting += [(child, matrix, path) for child in reversed(node.get("children", []))]


def _local(node: dict[str, Any]) -> NDArray[np.float64]:
    if "matrix" in node:
        # Stored column by column.
        return np.array(node["matrix"], np.float64).reshape(4, 4).T
    out = np.eye(4)
    out[:3, 3] = node.get("translation", (0.0, 0.0, 0.0))
    if "rotation" in node:
        x, y, z, w = map(float, node["rotation"])
        if x == y == z == w == 0.0:
            raise MeshFileError("a broken glTF file: a rotation is 0 0 0 0, expected a quaternion")
        out = compose(out, affine.of_quaternion(x, y, z, w))
    scale = np.eye(4)
    scale[[0, 1, 2], [0, 1, 2]] = node.get("scale", (1.0, 1.0, 1.0))
    return compose(out, scale)
