"""A renderer whose pictures are known, and scenes for the tests of shutters and apertures.

What it shows of a surface is its base color, whatever the light: a Monte Carlo estimate of coverage
alone, by the exact caster.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import cast

import numpy as np
from numpy.typing import NDArray

from scenec.backends.contract import Backend, Radiance, Rays
from scenec.backends.exact import ExactCaster
from scenec.backends.run.session import Session
from scenec.backends.stage.scene import Camera, OpenShutter, RenderScene
from scenec.backends.testing.scenes import mesh, scene, surface
from scenec.schemas.shutter import Shutter


class Flat(Backend):
    """Implements ``contract.Backend``: surfaces in their base color."""

    name, devices, device, denoiser, caster = "flat", ("cpu",), "cpu", "none", None

    def __init__(self, stochastic: bool = True) -> None:
        self.stochastic = stochastic
        self.drawn: list[tuple[Camera, int]] = []

    def version(self) -> str:
        """Of this."""
        return "flat 1"

    def load(self, scene: RenderScene) -> None:
        """For the exact caster."""
        self._scene, self._exact = scene, ExactCaster(scene)
        colors = np.array([one.base_color for one in scene.surfaces])
        self._colors = colors[[m.layers[0] for m in scene.meshes]]

    def radiance(
        self, camera: Camera, sample: int, spp: int, seed: int, denoise: bool = False
    ) -> Radiance:
        """Colors of what rays meet, all samples at once."""
        self.drawn.append((camera, spp))
        side = max(1, round(np.sqrt(spp)))
        parts = 2 if self.stochastic else 1
        each = (spp + 1) // 2 if self.stochastic else side * side
        pixels = camera.height * camera.width
        if self.stochastic:
            jitter = np.random.default_rng(seed).random((2, parts * each, pixels))
        else:
            cells = (np.arange(each)[None] // [[1], [side]] % side + 0.5) / side
            jitter = np.broadcast_to(cells[:, :, None], (2, each, pixels))
        row = self._exact.cast(_rays(camera, jitter))[0].reshape(parts, each, pixels)
        hit = row >= 0
        colors = np.where(hit[..., None], self._colors[self._scene.rows.mesh[row]], 0.0)
        shape = (camera.height, camera.width)
        halves = colors.mean(axis=1).reshape(parts, *shape, 3).astype(np.float32)
        coverage = hit.mean(axis=(0, 1)).reshape(shape).astype(np.float32)
        if not self.stochastic:
            halves = np.concatenate([halves, halves])
        return Radiance(halves, coverage, parts * each, stochastic=self.stochastic)


def _rays(camera: Camera, jitter: NDArray[np.float64]) -> Rays:
    """Rays through places in the pixels, [2, samples, pixels]."""
    k, m = camera.intrinsics, camera.camera_to_world
    v, u = (a.ravel() for a in np.mgrid[: camera.height, : camera.width].astype(np.float64))
    y = (v + jitter[1] - k[1, 2]) / k[1, 1]
    x = (u + jitter[0] - k[0, 2] - k[0, 1] * y) / k[0, 0]
    local = np.stack([x, y, np.ones_like(x)], -1).reshape(-1, 3)
    directions = np.ascontiguousarray(local @ m[:3, :3].T)
    origins = np.ascontiguousarray(np.broadcast_to(m[:3, 3], directions.shape))
    return Rays(origins, directions, (1, len(directions)))


def ahead(width: int = 64, height: int = 48, focal: float = 80.0, skew: float = 0.0) -> Camera:
    """At the origin, looking along +x; right is -y, down is -z."""
    pose = np.eye(4)
    pose[:3, :3] = np.array([[0.0, 0.0, 1.0], [-1.0, 0.0, 0.0], [0.0, -1.0, 0.0]])
    k = np.array([[focal, skew, width / 2], [0.0, focal, height / 2], [0.0, 0.0, 1.0]])
    return Camera("rig_cam", "/World/Rig/cam", width, height, k, pose)


def plate(
    distance: float, left: float, right: float, top: float, bottom: float
) -> tuple[NDArray[np.float64], NDArray[np.int64]]:
    """A rectangle across the view, camera coordinates (x right, y down)."""
    points = [[distance, -x, -y] for x, y in
              ((left, top), (right, top), (right, bottom), (left, bottom))]  # fmt: skip
    return np.array(points), np.array([[0, 1, 2], [0, 2, 3]])


def of_plates(plates: Sequence[tuple[float, ...]], color: float = 1.0) -> RenderScene:
    """Plates in the dark: nothing is behind them."""
    meshes = [mesh(*plate(*one)) for one in plates]
    return scene(meshes, [surface((color, color, color))])


def session(of: RenderScene, stochastic: bool = True) -> Session:
    """A scene that ``Flat`` draws."""
    return Session(of, cast("Backend", Flat(stochastic)))


def picture(
    made: Session, camera: Camera, spp: int = 64, seeds: Sequence[int] = (1,)
) -> NDArray[np.float64]:
    """One channel of a frame's rgb, the mean over some seeds."""
    shown = [made.render(camera, 0, ("rgb",), spp, seed).arrays["rgb"][..., 0] for seed in seeds]
    return np.mean(shown, axis=0, dtype=np.float64)


def shaken(
    camera: Camera,
    shutter: Shutter,
    at: Callable[[float], tuple[NDArray[np.float64], float]],
    keys: int = 65,
) -> Camera:
    """A camera that moves while its shutter is open.

    Args:
        camera: Where it is in the middle of it.
        shutter: Its shutter.
        at: By time, seconds: how far it is moved (right, down, ahead), and turned to the right.
        keys: Of its way.
    """
    times = np.linspace(-1.0, 1.0, keys) * max(shutter.half_span, 1e-9) * 1.5
    poses = []
    for t in times:
        offset, angle = at(float(t))
        pose = camera.camera_to_world.copy()
        c, s = np.cos(angle), np.sin(angle)
        pose[:3, :3] = pose[:3, :3] @ np.array([[c, 0.0, s], [0.0, 1.0, 0.0], [-s, 0.0, c]])
        pose[:3, 3] += camera.camera_to_world[:3, :3] @ np.asarray(offset, float)
        poses.append(pose)
    return replace(camera, shutter=OpenShutter(shutter, times, np.stack(poses)))


def disk(radius: float, focal: float, at: float, focus: float) -> float:
    """Diameter of the circle of confusion, pixels: similar triangles."""
    return 2.0 * radius * focal * abs(at - focus) / (at * focus)
