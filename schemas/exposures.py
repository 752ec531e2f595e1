"""Exposures that were metered of a stage: ``exposure.json`` beside the frames of its batch.

Whoever needs one that is there takes it, so that a stage is metered once, by whatever process and
for whatever renderer. Nothing else depends on the file: where it is missing, of another stage or
damaged, its exposures are metered again.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from scenec.schemas.codec import encode, read_record
from scenec.schemas.errors import FrameError
from scenec.schemas.files import write_json

#: Of a batch, in its folder of frames.
EXPOSURES = "exposure.json"


@dataclass(frozen=True)
class Exposure:
    """Holds a light meter's result.

    Attributes:
        ev: Pictures show radiance * 2**ev.
        level: Luminance that is shown as ``picture.exposure.GRAY`` unless highlights bind,
            W/(m^2 sr).
        highlight: ``PERCENTILE`` of luminance.
        glare: ``GLARE_PERCENTILE`` of that of surfaces and sky.
        of: "surfaces", "sky" where none is seen, or "nothing" where no light comes from either.
        samples: How many were metered.
    """

    ev: float
    level: float
    highlight: float
    glare: float
    of: str
    samples: int


@dataclass(frozen=True)
class CameraExposure:
    """An exposure, and whose it is.

    Attributes:
        camera: Path of its prim.
        sample: The one sample that it is for; None: all of the batch.
    """

    camera: str
    sample: int | None
    exposure: Exposure


@dataclass(frozen=True)
class ExposureTable:
    """The exposures of a stage.

    Attributes:
        stage_digest: Of the stage.
        metering: Digest of the code that metered.
    """

    stage_digest: str
    metering: str
    exposures: tuple[CameraExposure, ...] = ()


def read_exposures(path: Path) -> ExposureTable:
    """Reads a table.

    Raises:
        FileNotFoundError: There is none.
        FrameError: It is damaged; with the JSON pointer.
    """
    return read_record(path, ExposureTable, FrameError, "table of exposures")


def exposures_digest(path: Path) -> str | None:
    """Digest of the stage that a table is of; None if there is none, or a damaged one."""
    try:
        return read_exposures(path).stage_digest
    except (FileNotFoundError, FrameError):
        return None


def write_exposures(path: Path, table: ExposureTable) -> None:
    """Writes a table, whole or not at all.

    Raises:
        OutputError: It cannot be written.
    """
    write_json(path, encode(table))
