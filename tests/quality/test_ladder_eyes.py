"""Where ladders look: along the rays of lenses and of lidars, not those of pinholes."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest

from scenec.compiler.scene.rig import Lidar, LidarErrors, Rig, Sensor
from scenec.compiler.terrain.grid import Grid, HeightField
from scenec.compiler.views.frustum import rays_a_radian
from scenec.compiler.views.resolution import views_of
from scenec.quality.ladder import points
from scenec.quality.ladder.eyes import Eye, eyes_of
from scenec.quality.ladder.seen import horizons, looked_at, skylines
from scenec.schemas.lens import Lens

#: Camera axes in the world, as columns: right, down, forward.
DOWN = np.array([[1.0, 0.0, 0.0], [0.0, -1.0, 0.0], [0.0, 0.0, -1.0]])
NORTH = np.array([[1.0, 0.0, 0.0], [0.0, 0.0, 1.0], [0.0, -1.0, 0.0]])
FISHEYE = Lens("kannala_brandt", (0.0,) * 4, math.radians(80.0))
PANORAMA = Lens("equirectangular", ())


def flat(side: float = 400.0) -> HeightField:
    grid = Grid.with_spacing((side, side), 1.0)
    return HeightField(grid, np.zeros(grid.shape))


def sensor(lens: Lens | None, focal: float, resolution: tuple[int, int] = (200, 100)) -> Sensor:
    middle = 0.5 * resolution[0], 0.5 * resolution[1]
    return Sensor(
        "eye", resolution, (focal, focal, *middle, 0.0), np.eye(4), np.zeros(1), ("rgb",), lens=lens
    )


def rig(axes: np.ndarray, height: float, *sensors: Sensor, lidars: tuple[Lidar, ...] = ()) -> Rig:
    pose = np.eye(4)
    pose[:3, :3], pose[2, 3] = axes, height
    return Rig("rig", pose[None], sensors, lidars=lidars)


def one(axes: np.ndarray, height: float, own: Sensor) -> tuple[Eye, ...]:
    return eyes_of((rig(axes, height, own),))


def lidar(*elevations: float) -> Lidar:
    return Lidar(
        "top", np.eye(4), np.array(elevations), 360, (0.0, 90.0), (0.5, 100.0),
        LidarErrors(0.0, 0.0, 0.0, 0.0), 1,
    )  # fmt: skip


def pattern(*elevations: float) -> Lidar:
    """The same rays, each said by itself."""
    angles = np.meshgrid(elevations, np.arange(360) / 4.0, indexing="ij")
    return replace(lidar(), azimuths=0, azimuth_deg=(0.0, 0.0), rays=np.stack(angles, axis=-1))


def test_a_pattern_of_a_grids_rays_is_looked_along_as_the_grid() -> None:
    own, other = (
        eyes_of((rig(NORTH, 2.0, lidars=(make(-10.0, -20.0, -30.0),)),))[0]
        for make in (lidar, pattern)
    )
    u, v = np.arange(360) / 360.0, np.linspace(0.0, 1.0, 360)
    assert other.rays(u + 1e-4, v) == pytest.approx(own.rays(u, v), abs=1e-14)


def test_a_pattern_has_as_many_rays_a_radian_as_the_middle_one_of_its_steps_says() -> None:
    """Steps of a quarter degree, shorter by the cosine of the middle beam's elevation."""
    expected = math.degrees(4.0) / math.cos(math.radians(20.0))
    assert rays_a_radian(pattern(-10.0, -20.0, -30.0)) == pytest.approx(expected, rel=1e-5)
    # Beams nearer to each other than rays; then rays that all go the same way.
    close = replace(lidar(), rays=np.array([[[0.0, 0.0]], [[0.01, 0.0]]]))
    assert rays_a_radian(close) == pytest.approx(math.degrees(100.0), rel=1e-5)
    assert rays_a_radian(replace(lidar(), rays=np.zeros((2, 5, 2)))) == 0.5 / math.pi


def test_points_under_a_fisheye_fill_its_image_circle_evenly() -> None:
    """Its rays lie as far from the axis as the angle to it: h tan(t) from under the eye."""
    focal, height = 40.0, 2.0
    x, y = looked_at(flat(), one(DOWN, height, sensor(FISHEYE, focal)))
    distance = np.sqrt(x * x + y * y)
    angle = np.arctan2(distance, height)
    assert math.radians(70.0) < angle.max() < math.radians(80.5)
    u, v = (focal * angle * at / distance for at in (x, y))
    assert np.abs(v).max() < 50.01
    counts, _, _ = np.histogram2d(u, v, bins=(6, 6), range=[[-30, 30], [-30, 30]])
    assert counts.max() < 1.1 * counts.min()


def test_a_pinhole_s_points_fill_its_picture_evenly() -> None:
    x, y = looked_at(flat(), one(DOWN, 2.0, sensor(None, 50.0)))
    counts, _, _ = np.histogram2d(
        50.0 * x / 2.0, -50.0 * y / 2.0, bins=(8, 4), range=[[-100, 100], [-50, 50]]
    )
    assert counts.max() < 1.05 * counts.min()


def test_a_panorama_sees_ground_all_around() -> None:
    x, y = looked_at(flat(), one(NORTH, 2.0, sensor(PANORAMA, 200.0 / (2.0 * math.pi))))
    counts, _ = np.histogram(np.arctan2(y, x), bins=8, range=(-math.pi, math.pi))
    assert counts.max() < 1.1 * counts.min()


def test_a_lidar_s_points_lie_where_its_beams_meet_the_ground() -> None:
    scanner = lidar(5.0, -10.0, -45.0)
    x, y = looked_at(flat(), eyes_of((rig(NORTH, 2.0, lidars=(scanner,)),)))
    rings = 2.0 / np.tan(np.radians([10.0, 45.0]))
    off = np.abs(np.sqrt(x * x + y * y)[:, None] - rings)
    assert off.min(axis=1).max() < 1e-2
    # From ahead, north, a quarter turn to the left.
    assert x.max() <= 1e-3
    assert y.min() >= -1e-3


@pytest.mark.parametrize(
    ("lens", "focal"), [(None, 60.0), (FISHEYE, 60.0), (PANORAMA, 200.0 / (2.0 * math.pi))]
)
def test_the_horizon_of_a_level_eye_lies_as_far_down_as_its_lens_shows_it(
    lens: Lens | None, focal: float
) -> None:
    """Ground 2 m below the eye that ends, or is left, at the last place along each bearing."""
    eyes = one(NORTH, 2.0, sensor(lens, focal))
    lines = skylines(flat(), eyes)
    across = (np.arange(lines.x.shape[1]) + 0.5) / lines.x.shape[1] * 200.0 - 100.0
    rows = horizons(lines, eyes, np.zeros(lines.x.shape))[0]
    dip = 2.0 / lines.away[0, :, -1]
    if lens is None:
        # Depth along the axis is shorter than the way by the bearing's cosine.
        down = focal * dip * np.sqrt(1.0 + (across / focal) ** 2)
    elif lens is PANORAMA:
        down = focal * np.arctan(dip)
    else:
        bearing = across / focal
        angle = np.arccos(np.cos(bearing) / np.sqrt(1.0 + dip * dip))
        down = focal * angle * dip / np.sqrt(np.sin(bearing) ** 2 + dip * dip)
        down[np.abs(bearing) > math.radians(80.0)] = np.nan
    assert np.isnan(rows).tolist() == np.isnan(down).tolist()
    assert (~np.isnan(down)).sum() >= 36
    known = ~np.isnan(down)
    assert rows[known] == pytest.approx(50.0 + down[known], abs=1e-6)


@pytest.mark.parametrize("lens", [None, FISHEYE, PANORAMA])
def test_ground_that_is_nowhere_has_no_horizon(lens: Lens | None) -> None:
    eyes = one(NORTH, 2.0, sensor(lens, 30.0))
    lines = skylines(flat(), eyes)
    assert np.isnan(horizons(lines, eyes, np.full(lines.x.shape, np.nan))).all()


def test_lidars_have_no_horizon_and_eyes_are_in_the_order_of_views() -> None:
    rigs = (rig(NORTH, 2.0, sensor(None, 50.0), sensor(FISHEYE, 40.0), lidars=(lidar(-5.0),)),)
    eyes = eyes_of(rigs)
    assert np.array_equal([eye.pose[:, 3] for eye in eyes], views_of(rigs).eye)
    assert np.array_equal([eye.pose[:, 2] for eye in eyes], views_of(rigs).axis)
    lines = skylines(flat(), eyes)
    assert lines.eye.tolist() == [0, 1]
    assert skylines(flat(), eyes[2:]) is None
    u, v = points.square(100)
    assert np.abs(np.linalg.norm(eyes[2].rays(u, v), axis=1) - 1.0).max() < 1e-12
