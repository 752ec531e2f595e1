"""How far and how wide things are blurred: nothing that is seen is missed, wherever it is."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.typing import NDArray

from scenec.backends.camera.rays import camera_rays
from scenec.backends.camera.shutter import poses_at
from scenec.backends.exact import ExactCaster
from scenec.backends.picture.blur import Blur, measure
from scenec.backends.picture.subframes import moved_eye
from scenec.backends.registry import open_backend
from scenec.backends.run.session import Session
from scenec.backends.stage.scene import Camera, Focus, RenderScene
from scenec.backends.testing.scenes import mesh, scene, surface
from scenec.schemas.lens import EQUIRECTANGULAR, Lens, shown_at
from scenec.schemas.shutter import Shutter
from scenec.testing.blur_scenes import ahead, disk, of_plates, picture, plate, session, shaken
from scenec.testing.examples import examples

FAR_WALL = (30.0, -99.0, 99.0, -99.0, 99.0)


def measured(camera: Camera, of: RenderScene) -> Blur:
    blur = measure(camera, ExactCaster(of))
    assert blur is not None
    return blur


@examples(60)
@given(left=st.floats(-0.57, 0.56), width=st.floats(1e-5, 0.02), focus=st.floats(2.0, 60.0))
def test_a_pole_is_blurred_by_the_thin_lens_wherever_it_stands_and_however_thin(
    left: float, width: float, focus: float
) -> None:
    camera = replace(ahead(640, 480, 554.0), focus=Focus(focus, 0.0125))
    blur = measured(camera, of_plates([(1.0, left, left + width, -9.0, 9.0), FAR_WALL]))
    assert blur.disk_px == pytest.approx(disk(0.0125, 554.0, 1.0, focus), rel=1e-9)
    assert blur.nearest_m == pytest.approx(1.0, rel=1e-9)


@examples(20)
@given(left=st.floats(-1.0, 1.0), top=st.floats(-0.8, 0.8), size=st.floats(1e-5, 0.02))
def test_a_speck_moves_as_far_as_its_distance_says_wherever_it_is(
    left: float, top: float, size: float
) -> None:
    """A camera that goes sideways: its way times the focal length, over the distance."""
    camera = shaken(ahead(640, 480, 554.0), Shutter(0.06), lambda t: ([1.5 * t, 0.0, 0.0], 0.0))
    blur = measured(camera, of_plates([(2.0, left, left + size, top, top + size), FAR_WALL]))
    assert blur.motion_px == pytest.approx(0.09 * 554.0 / 2.0, rel=1e-6)


def test_a_speck_that_no_coarse_ray_meets_leaves_a_streak_as_long_as_its_way() -> None:
    """12 pixels, before a wall that hardly moves; it lies between the rays of 48 by 36."""
    f, z = 100.0, 2.0
    camera = shaken(
        ahead(144, 72, f), Shutter(0.02), lambda t: ([12.0 * z / f / 0.02 * t, 0.0, 0.0], 0.0)
    )
    left, right, top, bottom = (z / f * px for px in (0.1, 2.2, 0.1, 0.9))
    lit, dark = mesh(*plate(z, left, right, top, bottom)), mesh(*plate(*FAR_WALL))
    of = scene([lit, replace(dark, layers=(1,))], [surface((1.0,) * 3), surface((0.0,) * 3)])
    made = session(of)
    facts = made.render(camera, 0, ("rgb",), 48, 1).record.blur
    assert facts.motion_px == pytest.approx(12.0, rel=1e-6)
    assert facts.sub_frames_wanted_per_row == 24
    along = picture(made, camera, 48, range(6)).sum(axis=0)
    columns = np.flatnonzero(along)
    assert along.sum() == pytest.approx(2.1 * 0.8, rel=0.05)
    assert columns.min() in (66, 67)
    assert columns.max() in (79, 80)
    # Each of its columns has its share of the time.
    assert along[columns.min() + 3 : columns.max() - 2] == pytest.approx(1.68 / 12.0, rel=0.35)


def test_what_is_in_view_for_a_moment_alone_counts_too() -> None:
    """Not when the shutter opens, nor in the middle, nor at its end."""
    turning = shaken(ahead(96, 72, 80.0), Shutter(0.02), lambda t: ([40.0 * t, 0.0, 0.0], 0.0))
    # In view while the camera is about 0.2 m to the right.
    of = of_plates([(0.1, 0.199, 0.2, -0.01, 0.01), (500.0, -999.0, 999.0, -999.0, 999.0)])
    blur = measured(turning, of)
    # It passes through all of the picture, and more would take what is beside it.
    assert 96.0 <= blur.motion_px <= 0.8 * 80.0 / 0.1


LENSES = [
    None,
    Lens("brown_conrady", (-0.2, 0.05, 1e-3, -1e-3, 0.0, 0.0, 0.0, 0.0)),
    Lens("kannala_brandt", (-0.02, 0.004, -1e-3, 1e-4), 1.4),
    Lens(EQUIRECTANGULAR, ()),
]


def farthest(camera: Camera, of: RenderScene) -> float:
    """Along the ways of all that pixels' rays meet at nine times, while it is in the picture."""
    assert camera.shutter is not None
    times = np.linspace(-0.5, 0.5, 65) * camera.shutter.shutter.exposure_s
    poses = poses_at(camera.shutter, times)
    caster, still = ExactCaster(of), replace(camera, shutter=None)
    size = np.array([camera.width, camera.height])
    most = 0.0
    for j in range(0, 65, 8):
        rays = camera_rays(replace(still, camera_to_world=poses[j]))
        t = caster.cast(rays)[2]
        hit = np.isfinite(t) if rays.known is None else np.isfinite(t) & rays.known
        points = (rays.origins + np.where(hit, t, 0.0)[:, None] * rays.directions)[hit]
        way, before = np.zeros(len(points)), None
        for pose in poses:
            local = (points - pose[:3, 3]) @ pose[:3, :3]
            at = shown_at(camera.lens, camera.intrinsics, local)
            inside = ((at >= 0.0) & (at <= size)).all(axis=1)
            if before is not None:
                step = np.sqrt(((at - before[0]) ** 2).sum(axis=1))
                # What jumps across a panorama's seam has not moved so far.
                counts = inside & before[1] & (step < 0.5 * camera.width)
                way[counts] += step[counts]
            before = at, inside
        most = max(most, float(way.max(initial=0.0)))
    return most


@pytest.mark.slow
@examples(30)
@given(seed=st.integers(0, 2**32), which=st.sampled_from(LENSES))
def test_nothing_that_rays_meet_moves_farther_than_is_stated(seed: int, which: Lens | None) -> None:
    """Plates here and there before a camera that goes and turns, against all pixels' rays."""
    rng = np.random.default_rng(seed)
    plates = [(rng.uniform(0.5, 9.0), *_interval(rng), *_interval(rng)) for _ in range(6)]
    focal = 40.0 if which is None or which.planar else 20.0
    if which is not None and which.model == EQUIRECTANGULAR:
        focal = 64.0 / (2.0 * np.pi)
    go, turn = rng.normal(size=3), rng.normal()
    camera = shaken(
        replace(ahead(64, 32, focal), lens=which), Shutter(0.02),
        lambda t: (3.0 * t * go, 8.0 * t * turn),
    )  # fmt: skip
    of = of_plates([*plates, (-2.0, -1.0, 1.0, -1.0, 1.0)])
    blur = measure(camera, ExactCaster(of))
    stated = 0.0 if blur is None else blur.motion_px
    assert farthest(camera, of) <= stated * (1.0 + 1e-3) + 1e-3


def _interval(rng: np.random.Generator) -> tuple[float, float]:
    low = rng.uniform(-2.0, 2.0)
    return low, low + rng.uniform(0.01, 1.0)


@examples(20)
@given(seed=st.integers(0, 2**32))
def test_no_eye_on_an_aperture_sees_anything_wider_blurred_than_is_stated(seed: int) -> None:
    """Things beyond the picture's border, too, whose blur reaches into it."""
    rng = np.random.default_rng(seed)
    plates = [(rng.uniform(0.3, 9.0), *_interval(rng), *_interval(rng)) for _ in range(4)]
    of = of_plates([*plates, FAR_WALL])
    focus = Focus(rng.uniform(0.5, 20.0), 0.05)
    camera = ahead(64, 48, 60.0)
    stated = measured(replace(camera, focus=focus), of).disk_px
    caster = ExactCaster(of)
    for angle in rng.uniform(0.0, 2.0 * np.pi, 12):
        eye = moved_eye(camera, focus, 0.05 * np.cos(angle), 0.05 * np.sin(angle))
        depth: NDArray[np.float64] = caster.cast(camera_rays(eye))[2]
        widest = disk(0.05, 60.0, depth, focus.distance_m).max()  # type: ignore[arg-type]
        assert widest <= stated * (1.0 + 1e-9)


@pytest.mark.parametrize("hole_px", [3.0, 0.3], ids=["of pixels", "between rays"])
def test_a_view_through_a_hole_counts_or_its_share_is_stated(hole_px: float) -> None:
    """A wall in focus; what is behind the hole, infinitely far, has the widest disk there is."""
    d, f = 2.0, 80.0
    half = 0.5 * hole_px * d / f
    walls = [
        (d, -9.0, -half, -9.0, 9.0), (d, half, 9.0, -9.0, 9.0),
        (d, -half, half, -9.0, -half), (d, -half, half, half, 9.0),
    ]  # fmt: skip
    blur = measured(replace(ahead(64, 48, f), focus=Focus(d, 0.1)), of_plates(walls))
    beyond = 2.0 * 0.1 * f / d
    if hole_px > 1.0:
        assert (blur.disk_px, blur.gap_px) == pytest.approx((beyond, 0.0))
    else:
        assert (blur.disk_px, blur.gap_px) == pytest.approx((0.0, beyond), abs=1e-6)


def test_a_camera_within_a_thing_asks_for_all_sub_frames_there_may_be() -> None:
    camera = replace(ahead(64, 48, 80.0), focus=Focus(3.0, 0.05))
    across = np.array([[0.0, -1.0, -1.0], [0.0, 1.0, -1.0], [0.0, 0.0, 2.0]])
    of = scene(
        [mesh(across + np.array([1e-12, 0.0, 0.0]), np.array([[0, 1, 2]]))], [surface((1.0,) * 3)]
    )
    blur = measured(camera, of)
    assert blur.wanted > 10000
    assert np.isfinite(blur.spacing_px(64))


@pytest.mark.slow
@pytest.mark.parametrize("name", ["mitsuba", "pyrender"])
def test_renderers_draw_the_whole_streak_of_a_speck_that_shines(name: str) -> None:
    """12 pixels of motion, and 2.1 by 0.8 pixels of light spread over it."""
    f, z = 100.0, 2.0
    camera = shaken(
        ahead(144, 72, f), Shutter(0.02), lambda t: ([12.0 * z / f / 0.02 * t, 0.0, 0.0], 0.0)
    )
    left, right, top, bottom = (z / f * px for px in (0.1, 2.2, 0.1, 0.9))
    speck, wall = mesh(*plate(z, left, right, top, bottom)), mesh(*plate(*FAR_WALL))
    lit = replace(surface((0.0,) * 3), emission=(5.0,) * 3)
    of = scene([speck, replace(wall, layers=(1,))], [lit, surface((0.0,) * 3)])
    backend = open_backend(name)
    result = Session(of, backend).render(camera, 0, ("rgb",), 256, 1)
    rgb, record = result.arrays, result.record
    assert record.blur.motion_px == pytest.approx(12.0, rel=1e-6)
    along = rgb["rgb"][..., 0].sum(axis=0, dtype=float)
    columns = np.flatnonzero(along > 1e-6)
    assert along.sum() == pytest.approx(5.0 * 2.1 * 0.8, rel=0.15)
    assert columns.min() in (66, 67)
    assert columns.max() in (79, 80)
