"""Is an export of models, maps or point tracks as it was written?"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

from scenec.datasets.export_records import EXPORT
from scenec.datasets.maps import MAP
from scenec.datasets.models import MODEL_FORMATS
from scenec.datasets.tracks import TAPVID
from scenec.datasets.verify import Flaw
from scenec.schemas.codec import UNSET, Natural, Unset, read_record
from scenec.schemas.errors import OutputError
from scenec.schemas.files import inside, read_json, sha256
from scenec.schemas.manifest import FileEntry

_WHAT = f"{EXPORT} of scenec"


@dataclass(frozen=True, kw_only=True)
class ModelFile:
    """The file of a batch, as it was written; batches of maps and tracks have none of their own."""

    file: str | Unset = UNSET
    bytes: Natural | Unset = UNSET
    sha256: str | Unset = UNSET


@dataclass(frozen=True, kw_only=True)
class ModelsRecord:
    """Records the content of the models' ``export.json``: the file of each batch, or all files."""

    batches: Mapping[str, ModelFile]
    files: Mapping[str, FileEntry] | Unset = UNSET


def is_models(folder: Path) -> bool:
    """Whether a folder is what ``scenec export`` makes of stages."""
    try:
        found = read_json(folder / EXPORT, OutputError, _WHAT)
    except (FileNotFoundError, OutputError):
        return False
    return isinstance(found, dict) and found.get("format") in (MAP, TAPVID, *MODEL_FORMATS)


def verify_models(folder: Path) -> list[Flaw]:
    """All that is wrong with a folder of models: files that are missing, changed or of nobody.

    Raises:
        OutputError: Its ``export.json`` is none.
    """
    record = read_record(folder / EXPORT, ModelsRecord, OutputError, _WHAT)
    files: dict[str, ModelFile | FileEntry] = dict(record.files or {})
    files |= {str(one.file): one for one in record.batches.values() if one.file is not UNSET}
    flaws = []
    for name, entry in files.items():
        file = inside(folder, name, f"{folder / EXPORT}: /files")
        if not file.is_file():
            flaws.append(Flaw(name, "is missing"))
        elif file.stat().st_size != entry.bytes:
            what = f"has {file.stat().st_size:,} bytes; {EXPORT} says {entry.bytes:,}"
            flaws.append(Flaw(name, what))
        elif entry.sha256 is not UNSET and sha256(file) != entry.sha256:
            flaws.append(Flaw(name, f"was changed: its sha256 is not that of {EXPORT}"))
    folders = {Path(name).parts[0] for name in files}
    there = [p.relative_to(folder).as_posix() for p in sorted(folder.glob("batch_*/*"))]
    there += [p.name for p in sorted(folder.glob("batch_*")) if p.name not in folders]
    others = (name for name in there if name not in files)
    return flaws + [Flaw(name, f"is no part of it: {EXPORT} does not list it") for name in others]
