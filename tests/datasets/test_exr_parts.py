"""Parts of an OpenEXR file that nobody wants are cut out; what is left is read as before."""

from __future__ import annotations

import contextlib

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from scenec.schemas.errors import FrameError
from scenec.schemas.exr import read_exr, write_exr
from scenec.schemas.exr_parts import without_parts
from scenec.testing.examples import examples

NAMES = ("rgb", "label.class", "label.Länge", "instance", "depth", "normal")


def passes_of(names: tuple[str, ...], height: int, width: int) -> dict[str, np.ndarray]:
    draw = np.random.default_rng(height * 100 + width)
    shapes = {"rgb": (height, width, 3), "normal": (height, width, 3)}
    found = {}
    for name in names:
        shape = shapes.get(name, (height, width))
        found[name] = (
            draw.normal(size=shape).astype(np.float32)
            if name in ("rgb", "normal", "depth")
            else draw.integers(0, 2**32, shape, np.uint32)
        )
    return found


@examples(60)
@given(
    st.lists(st.sampled_from(NAMES), min_size=1, unique=True),
    st.sets(st.sampled_from(NAMES)),
    st.integers(1, 40),
    st.integers(1, 20),
)
def test_what_is_left_is_what_a_whole_reading_gives(tmp_path_factory, names, unused, h, w):
    path = tmp_path_factory.mktemp("exr") / "a.exr"
    passes = passes_of(tuple(names), h, w)
    write_exr(path, passes)
    left = [name for name in names if name not in unused]
    if not left:
        with pytest.raises(FrameError, match="there are none"):
            read_exr(path, sorted(unused))
        return
    read = read_exr(path, sorted(unused))
    assert list(read) == left
    for name in left:
        assert read[name].dtype == passes[name].dtype
        assert (read[name] == passes[name]).all()


def test_the_bytes_of_what_is_not_wanted_are_gone(tmp_path):
    path = tmp_path / "a.exr"
    passes = passes_of(("rgb", "instance", "depth"), 64, 64)
    write_exr(path, passes)
    data = path.read_bytes()
    short = without_parts(data, ("rgb",))
    assert len(short) < len(data) - 0.7 * passes["rgb"].nbytes
    assert without_parts(short, ("rgb",)) == short
    assert without_parts(data, ("face",)) == data


@examples(150)
@given(st.data())
def test_a_file_cut_short_anywhere_ends_in_one_error(tmp_path_factory, data):
    path = tmp_path_factory.mktemp("exr") / "cut.exr"
    write_exr(path, passes_of(("rgb", "instance"), 20, 6))
    whole = path.read_bytes()
    # The header and the tables, where most can go wrong.
    path.write_bytes(whole[: data.draw(st.integers(0, min(len(whole), 1500) - 1))])
    with contextlib.suppress(ValueError):
        without_parts(path.read_bytes(), ("rgb",))
    with pytest.raises(FrameError, match=r"cut\.exr"):
        read_exr(path, ("rgb",))


def test_any_byte_of_header_and_tables_may_be_changed(tmp_path):
    path = tmp_path / "a.exr"
    write_exr(path, passes_of(("rgb", "instance"), 20, 6))
    whole = path.read_bytes()
    refused = 0
    for at in range(min(len(whole), 1500)):
        # The highest bit of an offset makes it larger than any file.
        for flip in (1, 0x80, 0xFF):
            broken = bytearray(whole)
            broken[at] ^= flip
            try:
                without_parts(bytes(broken), ("rgb",))
            except ValueError:
                refused += 1
    assert refused > 0


@pytest.mark.parametrize("data", [b"", b"v/1", b"no picture at all", b"v/1\x01\x02\x02\0\0"])
def test_what_is_no_such_file_is_refused(tmp_path, data):
    with pytest.raises(ValueError, match="OpenEXR"):
        without_parts(data, ("rgb",))
    path = tmp_path / "a.exr"
    path.write_bytes(data)
    with pytest.raises(FrameError, match=r"a\.exr"):
        read_exr(path, ("rgb",))
