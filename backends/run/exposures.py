"""Does what a frame needs beside its renderer: its camera's exposure, and what annotates it."""

from __future__ import annotations

from contextlib import ExitStack
from pathlib import Path
from typing import TYPE_CHECKING

from scenec.backends.picture.exposure_store import ExposureStore
from scenec.backends.run.session import Session, timed
from scenec.schemas.manifest import FRAMES
from scenec.schemas.records import ExposureRecord
from scenec.schemas.units import Say

if TYPE_CHECKING:
    from scenec.backends.exact import ExactCaster
    from scenec.backends.stage.scene import Camera


def exposed(
    session: Session, camera: Camera, sample: int, folder: Path, seconds: dict[str, float], say: Say
) -> tuple[Camera, ExposureRecord]:
    """Returns a camera with its exposure, and where that comes from (``Meter.exposed``).

    Args:
        session: Of its stage.
        camera: The camera at the sample.
        sample: Time code.
        folder: Of the batch's frames, which keeps what was metered.
        seconds: By step, of nothing else so far; what it took is added.
        say: Told what a user should see.
    """
    scene = session.scene
    # What is rendered elsewhere has what was metered beside the stage.
    beside = scene.source.absolute().parent / FRAMES
    with timed(seconds, "exposure"), ExitStack() as casting:

        def caster() -> ExactCaster:
            casting.enter_context(session.casting)
            return session.caster(seconds)

        store = ExposureStore(folder, scene.digest, (beside,), say)
        found = session.meter.exposed(camera, sample, caster, store)
    seconds["exposure"] -= seconds.get("load", 0.0)
    return found


def prepare(session: Session, seconds: dict[str, float] | None) -> None:
    """Gets what completing a frame needs, so that it is there when the frame has been drawn.

    Args:
        session: Of its stage.
        seconds: By step; what building the caster took is added. None: the frame casts nothing.
    """
    if seconds is not None:
        session.caster(seconds)
