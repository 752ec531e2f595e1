"""Frames rendered and written from a session, without an output around them."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

from scenec.backends.run.session import Session
from scenec.backends.run.units import Opening, RenderFrame
from scenec.schemas.frames import FrameKey
from scenec.schemas.units import Keeper


def render_to(session: Session, stem: Path, sample: int, key: FrameKey, seed: int = 0) -> None:
    """Renders a frame of the first camera and writes it, as a worker does.

    Args:
        session: The stage, opened.
        stem: The frame's path, without a suffix.
        sample: Time code.
        key: What it is made with; by the session's own version.
        seed: Of its noise.

    Raises:
        ScenecError: As of ``RenderFrame.run``.
    """
    opening, keeper = Opening(str(session.scene.source), key.backend), Keeper()
    keeper.keep(opening, lambda: session)
    key = replace(key, backend_version=session.facts().version)
    RenderFrame(opening, "a frame", stem, "camera", 0, sample, key, seed).run(keeper)
