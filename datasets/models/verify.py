"""Is an export of models as it was written?"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

from scenec.datasets.export_records import EXPORT
from scenec.datasets.models import MODEL_FORMATS
from scenec.datasets.verify import Flaw
from scenec.schemas.codec import UNSET, Natural, Unset, read_record
from scenec.schemas.errors import OutputError
from scenec.schemas.files import read_json, sha256

_WHAT = f"{EXPORT} of scenec"


@dataclass(frozen=True, kw_only=True)
class ModelFile:
    """The file of a batch, as it was written."""

    file: str
    bytes: Natural
    sha256: str | Unset = UNSET


@dataclass(frozen=True, kw_only=True)
class ModelsRecord:
    """Records the content of the models' ``export.json``: the file of each batch."""

    batches: Mapping[str, ModelFile]


def is_models(folder: Path) -> bool:
    """Whether a folder is what ``scenec export`` makes of stages."""
    try:
        found = read_json(folder / EXPORT, OutputError, _WHAT)
    except (FileNotFoundError, OutputError):
        return False
    return isinstance(found, dict) and found.get("format") in tuple(MODEL_FORMATS)


def verify_models(folder: Path) -> list[Flaw]:
    """All that is wrong with a folder of models: files that are missing, changed or of nobody.

    Raises:
        OutputError: Its ``export.json`` is none.
    """
    batches = read_record(folder / EXPORT, ModelsRecord, OutputError, _WHAT).batches
    flaws = []
    for entry in batches.values():
        file = folder / entry.file
        if not file.is_file():
            flaws.append(Flaw(entry.file, "is missing"))
        elif file.stat().st_size != entry.bytes:
            what = f"has {file.stat().st_size:,} bytes; {EXPORT} says {entry.bytes:,}"
            flaws.append(Flaw(entry.file, what))
        elif entry.sha256 is not UNSET and sha256(file) != entry.sha256:
            flaws.append(Flaw(entry.file, f"was changed: its sha256 is not that of {EXPORT}"))
    names = {entry.file for entry in batches.values()}
    others = (p.name for p in sorted(folder.glob("batch_*")) if p.name not in names)
    return flaws + [Flaw(name, f"is no part of it: {EXPORT} does not list it") for name in others]
