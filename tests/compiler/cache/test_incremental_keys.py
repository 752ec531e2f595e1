"""Keys: one bit of an input is another key, and what has none is said to."""

from __future__ import annotations

import struct
from dataclasses import dataclass, replace
from enum import Enum
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra import numpy as arrays

from scenec.compiler.cache.digests import Digests, digest_of
from scenec.compiler.cache.entry import packed, restored
from scenec.compiler.cache.memo import Memo, memoized, memoizing
from scenec.compiler.cache.store import Store
from scenec.compiler.cache.structure import Describer, NotPlainError, text_of
from scenec.compiler.scene.material import ImageFile
from scenec.compiler.scene.objects import Prototype
from scenec.compiler.terrain.grid import Grid, HeightField
from scenec.compiler.terrain.quantities import Quantities
from scenec.testing.examples import examples

_TYPES = ("<f8", "<f4", "<f2", "<i8", "<i4", "<u4", "|u1", "|b1", ">f8", "<c16")


def _key(value: Any) -> str:
    return text_of(Describer(Digests(), {}).describe(value))


def _number_arrays() -> st.SearchStrategy[Any]:
    shapes = arrays.array_shapes(min_dims=0, max_dims=3, min_side=0, max_side=5)
    return st.sampled_from(_TYPES).flatmap(lambda name: arrays.arrays(np.dtype(name), shapes))


_LEAVES = st.one_of(
    st.none(),
    st.booleans(),
    st.integers(),
    st.floats(),
    st.text(),
    st.binary(max_size=40),
    _number_arrays(),
    st.sampled_from([np.float64(1.5), np.float32(-0.0), np.int64(-3), np.bool_(True)]),
)
_VALUES = st.recursive(
    _LEAVES,
    lambda inner: st.one_of(
        st.lists(inner, max_size=4),
        st.lists(inner, max_size=4).map(tuple),
        st.dictionaries(st.text(max_size=5), inner, max_size=4),
        st.builds(ImageFile, st.text(max_size=4), st.binary(max_size=9)),
    ),
    max_leaves=12,
)


def _through_an_entry(value: Any, folder: Path) -> Any:
    store = Store(folder, 1 << 30)
    store.put("ab" * 32, packed(value, Describer(Digests(), {})))
    entry = store.find("ab" * 32)
    assert entry is not None
    return restored(entry, {}, Digests())


@given(_VALUES)
@examples(60)
def test_a_value_comes_back_from_an_entry_to_the_bit(tmp_path_factory, value):
    found = _through_an_entry(value, tmp_path_factory.getbasetemp() / "round")
    # Types, dtypes, shapes, orders and bits: all that a key tells.
    assert _key(found) == _key(value)
    assert type(found) is type(value)


@given(_VALUES, _VALUES)
@examples(50)
def test_values_have_one_key_only_if_they_are_the_same(a, b):
    def bits(value: Any) -> Any:
        """An oracle of its own: nested tuples of types and bits."""
        if isinstance(value, np.ndarray):
            return ("array", value.dtype.str, value.shape, value.tobytes(), _order(value))
        if isinstance(value, np.generic):
            return ("scalar", value.dtype.str, value.tobytes())
        if isinstance(value, float):
            return ("float", struct.pack("<d", value))
        if isinstance(value, ImageFile):
            return ("picture", value.suffix, value.data)
        if isinstance(value, dict):
            return ("dict", *((bits(k), bits(v)) for k, v in value.items()))
        if isinstance(value, list | tuple):
            return (type(value).__name__, *map(bits, value))
        return (type(value).__name__, value)

    def _order(array: Any) -> bool:
        return bool(array.flags.f_contiguous and not array.flags.c_contiguous)

    assert (_key(a) == _key(b)) == (bits(a) == bits(b))


@given(_number_arrays().filter(lambda a: a.nbytes > 0 and a.dtype != bool), st.data())
@examples(50)
def test_one_bit_of_an_array_is_another_key(array, data):
    bit = data.draw(st.integers(0, array.nbytes * 8 - 1))
    raw = bytearray(array.tobytes())
    raw[bit // 8] ^= 1 << bit % 8
    other = np.frombuffer(bytes(raw), array.dtype).reshape(array.shape)
    assert _key(array.copy("C")) == _key(array.copy("C"))
    assert _key(array.copy("C")) != _key(other)


@pytest.mark.parametrize(
    ("a", "b"),
    [
        (0.0, -0.0),
        (1, True),
        (1, 1.0),
        (1.0, np.float64(1.0)),
        ("1", 1),
        ([1], (1,)),
        ({"a": 1, "b": 2}, {"b": 2, "a": 1}),
        (b"a", "a"),
        (["f", "00"], [1.0]),
        (np.zeros(3), np.zeros(3, np.float32)),
        (np.zeros((2, 3)), np.zeros((3, 2))),
        (np.arange(6.0).reshape(2, 3), np.asfortranarray(np.arange(6.0).reshape(2, 3))),
        (float("nan"), float("inf")),
        (None, False),
    ],
)
def test_what_python_calls_equal_is_told_apart(a, b):
    assert _key(a) != _key(b)


def test_fields_and_classes_count():
    grid = Grid((2.0, 3.0), (4, 5))
    assert _key(grid) == _key(Grid((2.0, 3.0), (4, 5)))
    assert _key(grid) != _key(replace(grid, size_m=(2.0, np.nextafter(3.0, 4.0))))
    assert _key(grid) != _key(((2.0, 3.0), (4, 5)))


def test_a_files_content_and_name_count_and_its_folder_does_not(tmp_path):
    for folder in ("a", "b"):
        (tmp_path / folder).mkdir()
        (tmp_path / folder / "x.png").write_bytes(b"1234")
    assert _key(tmp_path / "a" / "x.png") == _key(tmp_path / "b" / "x.png")
    (tmp_path / "b" / "x.png").write_bytes(b"1235")
    assert _key(tmp_path / "a" / "x.png") != _key(tmp_path / "b" / "x.png")
    (tmp_path / "b" / "y.png").write_bytes(b"1234")
    assert _key(tmp_path / "a" / "x.png") != _key(tmp_path / "b" / "y.png")


def test_what_is_no_plain_data_has_no_key(tmp_path):
    scene = tmp_path / "x.gltf"
    scene.write_text("{}")
    for value in (object(), lambda: 0, np.array([object()]), scene, tmp_path, {1, 2}):
        with pytest.raises(NotPlainError):
            _key([value])


class _Color(Enum):
    RED = 1


@dataclass(frozen=True)
class _Foreign:
    x: int


def test_entries_hold_data_of_this_package_only():
    for value in (_Foreign(1), [_Color.RED], {"a": int}, Memo, Store.find, np.sin, object()):
        with pytest.raises(NotPlainError):
            packed(value, Describer(Digests(), {}))
    for value in (_Foreign(1), {"a": int}):
        with pytest.raises(NotPlainError, match="of another package"):
            Describer(Digests(), {}).describe(value)


def test_what_computes_things_once_is_one_again(tmp_path):
    height = np.arange(12.0).reshape(3, 4)
    quantities = Quantities(Grid((3.0, 2.0), (3, 4)), height)
    quantities.once("twice", lambda: 2.0 * height)
    value = [quantities, HeightField(quantities.grid, height), quantities]
    a, field, b = _through_an_entry(value, tmp_path)
    assert a is b
    assert field.height is a.height
    assert np.array_equal(field.height, height)
    assert np.array_equal(a.once("twice", lambda: 3.0 * height), 3.0 * height)


def test_arrays_come_back_as_they_were_and_equal_ones_are_stored_once(tmp_path):
    big = np.arange(4000.0)
    fixed = big[:8].copy()
    fixed.flags.writeable = False
    value = [big, big.copy(), np.asfortranarray(big.reshape(40, 100)), big[::2], fixed]
    found = _through_an_entry(value, tmp_path)
    for a, b in zip(found, value, strict=True):
        assert np.array_equal(a, b)
        assert a.flags.writeable == b.flags.writeable
        assert a.flags.aligned
        assert a.flags.f_contiguous == b.flags.f_contiguous or not b.flags.c_contiguous
    (entry,) = tmp_path.glob("steps/??/*.step")
    assert entry.stat().st_size < 2.75 * big.nbytes


def test_digests_of_what_is_restored_are_known():
    """As an independent hash has them, and without a look at the content."""
    value = [np.arange(400.0), np.asfortranarray(np.eye(40)[:, :20]), b"x" * 2000]
    known = Digests()
    found = restored(packed(value, Describer(Digests(), {})), {}, known)
    expected = [value[0].tobytes(), value[1].tobytes("F"), value[2]]
    found[0][:] = found[1][:] = 7.0
    assert [known.digest(one) for one in found] == [digest_of(data) for data in expected]


@memoized("named")
def _named(path: Path) -> tuple[Path, int]:
    return path, path.stat().st_size


def test_an_input_file_that_was_moved_is_found_where_it_is(tmp_path):
    (tmp_path / "a").mkdir()
    first = tmp_path / "a" / "x.png"
    first.write_bytes(b"1234")
    memo = Memo(Store(tmp_path / "cache"))
    with memoizing(memo):
        assert _named(first) == (first, 4)
        (tmp_path / "a").rename(tmp_path / "b")
        assert _named(tmp_path / "b" / "x.png") == (tmp_path / "b" / "x.png", 4)
    assert memo.taken == {"named": 1}
    with pytest.raises(NotPlainError, match="was not among its inputs"):
        packed([tmp_path / "b" / "x.png"], Describer(Digests(), {}))


def test_a_prototype_is_kept_with_all_that_it_is(tmp_path):
    n, m = 4, 2
    prototype = Prototype(
        "rock", np.zeros((n, 3), np.float32), np.zeros((m, 3), np.int32),
        np.ones((n, 3), np.float32), np.zeros(n, np.float32), 0.1, 0.5,
        np.zeros((m, 3, 2), np.float32), (),
    )  # fmt: skip
    assert _key(_through_an_entry(prototype, tmp_path)) == _key(prototype)
