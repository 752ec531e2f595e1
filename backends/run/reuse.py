"""Finds annotation that another backend's frame of the same picture holds."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from scenec.backends.annotation.annotate import Annotation
from scenec.backends.annotation.instances import Seen
from scenec.backends.run.facts import annotation_versions
from scenec.schemas.amodal import read_amodal
from scenec.schemas.codec import UNSET
from scenec.schemas.errors import FrameError
from scenec.schemas.frames import read_frame
from scenec.schemas.instances import read_frame_table
from scenec.schemas.passes import AMODAL
from scenec.schemas.records import FrameRecord
from scenec.schemas.sidecars import read_sidecar


def find_annotation(stem: Path, digest: str, passes: Sequence[str]) -> Annotation | None:
    """Finds annotation of this very picture in some backend's frame; None if none has it.

    Args:
        stem: Where the frame will be.
        digest: Of the stage.
        passes: All but ``rgb`` that are needed.
    """
    for path in sorted(stem.parents[2].glob(f"*/{stem.parent.name}/{stem.name}.json")):
        try:
            record = read_sidecar(path)
            height, sky = record.height_above_surface_m, record.sky
            if not _holds(record, digest, passes) or height is UNSET or sky is None:
                continue
            frame = read_frame(path, passes, [n for n in record.passes if n not in passes])
            seen = None
            if "instance" in passes:
                masks = read_amodal(path) if AMODAL in passes else None
                seen = Seen(read_frame_table(path), masks)
            return Annotation(frame.passes, seen, height, (sky.pixels, sky.below_horizon))
        except (FrameError, OSError, ValueError):
            # Damaged, or of another version: it is cast again.
            continue
    return None


def _holds(record: FrameRecord, digest: str, passes: Sequence[str]) -> bool:
    made = record.annotation or {}
    return (
        record.stage_digest == digest
        and all(made.get(name) == version for name, version in annotation_versions(passes).items())
        and set(passes) - {AMODAL} <= set(record.passes)
        and (AMODAL not in passes or record.amodal is not None)
    )
