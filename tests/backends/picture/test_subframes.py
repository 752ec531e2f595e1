"""Motion blur and rolling shutters: what the mean of sub-frames is, and how far it is from that."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.typing import NDArray

from scenec.backends.camera.shutter import poses_at
from scenec.backends.camera.tiles import crop
from scenec.backends.exact import ExactCaster
from scenec.backends.picture import blur as measuring
from scenec.backends.picture import subframes
from scenec.backends.picture.adaptive import Target
from scenec.backends.picture.blur import Blur, measure
from scenec.backends.picture.subframes import share_out, sub_frames
from scenec.backends.run.session import Session
from scenec.backends.stage.scene import Camera, Focus, Haze, OpenShutter
from scenec.backends.testing.scenes import dome, mesh, scene, surface
from scenec.schemas.errors import BackendError
from scenec.schemas.lens import Lens
from scenec.schemas.shutter import Shutter
from scenec.testing.blur_scenes import Flat, ahead, of_plates, picture, plate, session, shaken
from scenec.testing.examples import examples

#: The left half of the view: its edge is at the picture's middle, 2 m away.
HALF = (2.0, -9.0, 0.0, -9.0, 9.0)
FOCAL = 40.0


def panning(shutter: Shutter, speed: float, camera: Camera | None = None) -> Camera:
    """Moves to the right, so that what is 2 m away moves left by so many pixels a second."""
    camera = ahead(32, 24, FOCAL) if camera is None else camera
    return shaken(camera, shutter, lambda t: ([speed * 2.0 / FOCAL * t, 0.0, 0.0], 0.0))


def edges(values: NDArray[np.floating], low: float = 0.0) -> NDArray[np.float64]:
    """Where each row's edge is: bright on the left of it."""
    return np.asarray(low + values.astype(float).sum(axis=1))


@given(
    exposure=st.floats(1e-6, 10.0),
    readout=st.floats(0.0, 10.0),
    upward=st.booleans(),
    height=st.integers(1, 70),
    count=st.integers(1, 9),
    seed=st.integers(0, 2**32 - 1),
)
@examples(80)
def test_every_row_has_equally_many_sub_frames_within_its_own_exposure(
    exposure: float, readout: float, upward: bool, height: int, count: int, seed: int
) -> None:
    shutter = Shutter(max(exposure, readout / height), readout, upward)
    camera = ahead(4, height)
    # The way is along x, at one meter a second: eyes tell times.
    times = np.array([-1.0, 1.0]) * (shutter.half_span + 1.0)
    poses = np.stack([camera.camera_to_world] * 2)
    poses[:, 0, 3] = times
    opened = replace(camera, shutter=OpenShutter(shutter, times, poses))
    blur = Blur(opened, shutter, None, 1.0, 0.0, 0.0)
    found: list[list[float]] = [[] for _ in range(height)]
    for one in sub_frames(blur, count, seed, 0):
        assert one.camera.shutter is None
        assert one.camera.intrinsics[1, 2] == height / 2 - one.first
        for row in range(one.first, one.first + one.camera.height):
            found[row].append(float(one.camera.camera_to_world[0, 3]))
    middles = shutter.middles(np.arange(height) + 0.5, height)
    slack = 1e-9 * (shutter.exposure_s + readout)
    for row, seen in enumerate(found):
        assert len(seen) == count
        assert min(seen) >= middles[row] - 0.5 * shutter.exposure_s - slack
        assert max(seen) <= middles[row] + 0.5 * shutter.exposure_s + slack
        if readout == 0.0:
            # Anywhere in each part, and as early as late.
            part = (np.sort(seen) / exposure + 0.5) * count - np.arange(count)
            assert (part >= -1e-6).all()
            assert (part <= 1.0 + 1e-6).all()
            if count % 2 == 0:
                assert np.mean(seen) == pytest.approx(0.0, abs=1e-9 * exposure)
            continue
        step = shutter.exposure_s / count
        assert np.diff(sorted(seen)) == pytest.approx(step, rel=1e-6, abs=slack)


def test_a_moving_edge_is_a_ramp_of_the_way_that_it_moves() -> None:
    """An edge that moves evenly over D pixels: what a pixel shows is a box of D over a box of 1."""
    shutter = Shutter(0.02)
    camera = panning(shutter, 500.0)
    made = session(of_plates([HALF]))
    shown = picture(made, camera, 40, range(4)).mean(axis=0)
    # The share of the time in which points are left of the edge, averaged over pixels.
    at = np.arange(33) - 16.0
    share = np.clip(at + 5.0, 0.0, 10.0)
    area = np.cumsum(np.concatenate([[0.0], 1.0 - 0.05 * (share[1:] + share[:-1])]))
    # Kinks of the ramp lie at whole pixels, so trapezoids are exact.
    assert shown == pytest.approx(np.diff(area), abs=0.03)
    facts = made.render(camera, 0, ("rgb",), 40, 1).record.blur
    assert facts.motion_px == pytest.approx(10.0, rel=1e-6)
    assert facts.sub_frames_per_row == 20
    assert facts.spacing_px == pytest.approx(1.0, rel=1e-6)


@pytest.mark.parametrize("upward", [pytest.param(False, marks=pytest.mark.slow), True])
def test_a_rolling_shutter_slants_an_edge_by_its_way_during_the_readout(upward: bool) -> None:
    shutter = Shutter(0.004, 0.04, upward)
    camera = panning(shutter, 200.0)
    shown = picture(session(of_plates([HALF])), camera, 16, range(6))
    rows = np.arange(24) + 0.5
    # Where an edge is that moves left at 200 pixels a second, in the middle of each row's exposure.
    wanted = 16.0 - 200.0 * shutter.middles(rows, 24)
    assert edges(shown) == pytest.approx(wanted, abs=0.25)
    assert edges(shown).mean() == pytest.approx(wanted.mean(), abs=0.05)


def test_an_instant_of_each_row_is_widened_by_no_more_than_is_said() -> None:
    shutter = Shutter(0.0, 0.04)
    camera = panning(shutter, 200.0)
    made = session(of_plates([HALF]))
    result = made.render(camera, 0, ("rgb",), 32, 1)
    arrays, record = result.arrays, result.record
    facts = record.blur
    assert facts.exposure_s == 0.0
    assert facts.exposure_widened_px <= measuring.QUANTUM_PX + 1e-9
    wanted = 16.0 - 200.0 * shutter.middles(np.arange(24) + 0.5, 24)
    off = edges(arrays["rgb"][..., 0]) - wanted
    assert np.abs(off).max() <= 0.5 * facts.exposure_widened_px + 0.2
    assert abs(off.mean()) < 0.08


def test_rows_that_are_not_exposed_are_not_rendered() -> None:
    shutter = Shutter(0.002, 0.04)
    of = of_plates([HALF])
    backend = Flat()
    Session(of, backend).render(panning(shutter, 200.0), 0, ("rgb",), 16, 1)
    pixels = sum(camera.width * camera.height * spp for camera, spp in backend.drawn)
    assert pixels == 32 * 24 * 16
    assert max(camera.height for camera, _ in backend.drawn) <= 3


@pytest.mark.parametrize(
    "shutter", [Shutter(0.0, 0.0), Shutter(0.02, 0.04)], ids=["no time", "no motion"]
)
def test_without_time_or_motion_a_frame_is_the_plain_one_bit_for_bit(shutter: Shutter) -> None:
    made = session(of_plates([(2.0, -0.31, 0.22, -0.4, 0.3)]))
    camera = ahead(32, 24, FOCAL)
    speed = 300.0 if shutter.half_span == 0.0 else 0.0
    moved = panning(shutter, speed)
    plain = made.render(camera, 0, ("rgb",), 8, 3).arrays
    result = made.render(moved, 0, ("rgb",), 8, 3)
    arrays, record = result.arrays, result.record
    assert record.blur is None
    assert arrays["rgb"].tobytes() == plain["rgb"].tobytes()


@pytest.mark.parametrize(
    "kind",
    [
        pytest.param("rolling", marks=pytest.mark.slow),
        "aperture",
        pytest.param("both", marks=pytest.mark.slow),
    ],
)
def test_halves_tell_the_error_with_that_of_times_and_points(kind: str) -> None:
    """((A - B) / 2)^2 over many seeds is the variance of what they are the mean of."""
    camera = ahead(12, 6, 16.0)
    shutter = Shutter(0.01, 0.03) if kind == "rolling" else Shutter(0.02)
    if kind != "aperture":
        camera = panning(shutter, 250.0, camera)
    if kind in ("aperture", "both"):
        camera = replace(camera, focus=Focus(1.0, 0.25))
    meshes = [mesh(*plate(2.0, -0.4, 0.0, -9.0, 0.2)), mesh(*plate(6.0, -9.0, 1.0, -9.0, 9.0))]
    colors = [surface((1.0,) * 3), surface((0.4,) * 3)]
    meshes[1] = replace(meshes[1], layers=(1,))
    of = scene(meshes, colors, lights=[dome(0.3)])
    backend = Flat()
    backend.load(of)
    caster = ExactCaster(of)
    blur = measure(camera, caster)
    assert blur is not None
    drawing = subframes.Drawing(blur, backend, of, 0, caster)
    means, squares = [], []
    for seed in range(48):
        drawn = drawing.draw(8, seed)
        assert drawn.background is not None
        halves = (drawn.halves + drawn.background)[..., 0].astype(float)
        means.append(halves.mean(axis=0))
        squares.append((0.5 * (halves[0] - halves[1])) ** 2)
    # Of times and points beside that of pixels: so few copies are far apart.
    assert drawing.record.spacing_px > 0.4
    true = np.var(means, axis=0, ddof=1).mean()
    assert np.mean(squares) == pytest.approx(true, rel=0.3)


def test_samples_are_shared_out_to_as_many_sub_frames_as_blur_wants() -> None:
    blur = Blur(ahead(), None, Focus(1.0, 0.1), 0.0, 4.0, 0.0)
    assert blur.wanted == 13
    assert share_out(blur, 64, True) == subframes.Share(13, 4)
    assert share_out(blur, 16, True) == subframes.Share(4, 2)
    assert share_out(blur, 1, True) == subframes.Share(1, 2)
    assert share_out(blur, 64, False) == subframes.Share(13, 4)
    assert share_out(blur, 5, False) == subframes.Share(5, 1)
    assert blur.spacing_px(4) > 1.0 >= blur.spacing_px(13)


def test_rounds_to_a_target_add_up_with_what_is_behind() -> None:
    of = scene([mesh(*plate(*HALF))], [surface((1.0,) * 3)], lights=[dome(0.5)])
    camera = panning(Shutter(0.02), 300.0)
    made = session(of)
    result = made.render(camera, 0, ("rgb",), 0, 1, target=Target(0.02, None, 256))
    arrays, record = result.arrays, result.record
    rounds = record.rounds
    assert len(rounds.rounds) > 1
    assert rounds.stopped_by == "error"
    assert record.blur.sub_frames_per_row > 8
    # Right of the edge's way there is nothing but sky.
    assert arrays["rgb"][:, 22:] == pytest.approx(0.5, rel=1e-6)
    assert arrays["rgb"][:, :10] == pytest.approx(1.0, rel=1e-6)


def test_a_rasterizers_samples_are_spread_over_pixels_and_its_error_stays_unknown() -> None:
    camera = panning(Shutter(0.02), 150.0)
    made = session(of_plates([(2.0, -9.0, 0.013, -9.0, 9.0)]), stochastic=False)
    result = made.render(camera, 0, ("rgb",), 64, 1)
    arrays, record = result.arrays, result.record
    shown = arrays["rgb"][..., 0]
    assert record.estimated_error.relative_rms is None
    assert record.blur.sub_frames_per_row == 3
    assert record.blur.samples_per_sub_frame == 16
    # An odd count: its middle one is anywhere in the middle third.
    assert edges(shown).mean() == pytest.approx(16.0 + 0.013 * 20.0, abs=0.5 / 3.0 + 0.13)


def test_a_denoiser_of_single_pictures_is_refused() -> None:
    made = session(of_plates([HALF]))
    with pytest.raises(BackendError, match=r"rig_cam.*mean of many.*without denoising"):
        made.render(panning(Shutter(0.02), 300.0), 0, ("rgb",), 4, 1, denoise=True)


def test_a_bent_picture_moves_as_a_straight_one() -> None:
    """The mean over times, each of them a still of the same camera elsewhere."""
    bent = replace(ahead(16, 6, 14.0), lens=Lens("kannala_brandt", (-0.02, 0.004, -1e-3, 1e-4)))
    camera = panning(Shutter(0.02, 0.01), 60.0, bent)
    made = session(of_plates([(2.0, -0.5, 0.4, -0.3, 0.5)]))
    shown = picture(made, camera, 16, range(4))
    assert camera.shutter is not None
    # A row in the middle, by many stills of that row.
    middle = camera.shutter.shutter.middles(np.array([3.5]), 6)[0]
    times = middle + 0.02 * ((np.arange(8) + 0.5) / 8.0 - 0.5)
    still = np.zeros(16)
    for i, pose in enumerate(poses_at(camera.shutter, times)):
        at = crop(replace(bent, camera_to_world=pose), range(3, 4))
        still += picture(made, at, 16, [i])[0] / 8.0
    assert shown[3] == pytest.approx(still, abs=0.12)


@pytest.mark.parametrize("air", [None, 5.0])
def test_rows_outside_of_an_image_circle_are_black_whatever_moves(air: float | None) -> None:
    """Views of a few such rows hold no ray at all; nor is there haze before them."""
    lens = Lens("kannala_brandt", (0.0, 0.0, 0.0, 0.0), 0.5)
    camera = panning(Shutter(0.001, 0.02), 1500.0, replace(ahead(48, 48, 40.0), lens=lens))
    lit = scene([mesh(*plate(2.0, -9.0, 9.0, -9.0, 9.0))], [surface((0.5, 0.5, 0.5))])
    if air is not None:
        haze = Haze(np.full(3, 0.2), 1e9, np.full(3, air))
        lit = replace(lit, haze=(haze,))
    shown = picture(session(lit), camera, 16)
    assert shown[24, 24] > 0.1
    assert not shown[:2].any()
    assert not shown[:, :2].any()


def test_a_single_pixel_and_an_empty_view_are_pictures_too() -> None:
    camera = replace(panning(Shutter(0.0, 0.03), 300.0, ahead(1, 1, 2.0)), focus=Focus(1.0, 0.2))
    behind = scene([mesh(*plate(-2.0, -1.0, 1.0, -1.0, 1.0))], lights=[dome(0.5)])
    made = session(behind)
    result = made.render(camera, 0, ("rgb",), 4, 1)
    arrays, record = result.arrays, result.record
    assert arrays["rgb"] == pytest.approx(0.5)
    assert np.isfinite(record.blur.circle_of_confusion_px)
    black = picture(session(of_plates([(-2.0, -1.0, 1.0, -1.0, 1.0)])), camera, 1)
    assert black.tolist() == [[0.0]]
