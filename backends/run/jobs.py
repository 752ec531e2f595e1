"""The frames of a batch: which there are, where each goes, and what a worker is asked for it."""

from __future__ import annotations

import hashlib
import os
from collections.abc import Collection, Iterator, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

from scenec.backends.run.supervise import WorkerProcess
from scenec.schemas.errors import BackendError, StageError
from scenec.schemas.files import inside
from scenec.schemas.frames import FrameKey, frame_stem
from scenec.schemas.manifest import FRAMES, Batch
from scenec.schemas.spelling import nearest


@dataclass(frozen=True)
class Wanted:
    """What is asked of a render; see ``scenec.backends.run.render.render``."""

    backend: str
    spp: int = 64
    passes: Sequence[str] | None = None
    samples: Collection[int] | None = None
    noise_seed: int = 0
    device: str = "auto"
    denoise: bool = False
    error: float | None = None
    seconds: float | None = None
    cameras: Collection[str] | None = None
    choice: dict[str, Any] | None = None
    allow_missing: bool = False


@dataclass(frozen=True)
class Job:
    """One frame.

    Attributes:
        stem: Its path without a suffix.
        what: Its name in messages.
        camera: Whose frame it is, by name.
        key: What it is made with.
        request: What a worker is asked.
    """

    stem: Path
    what: str
    camera: str
    key: FrameKey
    request: dict[str, Any]


class Jobs:
    """The frames of one batch, once its stage has been opened."""

    def __init__(self, batch: Batch, wanted: Wanted) -> None:
        self._batch = batch
        self._wanted = wanted
        self._places: list[tuple[int, int]] = []
        self._opened: dict[str, Any] = {}

    @property
    def count(self) -> int:
        """Number of frames."""
        return len(self._places)

    @property
    def table(self) -> dict[str, Any] | None:
        """The request for the batch's table of instances; None where no frame has ``instance``."""
        if not any("instance" in self._camera(*place)["passes"] for place in self._places):
            return None
        return {"op": "instances", "folder": str((self._batch.folder / FRAMES).resolve())}

    @property
    def cameras(self) -> set[str]:
        """Whose frames they are."""
        return {str(self._camera(*place)["name"]) for place in self._places}

    @property
    def firing(self) -> list[list[tuple[str, bool]]]:
        """Of each sample: the cameras, and whether they are triggered then."""
        return [[(c["name"], bool(c["fires"])) for c in of] for of in self._opened["cameras"]]

    @property
    def pixels(self) -> float:
        """Of a frame, on average."""
        sizes = [self._camera(*place)["pixels"] for place in self._places]
        return sum(sizes) / max(1, len(sizes))

    @property
    def annotated(self) -> bool:
        """Whether any of them has more than ``rgb``."""
        return any(set(self._camera(*place)["passes"]) - {"rgb"} for place in self._places)

    @property
    def rgb(self) -> bool:
        """Whether any of them has ``rgb``."""
        return any("rgb" in self._camera(*place)["passes"] for place in self._places)

    def open(self, worker: WorkerProcess) -> dict[str, Any]:
        """Open the stage in a worker, and find its frames.

        Args:
            worker: It will be asked for the frames.

        Returns:
            What the worker says about stage and backend.

        Raises:
            StageError: The stage cannot be read, or does not hold what is asked for.
            BackendError: The backend cannot start, or a picture is to be denoised that cannot be.
        """
        wanted = self._wanted
        opened = worker.open(
            {
                "op": "open",
                "stage": os.path.abspath(self._batch.stage),
                "backend": wanted.backend,
                "device": wanted.device,
                "passes": None if wanted.passes is None else list(wanted.passes),
                "allow_missing": wanted.allow_missing,
            }
        )
        self.take(opened)
        return opened

    def take(self, opened: dict[str, Any]) -> None:
        """Find the batch's frames in what a worker said about the stage that it has open.

        Raises:
            StageError: The stage does not hold what is asked for.
            BackendError: A picture is to be denoised that cannot be.
        """
        wanted = self._wanted
        self._opened = opened
        there = range(opened["samples"])
        beyond = [sample for sample in wanted.samples or () if sample not in there]
        if beyond:
            raise StageError(
                f"{self._batch.stage}: has samples 0 to {len(there) - 1}, not {beyond[0]}"
            )
        self._places = [
            (sample, index)
            for sample in (there if wanted.samples is None else sorted(wanted.samples))
            for index, camera in enumerate(opened["cameras"][sample])
            if camera["fires"] and (wanted.cameras is None or camera["name"] in wanted.cameras)
        ]
        seen = sorted({camera["name"] for cameras in opened["cameras"] for camera in cameras})
        unknown = [name for name in wanted.cameras or () if name not in seen]
        if unknown:
            raise StageError(
                f"{self._batch.stage}: has no camera {unknown[0]!r}{nearest(unknown[0], seen)}"
            )
        for place in self._places:
            camera = self._camera(*place)
            if not camera["passes"]:
                raise StageError(f"{self._batch.stage}: no passes asked for, and none in the stage")
            if wanted.denoise and "rgb" in camera["passes"] and camera["undenoised"]:
                raise BackendError(camera["undenoised"])

    def __iter__(self) -> Iterator[Job]:
        wanted, batch = self._wanted, self._batch
        checked: set[str] = set()
        for sample, index in self._places:
            camera = self._camera(sample, index)
            name = camera["name"]
            key = self._key(camera["passes"])
            stem = frame_stem(batch.folder, self._opened["backend"], name, sample)
            if name not in checked:
                # The name is the stage's, and what lies there may be a link.
                inside(batch.folder, stem.relative_to(batch.folder).as_posix(), batch.stage)
                checked.add(name)
            request = {
                "op": "render",
                "stem": str(stem.resolve()),
                "camera": index,
                "sample": sample,
                "key": asdict(key),
                "seed": frame_seed(wanted.noise_seed, batch.name, name, sample),
                "choice": wanted.choice,
            }
            yield Job(stem, f"{batch.name}/{name}/{sample:06d}", name, key, request)

    def _camera(self, sample: int, index: int) -> dict[str, Any]:
        found: dict[str, Any] = self._opened["cameras"][sample][index]
        return found

    def _key(self, passes: Sequence[str]) -> FrameKey:
        wanted, pictures = self._wanted, "rgb" in passes
        return FrameKey(
            stage_digest=self._opened["digest"],
            passes=tuple(passes),
            spp=wanted.spp if pictures else 0,
            noise_seed=wanted.noise_seed if pictures else 0,
            backend=self._opened["backend"],
            backend_version=self._opened["version"],
            denoise=wanted.denoise and pictures,
            error=wanted.error if pictures else None,
            seconds=wanted.seconds if pictures else None,
        )


def frame_seed(noise_seed: int, batch: str, camera: str, sample: int) -> int:
    """Seed of one frame's noise, 32 bits: no two frames share their noise."""
    text = f"{noise_seed}/{batch}/{camera}/{sample}"
    return int.from_bytes(hashlib.blake2b(text.encode(), digest_size=4).digest(), "little")
