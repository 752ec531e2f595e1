"""Pictures through lenses: light that stays, straight lines that OpenCV gives back, both ways."""

from __future__ import annotations

import dataclasses
from typing import Any

import cv2
import numpy as np
import pytest
from numpy.typing import NDArray

from scenec.backends.camera.lens import TOLERANCE_PX, ray_table
from scenec.backends.camera.rays import camera_rays, subpixel_directions
from scenec.backends.contract import Backend, Radiance, Rays
from scenec.backends.exact import ExactCaster
from scenec.backends.mitsuba.adapter import Mitsuba
from scenec.backends.picture import resample
from scenec.backends.picture.compose import compose, disc_fraction
from scenec.backends.run.session import Session
from scenec.backends.stage.scene import Camera, RenderScene
from scenec.backends.testing.geometry import LENSES, inside_glow
from scenec.backends.testing.scenes import dome, look_at, mesh, plane, scene, sun, surface
from scenec.schemas.errors import BackendError
from scenec.schemas.lens import Lens
from scenec.testing.lens_scenes import BROWN, CAMERAS, FISHEYE, with_lens


def board(upright: bool = True, bars: int = 5) -> RenderScene:
    """Bars on nothing, the pattern of a calibration board, at x = 2; they go beyond the picture."""
    meshes = []
    for i in range(bars):
        at = -1.5 + 3.0 * (i + 0.5) / bars
        along, across = (-2.0, 2.0), (at - 0.15, at + 0.15)
        y, z = (across, along) if upright else (along, across)
        points = [[2.0, y[j], z[k]] for j, k in ((0, 0), (1, 0), (1, 1), (0, 1))]
        meshes.append(mesh(np.array(points), np.array([[0, 1, 2], [0, 2, 3]])))
    return scene(meshes, [surface((1.0, 1.0, 1.0))], lights=[dome(1.0)])


def before_board(lens: Lens, width: int, height: int, focal: float) -> Camera:
    """A camera before the board, not quite straight."""
    camera = look_at([0.0, 0.05, -0.03], [2.0, 0.0, 0.02], width, height)
    k = np.array([[focal, 0, 0.505 * width], [0, 1.01 * focal, 0.49 * height], [0, 0, 1.0]])
    return dataclasses.replace(camera, intrinsics=k, lens=lens)


#: Strongly bent, and a fisheye.
BOARDS = {
    "brown_conrady": (Lens("brown_conrady", (-0.3, 0.09, 2e-3, -1.5e-3, 0.0, 0.0, 0.0, 0.0)), 0.72),
    "kannala_brandt": (Lens("kannala_brandt", (-0.02, 0.004, -1e-3, 1e-4)), 0.66),
}


def undistorted(picture: NDArray[np.float32], camera: Camera) -> NDArray[np.float32]:
    """By OpenCV's own functions, with our cx and cy less a half; of the same scale at the axis."""
    k = camera.intrinsics.copy()
    k[:2, 2] -= 0.5
    assert camera.lens is not None
    given = np.array(camera.lens.coefficients)
    size = camera.width, camera.height
    if camera.lens.planar:
        maps = cv2.initUndistortRectifyMap(k, given, None, k, size, cv2.CV_32FC1)
    else:
        maps = cv2.fisheye.initUndistortRectifyMap(k, given, np.eye(3), k, size, cv2.CV_32FC1)
    # As finders of edges do: what is between pixels is not known of edges a pixel wide.
    smooth = cv2.GaussianBlur(picture, (0, 0), 0.8)
    return cv2.remap(smooth, *maps, cv2.INTER_LANCZOS4)


def off_straight(picture: NDArray[np.floating], lines: int = 1) -> NDArray[np.float64]:
    """How far points of edges are off the lines through them, pixels, of all upright edges.

    A point of an edge is where the sum over a window across it says that it is (a mean of so many
    lines), which holds for any symmetric blur.
    """
    reach, found = 5, []
    values = picture.astype(np.float64)
    middle = values.shape[0] // 2
    for start in np.flatnonzero(np.diff((values[middle] > 0.5).astype(int))).tolist():
        rises = values[middle, start + 1] > 0.5
        points = []
        for step in (1, -1):
            at, row = start, middle if step > 0 else middle - 1
            while 0 <= row < values.shape[0] and reach < at < values.shape[1] - reach - 2:
                line = values[row, at - reach : at + reach + 2]
                flat = line if rises else line[::-1]
                # A window holds one edge alone, flat on both sides.
                if np.abs(flat[:3]).max() > 0.1 or np.abs(flat[-3:] - 1.0).max() > 0.1:
                    break
                inside = line.sum()
                edge = at + reach + 2.0 - inside if rises else at - reach + inside
                points.append((row, edge))
                at = int(np.floor(edge - 0.5))
                row += step
        if len(points) < values.shape[0] // 2:
            continue
        sorted_points = np.array(sorted(points))
        count = len(points) // lines * lines
        mean = sorted_points[:count].reshape(-1, lines, 2).mean(axis=1)
        fit = np.polyfit(mean[:, 0], mean[:, 1], 1)
        found.append(mean[:, 1] - np.polyval(fit, mean[:, 0]))
    assert len(found) >= 4
    return np.concatenate(found)


def coverage_of(camera: Camera, world: RenderScene, side: int = 16) -> NDArray[np.float64]:
    """What surfaces cover of each pixel, by exact rays on a grid within those at edges."""
    caster = ExactCaster(world)
    steps = (np.arange(side) + 0.5) / side - 0.5
    dv, du = (a.ravel() for a in np.meshgrid(steps, steps, indexing="ij"))
    rays = camera_rays(camera)
    hit = np.isfinite(caster.cast(rays)[2]).reshape(rays.shape)
    wide = np.pad(hit, 1, mode="edge")
    shifted = [wide[j : j + hit.shape[0], i : i + hit.shape[1]] for i in range(3) for j in range(3)]
    mixed = np.logical_or.reduce(shifted) & ~np.logical_and.reduce(shifted)
    index = np.flatnonzero(mixed)
    around = subpixel_directions(camera, index, du, dv).reshape(-1, 3)
    origins = np.broadcast_to(rays.origins[0], around.shape)
    table = Rays(np.ascontiguousarray(origins), around, (len(index), side * side))
    out = hit.astype(np.float64).ravel()
    out[index] = np.isfinite(caster.cast(table)[2]).reshape(len(index), -1).mean(axis=1)
    return out.reshape(rays.shape)


def turned(picture: NDArray[np.floating], upright: bool) -> NDArray[np.floating]:
    """So that its edges are upright."""
    return picture if upright else picture.T


@pytest.mark.parametrize("upright", [True, False])
@pytest.mark.parametrize("name", BOARDS)
def test_opencv_makes_the_lines_of_a_board_straight(name: str, upright: bool) -> None:
    """To 0.05 pixel, the worst of all points of all edges; before, they are bent by pixels."""
    lens, share = BOARDS[name]
    camera = before_board(lens, 320, 240, share * 320)
    bent = coverage_of(camera, board(upright)).astype(np.float32)
    assert np.abs(off_straight(turned(bent, upright))).max() > 1.0
    off = off_straight(turned(undistorted(bent, camera), upright))
    assert np.sqrt((off**2).mean()) < 0.02
    assert np.abs(off).max() < 0.05


@pytest.mark.slow
@pytest.mark.invariant
@pytest.mark.parametrize("way", ["rays", "resampled"])
@pytest.mark.parametrize("name", BOARDS)
def test_opencv_makes_a_renderers_lines_straight(name: str, way: str) -> None:
    """Mitsuba's picture by its own rays, and resampled of pinhole views; means of 8 lines."""
    lens, share = BOARDS[name]
    camera = before_board(lens, 320, 240, share * 320)
    backend = Mitsuba(bounces=0)
    backend.load(board())
    # Views are finer than the picture: with fewer samples a pixel they leave less noise than rays.
    picture = drawn(backend, camera, 256 if way == "rays" else 128, way).coverage
    off = off_straight(undistorted(picture, camera), 8)
    assert np.sqrt((off**2).mean()) < 0.02
    assert np.abs(off).max() < 0.05


def drawn(backend: Any, camera: Camera, spp: int, way: str) -> Radiance:
    """A picture by a backend's own rays, or of pinhole views."""
    if way == "rays":
        found: Radiance = backend.radiance(camera, 0, spp, 7)
        return found
    return resample.draw(backend, camera, resample.plan_views(camera), 0, spp, 7, False)


@pytest.mark.parametrize("name", LENSES)
def test_in_even_light_every_pixel_with_a_ray_shows_it(name: str) -> None:
    """In a box that glows: 1 wherever there is a ray, 0 where there is none; of pinhole views."""
    world = inside_glow(name)
    camera = world.cameras[0][0]
    backend = Mitsuba(bounces=0)
    backend.load(world)
    found = drawn(backend, camera, 4, "resampled")
    known = ray_table(camera).known
    assert np.allclose(found.halves[:, known], 1.0, atol=1e-5)
    assert (found.halves[:, ~known] == 0.0).all()
    assert np.allclose(found.coverage[known], 1.0, atol=1e-5)
    assert (found.coverage[~known] == 0.0).all()


@pytest.mark.parametrize("name", CAMERAS)
def test_resampled_pictures_are_those_of_rays(name: str) -> None:
    """A lit, patterned ground under an empty sky: mean brightness to 1 %, pixels to the noise."""
    camera = CAMERAS[name]
    points, faces = plane(40.0, 80)
    tone = np.random.default_rng(0).uniform(-1.0, 1.0, len(points))
    ground = mesh(points, faces, variation=tone)
    world = scene([ground], [surface((0.4, 0.4, 0.4), variation=0.5)], lights=[sun(50.0)])
    backend = Mitsuba(bounces=0)
    backend.load(world)
    rays = drawn(backend, camera, 64, "rays")
    views = drawn(backend, camera, 64, "resampled")
    one, two = rays.halves.mean(axis=0), views.halves.mean(axis=0)
    assert two.mean() == pytest.approx(one.mean(), rel=0.01)
    inside = (rays.coverage == 1.0) & (views.coverage == 1.0)
    assert inside.mean() > 0.2
    assert np.sqrt(((one - two)[inside] ** 2).mean()) < 0.06 * one[inside].mean()
    assert np.abs(rays.coverage - views.coverage).mean() < 0.01


def test_halves_of_resampled_pictures_tell_their_error() -> None:
    """((A - B)/2)^2 is the variance of the mean, against many pictures with other seeds."""
    camera = with_lens(BROWN, 24, 18)
    world = scene([mesh(*plane())], [surface()], lights=[dome(1.0), sun(30.0, diameter_deg=40.0)])
    backend = Mitsuba(bounces=0)
    backend.load(world)
    views = resample.plan_views(camera)
    pictures, stated = [], []
    for seed in range(24):
        found = resample.draw(backend, camera, views, 0, 8, seed, False)
        pictures.append(found.halves.mean(axis=0))
        stated.append(((found.halves[0] - found.halves[1]) / 2.0) ** 2)
    inside = found.coverage == 1.0
    true = np.var(pictures, axis=0, ddof=1)[inside].mean()
    assert np.mean(stated, axis=0)[inside].mean() == pytest.approx(true, rel=0.15)


@pytest.mark.parametrize("name", CAMERAS)
def test_a_sun_behind_a_lens_keeps_its_light(name: str) -> None:
    """Fractions of pixels times their solid angles are the disc's solid angle."""
    camera = dataclasses.replace(CAMERAS[name])
    rays = camera_rays(camera)
    index = np.arange(len(rays.directions))
    to_light = rays.directions[len(index) // 2 + 11]
    disc = dataclasses.replace(sun(diameter_deg=9.0), to_light=to_light / np.linalg.norm(to_light))
    near, fraction = disc_fraction(disc, camera, rays.directions, index)
    corners = subpixel_directions(
        camera, index[near], np.array([-0.5, 0.5, 0.5, -0.5]), np.array([-0.5, -0.5, 0.5, 0.5])
    )
    corners /= np.linalg.norm(corners, axis=2)[..., None]
    solid = 0.5 * np.linalg.norm(
        np.cross(corners[:, 2] - corners[:, 0], corners[:, 3] - corners[:, 1]), axis=1
    )
    expected = 2.0 * np.pi * (1.0 - np.cos(np.radians(4.5)))
    assert (fraction * solid).sum() == pytest.approx(expected, rel=0.02)


def test_outside_of_the_image_circle_the_picture_is_black() -> None:
    """Even of a sky."""
    camera = CAMERAS["kannala_brandt"]
    world = scene([mesh(*plane())], [surface()], lights=[dome(1.0)])
    backend = Mitsuba(bounces=0)
    backend.load(world)
    picture = compose(drawn(backend, camera, 4, "rays"), world, camera, 0)
    known = ray_table(camera).known
    assert (picture.rgb[~known] == 0.0).all()
    assert (picture.rgb[known] > 0.0).all()


@pytest.mark.parametrize("name", [*CAMERAS, "small"])
def test_rays_between_the_tables_are_off_by_what_it_says(name: str) -> None:
    """At random places of random pixels, against the formulas, in pixels."""
    camera = CAMERAS.get(name, with_lens(FISHEYE, 9, 8, 3.0))
    table = ray_table(camera)
    assert table.error_px <= TOLERANCE_PX
    rng = np.random.default_rng(3)
    index = rng.choice(np.flatnonzero(table.known.ravel()), 40)
    d = np.empty(3)
    worst = 0.0
    rolled = [np.roll(table.known, (i, i), (0, 1)) for i in (-1, 1)]
    inner = table.known & rolled[0] & rolled[1]
    turn = camera.camera_to_world[:3, :3]
    for k in index.tolist():
        row, column = divmod(k, camera.width)
        if not inner[row, column]:
            continue
        du, dv = rng.uniform(-0.5, 0.5, (2, 1))
        at = np.array([k])
        exact = subpixel_directions(camera, at, du, dv)[0, 0] @ turn
        step = subpixel_directions(camera, at, du + 0.01, dv)[0, 0] @ turn
        u, v = column + 0.5 + du[0], row + 0.5 + dv[0]
        resample._between(table.directions, table.per_pixel, u, v, d)
        worst = max(worst, sine(d, exact) / (100.0 * sine(step, exact)))
    assert worst < 3.0 * TOLERANCE_PX


def sine(a: NDArray[np.float64], b: NDArray[np.float64]) -> float:
    """Of the angle between two directions."""
    return float(np.linalg.norm(np.cross(a, b)) / np.linalg.norm(a) / np.linalg.norm(b))


class Pinholes(Backend):
    """A backend that follows no lenses."""

    name = "pinholes"

    def __init__(self) -> None:
        self.device = "cpu"
        self.seen: list[Camera | None] = []

    def version(self) -> str:
        """One."""
        return "1"

    def load(self, scene: RenderScene) -> None:
        """Nothing to do."""

    def witness(self, rays: Any, sample: int, camera: Camera | None = None) -> None:
        """Sees nothing, but which camera it is asked of."""
        self.seen.append(camera)

    def radiance(
        self, camera: Camera, sample: int, spp: int, seed: int, denoise: bool = False
    ) -> Radiance:
        """Light of 1 everywhere."""
        assert camera.lens is None
        shape = (camera.height, camera.width)
        return Radiance(np.ones((2, *shape, 3), np.float32), np.ones(shape, np.float32), spp)


def test_a_backend_that_knows_pinholes_alone_draws_lenses_and_the_sidecar_says_how() -> None:
    """It is never shown a lens; annotation is cast."""
    camera = CAMERAS["kannala_brandt"]
    world = scene([mesh(*plane())], [surface()], cameras=[camera])
    backend: Any = Pinholes()
    session = Session(world, backend)
    result = session.render(camera, 0, ["rgb", "depth"], 4, 1)
    arrays, record = result.arrays, result.record
    assert session.witness(0, 0) is None
    assert backend.seen == [None]
    assert record.lens_radiance.way == "resampled"
    assert record.lens_radiance.views == 5
    assert arrays["rgb"].max() == 1.0
    mitsuba = Session(world, Mitsuba(bounces=0))
    record = mitsuba.render(camera, 0, ["rgb"], 1, 1).record
    assert record.lens_radiance.way == "rays"
    assert record.lens_radiance.interpolation_px <= TOLERANCE_PX


def test_a_lens_that_shows_nothing_is_one_message() -> None:
    """All of the picture beyond the image circle."""
    camera = with_lens(dataclasses.replace(FISHEYE, max_angle=0.01), 8, 8, 100.0)
    k = camera.intrinsics.copy()
    k[:2, 2] += 50.0
    camera = dataclasses.replace(camera, intrinsics=k)
    with pytest.raises(BackendError, match="rig_cam: its lens has no ray"):
        drawn(Pinholes(), camera, 1, "resampled")
