"""One stage, one backend: what a worker process holds while it renders a batch."""

from __future__ import annotations

import threading
import time
from collections.abc import Iterator, Sequence
from contextlib import contextmanager, nullcontext
from dataclasses import dataclass, replace
from functools import cached_property, partial
from pathlib import Path
from typing import TYPE_CHECKING

from numpy.typing import NDArray

from scenec.backends.annotation.annotate import Annotation, annotate
from scenec.backends.annotation.instances import Instances
from scenec.backends.annotation.registry import select
from scenec.backends.camera.rays import camera_rays
from scenec.backends.camera.shutter import blurred_by, is_rolling, undenoised
from scenec.backends.camera.tiles import witness
from scenec.backends.contract import Backend, Radiance, Visibility
from scenec.backends.exact import ExactCaster, Hits
from scenec.backends.picture import tiles
from scenec.backends.picture.adaptive import Denoise, Draw, Rounds, Target, collect
from scenec.backends.picture.compose import Picture, compose
from scenec.backends.picture.exposure import Meter
from scenec.backends.registry import open_backend
from scenec.backends.registry import version_of as version_of_backend
from scenec.backends.run import memory
from scenec.backends.run.facts import (
    FrameResult,
    annotation_versions,
    describe_frame,
)
from scenec.backends.stage.posing import sliding
from scenec.backends.stage.read import read_stage
from scenec.backends.stage.scene import Camera, RenderScene
from scenec.schemas.errors import BackendError, CameraRefusedError
from scenec.schemas.instances import BATCH_TABLE, table_digest, write_table
from scenec.schemas.passes import ANNOTATION, ANNOTATION_NAMES
from scenec.schemas.records import (
    FrameRecord,
    HazePixels,
    LensRadiance,
    RendererFacts,
    SkyPixels,
)
from scenec.schemas.versions import version_of

if TYPE_CHECKING:
    from scenec.backends.picture.haze import Hazy, Veil
    from scenec.backends.picture.subframes import Drawing


@dataclass(frozen=True)
class SurfaceLight:
    """Describes how light from surfaces is drawn for a frame.

    Attributes:
        draw: Draws a picture.
        continues: Whether it goes on from samples that were drawn before.
        denoise: Denoises a mean of rounds; None: ``draw`` does so, if it is asked for.
        lens: How it comes through a lens; None: a pinhole.
        blurred: What draws an open shutter or an aperture, and says how; None without either.
    """

    draw: Draw
    continues: bool
    denoise: Denoise | None
    lens: LensRadiance | None
    blurred: Drawing | None


@dataclass(frozen=True)
class DrawnPicture:
    """Holds what a renderer drew of a frame: light from surfaces, and how it came to be."""

    light: SurfaceLight
    radiance: Radiance
    rounds: Rounds | None


class Session:
    """A stage that has been read, and the backend that draws its pictures.

    The backend's own scene and the exact caster are built when the first frame needs them, so that
    a run that finds all its frames done costs no more than reading the stage.

    Args:
        scene: The stage.
        backend: The renderer; None where annotation alone is asked for, which needs none.
    """

    def __init__(self, scene: RenderScene, backend: Backend | None) -> None:
        self.scene = scene
        self.backend = backend
        self._caster: ExactCaster | None = None
        #: Held by who casts: the caster is posed at one sample, and one frame may be drawn while
        #: another is annotated.
        self.casting = threading.RLock()
        self._loaded = False
        #: Of its cameras' exposures.
        self.meter = Meter(scene)
        #: Where frames of it go, as far as they have been made ready.
        self.folders: set[Path] = set()

    @classmethod
    def open(
        cls,
        stage: Path | RenderScene,
        backend: str,
        device: str = "auto",
        passes: Sequence[str] | None = None,
    ) -> Session:
        """Read a stage, unless it has been; start a backend if any frame is to have ``rgb``.

        Raises:
            StageError: The stage cannot be read.
            BackendError: A backend is not there or cannot start, or has no such device.
        """
        scene = stage if isinstance(stage, RenderScene) else read_stage(stage)
        wanted = (c.outputs if passes is None else passes for of in scene.cameras for c in of)
        if backend in ANNOTATION_NAMES or not any("rgb" in names for names in wanted):
            return cls(scene, None)
        return cls(scene, open_backend(backend, device))

    def facts(self) -> RendererFacts:
        """Returns the facts of the pictures' renderer, for sidecars, resume keys and messages."""
        backend = self.backend
        if backend is None:
            version = f"{ANNOTATION} (scenec {version_of()})"
            return RendererFacts(ANNOTATION, version, "cpu", None, None)
        return RendererFacts(
            backend.name,
            version_of_backend(backend),
            backend.device,
            backend.denoiser,
            backend.warning(),
        )

    @cached_property
    def losses(self) -> tuple[str, ...]:
        """A line for each thing in the stage that was not read, or that ``rgb`` leaves out."""
        if self.backend is None:
            return self.scene.losses
        lines = (*self.scene.losses, *sliding(self.scene), *self.backend.losses(self.scene))
        if any(self.scene.haze):
            from scenec.backends.picture.haze import GOBO_LOSS, LOSS

            suns = (sun for lighting in self.scene.lighting for sun in lighting.suns)
            lines += (LOSS, GOBO_LOSS) if any(sun.gobo for sun in suns) else (LOSS,)
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
        return (*(["rgb"] if "rgb" in names else []), *select(self.scene, names))

    def undenoised(self, camera: Camera) -> str | None:
        """Why pictures of a camera cannot be denoised, a line; None where they can be."""
        cause = blurred_by(camera)
        return None if cause is None else undenoised(camera.name, cause)

    @cached_property
    def instances(self) -> Instances:
        """Returns the stage's instances, for tables and masks."""
        return Instances(self.scene)

    def render(
        self,
        camera: Camera,
        sample: int,
        passes: Sequence[str],
        spp: int,
        seed: int,
        denoise: bool = False,
        target: Target | None = None,
        ready: Annotation | None = None,
    ) -> FrameResult:
        """Render one frame: ``draw`` it if it has ``rgb``, and ``complete`` it.

        Args:
            camera: The camera at this sample.
            sample: Time code.
            passes: As ``passes`` returns them.
            spp: Samples per pixel of ``rgb``.
            seed: Noise seed of this very frame.
            denoise: Whether to denoise ``rgb``.
            target: What to render ``rgb`` to, in rounds; None renders ``spp`` at once.
            ready: Its annotation, where that is there already.

        Raises:
            BackendError: The renderer failed, or cannot do what is asked.
        """
        seconds: dict[str, float] = {}
        drawn = None
        if "rgb" in passes:
            drawn = self.draw(camera, sample, spp, seed, denoise, target, seconds)
        return self.complete(camera, sample, passes, drawn, ready, seconds)

    def draw(
        self,
        camera: Camera,
        sample: int,
        spp: int,
        seed: int,
        denoise: bool,
        target: Target | None,
        seconds: dict[str, float],
    ) -> DrawnPicture:
        """Has the renderer draw a frame; the arguments are those of ``render``.

        Args:
            seconds: By step; what it takes is added.

        Raises:
            BackendError: The renderer failed, or cannot do what is asked.
        """
        # Sub-frames are cast amid the drawing.
        with self.casting if blurred_by(camera) else nullcontext():
            light = self._plan_light(camera, sample, denoise, target is not None, seconds)
            rounds = None
            with timed(seconds, "radiance"):
                if target is None:
                    radiance = light.draw(spp, seed)
                else:
                    radiance, rounds = collect(
                        light.draw, seed, target, continues=light.continues, denoise=light.denoise
                    )
        return DrawnPicture(light, radiance, rounds)

    def complete(
        self,
        camera: Camera,
        sample: int,
        passes: Sequence[str],
        drawn: DrawnPicture | None,
        ready: Annotation | None,
        seconds: dict[str, float],
    ) -> FrameResult:
        """Annotates a frame, and composes what was drawn of it; needs no renderer.

        May run in another thread while the next frame is drawn.

        Args:
            camera, sample, passes, ready: As of ``render``.
            drawn: Light from surfaces; None of a frame without ``rgb``.
            seconds: By step; what it takes is added.

        Raises:
            BackendError: A pass failed.
        """
        arrays: dict[str, NDArray] = {}
        radiance = None if drawn is None else drawn.radiance
        if radiance is not None:
            # First of the passes, whatever is known of it only later.
            arrays["rgb"] = radiance.halves[0]
        record = describe_frame(self.scene, camera, sample, self.facts())
        annotation = [name for name in passes if name != "rgb"]
        found = ready
        if annotation:
            if found is None:
                listing = self.instances if "instance" in annotation else None
                with self.casting:
                    caster = self.caster(seconds)
                    found = annotate(self.scene, caster, camera, annotation, sample, listing)
                for step, took in found.seconds.items():
                    seconds[step] = seconds.get(step, 0.0) + took
            arrays |= {name: found.arrays[name] for name in annotation if name in found.arrays}
            sky = found.sky
            record = replace(
                record,
                annotation=annotation_versions(annotation),
                height_above_surface_m=found.height_m,
                sky=None if sky is None else SkyPixels(pixels=sky[0], below_horizon=sky[1]),
            )
        if drawn is not None and radiance is not None:
            hits = None if found is None else found.hits
            with self.casting:
                veil = self._veil(radiance, camera, sample, hits, seconds)
            with timed(seconds, "compose"):
                picture = compose(radiance, self.scene, camera, sample, veil)
            arrays["rgb"] = picture.rgb
            record = self._describe_light(record, drawn, picture, veil)
        return FrameResult(
            arrays,
            replace(record, seconds=seconds),
            None if found is None else found.seen,
            None if radiance is None else radiance.coverage > 0.0,
        )

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

    def witness(self, camera_index: int, sample: int) -> Visibility | None:
        """Returns the backend's own first hits of a frame, for checks.

        Returns:
            None if it does not tell, or cannot follow this camera's rays.

        Raises:
            BackendError: There is no such camera or sample, or the renderer failed.
        """
        camera = self.camera(camera_index, sample)
        backend = self.renderer({})
        plain = camera.lens is None and not is_rolling(camera)
        return witness(
            lambda rays, part: backend.witness(rays, sample, part if plain else None), camera
        )

    def _plan_light(
        self, camera: Camera, sample: int, denoise: bool, rounds: bool, seconds: dict[str, float]
    ) -> SurfaceLight:
        """Plans how light from surfaces is drawn: by whom, and what comes after."""
        backend = self.renderer(seconds)
        views = lens = None
        if camera.lens is not None:
            # Imported here: few cameras have a lens.
            from scenec.backends.camera.lens import ray_table
            from scenec.backends.picture import resample

            if backend.follows_lenses:
                lens = LensRadiance(way="rays", interpolation_px=ray_table(camera).error_px)
            else:
                views = resample.plan_views(camera)
                lens = views.record()
        blurred = self._blurred(camera, sample, denoise, seconds)
        # What can denoise a mean of rounds does so, and no round.
        clean = backend.denoise if denoise and rounds and views is None else None
        draw: Draw
        if blurred is not None:
            draw = blurred.draw
        elif views is not None:
            draw = partial(resample.draw, backend, camera, views, sample, denoise=denoise)
        else:
            draw = tiles.drawer(backend, camera, sample, denoise and clean is None)
        return SurfaceLight(
            draw,
            backend.continues and views is None and blurred is None,
            None if clean is None else partial(clean, camera, sample),
            lens,
            blurred,
        )

    def _blurred(
        self, camera: Camera, sample: int, denoise: bool, seconds: dict[str, float]
    ) -> Drawing | None:
        """Returns the drawing of a camera with an open shutter or an aperture; None without either.

        Raises:
            BackendError: Its picture is to be denoised.
        """
        if camera.shutter is None and camera.focus is None:
            return None
        why = self.undenoised(camera) if denoise else None
        if why is not None:
            raise BackendError(why)
        # Imported here: few cameras have either.
        from scenec.backends.picture import blur, subframes

        caster = self.caster(seconds)
        caster.pose(sample)
        with timed(seconds, "blur"):
            found = blur.measure(camera, caster)
        if found is None:
            return None
        return subframes.Drawing(found, self.renderer(seconds), self.scene, sample, caster)

    def _veil(
        self,
        radiance: Radiance,
        camera: Camera,
        sample: int,
        hits: Hits | None,
        seconds: dict[str, float],
    ) -> Veil | None:
        """The haze before a picture, if there is any; without annotation it casts its own rays."""
        if not self.scene.haze or self.scene.haze[sample] is None:
            return None
        if radiance.background is not None:
            # Each sub-frame was seen through its own.
            return None
        # Imported here: few scenes have any.
        from scenec.backends.picture.haze import veil

        caster = self.caster(seconds)
        with timed(seconds, "haze"):
            rays = camera_rays(camera)
            air = self._hazy.air(sample)
            assert air is not None
            caster.pose(sample)
            if hits is None:
                hits = caster.hits(rays)
            return veil(air, camera, caster, rays, hits.t, radiance.coverage)

    def _describe_light(
        self,
        record: FrameRecord,
        drawn: DrawnPicture,
        picture: Picture,
        veil: Veil | None,
    ) -> FrameRecord:
        """Adds what there is to say of ``rgb``."""
        light, radiance, rounds = drawn.light, drawn.radiance, drawn.rounds
        denoised = radiance.denoised is not None
        error = picture.denoised if denoised else picture.noise
        assert error is not None
        bound = error.relative_rms_bound_95
        if bound is None:
            bound = picture.noise.relative_rms_bound_95
        return replace(
            record,
            losses=tuple(self.losses),
            denoised=self.facts().denoiser if denoised else None,
            lens_radiance=light.lens,
            blur=None if light.blurred is None else light.blurred.record,
            haze=None
            if veil is None
            else HazePixels(subsampled_pixels=veil.subsampled, changing_pixels=veil.changing),
            samples_per_pixel=radiance.spp,
            samples_dropped=radiance.dropped,
            estimated_error=error,
            estimated_error_before_denoising=picture.noise if denoised else None,
            rounds=None if rounds is None else rounds.record(bound),
        )

    def caster(self, seconds: dict[str, float] | None = None, trees: bool = True) -> ExactCaster:
        """The exact caster, of the scene as it was posed last; what building it takes is added.

        Without ``trees`` it may have none: it then builds them when parallel rays need them.
        """
        with timed({} if seconds is None else seconds, "load"):
            if self._caster is None:
                with self.casting:
                    self._caster = self._caster or ExactCaster(self.scene, trees)
            elif trees:
                self._caster.grow()
        return self._caster

    @cached_property
    def _hazy(self) -> Hazy:
        """The haze of a stage that has any."""
        # Imported here: few scenes have any.
        from scenec.backends.picture.haze import Hazy

        with self.casting:
            return Hazy(self.scene, self.caster())

    def renderer(self, seconds: dict[str, float]) -> Backend:
        """The backend, its own scene built.

        Raises:
            CameraRefusedError: There is none, as annotation alone was asked for.
        """
        if self.backend is None:
            raise CameraRefusedError(
                f"{ANNOTATION} has no rgb; leave rgb out of --passes, or use --backend mitsuba"
            )
        with timed(seconds, "load"):
            if not self._loaded:
                memory.require_room(self.backend.name, self.backend.load_cost, self.scene)
                self.backend.load(self._hazy.lit() if any(self.scene.haze) else self.scene)
                self._loaded = True
        return self.backend

    def camera(self, index: int, sample: int) -> Camera:
        """Returns a camera at a sample.

        Raises:
            BackendError: There is no such sample.
        """
        if not 0 <= sample < len(self.scene.cameras):
            raise BackendError(f"{self.scene.source}: has no sample {sample}")
        return self.scene.cameras[sample][index]


@contextmanager
def timed(seconds: dict[str, float], name: str) -> Iterator[None]:
    """Adds what the block takes to the seconds of a step."""
    start = time.perf_counter()
    yield
    seconds[name] = seconds.get(name, 0.0) + time.perf_counter() - start
