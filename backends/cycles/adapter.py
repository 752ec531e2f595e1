"""The Cycles backend: visibility from one ray a pixel, radiance by its path tracer."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from scenec.backends.camera.tiles import by_columns
from scenec.backends.contract import BOUNCES, Backend, LoadCost, Radiance, Rays, Visibility
from scenec.backends.cycles import blender, render
from scenec.backends.cycles.built import Built
from scenec.backends.cycles.camera import Lens, find_lens, place
from scenec.backends.cycles.materials import FACE_PASS, ROW_PASS
from scenec.backends.cycles.planetary import surfaces_by_law
from scenec.backends.noise_seeds import half_seed
from scenec.backends.picture.denoise import NAME, keep_rim
from scenec.backends.stage.scene import Camera, RenderScene
from scenec.backends.surface.facets import deviation
from scenec.schemas.errors import BackendError, CameraRefusedError

#: Measured against Mitsuba, which is exact: the ground of mars_yard.
FACETS_LOSS = (
    "cycles shades facets of maps of normals exactly under suns and lamps, under a sky by their "
    "mean under an even one: mean radiance is off by 0.5 %, by up to 6 % against a bright aureole"
)
#: Measured against Mitsuba, which is exact: bumpy ground of the Moon's and of a strongly
#: backscattering law, sun 10 to 40 degrees high, with an aureole of seven times the sky's radiance.
LAW_LOSS = (
    "cycles reflects suns and lamps by Hapke's and Lommel and Seeliger's laws, but sky and what "
    "other surfaces throw by these laws' albedo towards the camera: mean radiance is off by 0.5 % "
    "where a sun shines alone, by up to 5 % under a sky with a bright aureole"
)

#: What materials write for visibility.
PASSES = (ROW_PASS, FACE_PASS)
#: Pixels of a side that Cycles draws in one piece. Of larger pictures it keeps parts in a file,
#: which fails in Blender as a module ("Error writing tile to file").
LARGEST = 8192


class Cycles(Backend):
    """Implements ``contract.Backend``: ``load`` once, then any number of samples.

    One Blender scene serves both questions. Lights come at the first radiance call, so annotation
    alone never pays for them.
    """

    name = "cycles"
    devices = ("cpu", "cuda", "optix")
    denoiser = NAME
    load_cost = LoadCost(row=2700.0, triangle=300.0)

    def __init__(self, bounces: int = BOUNCES, device: str = "auto") -> None:
        self._bpy = blender.load_bpy()
        self.device = blender.choose_device(self._bpy, device, self._works)
        self._bounces = bounces
        self._loaded: Built | None = None

    def version(self) -> str:
        """Renderer, device and length of paths: whatever decides the picture."""
        return f"cycles {self._bpy.app.version_string} {self.device} path{self._bounces}"

    def losses(self, scene: RenderScene) -> tuple[str, ...]:
        """Nothing of the shared surface model; light from around on what is not Lambert's."""
        surfaces = surfaces_by_law(scene)
        lines = []
        if any(surface.reflectance is not None for surface in surfaces):
            lines.append(LAW_LOSS)
        if any(deviation(surface) > 0.0 for surface in surfaces):
            lines.append(FACETS_LOSS)
        return tuple(lines)

    def load(self, scene: RenderScene) -> None:
        """Build Blender's scene; that of an earlier batch goes.

        Raises:
            BackendError: Faces that name points which are not there.
            StageError: A map that cannot be read.
        """
        self._loaded = None
        self._loaded = Built(self._bpy, scene, self.device, self._bounces)

    def witness(self, rays: Rays, sample: int, camera: Camera | None = None) -> Visibility | None:
        """First hits in float32; None for rays of no camera that Blender has: skewed ones."""
        loaded = self._require_loaded()
        lens = None if camera is None else find_lens(camera)
        if camera is None or lens is None or isinstance(lens, str):
            return None
        loaded.pose(sample)
        return by_columns(self._look, camera, LARGEST)

    def _look(self, camera: Camera) -> Visibility:
        """First hits of a camera that Blender has."""
        loaded, lens = self._require_loaded(), find_lens(camera)
        assert isinstance(lens, Lens)
        place(loaded.scene, loaded.camera, camera, lens, loaded.frame)
        render.for_visibility(loaded.scene, PASSES)
        row, face = (
            _whole(picture[: camera.height, : camera.width])
            for picture in render.draw(self._bpy, loaded.scene, PASSES)
        )
        # Rows count from 1: 0 is where no ray hits.
        return Visibility(row - 1, np.where(row > 0, face, 0).astype(np.int32))

    def radiance(
        self, camera: Camera, sample: int, spp: int, seed: int, denoise: bool = False
    ) -> Radiance:
        """Surface light in two independent halves of ceil(spp / 2) samples a pixel each.

        Box filter: the plain mean of samples placed anywhere in the pixel.

        Raises:
            BackendError: The camera is one that Blender does not have.
        """
        loaded = self._require_loaded()
        lens = find_lens(camera)
        if isinstance(lens, str):
            raise CameraRefusedError(f"cycles: cannot draw {camera.path}: it has {lens}")
        loaded.set_light(sample)
        loaded.pose(sample)
        place(loaded.scene, loaded.camera, camera, lens, loaded.frame)
        each = max(1, (spp + 1) // 2)
        wanted = (render.NOISY, render.COMBINED) if denoise else (render.COMBINED,)
        halves = np.zeros((2, camera.height, camera.width, 3), np.float32)
        clean = np.zeros_like(halves)
        hits, drawn = np.zeros((camera.height, camera.width)), 0
        shares = 1 if loaded.shares is None else len(loaded.shares)
        for share in range(shares):
            bounces, samples = self._bounces, each
            if loaded.shares is not None:
                bounces = loaded.shares.choose(share, bounces)
                samples = loaded.shares.samples(share, each)
            for half in range(2):
                # Blender's seeds have 31 bits.
                noise = half_seed(seed, half + 2 * share) >> 1
                render.for_radiance(loaded.scene, bounces, samples, noise, denoise)
                pictures = [
                    picture[: camera.height, : camera.width]
                    for picture in render.draw(self._bpy, loaded.scene, wanted)
                ]
                halves[half] += pictures[0][..., :3]
                clean[half] += pictures[-1][..., :3]
                # A sample covers its pixel or not; float32 sums of their shares miss 1 by a hair.
                hits += np.rint(pictures[0][..., 3].astype(np.float64) * samples)
                drawn += samples
        coverage = np.asarray(np.clip(hits / drawn, 0.0, 1.0), np.float32)
        made = Radiance(halves, coverage, 2 * each)
        if not denoise:
            return made
        keep_rim(clean, halves, coverage)
        mean = clean.mean(axis=0, dtype=np.float32)
        return replace(made, denoised=mean, denoised_halves=clean)

    def _works(self, device: str) -> bool:
        """Whether a device renders an empty picture."""
        nothing = Built(self._bpy, None, device, 0)
        render.for_visibility(nothing.scene, PASSES)
        try:
            render.draw(self._bpy, nothing.scene, PASSES)
        except BackendError:
            return False
        return True

    def _require_loaded(self) -> Built:
        if self._loaded is None:
            raise BackendError("cycles: no scene is loaded; call load first")
        return self._loaded


def _whole(picture: NDArray[np.float32]) -> NDArray[np.int32]:
    """Whole numbers from two halves of 16 bits, [h, w, 4] -> int32 [h * w]."""
    low, high = (picture[..., i].astype(np.int64) for i in range(2))
    return (low + (high << 16)).ravel().astype(np.int32)
