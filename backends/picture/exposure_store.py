"""Keeps a stage's exposures beside its frames, so that of many workers one alone meters each.

The file (``scenec.schemas.exposures``) is keyed by the stage's digest and by the code that meters:
exposures of others are metered again. Who meters one holds a lock meanwhile; the others wait, and
take what it found. Where nothing can be written each meters for itself.
"""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Sequence
from contextlib import suppress
from dataclasses import astuple, dataclass, field, replace
from functools import cache
from pathlib import Path

import numpy as np

import scenec.backends
import scenec.schemas
from scenec.schemas.errors import FrameError, OutputError
from scenec.schemas.exposures import (
    EXPOSURES,
    CameraExposure,
    Exposure,
    ExposureTable,
    read_exposures,
    write_exposures,
)
from scenec.schemas.files import digest_of_folder
from scenec.schemas.lock import LOCK, BusyError, Lock
from scenec.schemas.units import Say

#: Seconds between two looks at what another process meters.
_LOOK_S = 0.02


@cache
def metering_digest() -> str:
    """Returns a digest of all that decides an exposure beside the stage: our code, and NumPy's."""
    rooms = (scenec.backends, scenec.schemas)
    code = (digest_of_folder(Path(room.__path__[0]), {".py"}) for room in rooms)
    return " ".join((*code, f"numpy {np.__version__}"))


@dataclass(frozen=True)
class ExposureStore:
    """Gives out exposures of a stage, each metered once.

    Attributes:
        folder: Of the frames that need them; exposures are kept there.
        digest: Of the stage.
        others: Folders where exposures of the stage may be, too.
        say: Told if a file is damaged.
        said: Damaged files that were told of.
    """

    folder: Path
    digest: str
    others: Sequence[Path] = ()
    say: Say = lambda _line: None
    said: set[Path] = field(default_factory=set)

    def find_or_meter(
        self, camera: str, sample: int | None, meter: Callable[[], Exposure]
    ) -> Exposure:
        """Returns an exposure that is there; else meters it, and keeps it.

        Args:
            camera: Path of its prim.
            sample: As of ``CameraExposure``.
            meter: Meters it.
        """
        for folder in (self.folder, *self.others):
            found = self._find(folder, camera, sample)
            if found is not None:
                return found
        while True:
            try:
                with Lock(self.folder / f"{LOCK}-exposure", what=self.folder / EXPOSURES):
                    # It may have come while nobody looked.
                    found = self._find(self.folder, camera, sample)
                    return found or self._keep(CameraExposure(camera, sample, meter()))
            except BusyError:
                time.sleep(_LOOK_S)
            except OutputError:
                # Nobody can write here.
                return meter()

    def _find(self, folder: Path, camera: str, sample: int | None) -> Exposure | None:
        places = ((one.camera, one.sample, one.exposure) for one in self._table(folder).exposures)
        return next((of for *place, of in places if place == [camera, sample]), None)

    def _table(self, folder: Path) -> ExposureTable:
        """Returns what is kept of this stage."""
        path = folder / EXPOSURES
        with suppress(FileNotFoundError):
            try:
                table = read_exposures(path)
                if (table.stage_digest, table.metering) == (self.digest, metering_digest()):
                    return table
            except FrameError as error:
                if path not in self.said:
                    self.say(f"{error}; its exposures are metered again")
                    self.said.add(path)
        return ExposureTable(self.digest, metering_digest())

    def _keep(self, made: CameraExposure) -> Exposure:
        exposure = made.exposure
        # JSON has no infinity; what overflows is metered by whoever needs it.
        if all(math.isfinite(value) for value in astuple(exposure) if not isinstance(value, str)):
            table = self._table(self.folder)
            table = replace(table, exposures=(*table.exposures, made))
            # A disk that is full is said of the frame, which needs more of it.
            with suppress(OutputError):
                write_exposures(self.folder / EXPOSURES, table)
        return exposure
