"""One stage, one backend: what a worker process holds while it renders a batch."""

from __future__ import annotations

import math
import time
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import asdict
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from scenec.backends import bands, memory
from scenec.backends.bare import bare
from scenec.backends.contract import Backend, Radiance
from scenec.backends.exact import ExactCaster
from scenec.backends.exposure import Meter
from scenec.backends.frames import write_frame
from scenec.backends.instances import Instances, Seen
from scenec.backends.rays import camera_rays, ray_down
from scenec.backends.reader import read_stage
from scenec.backends.registry import open_backends
from scenec.backends.render_scene import Camera, RenderScene
from scenec.backends.resolver import Settled, pass_names
from scenec.backends.rounds import Draw, Rounds, Target, collect
from scenec.backends.shutter import blurred_by, is_rolling, undenoised
from scenec.schemas.amodal import AMODAL
from scenec.schemas.correspondence import CORRESPONDENCES
from scenec.schemas.depth_camera import MEASURED
from scenec.schemas.errors import BackendError, StageError
from scenec.schemas.frames import FrameKey
from scenec.schemas.instances import BATCH_TABLE, table_digest, write_table
from scenec.schemas.memory import GB

if TYPE_CHECKING:
    from scenec.backends.haze import Veil


class Session:
    """A stage that has been read and a backend that has been started.

    The backend's own scene and the exact caster are built when the first frame needs them, so that
    a run that finds all its frames done costs no more than reading the stage.

    Args:
        scene: The stage.
        backend: The renderer.
        annotator: Another backend, whose visibility is taken instead of the renderer's; one that
            may share a process with it. The renderer then builds its scene for ``rgb`` alone.
    """

    def __init__(
        self, scene: RenderScene, backend: Backend, annotator: Backend | None = None
    ) -> None:
        self.scene = scene
        self.backend = backend
        self._annotator = backend if annotator is None else annotator
        self._caster: ExactCaster | None = None
        self._meter = Meter(scene)
        self._loaded: set[str] = set()
        #: Whether ``rgb`` may be asked for: without, renderers need no materials and no light.
        self.pictures = True

    @classmethod
    def open(
        cls,
        stage: Path,
        backend: str,
        device: str = "auto",
        annotator: str | None = None,
        allow_missing: bool = False,
    ) -> Session:
        """Read a stage and start a backend.

        Raises:
            StageError: The stage cannot be read.
            BackendError: A backend is not there or cannot start, or has no such device.
        """
        # First: a backend that is not installed should not cost the reading of a stage.
        started = open_backends(backend, device, annotator)
        return cls(read_stage(stage, allow_missing=allow_missing), *started)

    @cached_property
    def losses(self) -> tuple[str, ...]:
        """A line for each thing in the stage that was not read, or that ``rgb`` leaves out."""
        lines = (*self.scene.losses, *self.backend.losses(self.scene))
        if any(self.scene.haze):
            from scenec.backends.haze import LOSS

            lines += (LOSS,)
        return lines

    def passes(self, wanted: Sequence[str] | None, camera: Camera) -> tuple[str, ...]:
        """Passes as they are written: ``rgb`` first, ``label`` spelled out as its levels.

        ``amodal``, a file of its own, brings ``instance`` with it, whose ids name its masks.

        Args:
            wanted: As a user asks for them; None takes what the camera's render product asks for.
            camera: Whose frame it is.

        Raises:
            BackendError: A pass nobody knows.
        """
        names = tuple(camera.outputs if wanted is None else wanted)
        return (*(["rgb"] if "rgb" in names else []), *pass_names(self.scene, names))

    def undenoised(self, camera: Camera) -> str | None:
        """Why pictures of a camera cannot be denoised, a line; None where they can be."""
        cause = blurred_by(camera)
        return None if cause is None else undenoised(camera.name, cause)

    @cached_property
    def instances(self) -> Instances:
        """What there is to say of the stage's instances."""
        return Instances(self.scene)

    def render(
        self,
        camera: Camera,
        sample: int,
        passes: Sequence[str],
        spp: int,
        seed: int,
        denoise: bool = False,
        seen: Mapping[str, Any] | None = None,
        target: Target | None = None,
    ) -> tuple[dict[str, NDArray], dict[str, Any]]:
        """Render one frame.

        Args:
            camera: The camera at this sample.
            sample: Time code.
            passes: As ``passes`` returns them.
            spp: Samples per pixel of ``rgb``.
            seed: Noise seed of this very frame.
            denoise: Whether to denoise ``rgb``.
            seen: What another process's backend saw (``see_to``), to annotate with: ``backend``,
                ``version``, and what ``see_to`` returned.
            target: What to render ``rgb`` to, in rounds; None renders ``spp`` at once.

        Returns:
            (arrays by pass, none for ``amodal``; details for the sidecar: ``device``, ``seconds``,
            ``annotation`` (who saw), ``denoised``, ``losses``, ``resolver``; ``estimated_error``
            ... with ``rgb``).

        Raises:
            BackendError: The renderer failed, or cannot do what is asked.
        """
        return self._render(camera, sample, passes, spp, seed, denoise, seen, target)[:2]

    def _render(
        self,
        camera: Camera,
        sample: int,
        passes: Sequence[str],
        spp: int,
        seed: int,
        denoise: bool,
        seen: Mapping[str, Any] | None,
        target: Target | None = None,
    ) -> tuple[dict[str, NDArray], dict[str, Any], Seen | None, NDArray[np.bool_] | None]:
        """As ``render``, what is seen of instances (with ``instance``), and where surfaces are."""
        seconds: dict[str, float] = dict(seen["seconds"]) if seen else {}
        details: dict[str, Any] = {
            "device": self.backend.device,
            "annotation": None,
            "denoised": None,
            "losses": self.scene.losses,
            "seconds": seconds,
        }
        arrays: dict[str, NDArray] = {}
        listed = None
        annotation = [name for name in passes if name != "rgb"]
        radiance = rounds = None
        if "rgb" in passes:
            radiance, rounds = self._radiance(camera, sample, spp, seed, denoise, details, target)
            # First of the passes, whatever is known of it only later.
            arrays["rgb"] = radiance.halves[0]
        settled = None
        if annotation:
            annotating, settled, found = self._annotate(camera, sample, annotation, seen, details)
            arrays |= found
            caster = self._exact(seconds)
            details["resolver"] = asdict(settled.statistics)
            height = float(caster.cast(ray_down(camera))[2][0])
            details["height_above_surface_m"] = height if math.isfinite(height) else None
            needs_rays = camera.lens is not None or is_rolling(camera)
            if "instance" in annotation:
                with _timed(seconds, "instances"):
                    listed = self.instances.seen(
                        settled.row, settled.t, camera, sample, caster.geometry, AMODAL in passes,
                        annotating.all_rays if needs_rays else None,
                    )  # fmt: skip
            # Imported here: few frames ask for any.
            if any(name in CORRESPONDENCES for name in annotation):
                from scenec.backends.correspondence import compare

                view = (self.scene, caster, settled, annotating.all_rays, camera, sample)
                with _timed(seconds, "correspondence"):
                    arrays |= compare(*view, annotation)
            if MEASURED in annotation:
                from scenec.backends.depth_camera import measure

                view = (self.scene, caster, settled, annotating.all_rays, camera, sample)
                with _timed(seconds, MEASURED):
                    arrays[MEASURED] = measure(*view)
        if radiance is not None:
            veil = self._veil(radiance, camera, sample, settled, details)
            arrays["rgb"] = self._compose(radiance, camera, sample, veil, details, rounds)
        return arrays, details, listed, None if radiance is None else radiance.coverage > 0.0

    def write_instances(self, folder: Path) -> None:
        """Write the batch's table of instances, unless it is there.

        Args:
            folder: Where the batch's frames go.

        Raises:
            OutputError: It cannot be written.
        """
        path = folder / BATCH_TABLE
        if table_digest(path) != self.scene.digest:
            write_table(path, self.instances.table())

    def render_to(
        self,
        stem: Path,
        camera_index: int,
        sample: int,
        key: FrameKey,
        seed: int,
        seen: Mapping[str, Any] | None = None,
        choice: Mapping[str, Any] | None = None,
    ) -> dict[str, Any]:
        """Render a frame and write it; returns its details, with the seconds of writing.

        A ``choice`` of this backend (``auto.Choice``) is noted in the sidecar.

        Raises:
            BackendError: There is no such camera or sample, or the renderer failed.
            StageError: The frame is to be of another stage than the one that was opened.
            OutputError: A file cannot be written.
        """
        if key.stage_digest != self.scene.digest:
            # A process that was replaced has opened it again.
            raise StageError(f"{self.scene.source}: has changed since rendering began; run again")
        camera = self._camera(camera_index, sample)
        memory.reset_peak()
        once = key.error is None and key.seconds is None
        target = None if once else Target(key.error, key.seconds, key.spp)
        exposure, metering = None, dict[str, float]()
        if "rgb" in key.passes:
            with _timed(metering, "exposure"):
                camera, exposure = self._meter.exposed(
                    camera, sample, lambda: self._exact(metering)
                )
            metering["exposure"] -= metering.get("load", 0.0)
        arrays, details, listed, surfaces = self._render(
            camera, sample, key.passes, key.spp, seed, key.denoise, seen, target
        )
        details |= {} if exposure is None else {"exposure": exposure}
        for step, seconds in metering.items():
            details["seconds"][step] = details["seconds"].get(step, 0.0) + seconds
        peak = memory.peak()
        details["peak_memory_gb"] = None if peak is None else round(peak / GB, 3)
        if choice is not None:
            details["choice"] = choice
        taken = None
        if camera.imaging is not None and "rgb" in arrays:
            # Imported here: few cameras have any.
            from scenec.backends.imaging.camera import take

            with _timed(details["seconds"], "imaging"):
                taken = take(arrays["rgb"], camera, camera.imaging, sample)
        with _timed(details["seconds"], "write"):
            more = details, listed, taken, surfaces
            write_frame(stem, arrays, key, self.scene, camera, sample, *more)
        return details

    def see_to(self, file: Path, camera_index: int, sample: int) -> dict[str, Any]:
        """Leave a frame's visibility in a file, for a session of another backend to annotate with.

        Returns:
            ``file`` (None if the backend cannot follow this camera's rays) and ``seconds``.

        Raises:
            BackendError: There is no such camera or sample, or the renderer failed.
        """
        camera = self._camera(camera_index, sample)
        seconds: dict[str, float] = {}
        self._load(self._annotator, seconds)
        with _timed(seconds, "visibility"):
            seen = bands.see(
                lambda rays, part: bands.visible(self._annotator, rays, sample, part), camera
            )
        if seen is None:
            return {"file": None, "seconds": seconds}
        np.savez(file, row=seen.row, face=seen.face)
        return {"file": str(file), "seconds": seconds}

    def _radiance(
        self,
        camera: Camera,
        sample: int,
        spp: int,
        seed: int,
        denoise: bool,
        details: dict[str, Any],
        target: Target | None,
    ) -> tuple[Radiance, Rounds | None]:
        """Light from surfaces; with a target, in rounds."""
        backend, seconds = self.backend, details["seconds"]
        self._load(backend, seconds)

        views = None
        if camera.lens is not None:
            # Imported here: few cameras have a lens.
            from scenec.backends import lens, resample

            if getattr(backend, "follows_lenses", False):
                error = lens.ray_table(camera).error_px
                details["lens_radiance"] = {"way": "rays", "interpolation_px": error}
            else:
                views = resample.plan_views(camera)
                details["lens_radiance"] = {"way": "resampled", **views.as_json()}

        def draw(count: int, noise: int) -> Radiance:
            if views is not None:
                return resample.draw(backend, camera, views, sample, count, noise, denoise)
            return bands.radiance(backend, camera, sample, count, noise, denoise)

        blurred = self._blurred(camera, sample, denoise, details)
        rounds = None
        with _timed(seconds, "radiance"):
            if target is None:
                radiance = (blurred or draw)(spp, seed)
            else:
                radiance, rounds = collect(blurred or draw, seed, target)
        if denoise and radiance.denoised is None:
            raise BackendError(f"backend {backend.name} was asked to denoise, and did not")
        return radiance, rounds

    def _blurred(
        self, camera: Camera, sample: int, denoise: bool, details: dict[str, Any]
    ) -> Draw | None:
        """What draws a camera with an open shutter or an aperture; None where there is neither.

        Raises:
            BackendError: Its picture is to be denoised.
        """
        if camera.shutter is None and camera.focus is None:
            return None
        why = self.undenoised(camera) if denoise else None
        if why is not None:
            raise BackendError(why)
        # Imported here: few cameras have either.
        from scenec.backends import subframes

        caster = self._exact(details["seconds"])
        caster.pose(sample)
        with _timed(details["seconds"], "blur"):
            blur = subframes.measure(camera, caster)
        if blur is None:
            return None
        drawing = subframes.Drawing(blur, self.backend, self.scene, sample, caster)
        details["blur"] = drawing.facts
        return drawing.draw

    def _veil(
        self,
        radiance: Radiance,
        camera: Camera,
        sample: int,
        settled: Settled | None,
        details: dict[str, Any],
    ) -> Veil | None:
        """The haze before a picture, if there is any; without annotation it casts its own rays."""
        if not self.scene.haze or self.scene.haze[sample] is None:
            return None
        if radiance.background is not None:
            # Each sub-frame was seen through its own.
            return None
        # Imported here: few scenes have any.
        from scenec.backends.haze import air_at, veil
        from scenec.backends.sky import combine

        caster = self._exact(details["seconds"])
        with _timed(details["seconds"], "haze"):
            rays = camera_rays(camera)
            if settled is None:
                caster.pose(sample)
                t = caster.cast(rays)[2]
            else:
                t = settled.t
            air = air_at(self.scene, sample, combine(self.scene.lighting[sample].domes))
            if air is None:
                return None
            made = veil(air, camera, caster, rays, t, radiance.coverage)
        details["haze"] = {"subsampled_pixels": made.subsampled}
        return made

    def _compose(
        self,
        radiance: Radiance,
        camera: Camera,
        sample: int,
        veil: Veil | None,
        details: dict[str, Any],
        rounds: Rounds | None,
    ) -> NDArray[np.float32]:
        """``rgb``, with what there is to say of it."""
        with _timed(details["seconds"], "compose"):
            picture = bands.compose(radiance, self.scene, camera, sample, veil)
        noise = picture.noise.as_json()
        if rounds is not None:
            details["rounds"] = rounds.as_json(picture.noise.relative_rms_bound)
        details["losses"] = self.losses
        details["samples_per_pixel"] = radiance.spp
        details["samples_dropped"] = radiance.dropped
        if radiance.denoised is None:
            details["estimated_error"] = noise
        else:
            # Denoising trades noise for bias, which the difference of two halves does not show.
            details["denoised"] = self.backend.denoiser
            details["estimated_error"] = dict.fromkeys(noise)
            details["estimated_error_before_denoising"] = noise
        return picture.rgb

    def _annotate(
        self,
        camera: Camera,
        sample: int,
        passes: Sequence[str],
        seen: Mapping[str, Any] | None,
        details: dict[str, Any],
    ) -> tuple[bands.Annotating, Settled, dict[str, NDArray]]:
        """Annotation, from what the annotating backend sees, or another process's saw."""
        seconds = details["seconds"]
        backend, report = self._annotator, None
        if seen is not None:
            details["annotation"] = {"backend": seen["backend"], "version": seen["version"]}
            report = None if seen["file"] is None else bands.read_visibility(Path(seen["file"]))
        else:
            details["annotation"] = {"backend": backend.name, "version": backend.version()}
            self._load(backend, seconds)
            # A backend that is exact itself lends its caster and needs no settling.
            self._caster = self._caster or backend.caster
        blind = seen is not None or backend.caster is not None
        caster = self._exact(seconds)
        with _timed(seconds, "resolve"):
            caster.pose(sample)
        annotating = bands.Annotating(self.scene, caster, camera, passes, sample)
        for rows in annotating.bands:
            rays = annotating.rays(rows)
            with _timed(seconds, "visibility"):
                if report is not None:
                    visible = annotating.part(report, rows)
                elif blind:
                    visible = None
                else:
                    visible = bands.visible(backend, rays, sample, annotating.camera(rows))
            with _timed(seconds, "resolve"):
                annotating.add(rows, rays, visible)
        with _timed(seconds, "resolve"):
            return annotating, *annotating.finish()

    def _exact(self, seconds: dict[str, float]) -> ExactCaster:
        with _timed(seconds, "load"):
            if self._caster is None:
                self._caster = ExactCaster(self.scene)
        return self._caster

    def _load(self, backend: Backend, seconds: dict[str, float]) -> None:
        """Builds the backend's own scene, once."""
        with _timed(seconds, "load"):
            if backend.name not in self._loaded:
                shown = self.pictures and backend is self.backend
                memory.require_room(backend.name, getattr(backend, "load_cost", None), self.scene)
                backend.load(self.scene if shown else bare(self.scene))
                self._loaded.add(backend.name)

    def _camera(self, index: int, sample: int) -> Camera:
        if not 0 <= sample < len(self.scene.cameras):
            raise BackendError(f"{self.scene.source}: has no sample {sample}")
        return self.scene.cameras[sample][index]


@contextmanager
def _timed(seconds: dict[str, float], name: str) -> Iterator[None]:
    """Adds what the block takes to the seconds of a step."""
    start = time.perf_counter()
    yield
    seconds[name] = seconds.get(name, 0.0) + time.perf_counter() - start
