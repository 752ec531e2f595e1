"""Writes what was imported: a cfg, and the files that it needs in a folder beside it."""

from __future__ import annotations

import os
import shutil
from dataclasses import dataclass, field
from pathlib import Path

from scenec.compiler.cfg.load import load
from scenec.importers.report import Report
from scenec.importers.writers import Writer
from scenec.schemas.codec import JsonObject
from scenec.schemas.errors import CfgError, Fault, OutputError
from scenec.schemas.files import as_json, atomic, check_output, temporary_folder
from scenec.schemas.packages import is_packaged, packaged_bytes, packaged_name


@dataclass
class Imported:
    """A cfg in the making.

    Attributes:
        out: The cfg file that it becomes.
        cfg: Its value.
        report: What became of what was imported.
        made: Files that it needs and nobody has: name and what writes it.
        options: Words for ``scenec run`` that no cfg says.
    """

    out: Path
    cfg: JsonObject = field(default_factory=dict)
    report: Report = field(default_factory=Report)
    made: dict[str, Writer] = field(default_factory=dict)
    options: list[str] = field(default_factory=list)

    @property
    def folder(self) -> Path:
        """Returns the folder of the files that are made for the cfg."""
        return self.out.with_name(f"{self.out.stem}_files")

    def refer(self, file: Path) -> str:
        """Returns the cfg's reference to an existing file; one in a package is copied out."""
        if is_packaged(file):
            return self.make(packaged_name(file), _Copy(file))
        # Where links are, ".." leads from what they point to.
        return Path(os.path.relpath(file.resolve(), self.out.parent.resolve())).as_posix()

    def make(self, name: str, write: Writer) -> str:
        """Has a file made, and says how the cfg names it: otherwise where another has that name."""
        stem, dot, suffix = name.rpartition(".")
        # Some file systems do not tell cases apart.
        taken = {other.casefold(): writer for other, writer in self.made.items()}
        free, number = name, 2
        while taken.get(free.casefold(), write) != write:
            free, number = f"{stem}_{number}{dot}{suffix}", number + 1
        self.made[free] = write
        return f"{self.folder.name}/{free}"


@dataclass(frozen=True)
class _Copy:
    """Copies a picture out of a package."""

    picture: Path

    def __call__(self, path: Path) -> None:
        path.write_bytes(packaged_bytes(self.picture))


def check_free(out: Path) -> None:
    """Sees that nothing would be overwritten, before anything is read.

    Raises:
        OutputError: The cfg or its folder is there, or cannot be written.
    """
    if out.suffix.lower() not in (".json", ".jsonc"):
        raise OutputError(f"{out}: an imported cfg is JSON: expected a name that ends with .json")
    for path in (out, out.with_name(f"{out.stem}_files")):
        if path.exists():
            raise OutputError(f"{path}: is there already; choose another name by -o")
    check_output(out)


def write(imported: Imported) -> list[str]:
    """Writes the cfg and its files, all or nothing, once it is valid.

    Returns:
        What is improbable in the cfg.

    Raises:
        CfgError: The cfg is not valid.
        OutputError: Something cannot be written.
    """
    out, folder = imported.out, imported.folder
    with temporary_folder(out.parent) as making:
        for name, write_file in imported.made.items():
            write_file(making / name)
        if imported.made:
            making.rename(folder)
        try:
            with atomic(out) as temporary:
                temporary.write_text(as_json(imported.cfg), encoding="utf-8")
                try:
                    spec = load(temporary)
                except CfgError as error:
                    # A file of that name is not there, and will not be.
                    name = f"{out} (not written, since no cfg can hold this)"
                    raise CfgError([_renamed(f, temporary, name) for f in error.faults]) from error
                return [str(_renamed(fault, temporary, str(out))) for fault in spec.warnings]
        except BaseException:
            if imported.made:
                shutil.rmtree(folder, ignore_errors=True)
            raise


def _renamed(fault: Fault, temporary: Path, name: str) -> Fault:
    file = name if fault.file == str(temporary) else fault.file
    return Fault(file, fault.line, fault.column, fault.pointer, fault.message)
