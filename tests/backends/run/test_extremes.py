"""Cameras at their limits, and pictures in bands: what ``docs/extremes.md`` shows, held."""

from __future__ import annotations

import dataclasses
import json
import subprocess
import sys
from collections.abc import Callable
from dataclasses import asdict
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.typing import NDArray

from scenec.backends.annotation.annotate import annotate
from scenec.backends.camera import tiles
from scenec.backends.camera.rays import camera_rays
from scenec.backends.check.compare import check_exact
from scenec.backends.contract import Radiance
from scenec.backends.exact import ExactCaster
from scenec.backends.picture import compose
from scenec.backends.picture import tiles as drawn
from scenec.backends.picture.haze import Veil
from scenec.backends.run.render import render
from scenec.backends.run.session import Session
from scenec.backends.stage.read import read_stage
from scenec.backends.stage.scene import Camera, RenderScene
from scenec.compiler.cameras.paths.motion import frames
from scenec.compiler.compile import compile_cfg
from scenec.compiler.geometry.poses import bearing_vector
from scenec.compiler.geometry.se3 import METHODS, interpolate
from scenec.schemas import picture
from scenec.schemas.errors import BackendError
from scenec.schemas.frames import read_frame
from scenec.testing.examples import examples
from scenec.testing.extreme_scenes import (
    CASES,
    GROUND,
    extreme_cfg,
    many_poses_cfg,
    near_and_far_stage,
    true_plane,
)
from scenec.testing.lens_scenes import CAMERAS, around
from scenec.testing.scenes import camera as pinhole
from scenec.testing.scenes import scene
from scenec.testing.small import small_cfg, write_cfg

PASSES = ("depth", "range", "label.class", "instance", "normal", "position", "face")
VIEWS = {"pinhole": pinhole(61, 47, 70.0, (0.3, -0.2, 1.4), (4.0, 2.0, 0.4)), **CAMERAS}


@pytest.fixture(scope="module")
def stones() -> tuple[RenderScene, ExactCaster]:
    """Stones of all sizes, most below a pixel, around the cameras of ``VIEWS``."""
    made = scene(*around())
    return made, ExactCaster(made)


@pytest.fixture(scope="module")
def extremes(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """All cases compiled; few stones, for time."""
    folder = tmp_path_factory.mktemp("extremes")
    return compile_cfg(extreme_cfg(folder, stones=200), seed=1, out=folder / "out").out


def test_every_camera_shows_the_plane_where_the_closed_form_has_it(extremes: Path) -> None:
    session = Session.open(extremes / "batch_0000" / "stage.usda", "reference")
    seen = 0
    for case, camera in _cases(session.scene):
        name = "depth" if camera.lens is None else "range"
        found = session.render(camera, 0, ("label.class", name), 1, 0).arrays
        hit, exact = true_plane(camera)
        ground = found["label.class"] == GROUND
        # Stones may stand before the plane, or beyond its border.
        assert not (ground & ~hit).any(), case
        assert np.isfinite(found[name][hit]).all(), case
        np.testing.assert_allclose(
            found[name][ground], exact[ground].astype(float), rtol=3e-14, err_msg=case
        )
        seen += int(ground.sum())
    assert seen > 25_000


def test_a_terrain_of_512_m_fills_24_x_24_pixels_from_100_km(extremes: Path) -> None:
    session = Session.open(extremes / "batch_0000" / "stage.usda", "reference")
    camera = dict(_cases(session.scene))["far"]
    # A pixel is 2 tan(0.3 degrees) 100 km / 48 = 21.817 m wide: 256 m are 11.73 pixels.
    found = session.render(camera, 0, ("depth",), 1, 0).arrays
    hit = np.isfinite(found["depth"])
    assert np.flatnonzero(hit.any(axis=0)).tolist() == list(range(12, 36))
    assert np.flatnonzero(hit.any(axis=1)).tolist() == list(range(6, 30))
    assert hit.sum() == 24 * 24


def test_mitsuba_resolves_to_the_definition_and_covers_what_it_should(extremes: Path) -> None:
    stage = extremes / "batch_0000" / "stage.usda"
    session, truth = Session.open(stage, "mitsuba"), Session.open(stage, "reference")
    for case, camera in _cases(session.scene):
        if case in ("column", "narrow", "flat", "aside"):
            continue
        passes = ("label.class", "instance", "depth", "range", "face")
        result = session.render(camera, 0, ("rgb", *passes), 2, 0)
        found, record = result.arrays, result.record
        exact = truth.render(camera, 0, passes, 1, 0).arrays
        for name in passes:
            np.testing.assert_array_equal(found[name], exact[name], err_msg=f"{case} {name}")
        assert np.isfinite(found["rgb"]).all(), case
        assert (found["rgb"][np.isfinite(exact["range"])] >= 0.0).all(), case
        assert record.samples_dropped == 0, case
        radiance = session.backend.radiance(camera, 0, 2, 0)
        inside = _shrunk(np.isfinite(exact["range"]))
        # Seldom a ray in float32 slips between two triangles: a sample of 200,000.
        assert (radiance.coverage[inside] < 1.0).sum() <= 1, case
        assert (radiance.coverage[_shrunk(~np.isfinite(exact["range"]))] == 0.0).all(), case


def test_near_and_far_in_a_ratio_of_1e9_keep_their_digits(tmp_path: Path) -> None:
    stage = near_and_far_stage(tmp_path)
    for backend in ("reference", "mitsuba"):
        session = Session.open(stage, backend)
        camera = session.scene.cameras[0][0]
        found = session.render(camera, 0, ("depth",), 1, 0).arrays
        # Vertices are float32: 0.01 is off by 2e-8 of it.
        near = np.arange(camera.width) < camera.width // 2
        expected = np.where(near, float(np.float32(0.01)), 1e7)
        np.testing.assert_allclose(
            found["depth"], np.broadcast_to(expected, found["depth"].shape), rtol=1e-14
        )


@examples(30)
@given(st.data())
def test_rays_of_some_rows_are_those_of_the_whole_picture(data: st.DataObject) -> None:
    camera = VIEWS[data.draw(st.sampled_from(sorted(VIEWS)))]
    k = camera.intrinsics.copy()
    k[:2, 2] += data.draw(st.floats(-1e4, 1e4)), data.draw(st.floats(-1e4, 1e4))
    camera = dataclasses.replace(camera, intrinsics=k)
    first = data.draw(st.integers(0, camera.height - 1))
    rows = range(first, data.draw(st.integers(first + 1, camera.height)))
    whole, some = camera_rays(camera), camera_rays(camera, rows)
    part = slice(rows.start * camera.width, rows.stop * camera.width)
    assert some.shape == (len(rows), camera.width)
    for name in ("origins", "directions", "depth", "known"):
        all_of_them = getattr(whole, name)
        own = getattr(some, name)
        if name == "known" and (all_of_them is None or own is None):
            assert all_of_them is None or all_of_them[part].all()
        elif all_of_them is not None:
            np.testing.assert_array_equal(own, all_of_them[part])


@examples(20)
@given(
    columns=st.tuples(st.integers(0, 60), st.integers(1, 61)).filter(lambda c: c[0] < c[1]),
    rows=st.tuples(st.integers(0, 46), st.integers(1, 47)).filter(lambda r: r[0] < r[1]),
)
def test_a_crop_looks_along_the_rays_of_its_part(
    columns: tuple[int, int], rows: tuple[int, int]
) -> None:
    camera = VIEWS["pinhole"]
    part = tiles.crop(camera, range(*rows), range(*columns))
    whole = camera_rays(camera).directions.reshape(camera.height, camera.width, 3)
    np.testing.assert_allclose(
        camera_rays(part).directions.reshape(part.height, part.width, 3),
        whole[rows[0] : rows[1], columns[0] : columns[1]],
        rtol=0,
        atol=1e-14,
    )


@pytest.mark.parametrize(("name", "rows"), [("pinhole", 1), *((name, 17) for name in VIEWS)])
def test_annotation_in_bands_is_that_of_the_whole_picture_to_the_bit(
    stones: tuple[RenderScene, ExactCaster], name: str, rows: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    world, caster = stones
    camera = VIEWS[name]
    exact = caster.hits(camera_rays(camera))
    expected = annotate(world, caster, camera, PASSES, 0).arrays
    monkeypatch.setattr(tiles, "PIXELS", rows * camera.width)
    found = annotate(world, caster, camera, PASSES, 0)
    for key, values in expected.items():
        np.testing.assert_array_equal(found.arrays[key], values, err_msg=key)
    for key in ("row", "face", "t"):
        np.testing.assert_array_equal(getattr(found.hits, key), getattr(exact, key))


@pytest.mark.parametrize("hazy", [False, True])
def test_a_picture_composed_in_bands_is_the_same(
    monkeypatch: pytest.MonkeyPatch, hazy: bool
) -> None:
    rng = np.random.default_rng(3)
    camera = pinhole(23, 19)
    made = scene([], [], cameras=[camera])
    coverage = np.clip(rng.normal(0.6, 0.6, (19, 23)), 0, 1).astype(np.float32)
    light = rng.exponential(size=(2, 19, 23, 3)).astype(np.float32) * coverage[..., None]
    radiance = Radiance(light, coverage, 8)
    veil = Veil(*rng.uniform(size=(4, 19, 23, 3)), 0) if hazy else None
    whole = compose.compose(radiance, made, camera, 0, veil)
    monkeypatch.setattr(tiles, "PIXELS", 4 * 23)
    parts = compose.compose(radiance, made, camera, 0, veil)
    np.testing.assert_array_equal(parts.rgb, whole.rgb)
    for key, value in asdict(whole.noise).items():
        assert getattr(parts.noise, key) == pytest.approx(value, rel=1e-12), key


def test_noise_of_a_black_picture_and_of_nothing_is_nothing_in_bands(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(tiles, "PIXELS", 10)
    camera = pinhole(5, 6)
    made = scene([], [], cameras=[camera])
    for coverage in (0.0, 1.0):
        dark = Radiance(np.zeros((2, 6, 5, 3), np.float32), np.full((6, 5), coverage, "f4"), 2)
        assert compose.compose(dark, made, camera, 0).noise.relative_rms == 0.0


def test_radiance_in_tiles_is_as_bright_and_none_has_the_noise_of_another(
    extremes: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    session = Session.open(extremes / "batch_0000" / "stage.usda", "mitsuba")
    camera = dict(_cases(session.scene))["down"]
    session.backend.load(session.scene)
    whole = drawn.drawer(session.backend, camera, 0)(16, 5)
    monkeypatch.setattr(tiles, "PIXELS", 12 * 18)
    monkeypatch.setattr(tiles, "WIDEST", 12)
    tiled = drawn.drawer(session.backend, camera, 0)(16, 5)
    assert tiled.spp == whole.spp
    np.testing.assert_array_equal(tiled.coverage, whole.coverage)
    variance = (0.5 * (whole.halves[0] - whole.halves[1]).astype(float)) ** 2
    error = np.sqrt(2.0 * variance.mean() / variance[..., 0].size)
    assert abs(tiled.halves.mean() - whole.halves.mean(dtype=float)) < 6.0 * error
    noise = (tiled.halves[0] - tiled.halves[1]).astype(float)
    parts = [noise[y : y + 18, x : x + 12].ravel() for y in (0, 18) for x in (0, 12, 24, 36)]
    correlation = np.corrcoef(parts) - np.eye(len(parts))
    assert np.abs(correlation).max() < 6.0 / np.sqrt(12 * 18)


def test_a_picture_is_developed_part_by_part_alike(monkeypatch: pytest.MonkeyPatch) -> None:
    radiance = np.random.default_rng(0).exponential(0.3, (13, 17, 3)).astype(np.float32)
    radiance[3, 4], radiance[5, 6] = np.nan, np.inf
    whole = picture.develop(radiance, 0.5)
    monkeypatch.setattr(picture, "_AT_ONCE", 31)
    np.testing.assert_array_equal(picture.develop(radiance, 0.5), whole)


@pytest.mark.parametrize("method", METHODS)
@pytest.mark.parametrize("keys", [1, 2, 7])
def test_a_track_of_no_length_stays_where_it_is(method: str, keys: int) -> None:
    time = np.arange(float(keys))
    place = np.tile([1e6 / 3, -2.0 / 7, 1e-9], (keys, 1))
    turn = np.tile([0.1, -0.7, 0.5, 0.5], (keys, 1))
    at = np.linspace(0.0, max(keys - 1.0, 0.0), 50)
    position, quaternion = interpolate(time, place, turn, at, method)
    # A last bit: (1 - u) a + u a need not be a.
    np.testing.assert_allclose(position, np.tile(place[0], (50, 1)), rtol=3e-16, atol=0)
    alike = np.abs((quaternion * turn[0]).sum(axis=1)) / np.sqrt((quaternion**2).sum(axis=1))
    np.testing.assert_allclose(alike, np.sqrt((turn[0] ** 2).sum()), rtol=1e-15)


@given(bearing=st.floats(0, 360), off=st.floats(0, 1e-6), down=st.sampled_from([-1, 1]))
def test_straight_down_and_up_have_no_gimbal_lock(bearing: float, off: float, down: int) -> None:
    way = bearing_vector(bearing)[None, :2]
    steep, near = frames(way, 90.0 * down), frames(way, down * (90.0 - off))
    np.testing.assert_allclose(steep, near, atol=np.radians(off) + 1e-15)
    np.testing.assert_allclose(steep[0].T @ steep[0], np.eye(3), atol=1e-15)


@pytest.mark.slow
@pytest.mark.parametrize("backend", ["mitsuba", "cycles", "pyrender"])
def test_every_backend_draws_every_case_or_says_in_one_line_why_not(
    extremes: Path, backend: str
) -> None:
    for case in CASES:
        if backend in case.limits:
            with pytest.raises(BackendError, match=case.limits[backend]) as caught:
                render(extremes, backend, spp=1, cameras=[f"{case.name}_eye"])
            assert "\n" not in str(caught.value)
    limited = [f"{case.name}_eye" for case in CASES if backend in case.limits]
    others = [f"{case.name}_eye" for case in CASES if backend not in case.limits]
    passes = ("label", "instance", "depth", "range", "face")
    report = render(extremes, backend, spp=4, passes=("rgb", *passes), cameras=others)
    for stem in report.frames:
        assert np.isfinite(read_frame(stem).passes["rgb"]).all(), stem
    if limited:
        report = render(extremes, backend, passes=passes, cameras=limited)
    assert not report.failed
    assert check_exact(extremes).differing == 0


@pytest.mark.slow
@pytest.mark.parametrize("backend", ["cycles", "pyrender"])
def test_other_depth_buffers_than_float64_do_not_show_at_a_ratio_of_1e9(
    tmp_path: Path, backend: str
) -> None:
    stage = near_and_far_stage(tmp_path)
    frame = read_frame(render(stage, backend, passes=("depth",)).frames[0])
    depth = frame.passes["depth"]
    half = depth.shape[1] // 2
    assert (depth[:, :half] == np.float32(0.01)).all()
    assert (depth[:, half:] == np.float32(1e7)).all()


@pytest.mark.slow
def test_a_picture_wider_than_opengl_draws_is_drawn_in_columns(extremes: Path) -> None:
    # In a process of its own: GL contexts stay.
    script = (
        "import sys, numpy as np\n"
        "from scenec.backends.run.session import Session\n"
        "s = Session.open(sys.argv[1], 'pyrender', passes=['rgb'])\n"
        "names = [c.name for c in s.scene.cameras[0]]\n"
        "whole = s.witness(names.index('down_eye'), 0)\n"
        "type(s.backend._renderer).largest = 13\n"
        "parts = s.witness(names.index('down_eye'), 0)\n"
        "assert (whole.row >= 0).any()\n"
        "assert np.array_equal(whole.row, parts.row)\n"
        "assert np.array_equal(whole.face, parts.face)\n"
    )
    _run(script, str(extremes / "batch_0000" / "stage.usda"))


@examples(200)
@given(st.integers(1, 70_000), st.integers(1, 70_000))
def test_bands_are_all_of_a_picture_and_no_larger_than_renderers_draw(w: int, h: int) -> None:
    camera = Camera("rig_eye", "/eye", w, h, np.eye(3), np.eye(4))
    found = tiles.bands(camera)
    assert [row for rows in found for row in rows] == list(range(h))
    # With a row beside it on either side.
    assert max(len(rows) for rows in found) <= tiles.TALLEST
    assert max(len(rows) for rows in found) * w <= max(tiles.PIXELS, w)


@pytest.mark.slow
def test_each_pose_of_a_track_is_a_sample(tmp_path: Path) -> None:
    out = compile_cfg(many_poses_cfg(tmp_path, 100_000), seed=1, out=tmp_path / "out").out
    made = read_stage(out / "batch_0000" / "stage.usda")
    asked = np.loadtxt(tmp_path / "many.csv", delimiter=",")[:, 1:4]
    assert made.samples == 100_000
    poses = np.array([cameras[0].camera_to_world[:3, 3] for cameras in made.cameras])
    np.testing.assert_allclose(poses, asked, rtol=1e-15, atol=1e-12)


@pytest.mark.slow
def test_67_million_pixels_are_annotated_within_6_gib(tmp_path: Path) -> None:
    out = compile_cfg(write_cfg(tmp_path, small_cfg(samples=1)), seed=4, out=tmp_path / "out").out
    script = (
        "import dataclasses, json, sys\n"
        "from scenec.backends.run import memory\n"
        "from scenec.backends.run.session import Session\n"
        "s = Session.open(sys.argv[1], 'reference')\n"
        "c = s.scene.cameras[0][0]\n"
        "k = c.intrinsics * (8192 / c.width)\n"
        "k[1, 2], k[2, 2] = 4096.0, 1.0\n"
        "c = dataclasses.replace(c, width=8192, height=8192, intrinsics=k)\n"
        "p = s.passes(('label', 'instance', 'depth'), c)\n"
        "memory.reset_peak()\n"
        "a = s.render(c, 0, p, 1, 0).arrays\n"
        "print(json.dumps([memory.peak(), a['depth'].shape, a['depth'].size]))\n"
    )
    peak, shape, pixels = json.loads(_run(script, str(out / "batch_0000" / "stage.usda")))
    assert shape == [8192, 8192]
    assert pixels == 8192 * 8192
    assert peak <= 6 * 2**30


def _cases(made: RenderScene) -> list[tuple[str, Camera]]:
    return [(camera.name.removesuffix("_eye"), camera) for camera in made.cameras[0]]


def _shrunk(mask: NDArray[np.bool_]) -> NDArray[np.bool_]:
    """Pixels all of whose 3x3 window is in a mask."""
    h, w = mask.shape
    wide = np.pad(mask, 1, mode="edge")
    near: Callable[[int, int], NDArray[np.bool_]] = lambda y, x: wide[y : y + h, x : x + w]  # noqa: E731
    return np.logical_and.reduce([near(y, x) for y in range(3) for x in range(3)])


def _run(script: str, *arguments: str) -> str:
    done = subprocess.run(
        [sys.executable, "-c", script, *arguments], capture_output=True, text=True, check=False
    )
    assert done.returncode == 0, done.stderr[-2000:]
    return done.stdout
