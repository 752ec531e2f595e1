"""One stage, one backend: what a worker process holds while it renders a batch."""

from __future__ import annotations

import time
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import asdict
from pathlib import Path
from typing import Any

from numpy.typing import NDArray

from scenec.backends.compose import compose
from scenec.backends.contract import Backend
from scenec.backends.exact import ExactCaster
from scenec.backends.frames import write_frame
from scenec.backends.rays import camera_rays
from scenec.backends.reader import read_stage
from scenec.backends.registry import open_backend
from scenec.backends.render_scene import Camera, RenderScene
from scenec.backends.resolver import annotate, pass_names, settle
from scenec.schemas.errors import BackendError
from scenec.schemas.frames import FrameKey


class Session:
    """A stage that has been read and a backend that has been started.

    The backend's own scene and the exact caster are built when the first frame needs them, so that
    a run that finds all its frames done costs no more than reading the stage.
    """

    def __init__(self, scene: RenderScene, backend: Backend) -> None:
        self.scene = scene
        self.backend = backend
        self._caster: ExactCaster | None = None
        self._loaded = False

    @classmethod
    def open(cls, stage: Path, backend: str) -> Session:
        """Read a stage and start a backend.

        Raises:
            StageError: The stage cannot be read.
            BackendError: The backend is not there or cannot start.
        """
        # First: a backend that is not installed should not cost the reading of a stage.
        made = open_backend(backend)
        return cls(read_stage(stage), made)

    def passes(self, wanted: Sequence[str] | None, camera: Camera) -> tuple[str, ...]:
        """Passes as they are written: ``rgb`` first, ``label`` spelled out as its levels.

        Args:
            wanted: As a user asks for them; None takes what the camera's render product asks for.
            camera: Whose frame it is.

        Raises:
            BackendError: A pass nobody knows.
        """
        names = tuple(camera.outputs if wanted is None else wanted)
        return (*(["rgb"] if "rgb" in names else []), *pass_names(self.scene, names))

    def render(
        self, camera: Camera, sample: int, passes: Sequence[str], spp: int, seed: int
    ) -> tuple[dict[str, NDArray], dict[str, Any]]:
        """Render one frame.

        Args:
            camera: The camera at this sample.
            sample: Time code.
            passes: As ``passes`` returns them.
            spp: Samples per pixel of ``rgb``.
            seed: Noise seed of this very frame.

        Returns:
            (arrays by pass, details for the sidecar: ``seconds``, ``estimated_error``,
            ``resolver``).
        """
        seconds: dict[str, float] = {}
        details: dict[str, Any] = {"seconds": seconds}
        arrays: dict[str, NDArray] = {}
        annotation = [name for name in passes if name != "rgb"]
        with _timed(seconds, "load"):
            if not self._loaded:
                self.backend.load(self.scene)
                self._loaded = True
            if annotation and self._caster is None:
                # A backend that is exact itself lends its caster and needs no settling.
                own = self.backend.caster
                self._caster = own if own is not None else ExactCaster(self.scene)
        if "rgb" in passes:
            with _timed(seconds, "radiance"):
                radiance = self.backend.radiance(camera, sample, spp, seed)
            with _timed(seconds, "compose"):
                picture = compose(radiance, self.scene, camera, sample)
            arrays["rgb"] = picture.rgb
            details["samples_per_pixel"] = radiance.spp
            details["samples_dropped"] = radiance.dropped
            details["estimated_error"] = {
                "relative_rms": picture.relative_error,
                "relative_mse": picture.relative_mse,
            }
        if annotation and self._caster is not None:
            rays = camera_rays(camera)
            exact = self._caster is self.backend.caster
            with _timed(seconds, "visibility"):
                visibility = None if exact else self.backend.visibility(rays, sample, camera)
            with _timed(seconds, "resolve"):
                settled = settle(self._caster, rays, visibility, camera)
                arrays |= annotate(self.scene, settled, rays, annotation)
            details["resolver"] = asdict(settled.statistics)
        return arrays, details

    def render_to(
        self, stem: Path, camera_index: int, sample: int, key: FrameKey, seed: int
    ) -> dict[str, Any]:
        """Render a frame and write it; returns its details, with the seconds of writing.

        Raises:
            BackendError: There is no such camera or sample, or the renderer failed.
            OutputError: A file cannot be written.
        """
        if not 0 <= sample < len(self.scene.cameras):
            raise BackendError(f"{self.scene.source}: has no sample {sample}")
        camera = self.scene.cameras[sample][camera_index]
        arrays, details = self.render(camera, sample, key.passes, key.spp, seed)
        start = time.perf_counter()
        write_frame(stem, arrays, key, self.scene, camera, sample, details)
        details["seconds"]["write"] = time.perf_counter() - start
        return details


@contextmanager
def _timed(seconds: dict[str, float], name: str) -> Iterator[None]:
    start = time.perf_counter()
    yield
    seconds[name] = time.perf_counter() - start
