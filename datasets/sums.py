"""The files of a dataset that is being made, and their digests (``SHA256SUMS``)."""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping
from pathlib import Path

from scenec.schemas.errors import OutputError
from scenec.schemas.files import atomic, inside, tree

#: Of every file but itself.
SUMS = "SHA256SUMS"
_SUM = re.compile(r"([0-9a-f]{64})  (.+)")


def note(form: str, sums: dict[str, str], files: Mapping[str, str]) -> None:
    """Add files to the sums.

    Args:
        form: The format's name.
        sums: Path -> sha256; added to.
        files: Likewise.

    Raises:
        OutputError: One is there already: the format does not keep its tasks apart.
    """
    for name in files:
        if name in sums or name == SUMS:
            raise OutputError(f"format {form} wrote {name} twice")
    sums.update(files)


def settle(form: str, data: Path, sums: dict[str, str], moved: Mapping[str, str | None]) -> None:
    """Move and delete files of tasks, as ``contract.Settled`` says.

    A task whose file is gone is done again, so this may be cut short.

    Args:
        form: The format's name.
        data: The dataset's folder.
        sums: Path -> sha256; changed.
        moved: As of ``Settled``.

    Raises:
        OutputError: A file cannot be moved, or another lies where it goes.
    """
    for old, new in moved.items():
        digest = sums.pop(old)
        try:
            if new is None:
                (data / old).unlink()
            else:
                note(form, sums, {new: digest})
                (data / new).parent.mkdir(parents=True, exist_ok=True)
                (data / old).replace(data / new)
        except OSError as error:
            raise OutputError(f"{data / old}: cannot be moved: {error.strerror}") from error


def read_sums(folder: Path) -> Iterator[tuple[int, str, str]]:
    """Lines of a dataset's ``SHA256SUMS``: number from 1, name, digest; both empty if it is none.

    Raises:
        FileNotFoundError: It is not there.
        OutputError: It cannot be read.
    """
    try:
        lines = (folder / SUMS).read_text(encoding="utf-8").splitlines()
    except FileNotFoundError:
        raise
    except (OSError, ValueError) as error:
        raise OutputError(f"{folder / SUMS}: cannot be read: {error}") from error
    for number, line in enumerate(lines, 1):
        match = _SUM.fullmatch(line)
        try:
            name = "" if match is None else match[2]
            inside(folder, name)
        except OutputError:
            match = None
        yield (number, "", "") if match is None else (number, match[2], match[1])


def listed(folder: Path) -> set[str]:
    """Names of a dataset's files, as ``SHA256SUMS`` has them; none where it is missing."""
    try:
        return {name for _, name, _ in read_sums(folder) if name} | {SUMS}
    except FileNotFoundError:
        return set()


def write_sums(data: Path, sums: Mapping[str, str]) -> None:
    """Write ``SHA256SUMS``, sorted by paths.

    Raises:
        OutputError: It cannot be written.
    """
    with atomic(data / SUMS) as temporary:
        lines = [f"{digest}  {name}\n" for name, digest in sorted(sums.items())]
        temporary.write_text("".join(lines), encoding="utf-8")


def tidy(data: Path, listed: set[str]) -> None:
    """Delete what is no part of the dataset: of an earlier export that was cut short."""
    for path in tree(data):
        if path.as_posix() not in listed:
            (data / path).unlink()
    for folder in sorted(data.rglob("*"), reverse=True):
        if folder.is_dir() and not any(folder.iterdir()):
            folder.rmdir()
