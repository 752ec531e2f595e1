"""Several files of a folder replaced together: all of them or none, whenever the process ends.

An update is a folder of new files, laid out as they will be, and a list of old ones that go. It is
made aside, and one rename makes it the folder's ``UPDATE``: before that nothing has happened, from
then on it will, since whoever comes next finishes what was cut short. Each step is a rename or a
removal that can be done twice. Nothing else in the folder is touched.

That holds for power that fails as for processes that are killed, where the file system keeps its
renames in their order, as journals do: the update is on the disk before the rename is, and that
before anything is moved.
"""

from __future__ import annotations

import errno
import json
import logging
import os
import shutil
from collections.abc import Iterable, Iterator
from contextlib import contextmanager, suppress
from contextvars import ContextVar
from pathlib import Path

from scenec.schemas.errors import OutputError
from scenec.schemas.files import as_json, inside, sweep, tree
from scenec.schemas.lock import LOCK, Lock

#: The update that is being carried out, in the folder that it is of.
UPDATE = ".scenec-update"
#: In it: names of the files that go.
_REMOVED = ".scenec-removed"

#: Whether what is written is to outlast a failure of power.
_lasting = ContextVar("lasting", default=True)

_log = logging.getLogger("scenec.output")


def replace_files(new: Path, root: Path, removed: Iterable[str] = ()) -> None:
    """Moves all files of ``new`` to the same places in ``root``, and removes others.

    Args:
        new: On the same disk, and no more there afterwards.
        root: A folder, with no update begun (``finish_update``), or a name that is not there yet.
        removed: Relative names of files in ``root``, with slashes; folders left empty go with them.

    Raises:
        OutputError: The file system refuses. What was begun can be finished later.
    """
    try:
        if not root.exists():
            _write_through(new)
            os.rename(new, root)
            _sync(root.parent)
            return
        for path in tree(new):
            _check_place(root, path)
        removed = list(removed)
        for name in removed:
            if inside(root, name).is_dir():
                raise OutputError(f"{root / name}: is a folder, and a file was there; move it away")
        (new / _REMOVED).write_text(as_json(removed), encoding="utf-8")
        _write_through(new)
        os.rename(new, root / UPDATE)
        _sync(root)
        try:
            _carry_out(root)
        except KeyboardInterrupt:
            # It takes no longer than to say that it is not done.
            _carry_out(root)
            raise
    except OSError as error:
        raise OutputError(f"{root}: cannot be replaced: {error.strerror or error}") from error


@contextmanager
def short_lived() -> Iterator[None]:
    """Waits for no disk in the block: what is written in it is removed soon."""
    token = _lasting.set(False)
    try:
        yield
    finally:
        _lasting.reset(token)


def finish_update(root: Path) -> None:
    """Finishes an update of a folder that was cut short, and says so; sweeps what is nobody's.

    Raises:
        BusyError: Another process is carrying it out.
        OutputError: The file system refuses.
    """
    if (root / UPDATE).is_dir():
        with Lock(root / LOCK):
            finish_locked_update(root)
    sweep([root])


@contextmanager
def reading(out: Path) -> Iterator[None]:
    """Keeps compilations away from an output folder while its stages are read for long.

    Args:
        out: Of a file, a stage of its own, nothing is locked.

    Raises:
        BusyError: One is at work.
        OutputError: An update that was cut short cannot be finished.
    """
    if not out.is_dir():
        yield
        return
    finish_update(out)
    with Lock(out / LOCK, alone=False):
        yield


def finish_locked_update(root: Path) -> None:
    """The same for who holds the folder's lock."""
    if not (root / UPDATE).is_dir():
        return
    try:
        _carry_out(root)
    except OSError as error:
        raise OutputError(
            f"{root}: an update that was cut short cannot be finished: {error.strerror or error}"
        ) from error
    _log.warning("%s: finished an update that was cut short", root)


def _write_through(folder: Path) -> None:
    """Waits until the disk has all that is in a folder."""
    for path in (*folder.rglob("*"), folder):
        _sync(path)


def _sync(path: Path) -> None:
    if not _lasting.get():
        return
    file = os.open(path, os.O_RDONLY)
    try:
        os.fsync(file)
    except OSError as error:
        # Some file systems have nothing to wait for, of folders above all.
        if error.errno != errno.EINVAL:
            raise
    finally:
        os.close(file)


def _check_place(root: Path, path: Path) -> None:
    """Refuses what a rename would fail at, before anything is done."""
    place = inside(root, path.as_posix())
    if place.is_dir():
        raise OutputError(f"{place}: is a folder, and a file goes there; move it away")
    for parent in path.parents:
        if os.path.lexists(root / parent) and not (root / parent).is_dir():
            raise OutputError(f"{root / parent}: is a file, and a folder goes there; move it away")


def _carry_out(root: Path) -> None:
    update = root / UPDATE
    removed = _removed(update / _REMOVED)
    for path in tree(update):
        if path.name != _REMOVED:
            _check_place(root, path)
            (root / path).parent.mkdir(parents=True, exist_ok=True)
            os.replace(update / path, root / path)
    for name in removed:
        place = inside(root, name, update / _REMOVED)
        place.unlink(missing_ok=True)
        for parent in place.parents[: len(Path(name).parents) - 1]:
            # Until one holds something else.
            with suppress(OSError):
                parent.rmdir()
    # Without the list there is nothing left but folders.
    (update / _REMOVED).unlink(missing_ok=True)
    shutil.rmtree(update)


def _removed(path: Path) -> list[str]:
    try:
        names = json.loads(path.read_bytes())
    except FileNotFoundError:
        return []
    except (ValueError, RecursionError) as error:
        raise OutputError(f"{path}: is no list of files: {error}") from error
    if not isinstance(names, list) or not all(isinstance(name, str) for name in names):
        raise OutputError(f"{path}: is no list of files")
    return names
