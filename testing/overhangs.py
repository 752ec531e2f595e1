"""Meshes with overhangs, and how each format writes them: for tests of terrain that is a mesh."""

from __future__ import annotations

import json
import struct
from pathlib import Path

import numpy as np

FORMATS = ("obj", "ply", "glb", "usda", "usdc")


def shelter(n: int = 48, size_m: float = 20.0) -> tuple[np.ndarray, np.ndarray]:
    """A rock shelter under a cliff: points float64 [n * n, 3], quads int64 [m, 4]; z up, meters.

    One sheet over a square plan, folded in its middle part (in y): floor, back wall, ceiling, lip,
    plateau. Coordinates are multiples of 1/1024, so that float32 holds them.
    """
    s = np.linspace(0.0, 1.0, n)
    #       floor                wall          ceiling          lip           plateau
    fold_x = [-1.0, -0.55, -0.1, 0.22, 0.38, 0.40, 0.28, 0.02, -0.14, -0.16, 0.0, 0.4, 1.0]
    fold_z = [0.0, -0.01, 0.01, 0.02, 0.08, 0.18, 0.25, 0.25, 0.27, 0.35, 0.41, 0.44, 0.45]
    at = np.linspace(0.0, 1.0, len(fold_x))
    ramp_x, ramp_z = 2.0 * s - 1.0, 0.45 * (3.0 * s**2 - 2.0 * s**3)
    v = np.linspace(-1.0, 1.0, n)
    w = np.clip(1.2 - 1.6 * np.abs(v), 0.0, 1.0)
    w = (w * w * (3.0 - 2.0 * w))[:, None]
    x = w * np.interp(s, at, fold_x) + (1.0 - w) * ramp_x
    z = w * np.interp(s, at, fold_z) + (1.0 - w) * ramp_z
    y = np.broadcast_to(v[:, None], x.shape)
    inner = (1.0 - x**2) * (1.0 - y**2)
    z = z + 0.012 * np.sin(9.0 * x + 4.0 * y + 3.0 * z) + 0.008 * np.sin(17.0 * y - 5.0 * x)
    x = x + 0.025 * inner * np.sin(7.0 * y + 9.0 * z)
    points = np.stack([x, y, z], axis=-1).reshape(-1, 3) * (0.5 * size_m)
    points = np.round(points * 1024.0) / 1024.0
    j, i = np.meshgrid(np.arange(n - 1), np.arange(n - 1), indexing="ij")
    a = (j * n + i).ravel()
    return points, np.stack([a, a + 1, a + n + 1, a + n], axis=1)


def triangles(quads: np.ndarray) -> np.ndarray:
    """Quads as the readers split them."""
    return quads[:, [0, 1, 2, 0, 2, 3]].reshape(-1, 3)


def write(path: Path, points: np.ndarray, polygons: np.ndarray) -> Path:
    """A mesh file of the format that the path's ending names; z up and meters where it says so."""
    writer = {".obj": _obj, ".ply": _ply, ".glb": _glb}.get(path.suffix, _usd)
    writer(path, points, polygons)
    return path


def keys(suffix: str) -> dict[str, object]:
    """What a cfg must say of a file that ``write`` wrote."""
    return {"unit_m": 1, "up": "z"} if suffix in ("obj", "ply") else {}


def _obj(path: Path, points: np.ndarray, polygons: np.ndarray) -> None:
    lines = ["# a shelter", "mtllib none.mtl", "o shelter", "vt 0 0", "vn 0 0 1", "usemtl rock"]
    lines += [f"v {x!r} {y!r} {z!r}" for x, y, z in points.tolist()]
    lines += ["f " + " ".join(f"{k + 1}/1/1" for k in polygon) for polygon in polygons.tolist()]
    path.write_text("\n".join(lines) + "\n")


def _ply(path: Path, points: np.ndarray, polygons: np.ndarray) -> None:
    sides = polygons.shape[1]
    header = (
        f"ply\nformat binary_little_endian 1.0\ncomment a shelter\nelement vertex {len(points)}\n"
        "property float x\nproperty float y\nproperty float z\n"
        f"element face {len(polygons)}\nproperty list uchar int vertex_indices\nend_header\n"
    )
    rows = np.zeros(len(polygons), [("n", "u1"), ("v", "<i4", (sides,))])
    rows["n"], rows["v"] = sides, polygons
    path.write_bytes(header.encode() + points.astype("<f4").tobytes() + rows.tobytes())


def glb(document: dict, binary: bytes) -> bytes:
    """The bytes of a binary glTF file."""
    text = json.dumps(document).encode()
    text += b" " * (-len(text) % 4)
    binary += b"\0" * (-len(binary) % 4)
    body = struct.pack("<I4s", len(text), b"JSON") + text
    body += struct.pack("<I4s", len(binary), b"BIN\0") + binary
    return struct.pack("<4sII", b"glTF", 2, 12 + len(body)) + body


def gltf_document(vertices: int, corners: int) -> dict:
    """One mesh under one node; positions and indices follow each other in buffer 0."""
    return {
        "asset": {"version": "2.0"},
        "scene": 0,
        "scenes": [{"nodes": [0]}],
        "nodes": [{"name": "shelter", "mesh": 0}],
        "meshes": [{"primitives": [{"attributes": {"POSITION": 0}, "indices": 1}]}],
        "accessors": [
            {"bufferView": 0, "componentType": 5126, "count": vertices, "type": "VEC3"},
            {"bufferView": 1, "componentType": 5125, "count": corners, "type": "SCALAR"},
        ],
        "bufferViews": [
            {"buffer": 0, "byteOffset": 0, "byteLength": 12 * vertices},
            {"buffer": 0, "byteOffset": 12 * vertices, "byteLength": 4 * corners},
        ],
        "buffers": [{"byteLength": 12 * vertices + 4 * corners}],
    }


def _glb(path: Path, points: np.ndarray, polygons: np.ndarray) -> None:
    faces = triangles(polygons) if polygons.shape[1] == 4 else polygons
    y_up = np.stack([points[:, 0], points[:, 2], -points[:, 1]], axis=1)
    binary = y_up.astype("<f4").tobytes() + faces.astype("<u4").tobytes()
    path.write_bytes(glb(gltf_document(len(points), faces.size), binary))


def _usd(path: Path, points: np.ndarray, polygons: np.ndarray) -> None:
    from pxr import Usd, UsdGeom, Vt

    stage = Usd.Stage.CreateNew(str(path))
    UsdGeom.SetStageUpAxis(stage, UsdGeom.Tokens.z)
    UsdGeom.SetStageMetersPerUnit(stage, 1.0)
    mesh = UsdGeom.Mesh.Define(stage, "/World/shelter")
    mesh.CreateSubdivisionSchemeAttr("none")
    mesh.CreatePointsAttr(Vt.Vec3fArray.FromNumpy(points.astype(np.float32)))
    counts = np.full(len(polygons), polygons.shape[1], np.int32)
    mesh.CreateFaceVertexCountsAttr(Vt.IntArray.FromNumpy(counts))
    mesh.CreateFaceVertexIndicesAttr(Vt.IntArray.FromNumpy(polygons.ravel().astype(np.int32)))
    stage.Save()
