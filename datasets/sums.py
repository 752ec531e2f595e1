"""The files of a dataset that is being made, and their digests (``SHA256SUMS``)."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

from scenec.schemas.errors import OutputError
from scenec.schemas.files import atomic, tree

#: Of every file but itself.
SUMS = "SHA256SUMS"


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


def write_sums(data: Path, sums: Mapping[str, str]) -> None:
    """Write ``SHA256SUMS``, sorted by paths.

    Raises:
        OutputError: It cannot be written.
    """
    with atomic(data / SUMS) as temporary:
        lines = [f"{digest}  {name}\n" for name, digest in sorted(sums.items())]
        temporary.write_text("".join(lines), encoding="utf-8")


def tidy(data: Path, known: set[str]) -> None:
    """Delete what is no part of the dataset: of an earlier export that was cut short."""
    for path in tree(data):
        if path.as_posix() not in known:
            (data / path).unlink()
    for folder in sorted(data.rglob("*"), reverse=True):
        if folder.is_dir() and not any(folder.iterdir()):
            folder.rmdir()
