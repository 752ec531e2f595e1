"""Files that a foreign scene names: where they are, and which are missing."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from pathlib import Path

from scenec.compiler.cfg.faults import pointer
from scenec.importers.source import Item
from scenec.schemas.errors import CfgError, Fault
from scenec.schemas.spelling import closest, shown

#: Folders above that of the file which are looked in, too.
_UP = 3


class Assets:
    """The files of one scene.

    Attributes:
        stand_ins: Whether something procedural may stand for what is missing.
    """

    def __init__(self, file: Path, folders: Sequence[Path], stand_ins: bool):
        """Prepares to look for files.

        Args:
            file: The scene: its folder and those above it are looked in.
            folders: Looked in first.
            stand_ins: See above.
        """
        parents = list(file.resolve().parents)[: _UP + 1]
        self._folders = list(dict.fromkeys([*(f.resolve() for f in folders), *parents]))
        self.stand_ins = stand_ins
        self._missing: list[Fault] = []

    def find(self, item: Item, replacement: str, *, folder: bool = False) -> Path | None:
        """The file, or folder, that a string names; None where it is missing.

        Args:
            item: The string; what becomes of it where a stand-in takes its place is said.
            replacement: What that is.
            folder: Whether a folder is looked for.
        """
        name = item.text().replace("\\", "/")
        fits: Callable[[Path], bool] = Path.is_dir if folder else Path.is_file
        for root in self._folders if name else ():
            # Workspaces of others: the end of their path may be here.
            for end in _ends(name):
                if fits(root / end):
                    return root / end
        if self.stand_ins:
            item.approximated("", f"not found: in its place {replacement}")
        elif name:
            self._miss(item, name, "folder" if folder else "file", replacement)
        return None

    def _miss(self, item: Item, name: str, what: str, replacement: str) -> None:
        where = ", ".join(str(root) for root in self._folders[:2])
        place = item.source.document.values[item.path]
        there = [
            p.name for r in self._folders for p in [(r / name).parent] if p.is_dir()
            for p in sorted(p.iterdir())
        ]  # fmt: skip
        guess = closest(Path(name).name, there)
        hint = f"; did you mean {shown(guess)}?" if guess else ""
        message = (
            f"no {what} {shown(name)} in {where} or above{hint}; --assets DIR says where to look, "
            f"--stand-ins puts {replacement} in its place"
        )
        self._missing.append(
            Fault(place.file, place.line, place.column, pointer(item.path), message)
        )

    def check(self) -> None:
        """Raises all that is missing.

        Raises:
            CfgError: Something is.
        """
        if self._missing:
            raise CfgError(self._missing)


def _ends(name: str) -> list[Path]:
    """A path and, where it is absolute or begins with a placeholder, what it ends with."""
    path = Path(name)
    if not path.is_absolute() and not name.startswith("<"):
        return [path]
    ends = [Path(*path.parts[i:]) for i in range(1, len(path.parts))]
    return [path, *ends] if path.is_absolute() else ends
