"""Counts in .usdc files that cannot be are refused before OpenUSD believes them."""

from __future__ import annotations

import struct
from collections.abc import Callable
from pathlib import Path

import pytest
from pxr import Usd, UsdGeom

from scenec.backends.stage.read import read_stage
from scenec.compiler.assets.parse import MeshFileError
from scenec.compiler.assets.usd import sound_stage
from scenec.schemas.crate import crate_fault
from scenec.schemas.errors import StageError


@pytest.fixture
def crate(tmp_path: Path) -> Path:
    path = tmp_path / "sound.usdc"
    stage = Usd.Stage.CreateNew(str(path))
    UsdGeom.Cube.Define(stage, "/cube")
    stage.Save()
    return path


def damaged(path: Path, place: Callable[[bytes, int], int], value: int) -> Path:
    data = bytearray(path.read_bytes())
    (contents,) = struct.unpack_from("<q", data, 16)
    struct.pack_into("<Q", data, place(data, contents), value)
    made = path.with_name("damaged.usdc")
    made.write_bytes(data)
    return made


def section(data: bytes, contents: int) -> int:
    """Where the count of the last section, specs, stands."""
    return struct.unpack_from("<16sqq", data, contents + 8 + 5 * 32)[1]


@pytest.mark.parametrize(
    ("place", "value", "told"),
    [
        (lambda data, contents: 16, 1 << 40, "table of contents is at 1099511627776"),
        (lambda data, contents: contents, 116_983_803, "says 116983803 sections"),
        (lambda data, contents: contents + 8 + 16, 1 << 50, "section TOKENS is not within"),
        (section, 536_870_975, r"section SPECS of \d+ bytes says that it holds 536870975"),
    ],
)
def test_counts_beyond_the_file_are_refused(crate, place, value, told):
    assert crate_fault(crate) == ""
    path = damaged(crate, place, value)
    with pytest.raises(MeshFileError, match=told), sound_stage(path):
        pass
    with pytest.raises(StageError, match=rf"damaged\.usdc: .*{told}"):
        read_stage(path)


def test_other_kinds_of_files_are_left_to_those_who_read_them(tmp_path):
    path = tmp_path / "text.usda"
    path.write_text("#usda 1.0\n", encoding="utf-8")
    assert crate_fault(path) == crate_fault(tmp_path / "nothing.usdc") == ""
