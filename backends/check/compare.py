"""Do renderers see what is annotated, does their light agree, and is what was written exact."""

from __future__ import annotations

from collections.abc import Collection, Sequence
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path

import numpy as np

from scenec.backends.annotation.annotate import annotate
from scenec.backends.annotation.instances import Instances
from scenec.backends.annotation.registry import select
from scenec.backends.camera.rays import camera_rays
from scenec.backends.check.instances import against
from scenec.backends.check.radiance import (
    RadianceComparison,
    differing,
    flip,
    write_differences,
)
from scenec.backends.check.witness import Witness, ask
from scenec.backends.exact import ExactCaster
from scenec.backends.run.plan import RenderPlan
from scenec.backends.run.render import render
from scenec.backends.stage.read import read_stage
from scenec.backends.stage.scene import Camera, RenderScene
from scenec.schemas.errors import BackendError, FrameError
from scenec.schemas.frames import Frame, frame_stem, read_frame
from scenec.schemas.manifest import FRAMES, Batch, find_batches
from scenec.schemas.passes import AMODAL, ANNOTATION_NAMES
from scenec.schemas.scratch import scratch_folder
from scenec.schemas.units import Say

#: Where pictures of differences go, in the output folder.
PICTURES = "check"

#: Sample, number of the camera, camera.
Place = tuple[int, int, Camera]


@dataclass
class Comparison:
    """One channel of annotation, over all frames.

    Attributes:
        channel: Pass name.
        backend: Whose frames they are, by folder.
        pixels: Compared.
        differing: With different bits.
    """

    channel: str
    backend: str
    pixels: int = 0
    differing: int = 0


@dataclass(frozen=True)
class Agreement:
    """Holds the results of a comparison of backends.

    Attributes:
        comparisons: Frames' annotation against the exact caster, one a channel and backend.
        radiance: ``rgb``, one a pair.
        witnesses: What renderers themselves see against the exact caster, by backend.
        frames: Samples and cameras compared.
        pictures: Of where they differ: files.
    """

    comparisons: tuple[Comparison, ...]
    radiance: tuple[RadianceComparison, ...]
    witnesses: dict[str, Witness]
    frames: int
    pictures: tuple[Path, ...] = ()

    @property
    def differing(self) -> int:
        """Annotation that is not exact, and what renderers see that is not there, pixels."""
        return sum(c.differing for c in self.comparisons) + sum(
            w.beyond for w in self.witnesses.values()
        )


@dataclass(frozen=True)
class CompareOptions:
    """Holds the options of a comparison.

    Attributes:
        spp: Samples per pixel of ``rgb`` that has to be rendered.
        passes: Only these; None takes what each camera asks for.
        samples: Only these time codes; None takes all.
        floor: Whether to render the first backend again with another noise seed.
        pictures: Folder for pictures of where they differ; None makes none.
        allow_missing: Whether to compare frames of a stage that is not whole.
        most_pictures: For each pair with ``rgb``.
    """

    spp: int = 64
    passes: tuple[str, ...] | None = None
    samples: Collection[int] | None = None
    floor: bool = False
    pictures: Path | None = None
    most_pictures: int = 8
    allow_missing: bool = False


def compare(
    out: Path,
    backends: Sequence[str],
    say: Say = lambda _text: None,
    options: CompareOptions | None = None,
) -> Agreement:
    """Holds each renderer's own first hits against the exact ones, on every pixel, and light.

    The light of the first backend's frames is compared with that of each other.

    Frames that are there and made from this very stage are taken, whatever else they hold. Samples
    that a backend has no frames of are rendered into the output; where frames are there but do not
    serve (stale, or without a pass), they are rendered aside: nothing that is there is touched.

    Args:
        out: Output folder, or a USD file.
        backends: Names; the exact caster's own counts for nothing: all are held against it.
        say: Told what is rendered.
        options: See ``CompareOptions``.

    Raises:
        ScenecError: A stage cannot be read, or a backend fails.
    """
    options = options or CompareOptions()
    run = _Run([name for name in backends if name not in ANNOTATION_NAMES], options, say)
    for batch in find_batches(out):
        with scratch_folder() as aside:
            run.batch(batch, Path(aside))
    return Agreement(
        (),
        tuple(run.radiance.values()),
        run.witnesses,
        run.frames,
        tuple(path for made in run.pictures.values() for path in made),
    )


def check_exact(out: Path, say: Say = lambda _text: None, allow_missing: bool = False) -> Agreement:
    """Casts every pixel of all frames there are through the exact ray caster.

    The caster defines annotation: what differs on disk is damaged, or of another version.

    Args:
        out: Output folder, or a USD file.
        say: Told what is cast.
        allow_missing: Whether to take a stage that is not whole.

    Raises:
        ScenecError: A stage or frame cannot be read.
    """
    comparisons: dict[tuple[str, str], Comparison] = {}
    compared = 0

    def count(backend: str, channel: str, pixels: int, wrong: int) -> None:
        entry = comparisons.setdefault((backend, channel), Comparison(channel, backend))
        entry.pixels += pixels
        entry.differing += wrong

    for batch in find_batches(out):
        scene = read_stage(batch.stage, allow_missing=allow_missing)
        caster, instances = ExactCaster(scene), Instances(scene)
        backends = sorted(path.name for path in (batch.folder / FRAMES).glob("*") if path.is_dir())
        if backends:
            say(f"casting every pixel of {batch.name}'s frames ({', '.join(backends)})")
        for sample, cameras in enumerate(scene.cameras):
            for camera in cameras:
                frames = dict(_current(batch, backends, scene, camera, sample))
                there = dict.fromkeys(name for frame in frames.values() for name in frame.passes)
                wanted = [name for name in there if name != "rgb"]
                if not wanted:
                    continue
                truth = annotate(scene, caster, camera, (*wanted, AMODAL), sample, instances)
                assert truth.seen is not None
                compared += len(frames)
                for backend, frame in frames.items():
                    for channel in (n for n in wanted if n in frame.passes):
                        # As frames store it.
                        own = frame.passes[channel]
                        exact = np.ascontiguousarray(truth.arrays[channel], own.dtype)
                        wrong = int(differing(exact, own).sum())
                        count(backend, channel, camera.width * camera.height, wrong)
                    for channel, pixels, wrong in against(truth.seen, frame):
                        count(backend, channel, pixels, wrong)
    return Agreement(tuple(comparisons.values()), (), {}, compared)


def _current(
    batch: Batch, backends: Sequence[str], scene: RenderScene, camera: Camera, sample: int
) -> list[tuple[str, Frame]]:
    """Frames of this sample that were made from this very stage."""
    found = []
    for backend in backends:
        stem = frame_stem(batch.folder, backend, camera.name, sample)
        if stem.with_suffix(".json").is_file():
            frame = read_frame(stem)
            if frame.sidecar.stage_digest == scene.digest:
                found.append((backend, frame))
    return found


@dataclass
class _Run:
    """One comparison under way."""

    backends: Sequence[str]
    options: CompareOptions
    say: Say
    radiance: dict[str, RadianceComparison] = field(default_factory=dict)
    witnesses: dict[str, Witness] = field(default_factory=dict)
    pictures: dict[str, list[Path]] = field(default_factory=dict)
    frames: int = 0

    def batch(self, batch: Batch, aside: Path) -> None:
        samples = self.options.samples
        scene = read_stage(batch.stage, allow_missing=self.options.allow_missing)
        places = [
            (sample, index, camera)
            for sample, cameras in enumerate(scene.cameras)
            for index, camera in enumerate(cameras)
            if samples is None or sample in samples
        ]
        self.frames += len(places)
        self._witness(batch, scene, places)
        if len(self.backends) < 2 or "rgb" not in self._common(places):
            return
        stems = [self._ready(batch, name, scene, places, aside / name) for name in self.backends]
        floors = self._floor(batch, places, aside / "floor") if self.options.floor else None
        for number, (sample, _, camera) in enumerate(places):
            first, *others = (read_frame(of[number]) for of in stems)
            for name, second in zip(self.backends[1:], others, strict=True):
                floor = None if floors is None else floors[number]
                flip_map = self._radiance(first, second, name, floor)
                file = f"{batch.name}_{camera.name}_{sample:06d}_{self.backends[0]}_{name}.png"
                self._picture(file, name, first, second, flip_map)

    def _witness(self, batch: Batch, scene: RenderScene, places: Sequence[Place]) -> None:
        """Compares each renderer's own first hits in each frame with the exact ones."""
        caster = ExactCaster(scene)
        for name in self.backends:
            found = self.witnesses.setdefault(name, Witness())
            self.say(f"asking {name} what it sees of {len(places)} frames of {batch.name}")
            plan = RenderPlan(name, ("rgb",), allow_missing=self.options.allow_missing)
            told = ask(batch, plan, [place[:2] for place in places])
            for (sample, _, camera), seen in zip(places, told, strict=True):
                if seen is None:
                    found.unseen += 1
                    continue
                caster.pose(sample)
                found.add(caster, camera_rays(camera), seen)

    def _picture(
        self, file: str, name: str, first: Frame, second: Frame, flip_map: np.ndarray | None
    ) -> None:
        made = self.pictures.setdefault(name, [])
        if self.options.pictures is not None and len(made) < self.options.most_pictures:
            path = self.options.pictures / file
            write_differences(path, first, second, flip_map)
            made.append(path)

    def _radiance(
        self, first: Frame, second: Frame, name: str, floor: Path | None
    ) -> np.ndarray | None:
        if "rgb" not in first.passes or "rgb" not in second.passes:
            return None
        entry = self.radiance.setdefault(name, RadianceComparison(self.backends[0], name))
        if floor is not None and floor.with_suffix(".json").is_file():
            found = flip(first, read_frame(floor))
            entry.floor.append(np.nan if found is None else float(found.mean()))
        return entry.add(first, second)

    def _wanted(self, camera: Camera) -> tuple[str, ...]:
        """Passes of a camera that backends are compared in."""
        return tuple(self.options.passes or camera.outputs)

    def _common(self, places: Sequence[Place]) -> tuple[str, ...]:
        """The same of all."""
        return tuple(dict.fromkeys(n for _, _, camera in places for n in self._wanted(camera)))

    def _ready(
        self, batch: Batch, backend: str, scene: RenderScene, places: Sequence[Place], aside: Path
    ) -> list[Path]:
        """Frames of one backend that can be compared, in order; missing ones are rendered first."""
        missing, unusable = [], []
        for sample in sorted({sample for sample, _, _ in places}):
            cameras = scene.cameras[sample]
            stems = [frame_stem(batch.folder, backend, camera.name, sample) for camera in cameras]
            if not any(stem.with_suffix(".json").is_file() for stem in stems):
                missing.append(sample)
            elif not all(map(partial(self._usable, scene), stems, cameras)):
                unusable.append(sample)
        usual = all(self._wanted(camera) == camera.outputs for _, _, camera in places)
        for samples, folder in ((missing, batch.folder), (unusable, aside)):
            if samples:
                passes = None if usual else self._common(places)
                self._render(batch, backend, passes, samples, folder)
        return [
            frame_stem(aside if sample in unusable else batch.folder, backend, camera.name, sample)
            for sample, _, camera in places
        ]

    def _floor(self, batch: Batch, places: Sequence[Place], aside: Path) -> list[Path]:
        """The first backend's ``rgb`` once more, with other noise."""
        first, samples = self.backends[0], sorted({sample for sample, _, _ in places})
        self._render(batch, first, ("rgb",), samples, aside, noise_seed=1)
        return [frame_stem(aside, first, camera.name, sample) for sample, _, camera in places]

    def _render(
        self,
        batch: Batch,
        backend: str,
        passes: tuple[str, ...] | None,
        samples: Collection[int],
        folder: Path,
        noise_seed: int = 0,
    ) -> None:
        self.say(f"rendering {len(samples)} samples of {batch.name} with {backend}")
        # The stage itself, so that the folder is the one we say.
        report = render(
            batch.stage, backend, passes=passes, samples=samples, folder=folder,
            spp=self.options.spp, noise_seed=noise_seed, allow_missing=self.options.allow_missing,
        )  # fmt: skip
        if report.failed:
            raise BackendError(report.failed[0])

    def _usable(self, scene: RenderScene, stem: Path, camera: Camera) -> bool:
        names = self._wanted(camera)
        wanted = [*(["rgb"] if "rgb" in names else []), *select(scene, names)]
        try:
            frame = read_frame(stem, wanted)
        except FrameError:
            return False
        if "rgb" in wanted and frame.sidecar.denoised:
            # A denoiser's error is no renderer's: compared are the pictures without it.
            return False
        return frame.sidecar.stage_digest == scene.digest
