"""Point tracks of a stage as units of work: a stage's cameras, and the points of a frame."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

from scenec.backends.run.units import Opening
from scenec.schemas.errors import StageError
from scenec.schemas.point_tracks import (
    CameraFrames,
    TrackFacts,
    TrackOptions,
    TrackPoints,
    TrackSights,
)
from scenec.schemas.units import Keeper

if TYPE_CHECKING:
    from scenec.backends.run.session import Session
    from scenec.backends.stage.scene import Camera


@dataclass(frozen=True)
class DescribeCameras:
    """Opens a stage, and tells what points can be followed in: ``TrackFacts``.

    Attributes:
        holds: The stage.
        options: What tracks are asked for.
    """

    holds: Opening
    options: TrackOptions

    @property
    def what(self) -> str:
        """In messages."""
        return f"cameras of {self.holds.stage}"

    def run(self, keeper: Keeper) -> TrackFacts:
        """Reads it, unless it is held.

        Raises:
            StageError: It cannot be read.
            OutputError: It has no such labels.
        """
        from scenec.backends.run.facts import time_of

        scene = self.holds.session(keeper).scene
        self.options.require_level(tuple(scene.levels), self.holds.stage)
        cameras = []
        for number, camera in enumerate(scene.cameras[0]):
            there = [s for s in range(scene.samples) if scene.cameras[s][number].fires(s)]
            times = [time_of(scene, sample) for sample in there]
            told = [s if time is None else time for s, time in zip(there, times, strict=True)]
            size = camera.width, camera.height
            cameras.append(CameraFrames(camera.name, tuple(there), tuple(map(float, told)), size))
        return TrackFacts(
            digest=scene.digest,
            cameras=tuple(cameras),
            label_names=scene.label_names,
            instance_paths=dict(scene.instance_paths),
            losses=tuple(scene.losses),
        )


@dataclass(frozen=True)
class OfFrame:
    """Has something done with a camera at a sample.

    Attributes:
        holds: The stage.
        digest: Of the stage.
        camera: Name.
        sample: Time code.
    """

    holds: Opening
    digest: str
    camera: str
    sample: int

    @property
    def what(self) -> str:
        """In messages."""
        return f"{self.camera}/{self.sample:06d} of {self.holds.stage}"

    def _opened(self, keeper: Keeper) -> tuple[Session, Camera]:
        session = self.holds.session(keeper)
        scene = session.scene
        if scene.digest != self.digest:
            raise StageError(f"{scene.source}: has changed since its export was begun; run again")
        return session, next(c for c in scene.cameras[self.sample] if c.name == self.camera)


@dataclass(frozen=True)
class ChoosePoints(OfFrame):
    """Chooses points in a frame.

    Attributes:
        count: How many.
        options: How.
    """

    count: int
    options: TrackOptions

    def run(self, keeper: Keeper) -> TrackPoints:
        """Casts the picture's rays.

        Raises:
            StageError: The stage is no more what it was.
        """
        from scenec.backends.annotation.point_tracks import choose_points

        session, camera = self._opened(keeper)
        return choose_points(
            session.scene, session.caster(), camera, self.sample, self.count, self.options
        )


@dataclass(frozen=True)
class FollowPoints(OfFrame):
    """Finds points in a frame.

    Attributes:
        points: Of the stage.
    """

    points: TrackPoints

    def run(self, keeper: Keeper) -> TrackSights:
        """Casts a ray to each.

        Raises:
            StageError: The stage is no more what it was.
        """
        from scenec.backends.annotation.point_tracks import follow_points

        session, camera = self._opened(keeper)
        return follow_points(session.scene, session.caster(), camera, self.sample, self.points)
