"""Entries: a step is made once, one bit of its entry is no entry, and nothing else is touched."""

from __future__ import annotations

import os
import pickle
import shutil
import threading
from contextlib import suppress
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from killed import contents, killed_at_each_call

from scenec.compiler.cache import store as store_module
from scenec.compiler.cache.digests import Digests
from scenec.compiler.cache.entry import Packed, packed, restored, write_entry
from scenec.compiler.cache.memo import Memo, memoized, memoized_file, memoizing
from scenec.compiler.cache.store import FAULTS, Store, default_folder, parsed_size
from scenec.compiler.cache.structure import Describer, NotPlainError
from scenec.compiler.terrain.grid import Grid
from scenec.schemas import files
from scenec.schemas.errors import ScenecError
from scenec.testing.examples import examples


@dataclass(frozen=True)
class _Foreign:
    x: int


_calls: list[str] = []


@memoized("scaled", lambda x, **_: f"of {len(x)}")
def _scaled(x: Any, by: float = 2.0) -> Any:
    _calls.append("scaled")
    return (x * by, {"by": by})


@memoized("not kept")
def _unkept(x: int) -> Any:
    _calls.append("unkept")
    return _Foreign(x)


@memoized_file("file")
def _written(path: Path, text: str) -> None:
    _calls.append("written")
    path.write_text(text)


@pytest.fixture(autouse=True)
def _no_calls():
    _calls.clear()


def test_without_a_memo_steps_are_functions():
    x = np.arange(3.0)
    assert np.array_equal(_scaled(x)[0], 2.0 * x)
    assert np.array_equal(_scaled(x)[0], 2.0 * x)
    assert _calls == ["scaled", "scaled"]


def test_a_step_is_made_once_for_the_same_arguments_however_they_are_given(tmp_path):
    x = np.arange(4000.0)
    for _ in range(2):
        memo = Memo(Store(tmp_path))
        with memoizing(memo):
            for y in (_scaled(x), _scaled(x.copy(), 2.0), _scaled(x=x, by=2.0)):
                assert np.array_equal(y[0], 2.0 * x)
                assert y[0].flags.writeable
                assert y[1] == {"by": 2.0}
    assert _calls == ["scaled"]
    assert memo.made == {}
    assert memo.taken == {"scaled/of 4000": 3}
    with memoizing(memo):
        _scaled(x, 3.0)
        _scaled(np.append(x, 0.0))
    assert _calls == ["scaled"] * 3


def test_what_cannot_be_kept_or_keyed_is_made_each_time(tmp_path):
    memo = Memo(Store(tmp_path))
    with memoizing(memo):
        assert [_unkept(1), _unkept(1)] == [_Foreign(1)] * 2
    assert memo.made["not kept"] == 2
    with memoizing(memo), pytest.raises(TypeError):
        _scaled([object()], by=2.5)


def test_an_error_of_a_step_is_not_kept(tmp_path):
    with memoizing(Memo(Store(tmp_path))):
        for _ in range(2):
            with pytest.raises(TypeError):
                _scaled([1.0], by=0.5)
    assert _calls == ["scaled", "scaled"]
    assert Store(tmp_path).size() == (0, 0)


def test_a_written_file_is_written_again_from_the_cache(tmp_path):
    memo = Memo(Store(tmp_path / "cache"))
    with memoizing(memo):
        for folder in ("a", "b"):
            (tmp_path / folder).mkdir(exist_ok=True)
            _written(tmp_path / folder / "x.txt", "hällo")
        _written(tmp_path / "a" / "y.txt", "hällo")
    assert (tmp_path / "b" / "x.txt").read_text() == "hällo"
    assert _calls == ["written", "written"]
    assert memo.taken == {"file/x.txt": 1}


@pytest.mark.parametrize("taken", [False, True])
def test_a_changed_array_is_found_and_one_let_go_of_is_freed(tmp_path, taken):
    memo, x = Memo(Store(tmp_path)), np.arange(1000.0)
    if taken:
        with memoizing(Memo(Store(tmp_path))):
            _scaled(x)
    with memoizing(memo):
        y = _scaled(x)[0]
    assert memo.changed() == []
    y[3] = 7.0
    assert memo.changed() == ["float64 (1000,)"]
    del y
    assert memo.changed() == []


def _only_entry(folder: Path) -> Path:
    (path,) = folder.glob("steps/??/*.step")
    return path


_DAMAGES = {
    "emptied": lambda data: b"",
    "cut in its head": lambda data: data[:20],
    "cut in its header": lambda data: data[:80],
    "cut in its arrays": lambda data: data[:-9],
    "another hash": lambda data: bytes([data[0] ^ 1]) + data[1:],
    "of the former format": lambda data: b"scenec step 1\r\n\0" + data,
    "a header of another hash": lambda data: data[:70] + bytes([data[70] ^ 1]) + data[71:],
    "an array of another hash": lambda data: data[:-5] + bytes([data[-5] ^ 4]) + data[-4:],
    "a length beyond the file": lambda data: data[:32] + b"\xff" * 8 + data[40:],
    "something else": lambda data: b"PK\x03\x04" * 500,
}


@pytest.mark.parametrize("damage", _DAMAGES)
def test_a_damaged_entry_is_dropped_and_made_again(tmp_path, damage, caplog):
    x = np.arange(3000.0)
    with memoizing(Memo(Store(tmp_path))):
        _scaled(x)
    path = _only_entry(tmp_path)
    whole = path.read_bytes()
    path.write_bytes(_DAMAGES[damage](whole))
    memo = Memo(Store(tmp_path))
    with caplog.at_level("DEBUG", "scenec.incremental"), memoizing(memo):
        assert np.array_equal(_scaled(x)[0], 2.0 * x)
    assert memo.made == {"scaled/of 3000": 1}
    assert [record.levelname for record in caplog.records] == ["DEBUG"]
    assert path.read_bytes() == whole


class _Runs:
    """What a pickle would do that somebody made for it."""

    def __init__(self, function: Any, *given: Any) -> None:
        self.made = function, given

    def __reduce__(self) -> Any:
        return self.made


_FOREIGN = {
    "os.system": lambda mark: _Runs(os.system, f"touch {mark}"),
    "builtins.exec": lambda mark: _Runs(exec, f"open({str(mark)!r}, 'w')"),
    "a function of ours": lambda mark: _Runs(files.write_json, mark, 1),
    "a class of ours that does things": lambda mark: _Runs(Store, mark),
    "another library's": lambda mark: _Runs(np.save, str(mark), 1),
}


@pytest.mark.parametrize("what", _FOREIGN)
def test_an_entry_that_somebody_made_runs_nothing_and_is_made_again(tmp_path, what, caplog):
    with memoizing(Memo(Store(tmp_path / "cache"))):
        _scaled(np.arange(5.0))
    path = _only_entry(tmp_path / "cache")
    value = _FOREIGN[what](tmp_path / "mark")
    path.unlink()
    write_entry(path, path.stem, Packed(pickle.dumps(value), [], {}))
    memo = Memo(Store(tmp_path / "cache"))
    with caplog.at_level("DEBUG", "scenec.incremental"), memoizing(memo):
        _scaled(np.arange(5.0))
    assert "is no data of this package" in caplog.text
    assert memo.made == {"scaled/of 5": 1}
    assert not list(tmp_path.glob("mark*"))
    # What reads them writes none of these, either.
    with pytest.raises(NotPlainError):
        packed(value, Describer(Digests(), {}))


def test_a_name_with_dots_leads_to_nothing_a_module_imports(tmp_path):
    (tmp_path / "steps" / "ab").mkdir(parents=True)
    for name in ("os.getpid", "getpid", "Path.home", "Path"):
        opcodes = pickle.PROTO + b"\4cscenec.schemas.files\n" + name.encode() + b"\n)R."
        key = "ab" * 32
        store = Store(tmp_path)
        write_entry(store.path(key), key, Packed(opcodes, [], {}))
        entry = store.find(key)
        with pytest.raises(NotPlainError, match="is no data"):
            restored(entry, {}, Digests())
        store.drop(key, name)


@given(st.data())
@examples(60)
def test_a_pickle_of_which_anything_was_changed_is_a_value_or_a_fault_that_is_caught(data):
    value = ([1.5, np.float32(2.0), b"x", "t", None], {"a": (3,)}, frozenset((4,)), np.eye(2))
    whole = packed((value, Grid((2.0, 3.0), (4, 5))), Describer(Digests(), {}))
    changed = bytearray(whole.pickled)
    for _ in range(data.draw(st.integers(1, 3))):
        changed[data.draw(st.integers(0, len(changed) - 1))] = data.draw(st.integers(0, 255))
    with suppress(*FAULTS):
        restored(replace(whole, pickled=bytes(changed)), {}, Digests())


_PRIVATE = pytest.mark.skipif(os.name == "nt", reason="modes say nothing there")


@_PRIVATE
def test_a_folder_that_a_group_can_write_becomes_its_users_alone(tmp_path):
    tmp_path.chmod(0o775)
    with memoizing(Memo(Store(tmp_path))):
        _scaled(np.arange(9.0))
    assert tmp_path.stat().st_mode & 0o777 == 0o755
    memo = Memo(Store(tmp_path))
    with memoizing(memo):
        _scaled(np.arange(9.0))
    assert memo.taken


@_PRIVATE
@pytest.mark.parametrize("mode", [0o777, 0o757, 0o707])
def test_a_folder_that_others_can_write_is_neither_read_nor_written_and_said_once(tmp_path, mode):
    with memoizing(Memo(Store(tmp_path))):
        _scaled(np.arange(9.0))
    kept = contents(tmp_path)
    tmp_path.chmod(mode)
    said: list[str] = []
    memo = Memo(Store(tmp_path, 0, said.append))
    with memoizing(memo):
        _scaled(np.arange(9.0))
        _scaled(np.arange(8.0))
    Store(tmp_path, 0).tidy()
    assert not memo.taken
    assert contents(tmp_path) == kept
    assert said == [
        f"cache {tmp_path}: others can write to it (chmod go-w takes that away); "
        "compiling goes on without keeping steps"
    ]
    tmp_path.chmod(0o755)
    memo = Memo(Store(tmp_path))
    with memoizing(memo):
        _scaled(np.arange(9.0))
    assert memo.taken


@_PRIVATE
def test_a_folder_of_another_user_is_neither_read_nor_written(tmp_path, monkeypatch):
    with memoizing(Memo(Store(tmp_path))):
        _scaled(np.arange(9.0))
    kept = contents(tmp_path)
    me = os.geteuid()
    monkeypatch.setattr(os, "geteuid", lambda: me + 1)
    said: list[str] = []
    memo = Memo(Store(tmp_path, None, said.append))
    with memoizing(memo):
        _scaled(np.arange(9.0))
    assert memo.made
    assert contents(tmp_path) == kept
    assert ["it belongs to another user" in line for line in said] == [True]


@_PRIVATE
def test_what_is_written_is_the_users_alone_whatever_the_umask(tmp_path):
    before = os.umask(0)
    try:
        with memoizing(Memo(Store(tmp_path / "a" / "cache"))):
            _scaled(np.arange(9.0))
    finally:
        os.umask(before)
    path = _only_entry(tmp_path / "a" / "cache")
    assert path.stat().st_mode & 0o777 == 0o600
    above = [folder for folder in path.parents if folder.is_relative_to(tmp_path / "a")]
    assert {folder.stat().st_mode & 0o777 for folder in above} == {0o700}
    # One that others could have changed is made again.
    path.chmod(0o666)
    memo = Memo(Store(tmp_path / "a" / "cache"))
    with memoizing(memo):
        _scaled(np.arange(9.0))
    assert memo.made
    assert path.stat().st_mode & 0o777 == 0o600


def test_killed_at_any_call_a_process_leaves_a_whole_entry_or_none(tmp_path):
    x = np.arange(9.0)

    def act() -> None:
        with memoizing(Memo(Store(tmp_path / "cache"))):
            _scaled(x)

    seen = set()
    for _ in killed_at_each_call(act):
        entries = list((tmp_path / "cache").glob("steps/??/*.step"))
        entries = [path for path in entries if not path.name.startswith(".")]
        seen.add(len(entries))
        for path in entries:
            assert Store(tmp_path / "cache").find(path.stem) is not None
        shutil.rmtree(tmp_path / "cache", ignore_errors=True)
    assert seen == {0, 1}


def test_what_links_in_the_folder_lead_to_is_neither_read_nor_changed(tmp_path):
    with memoizing(Memo(Store(tmp_path / "theirs"))):
        _scaled(np.arange(9.0))
    theirs = _only_entry(tmp_path / "theirs")
    kept = contents(tmp_path / "theirs")
    for place in (theirs.relative_to(tmp_path / "theirs"), Path("steps"), Path("CACHEDIR.TAG")):
        cache = tmp_path / f"cache {place.name}"
        (cache / place).parent.mkdir(parents=True)
        (cache / place).symlink_to(tmp_path / "theirs" / place)
        said: list[str] = []
        store = Store(cache, 0 if place.name == "steps" else None, said.append)
        memo = Memo(store)
        with memoizing(memo):
            _scaled(np.arange(9.0))
        store.tidy()
        assert not memo.taken
        assert contents(tmp_path / "theirs") == kept


def test_an_entry_under_another_key_is_dropped(tmp_path):
    with memoizing(Memo(Store(tmp_path))):
        _scaled(np.arange(10.0))
    path = _only_entry(tmp_path)
    with memoizing(Memo(Store(tmp_path))):
        _scaled(np.arange(11.0))
    other = next(p for p in tmp_path.glob("steps/??/*.step") if p != path)
    other.write_bytes(path.read_bytes())
    with memoizing(Memo(Store(tmp_path))):
        assert len(_scaled(np.arange(11.0))[0]) == 11


@given(st.binary(max_size=300))
@examples(25)
def test_any_bytes_in_place_of_an_entry_are_no_error(tmp_path_factory, data):
    store = Store(tmp_path_factory.getbasetemp() / "any")
    store.path("cd" * 32).parent.mkdir(parents=True, exist_ok=True)
    store.path("cd" * 32).write_bytes(data)
    assert store.find("cd" * 32) is None
    assert not store.path("cd" * 32).exists()


def _filled(folder: Path, count: int, most: int) -> Store:
    store = Store(folder, most)
    for i in range(count):
        key = f"{i:02x}" * 32
        store.put(key, packed(np.full(1000, float(i)), Describer(Digests(), {})))
        if store.path(key).exists():
            os.utime(store.path(key), ns=(i, i))
    return store


def test_the_longest_unused_entries_go_until_the_rest_fits(tmp_path):
    store = _filled(tmp_path, 8, 1 << 30)
    assert store.find("00" * 32) is not None  # used now
    store.most_bytes = store.size()[1] // 2
    store.tidy()
    left = sorted(path.name[:2] for path in tmp_path.glob("steps/??/*.step"))
    assert left == ["00", "05", "06", "07"]
    assert store.size()[1] <= store.most_bytes


def test_what_other_processes_wrote_is_bounded_too(tmp_path):
    _filled(tmp_path, 8, 1 << 30)
    Store(tmp_path, 4 * 8500).tidy()
    assert 0 < Store(tmp_path).size()[1] <= 4 * 8500


def test_a_long_run_tidies_on_its_way(tmp_path):
    _filled(tmp_path, 40, 10 * 8300)
    # A quarter of the bound may be there beyond it.
    assert Store(tmp_path).size()[1] <= 13 * 8300


def test_nothing_but_entries_is_ever_removed(tmp_path):
    (tmp_path / "steps" / "aa").mkdir(parents=True)
    mine = [tmp_path / "mine.txt", tmp_path / "steps" / "mine", tmp_path / "steps" / "aa" / "x.txt"]
    for path in mine:
        path.write_text("mine")
    _filled(tmp_path, 3, 0).tidy()
    store = _filled(tmp_path, 3, 8300)
    store.tidy()
    assert all(path.read_text() == "mine" for path in mine)
    assert (tmp_path / "CACHEDIR.TAG").read_text().startswith("Signature: 8a477f597d28d172789f06")


def test_what_was_left_unfinished_long_ago_goes(tmp_path):
    store = _filled(tmp_path, 1, 1 << 30)
    old, new = (store.path("00" * 32).with_name(f".x.{name}.step") for name in ("old", "new"))
    for path in (old, new):
        path.write_bytes(b"half")
    os.utime(old, (1.0, 1.0))
    store.tidy()
    assert new.exists()
    assert not old.exists()


def test_an_entry_larger_than_all_that_may_be_is_not_kept(tmp_path):
    assert _filled(tmp_path, 2, 5000).size() == (0, 0)


def test_a_folder_that_cannot_be_written_is_said_once(tmp_path):
    blocked = tmp_path / "file"
    blocked.write_text("no folder")
    said: list[str] = []
    memo = Memo(Store(blocked / "cache", 1 << 30, said.append))
    with memoizing(memo):
        for n in range(3):
            assert len(_scaled(np.arange(100.0 + n))[0]) == 100 + n
    assert len(said) == 1
    assert "compiling goes on" in said[0]


def test_a_full_disk_is_said_once_and_leaves_nothing(tmp_path, monkeypatch):
    def full(path: Path, *_: Any) -> int:
        path.write_bytes(b"half")
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(store_module, "write_entry", full)
    said: list[str] = []
    with memoizing(Memo(Store(tmp_path, None, said.append))):
        _scaled(np.arange(5.0))
        _scaled(np.arange(6.0))
    assert len(said) == 1
    assert "No space left on device" in said[0]
    assert not [path for path in tmp_path.rglob("*") if path.is_file()]


def test_a_folder_may_vanish_at_any_time(tmp_path):
    memo = Memo(Store(tmp_path / "cache"))
    with memoizing(memo):
        _scaled(np.arange(5.0))
        shutil.rmtree(tmp_path / "cache")
        _scaled(np.arange(5.0))
        _scaled(np.arange(5.0))
    assert _calls == ["scaled", "scaled"]


def test_many_at_once_neither_fail_nor_read_halves(tmp_path):
    failed: list[BaseException] = []

    def work() -> None:
        try:
            for _ in range(10):
                memo = Memo(Store(tmp_path, 60_000))
                with memoizing(memo):
                    for n in range(6):
                        x = np.full(2000, float(n))
                        assert np.array_equal(_scaled(x)[0], 2.0 * x)
        except (AssertionError, OSError, ValueError) as error:
            failed.append(error)

    threads = [threading.Thread(target=work) for _ in range(4)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert failed == []


def test_the_platform_and_the_environment_say_where(monkeypatch, tmp_path):
    monkeypatch.setenv("SCENEC_CACHE", str(tmp_path))
    assert default_folder() == tmp_path
    monkeypatch.setenv("SCENEC_CACHE", "")
    assert default_folder() is None
    monkeypatch.delenv("SCENEC_CACHE")
    monkeypatch.setenv("HOME", str(tmp_path))
    monkeypatch.delenv("XDG_CACHE_HOME", raising=False)
    monkeypatch.setattr("sys.platform", "linux")
    assert default_folder() == tmp_path / ".cache" / "scenec"
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "xdg"))
    assert default_folder() == tmp_path / "xdg" / "scenec"
    monkeypatch.setattr("sys.platform", "darwin")
    assert default_folder() == tmp_path / "Library" / "Caches" / "scenec"
    monkeypatch.setattr("sys.platform", "win32")
    monkeypatch.setenv("LOCALAPPDATA", str(tmp_path / "local"))
    assert default_folder() == tmp_path / "local" / "scenec"


@pytest.mark.parametrize(
    ("text", "size"),
    [
        ("0", 0),
        ("123", 123),
        ("1k", 1024),
        ("500M", 500 << 20),
        ("4GiB", 4 << 30),
        ("1.5g", 3 << 29),
    ],
)
def test_sizes_are_read(text, size):
    assert parsed_size(text, "x") == size


@pytest.mark.parametrize("text", ["", "x", "-1", "1q", "nan", "inf", "G"])
def test_other_texts_are_no_size(text):
    with pytest.raises(ScenecError, match="expected a size"):
        parsed_size(text, "$SCENEC_CACHE_MAX")
