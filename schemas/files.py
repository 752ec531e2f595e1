"""Files that appear whole or not at all, and their hashes."""

from __future__ import annotations

import hashlib
import json
import math
import os
import secrets
import shutil
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any

from scenec.schemas.errors import OutputError


def sha256(path: Path) -> str:
    """Hex digest of a file's bytes."""
    with path.open("rb") as file:
        return hashlib.file_digest(file, "sha256").hexdigest()


@contextmanager
def atomic(path: Path) -> Iterator[Path]:
    """A temporary path beside ``path`` that takes its place when the block ends well.

    Raises:
        OutputError: The folder cannot be written.
    """
    # The ending stays: libraries choose their format by it.
    temporary = path.with_name(f".{path.stem}.{secrets.token_hex(4)}{path.suffix}")
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        yield temporary
        os.replace(temporary, path)
    except OSError as error:
        raise OutputError(f"{path}: cannot be written: {error.strerror or error}") from error
    finally:
        with suppress(OSError):
            temporary.unlink(missing_ok=True)


def write_json(path: Path, value: Any) -> None:
    """Writes strict JSON (no NaN or infinity: they become null), two spaces of indent."""
    with atomic(path) as temporary:
        temporary.write_text(
            json.dumps(_finite(value), indent=2, ensure_ascii=False, allow_nan=False) + "\n",
            encoding="utf-8",
        )


def _finite(value: Any) -> Any:
    if isinstance(value, dict):
        return {key: _finite(item) for key, item in value.items()}
    if isinstance(value, list | tuple):
        return [_finite(item) for item in value]
    if isinstance(value, float) and not math.isfinite(value):
        return None
    return value


@contextmanager
def temporary_folder(beside: Path) -> Iterator[Path]:
    """An empty folder next to ``beside``, removed at the end if it is still there.

    Raises:
        OutputError: It cannot be made.
    """
    folder = beside.with_name(f".{beside.name}.{secrets.token_hex(4)}")
    try:
        folder.mkdir(parents=True)
    except OSError as error:
        raise OutputError(f"{beside.parent}: cannot be written: {error.strerror}") from error
    try:
        yield folder
    except OSError as error:
        raise OutputError(f"{beside}: cannot be written: {error.strerror or error}") from error
    finally:
        shutil.rmtree(folder, ignore_errors=True)


def tree(folder: Path) -> list[Path]:
    """All files below a folder, relative to it, in a fixed order."""
    return sorted(path.relative_to(folder) for path in folder.rglob("*") if path.is_file())


def same_tree(a: Path, b: Path, ignore: tuple[str, ...] = ()) -> bool:
    """Whether two folders hold the same files with the same bytes.

    Args:
        a: One folder.
        b: The other.
        ignore: Names of folders directly below ``b`` that do not count.
    """
    files_a = tree(a)
    files_b = [path for path in tree(b) if path.parts[0] not in ignore]
    return files_a == files_b and all(sha256(a / path) == sha256(b / path) for path in files_a)


def replace_folder(new: Path, final: Path, keep: tuple[str, ...] = ()) -> None:
    """Puts ``new`` in the place of ``final``; folders named in ``keep`` are carried over.

    Raises:
        OutputError: The file system refuses.
    """
    try:
        if final.exists():
            old = final.with_name(f".{final.name}.{secrets.token_hex(4)}")
            os.rename(final, old)
            os.rename(new, final)
            # Only then: ``new`` is temporary, and what is kept must never be inside of it.
            for name in keep:
                if (old / name).is_dir():
                    os.rename(old / name, final / name)
            shutil.rmtree(old)
        else:
            os.rename(new, final)
    except OSError as error:
        raise OutputError(f"{final}: cannot be replaced: {error.strerror}") from error
