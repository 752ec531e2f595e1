"""Keeps entries in a folder: bounded, safe to delete at any time, and never in the way.

    FOLDER/CACHEDIR.TAG         tells backups that nothing here is worth keeping
    FOLDER/steps/ab/abcd….step  one entry, its name is its key

Entries appear by renaming, so that a reader finds a whole one or none, and two processes can use a
folder at once. Which was used last is the time of its file's last change.
"""

from __future__ import annotations

import logging
import os
import pickle
import sys
from collections.abc import Iterator
from contextlib import suppress
from pathlib import Path

from scenec.compiler.cache.entry import DamagedError, Packed, read_entry, write_entry
from scenec.compiler.cache.structure import NotPlainError
from scenec.schemas.errors import OutputError, ScenecError
from scenec.schemas.files import atomic, inside, make_private_folder, refused_folder
from scenec.schemas.units import Say

#: Environment variables: the folder (empty: none), and the most that it may hold.
FOLDER_VARIABLE, MOST_VARIABLE = "SCENEC_CACHE", "SCENEC_CACHE_MAX"
#: Bytes that a folder holds at most where nothing else is said.
MOST_BYTES = 4 << 30
_STEPS, _SUFFIX, _TAG = "steps", ".step", "CACHEDIR.TAG"
_TAG_TEXT = (
    "Signature: 8a477f597d28d172789f06886806bc55\n"
    "# Steps of compilations by scenec, which makes again what is missing. Safe to delete.\n"
)
#: Seconds after which a file that was not finished counts as left behind.
_LEFT_BEHIND_S = 3600.0
_UNITS = {"": 0, "k": 10, "m": 20, "g": 30, "t": 40}
#: What reading a file ends in that is none of ours, or not whole.
FAULTS = (DamagedError, NotPlainError, pickle.UnpicklingError, EOFError, ValueError, LookupError,
          TypeError, AttributeError, ArithmeticError, MemoryError, RecursionError,
          ImportError)  # fmt: skip
_log = logging.getLogger("scenec.incremental")


class Store:
    """Entries by key.

    Attributes:
        folder: Where they are.
        most_bytes: That they may take together.
        refused: Whether others can write to the folder: nothing is read, nothing is written.
    """

    def __init__(self, folder: Path, most_bytes: int | None = None, say: Say | None = None) -> None:
        """Takes a folder, which need not be there.

        Args:
            folder: The folder.
            most_bytes: Bound; None takes that of the environment, or 4 GiB.
            say: Called once, with a line of text, if nothing can be read or written.

        Raises:
            ScenecError: The environment's bound is no size.
        """
        self.folder = folder
        self.most_bytes = most_of_environment() if most_bytes is None else most_bytes
        self._say = say or (lambda _text: None)
        self._written = 0
        why = refused_folder(folder)
        self.refused = why is not None
        self._writable = not self.refused
        if why is not None:
            self._warn(why)

    def path(self, key: str) -> Path:
        """Returns the path of a key's entry.

        Raises:
            OutputError: A link there leads out of the folder.
        """
        return inside(self.folder, f"{_STEPS}/{key[:2]}/{key}{_SUFFIX}")

    def find(self, key: str) -> Packed | None:
        """The entry of a key; None if there is none, or none that is whole."""
        if self.refused:
            return None
        try:
            path = self.path(key)
            entry = read_entry(path, key)
        except FileNotFoundError:
            return None
        except (OSError, OutputError, *FAULTS) as error:
            self.drop(key, str(error))
            return None
        with suppress(OSError):
            os.utime(path)
        return entry

    def drop(self, key: str, why: str) -> None:
        """Removes an entry that is not whole."""
        _log.debug("%s: dropped: %s", key, why)
        with suppress(OSError, OutputError):
            self.path(key).unlink(missing_ok=True)

    def put(self, key: str, value: Packed) -> None:
        """Keeps an entry; where nothing can be written, that is said once, and no more is tried."""
        if not self._writable or value.size > self.most_bytes:
            return
        try:
            path = self.path(key)
            make_private_folder(path.parent)
            with atomic(path) as temporary:
                self._written += write_entry(temporary, key, value)
        except (OSError, OutputError) as error:
            self._writable = False
            cause = error.__cause__ or error
            self._warn((isinstance(cause, OSError) and cause.strerror) or str(error))
            return
        # Long runs write more than all that may be there.
        if self._written > self.most_bytes // 4:
            self.tidy()

    def tidy(self) -> None:
        """Removes what was used longest ago until the rest fits, and what was left unfinished."""
        if not self._writable or not (self.folder / _STEPS).is_dir():
            return
        self._written = 0
        with suppress(OSError, OutputError):
            # Written anew each time: its time is now.
            with atomic(self.folder / _TAG) as tag:
                tag.write_text(_TAG_TEXT, encoding="ascii")
            now = (self.folder / _TAG).stat().st_mtime
            entries = []
            for path, stat in self._files():
                if path.name.startswith("."):
                    if now - stat.st_mtime > _LEFT_BEHIND_S:
                        path.unlink(missing_ok=True)
                else:
                    entries.append((stat.st_mtime_ns, path.name, stat.st_size, path))
            total = sum(size for _, _, size, _ in entries)
            for _, _, size, path in sorted(entries):
                if total <= self.most_bytes:
                    break
                _log.debug("%s: dropped: longest unused", path)
                path.unlink(missing_ok=True)
                total -= size

    def _warn(self, why: str) -> None:
        self._say(f"cache {self.folder}: {why}; compiling goes on without keeping steps")

    def size(self) -> tuple[int, int]:
        """Counts the entries, and the bytes that they take."""
        sizes = [stat.st_size for path, stat in self._files() if not path.name.startswith(".")]
        return len(sizes), sum(sizes)

    def _files(self) -> Iterator[tuple[Path, os.stat_result]]:
        """Ours: nothing else in the folder is ever touched, nor what links in it lead to."""
        steps = self.folder / _STEPS
        if steps.is_symlink():
            return
        # Not by pathlib, which takes ten times as long.
        for group in _scanned(steps):
            if len(group.name) == 2 and group.is_dir(follow_symlinks=False):
                for file in _scanned(group.path):
                    if file.name.endswith(_SUFFIX) and file.is_file(follow_symlinks=False):
                        with suppress(OSError):
                            yield Path(file.path), file.stat()


def _scanned(folder: Path | str) -> list[os.DirEntry[str]]:
    """What is in a folder; nothing of one that went, or cannot be read."""
    try:
        return sorted(os.scandir(folder), key=lambda entry: entry.name)
    except OSError:
        return []


def default_folder() -> Path | None:
    """``$SCENEC_CACHE``, or the platform's folder for caches; None: the variable is empty."""
    given = os.environ.get(FOLDER_VARIABLE)
    if given is not None:
        return Path(given).expanduser() if given else None
    home = Path("~").expanduser()
    if sys.platform == "win32":
        return Path(os.environ.get("LOCALAPPDATA") or home / "AppData" / "Local") / "scenec"
    if sys.platform == "darwin":
        return home / "Library" / "Caches" / "scenec"
    return Path(os.environ.get("XDG_CACHE_HOME") or home / ".cache") / "scenec"


def most_of_environment() -> int:
    """``$SCENEC_CACHE_MAX`` in bytes, or 4 GiB.

    Raises:
        ScenecError: It is no size.
    """
    given = os.environ.get(MOST_VARIABLE)
    return MOST_BYTES if not given else parsed_size(given, f"${MOST_VARIABLE}")


def parsed_size(text: str, what: str) -> int:
    """Bytes of a text such as ``500M`` or ``4G``: K, M, G, T are powers of 1024.

    Args:
        text: The size.
        what: Who says it, for the message.

    Raises:
        ScenecError: It is no size.
    """
    number = text.strip().lower().removesuffix("b").removesuffix("i")
    unit = number[-1:] if number[-1:].isalpha() else ""
    try:
        size = float(number.removesuffix(unit))
        if unit not in _UNITS or not 0.0 <= size < float("inf"):
            raise ValueError
        return int(size * 2.0 ** _UNITS[unit])
    except ValueError:
        raise ScenecError(
            f"{what}: {text!r}: expected a size such as 500M or 4G (0 keeps nothing)"
        ) from None
