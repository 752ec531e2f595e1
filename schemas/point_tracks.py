"""Point tracks: what ``scenec export --format tapvid`` is asked, and what is followed.

A point is chosen in a picture, by a ray through a place in it; it is fixed to the surface there and
moves with it. Each picture of a camera then shows it at a place, or does not.
"""

from __future__ import annotations

import hashlib
from collections.abc import Mapping
from dataclasses import dataclass, fields
from typing import Any

import numpy as np
from numpy.typing import NDArray

from scenec.schemas.errors import OutputError
from scenec.schemas.spelling import nearest

#: More points a camera than that are a slip.
MOST_POINTS = 1_000_000
#: Option -> the words that it takes.
_WORDS = {
    "queries": ("all", "first"),
    "places": ("random", "centers"),
    "video": ("yes", "no"),
}


@dataclass(frozen=True, kw_only=True)
class TrackOptions:
    """Describes the tracks that are asked for.

    Attributes:
        points: How many a camera.
        strata: ``none``: each place of the pictures alike; ``instance`` or ``label.<level>``: as
            many on each of these as there are, the rest on the others.
        queries: In which frames points are chosen: ``all``, as many in each, or the ``first``.
        places: ``random`` within pixels, or their ``centers``.
        seed: Of the choice.
        camera: In whose pictures the points of all cameras are chosen; "": in each one's own.
        video: Whether the pictures are part of it, ``yes`` or ``no``.
    """

    points: int = 256
    strata: str = "none"
    queries: str = "all"
    places: str = "random"
    seed: int = 0
    camera: str = ""
    video: str = "yes"

    def __post_init__(self) -> None:
        """Checks its values.

        Raises:
            OutputError: One makes no sense.
        """
        for name, words in _WORDS.items():
            value = getattr(self, name)
            if value not in words:
                raise OutputError(
                    f"{name}={value}: expected {' or '.join(words)}{nearest(value, words)}"
                )
        if not 1 <= self.points <= MOST_POINTS:
            raise OutputError(f"points={self.points}: expected a number from 1 to {MOST_POINTS:,}")
        if not 0 <= self.seed < 2**63:
            raise OutputError(f"seed={self.seed}: expected a number from 0 to 2**63 - 1")
        if self.strata not in ("none", "instance") and not self.strata.startswith("label."):
            raise OutputError(
                f"strata={self.strata}: expected none, instance or label.<level>"
                f"{nearest(self.strata, ('none', 'instance', 'label.'))}"
            )

    def require_level(self, levels: tuple[str, ...], stage: str) -> None:
        """Checks ``strata`` against a stage.

        Raises:
            OutputError: It has no such level of labels.
        """
        known = [f"label.{level}" for level in levels]
        if self.strata.startswith("label.") and self.strata not in known:
            raise OutputError(
                f"strata={self.strata}: {stage} has {', '.join(known) or 'no labels'}"
                f"{nearest(self.strata, known)}"
            )

    def key(self, camera: str) -> int:
        """Returns the key of the random numbers of points chosen in a camera's pictures."""
        digest = hashlib.sha256(f"point tracks/{self.seed}/{camera}".encode()).digest()
        return int.from_bytes(digest[:8], "little")

    def per_frame(self, frames: int) -> list[int]:
        """How many points are chosen in each of so many frames."""
        if self.queries == "first":
            return [self.points] + [0] * (frames - 1)
        return [self.points // frames + (i < self.points % frames) for i in range(frames)]


@dataclass(frozen=True)
class CameraFrames:
    """Describes a camera as far as tracks need that.

    Attributes:
        name: Its own.
        samples: Those at which it has frames, ascending.
        times_s: Of these, seconds.
        size: Width and height, pixels.
    """

    name: str
    samples: tuple[int, ...]
    times_s: tuple[float, ...]
    size: tuple[int, int]


@dataclass(frozen=True)
class TrackFacts:
    """Describes a stage as far as its tracks need that.

    Attributes:
        digest: Of the stage.
        cameras: Its cameras.
        label_names: Level -> id -> name.
        instance_paths: Prim path of a class of instances -> what is added to its local ids.
        losses: A line for each thing in the stage that was not read.
    """

    digest: str
    cameras: tuple[CameraFrames, ...]
    label_names: dict[str, dict[int, str]]
    instance_paths: dict[str, int]
    losses: tuple[str, ...]


@dataclass(frozen=True)
class TrackPoints:
    """Holds points that are followed, one an entry.

    Attributes:
        sample: At which each was chosen, int64 [n].
        pixel: Column and row there, float64 [n, 2].
        row, face: What it lies on, int32 [n].
        anchor: Where: world, or the frame of its row where that moves; meters, float64 [n, 3].
        instance: Id, uint32 [n]; 0 is none.
        labels: Level -> id, uint32 [n].
    """

    sample: NDArray[np.int64]
    pixel: NDArray[np.float64]
    row: NDArray[np.int32]
    face: NDArray[np.int32]
    anchor: NDArray[np.float64]
    instance: NDArray[np.uint32]
    labels: Mapping[str, NDArray[np.uint32]]

    @classmethod
    def joined(cls, parts: list[TrackPoints]) -> TrackPoints:
        """Those of several frames in turn: the first of each, the second of each, and so on."""
        rank = np.concatenate([np.arange(len(part.sample)) for part in parts])
        order = np.argsort(rank, kind="stable")

        def one(of: Any) -> NDArray[Any]:
            return np.concatenate([of(part) for part in parts])[order]

        labels = {level: one(lambda p, at=level: p.labels[at]) for level in parts[0].labels}
        arrays = (f.name for f in fields(cls) if f.name != "labels")
        return cls(
            **{name: one(lambda p, at=name: getattr(p, at)) for name in arrays}, labels=labels
        )


@dataclass(frozen=True)
class TrackSights:
    """Holds what a frame, or one after the other, makes of n points; [n, …] or [n, frames, …].

    Attributes:
        pixel: Column and row, float64 [..., 2]; NaN where the point is behind the camera or gone.
        position: World, meters, float64 [..., 3]; NaN where it is gone.
        depth: Planar depth, meters, float64; NaN where it is gone.
        code: ``schemas.correspondence.CODES``, uint8.
        undecided: Whether it counts as visible within rounding alone, bool.
    """

    pixel: NDArray[np.float64]
    position: NDArray[np.float64]
    depth: NDArray[np.float64]
    code: NDArray[np.uint8]
    undecided: NDArray[np.bool_]

    @classmethod
    def joined(cls, frames: list[TrackSights]) -> TrackSights:
        """Those of frames one after the other."""
        return cls(*(np.stack([getattr(s, f.name) for s in frames], axis=1) for f in fields(cls)))
