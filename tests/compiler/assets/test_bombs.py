"""Files that promise more than there is: refused at once, by name, in little memory.

Each is read in a process of its own, which may take 20 s of the processor and 2 GiB
(``robustness.mutants``).
"""

from __future__ import annotations

import io
import json
import struct
import sys
import zipfile
import zlib
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from PIL import Image

from scenec.backends.picture.sky import load_picture
from scenec.backends.stage.read import read_stage
from scenec.backends.surface.gobo import load_gobo
from scenec.compiler.assets.dem_file import read_dem
from scenec.compiler.assets.model import read_model
from scenec.compiler.assets.pose_table import read_poses
from scenec.compiler.assets.tracks import read_track
from scenec.compiler.cfg.load import load
from scenec.compiler.light.latlong import read_picture
from scenec.testing.mutants import tried
from scenec.testing.overhangs import glb
from scenec.testing.small import small_cfg

SIDE = 60_000
LARGE = 1 << 31


def _png(side: int, depth: int = 8) -> bytes:
    def chunk(name: bytes, data: bytes) -> bytes:
        return (
            struct.pack(">I", len(data)) + name + data + struct.pack(">I", zlib.crc32(name + data))
        )

    head = struct.pack(">IIBBBBB", side, side, depth, 0, 0, 0, 0)
    packed = zlib.compress(bytes(1 << 20))
    return (
        b"\x89PNG\r\n\x1a\n" + chunk(b"IHDR", head) + chunk(b"IDAT", packed) + chunk(b"IEND", b"")
    )


def _tiff() -> bytes:
    """One strip that is said to be all there is."""
    entries = {
        256: SIDE,
        257: SIDE,
        258: 32,
        259: 1,
        262: 1,
        273: 8,
        277: 1,
        278: SIDE,
        279: 4,
        339: 3,
    }
    body = b"".join(struct.pack("<HHII", tag, 4, 1, value) for tag, value in entries.items())
    return b"II*\0" + struct.pack("<I", 8) + struct.pack("<H", len(entries)) + body + bytes(4)


def _npy(shape: tuple[int, ...]) -> bytes:
    stream = io.BytesIO()
    header = {"descr": "<f8", "fortran_order": False, "shape": shape}
    np.lib.format.write_array_header_1_0(stream, header)  # type: ignore[arg-type]
    return stream.getvalue() + bytes(64)


def _npz() -> bytes:
    """An archive of an array of 30 GB, of which a megabyte is there."""
    stream = io.BytesIO()
    with zipfile.ZipFile(stream, "w", zipfile.ZIP_DEFLATED) as archive:
        archive.writestr("heights.npy", _npy((SIDE, SIDE)) + bytes(1 << 20))
    return stream.getvalue()


def _exr() -> bytes:
    def attribute(name: str, kind: str, data: bytes) -> bytes:
        return name.encode() + b"\0" + kind.encode() + b"\0" + struct.pack("<I", len(data)) + data

    channels = b"".join(
        c + b"\0" + struct.pack("<iBBBBii", 2, 0, 0, 0, 0, 1, 1) for c in (b"B", b"G", b"R")
    )
    window = struct.pack("<iiii", 0, 0, SIDE - 1, SIDE - 1)
    head = [
        attribute("channels", "chlist", channels + b"\0"),
        attribute("compression", "compression", b"\0"),
        attribute("dataWindow", "box2i", window),
        attribute("displayWindow", "box2i", window),
        attribute("lineOrder", "lineOrder", b"\0"),
        attribute("pixelAspectRatio", "float", struct.pack("<f", 1.0)),
        attribute("screenWindowCenter", "v2f", struct.pack("<ff", 0.0, 0.0)),
        attribute("screenWindowWidth", "float", struct.pack("<f", 1.0)),
    ]
    return b"\x76\x2f\x31\x01\x02\0\0\0" + b"".join(head) + b"\0" + bytes(8 * SIDE)


def _glb(**accessor: int) -> bytes:
    document = {
        "asset": {"version": "2.0"},
        "nodes": [{"mesh": 0}],
        "meshes": [{"primitives": [{"attributes": {"POSITION": 0}}]}],
        "accessors": [{"componentType": 5126, "count": 3, "type": "VEC3", **accessor}],
        "bufferViews": [{"buffer": 0, "byteLength": 36}],
        "buffers": [{"byteLength": 36}],
    }
    return glb(document, bytes(36))


def _cyclic_nodes() -> bytes:
    document = {"asset": {"version": "2.0"}, "nodes": [{"children": [1]}, {"children": [0]}]}
    return glb(document, bytes(4))


def _usda(text: str) -> bytes:
    return f'#usda 1.0\n(\n    metersPerUnit = 1\n    upAxis = "Z"\n)\n{text}\n'.encode()


def _nested(depth: int) -> bytes:
    return _usda('def Xform "a" {\n' * depth + "}\n" * depth)


def _packed_usdz() -> bytes:
    """A package whose layer is compressed, as no package of USD is: a gigabyte of blanks."""
    stream = io.BytesIO()
    with zipfile.ZipFile(stream, "w", zipfile.ZIP_DEFLATED) as archive:
        archive.writestr("scene.usda", _usda("") + b" " * (1 << 28))
    return stream.getvalue()


_COORDINATES = "".join(f"property float {axis}\n" for axis in "xyz")
PLY = "ply\nformat {}\nelement vertex {}\n" + _COORDINATES + "end_header\n"
CYCLE = 'def Xform "a" (\n    references = @./bomb.usda@</a>\n) {}\n'


def _heights(path: Path) -> object:
    return read_dem(path, height_range_m=(0.0, 1.0))


def _model(path: Path) -> object:
    return read_model(path, unit_m=1.0, up="z")


BOMBS: dict[str, tuple[str, Callable[[], bytes], Callable[[Path], object]]] = {
    "heights of 60,000 x 60,000": ("png", lambda: _png(SIDE, 16), _heights),
    "a sky of 60,000 x 60,000": ("png", lambda: _png(SIDE), load_picture),
    "a light filter of 60,000 x 60,000": ("png", lambda: _png(SIDE), load_gobo),
    "a TIFF of 60,000 x 60,000": ("tif", _tiff, read_dem),
    "an EXR of 60,000 x 60,000": ("exr", _exr, read_picture),
    "a stage's sky of 60,000 x 60,000": ("exr", _exr, load_picture),
    "an array of 2^62 numbers": ("npy", lambda: _npy((LARGE, LARGE)), read_dem),
    "an array of 30 GB": ("npy", lambda: _npy((SIDE, SIDE)), read_dem),
    "an archive of 30 GB": ("npz", _npz, read_dem),
    "a binary PLY of 10^12 points": (
        "ply", lambda: PLY.format("binary_little_endian 1.0", 10**12).encode() + bytes(64), _model,
    ),
    "a text PLY of 10^12 points": ("ply", lambda: PLY.format("ascii 1.0", 10**12).encode(), _model),
    "an STL of 2^32 triangles": ("stl", lambda: bytes(80) + b"\xff" * 4 + bytes(50), _model),
    "an OFF of 10^12 points": ("off", lambda: b"OFF\n1000000000000 1 0\n0 0 0\n", _model),
    "an OBJ that counts far": ("obj", lambda: b"v 0 0 0\nf 1 2 999999999999999999999\n", _model),
    "a glTF of 2^31 points": ("glb", lambda: _glb(bufferView=0, count=LARGE), _model),
    "a glTF of 2^31 points that are zero": ("glb", lambda: _glb(count=LARGE), _model),
    "nodes that are each other's children": ("glb", _cyclic_nodes, _model),
    "a glTF nested 100,000 deep": ("gltf", lambda: b"[" * 100_000, _model),
    "a package in a package's clothes": ("usdz", _packed_usdz, _model),
    "a stage nested 100,000 deep": ("usda", lambda: _nested(100_000), read_stage),
    "a model nested 100,000 deep": ("usda", lambda: _nested(100_000), _model),
    "a stage that refers to itself": ("usda", lambda: _usda(CYCLE), read_stage),
    "a model that refers to itself": ("usda", lambda: _usda(CYCLE), _model),
    "a cfg nested 100,000 deep": ("json", lambda: b"[" * 100_000, load),
    "a YAML cfg nested 100,000 deep": ("yaml", lambda: b"[" * 100_000, load),
    "a cfg that extends itself": ("json", lambda: b'{"extends": "bomb.json"}', load),
    "a cfg with a number of a million digits": (
        "json", lambda: b'{"batches": ' + b"9" * 1_000_000 + b"}", load,
    ),
    "a track of one cell without end": ("csv", lambda: b"1" * 50_000_000, read_track),
    "poses of a million columns": ("csv", lambda: b"1," * 1_000_000, read_poses),
}  # fmt: skip


@pytest.mark.parametrize("what", BOMBS)
def test_it_is_refused_at_once(tmp_path: Path, what: str, monkeypatch: pytest.MonkeyPatch) -> None:
    """Also where another package has lifted Pillow's limit for the whole process."""
    monkeypatch.setattr(Image, "MAX_IMAGE_PIXELS", None)
    suffix, make, read = BOMBS[what]
    file = tmp_path / f"bomb.{suffix}"
    file.write_bytes(make())
    outcome = tried(lambda: read(file), "bomb", tmp_path / "jail")
    assert outcome.kind in ("refused", "crash told"), outcome
    assert len(outcome.text) < 2000


def test_a_package_that_is_named_is_not_imported(tmp_path: Path) -> None:
    for package in ("trap_alone", "trap_outer"):
        (tmp_path / package).mkdir()
        (tmp_path / package / "__init__.py").write_text(f"open({str(tmp_path / 'sprung')!r}, 'w')")
    (tmp_path / "trap_outer" / "inner").mkdir()
    (tmp_path / "trap_outer" / "inner" / "__init__.py").touch()

    def read() -> None:
        sys.path.insert(0, str(tmp_path))
        for name in ("trap_alone/box.obj", "trap_outer.inner/box.obj", "trap_outer/../box.obj"):
            cfg: dict[str, Any] = small_cfg()
            cfg["objects"]["rocks"] |= {"type": "models", "models": [{"file": f"package:{name}"}]}
            (tmp_path / "cfg.json").write_text(json.dumps(cfg))
            load(tmp_path / "cfg.json")

    outcome = tried(read, "cfg.json", tmp_path / "jail")
    assert outcome.kind == "refused", outcome
    assert not (tmp_path / "sprung").exists()
