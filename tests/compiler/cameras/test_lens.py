"""Lenses: OpenCV's formulas as the oracle, inverses, where they fold, cfgs, what views see."""

from __future__ import annotations

import math

import cv2
import numpy as np
import pytest
from hypothesis import HealthCheck, assume, example, given
from hypothesis import strategies as st
from numpy.typing import NDArray

from scenec.compiler.geometry import lenses
from scenec.compiler.scene.rig import Rig, Sensor
from scenec.compiler.views import resolution
from scenec.schemas.lens import (
    Lens,
    directions,
    project,
    radial,
    reach,
    to_pixels,
    to_plane,
)
from scenec.schemas.records import LensRecord
from scenec.schemas.sidecars import lens_of
from scenec.testing.examples import examples

K = np.array([[412.5, 0.0, 320.25], [0.0, 409.75, 239.5], [0.0, 0.0, 1.0]])
MILD = Lens("brown_conrady", (-0.28, 0.07, 1.2e-3, -8e-4, 0.0, 0.0, 0.0, 0.0))
RATIONAL = Lens("brown_conrady", (0.9, 0.4, -2e-3, 1e-3, 0.02, 1.2, 0.6, 0.08))
FISHEYE = Lens("kannala_brandt", (-0.013, 0.0021, -9e-4, 7e-5))
PANORAMA = Lens("equirectangular", ())


def some_points(count: int = 500, spread: float = 0.7) -> NDArray[np.float64]:
    """Points before the camera."""
    points = np.random.default_rng(5).uniform(-spread, spread, (count, 3))
    points[:, 2] = np.random.default_rng(6).uniform(0.9, 3.0, count)
    return points


@pytest.mark.parametrize("lens", [MILD, RATIONAL])
def test_brown_conrady_is_opencvs_projection(lens: Lens) -> None:
    """cv2.projectPoints, whose pixel centers have whole numbers, to 1e-9 pixels."""
    points = some_points()
    k = K.copy()
    k[:2, 2] -= 0.5
    expected, _ = cv2.projectPoints(
        points, np.zeros(3), np.zeros(3), k, np.array(lens.coefficients)
    )
    plane, shown = project(lens, points)
    assert shown.all()
    assert np.abs(to_pixels(K, plane) - 0.5 - expected[:, 0]).max() < 1e-9


@pytest.mark.parametrize("skew", [0.0, 3.5])
def test_kannala_brandt_is_opencvs_fisheye(skew: float) -> None:
    """cv2.fisheye.projectPoints to 1e-9 pixels; its alpha is our skew over fx."""
    points = some_points(spread=4.0)
    k = K.copy()
    k[0, 1] = skew
    k[:2, 2] -= 0.5
    # OpenCV applies the skew by alpha alone.
    plain = k.copy()
    plain[0, 1] = 0.0
    expected, _ = cv2.fisheye.projectPoints(
        points[None], np.zeros((3, 1)), np.zeros((3, 1)), plain,
        np.array(FISHEYE.coefficients), alpha=skew / k[0, 0],
    )  # fmt: skip
    plane, shown = project(FISHEYE, points)
    assert shown.all()
    assert np.abs(to_pixels(k, plane) - expected[0]).max() < 1e-9


def test_our_inverse_is_opencvs() -> None:
    """cv2.undistortPoints, iterated until it no longer moves."""
    u, v = (a.ravel() for a in np.meshgrid(np.linspace(2, 638, 23), np.linspace(2, 478, 17)))
    points = np.stack([u, v], axis=1)
    criteria = (cv2.TERM_CRITERIA_EPS | cv2.TERM_CRITERIA_COUNT, 500, 1e-15)
    expected = cv2.undistortPoints(
        points[:, None], K, np.array(MILD.coefficients), criteria=criteria
    )[:, 0]
    rays, known = directions(MILD, *to_plane(K, u, v))
    assert known.all()
    assert np.abs(rays[:, :2] - expected).max() < 1e-9


coefficient = st.floats(-0.5, 0.5)
small = st.floats(-5e-3, 5e-3)


@st.composite
def any_lens(draw: st.DrawFn) -> Lens:
    """Lenses of both polynomial models, most of which fold somewhere."""
    if draw(st.booleans()):
        k = [draw(coefficient) for _ in range(6)]
        p = draw(small), draw(small)
        return Lens("brown_conrady", (k[0], k[1], *p, k[2], k[3], k[4], k[5]))
    scale = (0.3, 0.1, 0.03, 0.01)
    values = tuple(s * 2.0 * draw(coefficient) for s in scale)
    return Lens("kannala_brandt", values, draw(st.floats(0.2, math.pi)))


@examples(120, suppress_health_check=[HealthCheck.too_slow, HealthCheck.filter_too_much])
@given(any_lens(), st.integers(0, 2**32 - 1))
@example(MILD, 0)
@example(RATIONAL, 0)
@example(Lens("brown_conrady", (0.0,) * 8), 0)
@example(Lens("kannala_brandt", (0.0,) * 4), 0)
def test_rays_lead_back_to_their_pixels(lens: Lens, seed: int) -> None:
    """project(directions(x)) = x to 1e-9, wherever the lens is one-to-one, up to its border."""
    border = min(reach(lens), 20.0)
    share = np.concatenate([np.random.default_rng(seed).uniform(0.0, 0.999, 60), [0.0, 0.999]])
    turn = np.random.default_rng(seed + 1).uniform(0.0, 2.0 * np.pi, len(share))
    at = share * border
    if lens.planar:
        rays = np.stack([at * np.cos(turn), at * np.sin(turn), np.ones(len(at))], axis=1)
    else:
        across = np.sin(at)
        rays = np.stack([across * np.cos(turn), across * np.sin(turn), np.cos(at)], axis=1)
    plane, shown = project(lens, rays)
    assert shown.all()
    assume(np.isfinite(plane).all())
    found, known = directions(lens, plane[:, 0], plane[:, 1])
    assert known.all()
    again, _ = project(lens, found)
    scale = 1.0 + np.abs(plane).max()
    assert np.abs(again - plane).max() < 1e-9 * scale
    # Away from a fold, where the inverse is steep, the rays themselves are the same, too.
    inner = share < 0.7
    assert np.abs(found - rays)[inner].max() < 1e-6 * max(1.0, border)


@examples(60)
@given(any_lens())
def test_the_radial_function_rises_up_to_the_reach_and_no_farther(lens: Lens) -> None:
    """Against differences on a fine grid; an end is where it turns, has a pole, or is cut off."""
    border = reach(lens)
    at = np.linspace(0.0, min(border, 30.0), 4001)
    values = np.array([radial(lens, float(r)) for r in at[:-1]])
    assert (np.diff(values) > -1e-12 * np.abs(values).max()).all()
    tangential = lens.planar and any(lens.coefficients[2:4])
    if not tangential and border < (30.0 if lens.planar else lens.max_angle):
        beyond = [radial(lens, border * f) for f in (1.0, 1.001)]
        assert beyond[1] <= beyond[0] or beyond[0] > 1e3 or beyond[0] < 0.0


def test_a_known_fold_is_found() -> None:
    """R (1 + k1 r^2) turns at 1 / sqrt(-3 k1)."""
    lens = Lens("brown_conrady", (-0.5, *(0.0,) * 7))
    assert reach(lens) == pytest.approx(1.0 / math.sqrt(1.5), abs=1e-15)
    fisheye = Lens("kannala_brandt", (-0.2, 0.0, 0.0, 0.0))
    assert reach(fisheye) == pytest.approx(1.0 / math.sqrt(0.6), abs=1e-15)


def test_with_tangential_distortion_no_two_points_within_the_reach_coincide() -> None:
    """The Jacobian keeps its sign on the disc; just beyond a fold without it, it has lost it."""
    lens = Lens("brown_conrady", (-0.3, 0.0, 0.02, -0.015, *(0.0,) * 4))
    border = reach(lens)
    assert 0.5 < border < 1.0 / math.sqrt(0.9)
    side = np.linspace(-border, border, 201)
    a, b = (x.ravel() for x in np.meshgrid(side, side))
    inside = a * a + b * b <= border * border
    step = 1e-6
    at = np.stack([a, b, np.ones(len(a))], axis=1)[inside]
    x, y = step * np.eye(3)[:2]
    dx = (project(lens, at + x)[0] - project(lens, at - x)[0]) / (2 * step)
    dy = (project(lens, at + y)[0] - project(lens, at - y)[0]) / (2 * step)
    assert (dx[:, 0] * dy[:, 1] - dx[:, 1] * dy[:, 0] > 0.0).all()


def test_the_compilers_functions_are_numpys_to_rounding() -> None:
    """Its own arc tangent of two numbers in all octants, and rays made with them."""
    angle = np.linspace(-np.pi, np.pi, 721)
    y, x = np.sin(angle), np.cos(angle)
    assert np.abs(lenses.FUNCTIONS.atan2(y, x) - np.arctan2(y, x)).max() < 1e-15
    assert lenses.FUNCTIONS.atan2(np.zeros(1), np.zeros(1))[0] == 0.0
    u, v = np.random.default_rng(1).uniform(-2.0, 2.0, (2, 200))
    for lens in (MILD, FISHEYE, PANORAMA):
        own, there = directions(lens, u, v, lenses.FUNCTIONS)
        libm, known = directions(lens, u, v)
        assert np.array_equal(there, known)
        assert np.abs(own - libm).max() < 1e-14


@pytest.mark.parametrize("fov", [0.1, 40.0, 179.0])
def test_a_field_of_view_is_the_angle_between_the_outer_rays(fov: float) -> None:
    """With radial distortion; of fisheyes and panoramas beyond 180 degrees, too."""
    cases = [(Lens("brown_conrady", (0.02, 0.003, *(0.0,) * 6)), fov), (FISHEYE, 1.2 * fov)]
    for lens, wide in [*cases, (PANORAMA, 2.0 * fov)]:
        intrinsics = lenses.lens_intrinsics(lens, (640, 480), wide)
        assert not isinstance(intrinsics, str), intrinsics
        ends, known = lenses.pixel_rays(
            lens, intrinsics, np.array([1e-9, 640.0 - 1e-9]), np.full(2, 240.0)
        )
        assert known.all()
        ends /= np.linalg.norm(ends, axis=1)[:, None]
        # Each from the axis: their own angle is never beyond 180 degrees.
        angle = np.degrees(np.arctan2(np.abs(ends[:, 0]), ends[:, 2])).sum()
        assert angle == pytest.approx(wide, rel=1e-9)


def sensor(lens: Lens | None, resolution: tuple[int, int], fov: float) -> Sensor:
    """A sensor on its rig's origin."""
    assert lens is not None
    intrinsics = lenses.lens_intrinsics(lens, resolution, fov)
    assert not isinstance(intrinsics, str)
    return Sensor("s", resolution, intrinsics, np.eye(4), np.zeros(1), ("depth",), lens=lens)


@pytest.mark.parametrize(
    ("lens", "fov"),
    [(MILD, 80.0), (FISHEYE, 170.0), (FISHEYE, 230.0), (PANORAMA, 90.0), (PANORAMA, 360.0)],
)
def test_a_view_counts_all_that_its_picture_shows(lens: Lens, fov: float) -> None:
    """Random points that project into the picture are seen at full size, whatever their angle."""
    one = sensor(lens, (320, 200), fov)
    views = resolution.views_of((Rig("r", np.eye(4)[None], (one,)),))
    points = np.random.default_rng(2).normal(size=(4000, 3)) * 5.0
    plane, shown = project(lens, points)
    u, v = to_pixels(lenses.matrix(one.intrinsics), plane).T
    inside = shown & (u >= 0.0) & (u <= 320.0) & (v >= 0.0) & (v <= 200.0)
    assert inside.sum() > 20
    pixels = resolution.pixels_of_balls(views, points, np.zeros(len(points)), 0.0, 1e-3)
    assert (pixels[inside] > 0.0).all()
    if fov < 100.0 and lens is not PANORAMA:
        # What lies behind the camera is not.
        assert (pixels[points[:, 2] < -1.0] == 0.0).all()


def test_a_pinholes_view_is_the_same_beside_one_with_a_lens() -> None:
    """What another camera sees alone counts as what that one sees."""
    plain = Sensor("p", (64, 48), (60.0, 60.0, 32.0, 24.0, 0.0), np.eye(4), np.zeros(1), ("depth",))
    alone = resolution.views_of((Rig("r", np.eye(4)[None], (plain,)),))
    points = np.random.default_rng(3).normal(size=(500, 3)) * 4.0
    radius = np.full(len(points), 0.1)
    bent = sensor(FISHEYE, (64, 48), 170.0)
    beside, both = (
        resolution.pixels_of_balls(
            resolution.views_of((Rig("r", np.eye(4)[None], one),)), points, radius, 0.0, 0.1
        )
        for one in ((bent,), (plain, bent))
    )
    expected = resolution.pixels_of_balls(alone, points, radius, 0.0, 0.1)
    assert 0 < (expected > 0.0).sum() < (beside > 0.0).sum()
    assert np.array_equal(both, np.maximum(expected, beside))


def test_a_sidecars_lens_reads_back() -> None:
    """None is a pinhole."""
    assert lens_of(None) is None
    record = LensRecord(model="kannala_brandt", coefficients=(1, 2, 3, 4), max_angle_deg=90.0)
    assert lens_of(record) == Lens("kannala_brandt", (1.0, 2.0, 3.0, 4.0), math.pi / 2)
    assert lens_of(LensRecord(model="equirectangular", coefficients=())) == PANORAMA
