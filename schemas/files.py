"""Files that appear whole or not at all, where they may lie, and their hashes.

What is being written has a name that begins with ``TEMPORARY`` and says whose it is. The next
command that writes to the same folder removes it where that process is no more (``sweep``).
"""

from __future__ import annotations

import hashlib
import json
import math
import os
import re
import secrets
import shutil
import socket
import stat
import sys
import tempfile
import tokenize
import zlib
from collections.abc import Callable, Collection, Iterable, Iterator
from contextlib import contextmanager, suppress
from functools import cache, lru_cache, wraps
from pathlib import Path, PurePosixPath
from typing import Any, cast
from zipfile import BadZipFile

from scenec.schemas.errors import OutputError, ScenecError
from scenec.schemas.lock import LOCK, clear, is_alive, process_id
from scenec.schemas.packages import file_around

#: Begins the name of what is being written: ``.scenec-<machine>-<process>-<chance>-<name>``.
TEMPORARY = ".scenec-"
_TEMPORARY = re.compile(r"\.scenec-([0-9a-f]{8})-([0-9]+(?:\.[0-9]+)?)-[0-9a-f]{8}-.+")
#: Bytes below which a disk counts as full: no stage and no picture is smaller.
_LEAST_FREE = 1 << 20

#: What NumPy raises for files that are none of its own, or broken ones.
NUMPY_FAULTS = (
    OSError, ValueError, EOFError, BadZipFile, zlib.error, NotImplementedError, MemoryError,
    SyntaxError, TypeError, OverflowError, KeyError, RuntimeError, tokenize.TokenError,
)  # fmt: skip


def sha256(path: Path) -> str:
    """Hex digest of a file's bytes."""
    with path.open("rb") as file:
        return hashlib.file_digest(file, "sha256").hexdigest()


#: What tells a file from what it was before, within a process.
type Stamp = tuple[int, int, int, int]


def stamp(path: Path) -> Stamp:
    """Returns a file's stamp: times of its content and of its entry, number, size.

    Whoever writes a file can set the first time, and keep the size. The second one is the system's.

    Raises:
        OSError: It is not there.
    """
    found = path.stat()
    return found.st_mtime_ns, found.st_ctime_ns, found.st_ino, found.st_size


def _stamp(path: Any) -> Stamp | None:
    try:
        return stamp(file_around(path) if isinstance(path, Path) else path)
    except OSError:
        return None


def once_per_file[**P, R](most: int) -> Callable[[Callable[P, R]], Callable[P, R]]:
    """Keeps what a function has made of a file, its first argument, until the file changes.

    Args:
        most: Answers that are kept.
    """

    def keeping(function: Callable[P, R]) -> Callable[P, R]:
        @lru_cache(maxsize=most)
        def kept(_then: object, *args: Any, **kwargs: Any) -> R:
            return function(*args, **kwargs)

        @wraps(function)
        def of(*args: Any, **kwargs: Any) -> R:
            return kept(_stamp(args[0]), *args, **kwargs)

        return cast(Callable[P, R], of)

    return keeping


def digest_of_folder(folder: Path, suffixes: Collection[str] = ()) -> str:
    """Returns the hex digest of names and contents of all files below a folder, such as code.

    Args:
        folder: Hidden files in it, and byte code, do not count.
        suffixes: Of the files that count; none: all.
    """
    digest = hashlib.sha256()
    for path in tree(folder):
        hidden = any(part.startswith(".") or part == "__pycache__" for part in path.parts)
        if not hidden and (not suffixes or path.suffix in suffixes):
            digest.update(f"{path.as_posix()} {sha256(folder / path)}\n".encode())
    return digest.hexdigest()


def writers_besides(status: os.stat_result) -> str | None:
    """Says who else than this process's user can write to a file or folder; None: nobody can."""
    if sys.platform == "win32":
        return None  # There the mode says nothing of others.
    if status.st_uid != os.geteuid():
        return "it belongs to another user"
    if status.st_mode & (stat.S_IWGRP | stat.S_IWOTH):
        return "others can write to it (chmod go-w takes that away)"
    return None


def refused_folder(folder: Path) -> str | None:
    """Says why nothing that can hold code is to be read from a folder, or written to it.

    None: it is this user's alone, or not there yet (``make_private_folder``). A folder of this user
    that a group can write to, as the usual umask of some systems makes it, becomes its user's own.
    """
    try:
        found = folder.stat()
        is_group = found.st_mode & stat.S_IWGRP and not found.st_mode & stat.S_IWOTH
        if os.name == "posix" and found.st_uid == os.geteuid() and is_group:
            folder.chmod(stat.S_IMODE(found.st_mode) & ~stat.S_IWGRP)
        return writers_besides(folder.stat())
    except OSError:
        return None


def make_private_folder(folder: Path) -> None:
    """Makes a folder, and those above it that lack, that no other user can read or write.

    Raises:
        OSError: It cannot be made.
    """
    for each in (*reversed(folder.parents), folder):
        if not each.is_dir():
            each.mkdir(mode=0o700, exist_ok=True)


@contextmanager
def atomic(path: Path) -> Iterator[Path]:
    """A temporary path beside ``path`` that takes its place when the block ends well.

    Raises:
        OutputError: The folder cannot be written, or a folder, a device or a pipe has that name:
            a rename would take it away.
    """
    _require_plain(path)
    temporary = _sibling(path)
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        yield temporary
        os.replace(temporary, path)
    except OSError as error:
        raise OutputError(f"{path}: cannot be written: {error.strerror or error}") from error
    finally:
        with suppress(OSError):
            temporary.unlink(missing_ok=True)


def _require_plain(path: Path) -> None:
    if path.is_dir():
        raise OutputError(f"{path}: cannot be written: it is a folder")
    if path.exists() and not path.is_file():
        raise OutputError(f"{path}: cannot be written: it is no plain file (- is standard output)")


def _sibling(path: Path) -> Path:
    # The ending stays: libraries choose their format by it.
    chance = secrets.token_hex(4)
    return path.with_name(f"{TEMPORARY}{_machine()}-{process_id()}-{chance}-{path.name}")


@cache
def _machine() -> str:
    """Tells processes apart that may have the same number: host, boot, container."""
    parts = [socket.gethostname()]
    with suppress(OSError):
        parts.append(Path("/proc/sys/kernel/random/boot_id").read_text(encoding="ascii"))
    with suppress(OSError):
        parts.append(str(Path("/proc/self/ns/pid").readlink()))
    return hashlib.blake2b("\n".join(parts).encode(), digest_size=4).hexdigest()


def sweep(folders: Iterable[Path]) -> None:
    """Removes what killed processes left unfinished directly in some folders.

    What another process may still write stays, and so does what another machine wrote.
    """
    for folder in folders:
        with suppress(OSError):
            for path in sorted(folder.glob(f"{TEMPORARY}*")):
                whose = _TEMPORARY.fullmatch(path.name)
                if path.name.startswith(LOCK):
                    clear(path)
                elif whose and whose[1] == _machine() and not is_alive(whose[2]):
                    if path.is_dir() and not path.is_symlink():
                        shutil.rmtree(path, ignore_errors=True)
                    else:
                        path.unlink(missing_ok=True)


def write_json(path: Path, value: Any) -> None:
    """Writes strict JSON (no NaN or infinity: they become null), two spaces of indent."""
    with atomic(path) as temporary:
        temporary.write_text(as_json(value), encoding="utf-8")


def as_json(value: Any) -> str:
    """The text that ``write_json`` writes."""
    return json.dumps(_finite(value), indent=2, ensure_ascii=False, allow_nan=False) + "\n"


def _finite(value: Any) -> Any:
    if isinstance(value, dict):
        return {key: _finite(item) for key, item in value.items()}
    if isinstance(value, list | tuple):
        return [_finite(item) for item in value]
    if isinstance(value, float) and not math.isfinite(value):
        return None
    return value


@contextmanager
def temporary_folder(where: Path) -> Iterator[Path]:
    """An empty folder inside of ``where``, removed at the end if it is still there.

    Raises:
        OutputError: It, or something in it, cannot be written; the message has the name that this
            would have had directly in ``where``.
    """
    folder = _sibling(where / "new")
    try:
        folder.mkdir(parents=True)
        yield folder
    except OSError as error:
        raise OutputError(f"{where}: cannot be written: {error.strerror or error}") from error
    except OutputError as error:
        # A name that is gone when it is read helps nobody.
        raise OutputError(str(error).replace(str(folder), str(where))) from error
    finally:
        shutil.rmtree(folder, ignore_errors=True)


def tree(folder: Path) -> list[Path]:
    """All files below a folder, relative to it, in a fixed order."""
    return sorted(path.relative_to(folder) for path in folder.rglob("*") if path.is_file())


def inside(root: Path, name: str, said_by: object = None) -> Path:
    """The path of something in a folder, by a name that was read from a file.

    Args:
        root: The folder; it may be a link itself.
        name: Relative to it, with slashes. What is there must not lead out of the folder: no
            ``..``, no absolute path, no link to elsewhere.
        said_by: Where the name was read, for the message.

    Raises:
        OutputError: It leads out of the folder, or is no name of a file.
    """
    why = None
    path = root / name if "\0" not in name else root
    parts = PurePosixPath(name)
    if "\0" in name or not parts.parts:
        why = "is no name of a file"
    elif parts.is_absolute() or ".." in parts.parts or "\\" in name:
        why = "is no path inside of this folder"
    else:
        try:
            if not path.resolve().is_relative_to(root.resolve()):
                why = f"leads out of this folder, to {path.resolve()}"
        except (OSError, RuntimeError) as error:
            why = f"cannot be followed: {error}"
    if why is not None:
        before = "" if said_by is None else f"{said_by}: "
        raise OutputError(f"{before}{name!r} {why} ({root}); expected a file or folder in it")
    return path


def frame_stem_of(path: Path) -> Path:
    """Path of a frame without its suffix, from one of its files or the stem itself."""
    return path.with_suffix("") if path.suffix in (".exr", ".json", ".png") else path


def check_writable(*folders: Path) -> None:
    """Tries whether files can be written, before long work whose result they will be.

    Args:
        folders: They need not be there.

    Raises:
        OutputError: One cannot be written, or its disk is full.
    """
    for folder in folders:
        there = folder.absolute()
        try:
            while not there.exists():
                there = there.parent
            if not there.is_dir():
                raise OutputError(f"{folder}: cannot be written: {there} is not a folder")
            with tempfile.TemporaryFile(dir=there) as file:
                file.write(bytes(4096))
            disk = os.statvfs(there)
        except (OSError, ValueError) as error:
            reason = getattr(error, "strerror", None) or error
            raise OutputError(f"{folder}: cannot be written: {reason}") from error
        # Some network folders do not know how large they are.
        if disk.f_blocks and disk.f_bavail * disk.f_frsize < _LEAST_FREE:
            raise OutputError(
                f"{folder}: the disk is full: {disk.f_bavail * disk.f_frsize} bytes are free"
            )


def check_output(file: Path) -> None:
    """The same for one file; what killed processes left beside it is removed.

    Raises:
        OutputError: It cannot be written.
    """
    _require_plain(file)
    check_writable(file.parent)
    sweep([file.parent])


def read_json(path: Path, error: type[ScenecError], what: str) -> Any:
    """The JSON value in a file.

    Raises:
        FileNotFoundError: It is not there.
        ScenecError: It cannot be read, as the given class: ``<path>: is no <what>: <why>``.
    """
    try:
        return json.loads(path.read_bytes())
    except FileNotFoundError:
        raise
    except (OSError, ValueError, RecursionError) as fault:
        raise error(f"{path}: is no {what}: {fault}") from fault
