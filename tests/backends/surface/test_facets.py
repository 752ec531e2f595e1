"""Facets that hide and shade each other, beside drawn slopes, traced heights and hemispheres."""

from __future__ import annotations

import dataclasses
import math
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray
from pxr import Sdf

from scenec.backends.mitsuba import Mitsuba
from scenec.backends.stage.read import read_stage
from scenec.backends.stage.scene import Maps, Surface
from scenec.backends.surface import facets
from scenec.backends.surface.algebra import FLOAT64
from scenec.backends.surface.maps import map_values
from scenec.backends.surface.points import SurfacePoints
from scenec.backends.testing import looks
from scenec.backends.testing.scenes import dome, mesh, plane, sun, with_lights
from scenec.compiler.compile import compile_cfg
from scenec.schemas.errors import StageError
from scenec.testing.small import small_cfg, write_cfg

#: Degrees above the horizon, and of azimuth between viewer and light.
LOW_TO_HIGH = (0.5, 3.0, 10.0, 30.0, 60.0, 89.0)
TURNS = (0.0, 45.0, 90.0, 135.0, 180.0)


def factor(s: float, view_deg: float, light_deg: float, turn_deg: float) -> float:
    view, light, turn = np.radians([view_deg, light_deg, turn_deg])
    cosines = np.sin(view), np.sin(light)
    phase = cosines[0] * cosines[1] + np.cos(view) * np.cos(light) * np.cos(turn)
    return float(facets.factor(FLOAT64, s, *cosines, phase))


def smith(s: float, elevation_deg: float) -> float:
    """Smith's Lambda."""
    steep = min(math.tan(math.radians(elevation_deg)) / s, 100.0)
    return float(facets._lambda(FLOAT64, steep))


def lit(s: float, view_deg: float, light_deg: float, turn_deg: float) -> float:
    """The part of what is seen that is not in shadow."""
    hides, shades = smith(s, view_deg), smith(s, light_deg)
    p = math.radians(turn_deg) * 4.41
    return (1.0 + hides) / (1.0 + max(hides, shades) + p / (p + 1.0) * min(hides, shades))


@pytest.mark.parametrize("s", [0.05, 0.2, 0.5])
@pytest.mark.parametrize("view", [3.0, 10.0, 30.0, 60.0])
def test_facets_that_are_seen_are_those_of_drawn_slopes(s: float, view: float):
    """E[(a + x)+ (b + y)+] / E[(a + x)+] / E[(b + y)+] of two million pairs of slopes."""
    rng = np.random.Generator(np.random.Philox(5))
    x, other = rng.standard_normal((2, 2_000_000))
    for light in (5.0, 20.0, 50.0):
        for turn in TURNS:
            c = math.cos(math.radians(turn))
            y = c * x + math.sqrt(1.0 - c * c) * other
            a, b = (math.tan(math.radians(e)) / s for e in (view, light))
            seen, reflected = np.maximum(a + x, 0.0), np.maximum(b + y, 0.0)
            expected = (seen * reflected).mean() / seen.mean() / reflected.mean()
            found = factor(s, view, light, turn) / lit(s, view, light, turn)
            # Exact along the light and across it; a quadratic between these.
            allowed = 0.005 if turn in (0.0, 90.0, 180.0) else 0.05
            assert found == pytest.approx(expected, abs=allowed), (light, turn)


def heights(size: int, waves: int, slope: float) -> NDArray[np.float64]:
    """A Gaussian surface that repeats, [size, size], in texels; ``slope`` is s."""
    rng = np.random.Generator(np.random.Philox(8))
    u = np.fft.fftfreq(size)[:, None] * size
    v = np.fft.fftfreq(size)[None, :] * size
    band = np.exp(-(u * u + v * v) / (2.0 * waves * waves))
    made = np.fft.ifft2(np.fft.fft2(rng.standard_normal((size, size))) * band).real
    across = 0.5 * (np.roll(made, -1, 1) - np.roll(made, 1, 1))
    return np.asarray(made * (slope / across.std()))


def clear(h: NDArray[np.float64], azimuth: float, elevation: float) -> NDArray[np.bool_]:
    """Whether nothing stands between places and what lies in a direction: rays in steps."""
    size, rise = len(h), math.tan(elevation)
    step = np.array([math.sin(azimuth), math.cos(azimuth)])
    free = np.ones(h.shape, bool)
    row, column = np.indices(h.shape)
    for n in range(1, int((h.max() - h.min()) / rise) + 2):
        at = row + n * step[0], column + n * step[1]
        j, i = (np.floor(x).astype(int) for x in at)
        v, u = at[0] - j, at[1] - i
        j, i, j1, i1 = j % size, i % size, (j + 1) % size, (i + 1) % size
        there = (1 - v) * ((1 - u) * h[j, i] + u * h[j, i1]) + v * (
            (1 - u) * h[j1, i] + u * h[j1, i1]
        )
        free &= there <= h + n * rise + 1e-9
    return free


@pytest.mark.parametrize("view", [8.0, 25.0, 60.0])
@pytest.mark.parametrize("turn", [0.0, 60.0, 120.0, 180.0])
def test_traced_heights_are_as_bright(view: float, turn: float):
    """What is seen of a Gaussian surface under a sun, ray by ray, is within a tenth.

    Slopes' deviation is 0.2. Drawn one by one facets are off by a third and more.
    """
    h = heights(256, 24, 0.2)
    slopes = [0.5 * (np.roll(h, -1, axis) - np.roll(h, 1, axis)) for axis in (1, 0)]
    normals = np.stack([-slopes[0], -slopes[1], np.ones_like(h)])
    normals /= np.sqrt((normals * normals).sum(axis=0))
    alone, seen = [], []
    for height in (15.0, 40.0):
        elevations = np.radians([view, height])
        azimuths = 0.4, 0.4 + math.radians(turn)
        ways = [
            np.array([math.cos(e) * math.cos(a), math.cos(e) * math.sin(a), math.sin(e)])
            for e, a in zip(elevations, azimuths, strict=True)
        ]
        toward, reflected = (np.maximum(np.tensordot(w, normals, 1), 0.0) for w in ways)
        shown, bright = (clear(h, a, e) for a, e in zip(azimuths, elevations, strict=True))
        area = shown * toward / normals[2]
        truth = (area * bright * reflected).sum() / area.sum()
        alone.append(reflected.mean() / truth)
        seen.append(alone[-1] * factor(0.2, view, height, turn))
    assert seen == pytest.approx([1.0, 1.0], abs=0.12)
    if view < 10.0 and turn in (0.0, 180.0):
        assert abs(math.log(alone[0])) > 0.3


def test_light_and_viewer_can_change_places():
    """With 1 + Lambda(l), which is what facets drawn one by one get beside level ground."""
    for s in (0.01, 0.2, 1.0, 5.0):
        for view in LOW_TO_HIGH:
            for light in LOW_TO_HIGH:
                for turn in TURNS:
                    there, back = (
                        factor(s, first, second, turn) * (1.0 + smith(s, second))
                        for first, second in ((view, light), (light, view))
                    )
                    assert back == pytest.approx(there, rel=1e-9)


def test_all_are_finite_and_positive_from_level_ground_to_spikes():
    """The whole range, in double and single precision, which agree to four digits."""
    for s in (0.0, 1e-12, 1e-4, 0.03, 0.3, 1.0, 30.0, 1e6):
        for view in (0.0, 1e-6, *LOW_TO_HIGH, 90.0):
            for light in (0.0, 1e-6, *LOW_TO_HIGH, 90.0):
                for turn in TURNS:
                    found = factor(s, view, light, turn)
                    assert 0.0 <= found < 30.0, (s, view, light, turn)
                    with np.errstate(under="ignore"):
                        view32, light32, turn32 = np.radians(np.float32([view, light, turn]))
                        cosines = np.sin(view32), np.sin(light32)
                        phase = cosines[0] * cosines[1] + np.cos(view32) * np.cos(light32) * np.cos(
                            turn32
                        )
                        single = facets.factor(FLOAT64, np.float32(s), *cosines, phase)
                    # Straight up, single precision loses the azimuth, which is of no meaning.
                    if max(view, light) < 89.9:
                        assert single == pytest.approx(found, rel=3e-3, abs=3e-4)


def test_level_ground_is_as_it_was():
    for view in LOW_TO_HIGH:
        for turn in TURNS:
            assert factor(0.0, view, 20.0, turn) == pytest.approx(1.0, abs=3e-4)
            assert factor(1e-3, view, 20.0, turn) == pytest.approx(1.0, abs=2e-3)


@pytest.mark.parametrize("s", [0.1, 0.25, 0.5, 1.0])
def test_an_even_sky_is_the_mean_of_all_lights(s: float):
    """Beside a hundred thousand drawn directions; the polynomial beside the mean."""
    rng = np.random.Generator(np.random.Philox(3))
    cos_l, turn = np.sqrt(rng.uniform(size=100_000)), rng.uniform(0.0, np.pi, 100_000)
    cosines = np.array([0.02, 0.2, 0.5, 0.9])
    found = facets.under_even_sky(np.array([s]), cosines)[0]
    for cos_v, mean in zip(cosines, found, strict=True):
        sines = np.sqrt((1.0 - cos_l * cos_l) * (1.0 - cos_v * cos_v))
        phase = cos_v * cos_l + sines * np.cos(turn)
        drawn = facets.factor(FLOAT64, s, np.full_like(cos_l, cos_v), cos_l, phase).mean()
        assert mean == pytest.approx(drawn, abs=0.006)
        assert facets.even_sky(FLOAT64, s, cos_v) == pytest.approx(mean, abs=0.015)


def test_deviations_are_of_maps_that_say_so():
    dull = Surface("", (0.5, 0.5, 0.5), 0.0, 1.0, 0.0)
    assert facets.deviation(dull) == 0.0
    assert facets.deviation(dataclasses.replace(dull, maps=Maps(1.0))) == 0.0
    relief = dataclasses.replace(dull, maps=Maps(1.0, lean=0.25))
    # Slopes of a deviation of 0.2 along every line have this mean.
    rng = np.random.Generator(np.random.Philox(2))
    x, y = 0.2 * rng.standard_normal((2, 100_000))
    assert np.sqrt(x * x + y * y).mean() == pytest.approx(0.25, rel=0.01)
    assert facets.deviation(relief) == pytest.approx(0.2, rel=0.01)


def test_exposure_meters_what_facets_reflect():
    at, up = np.zeros((1, 3)), np.array([[0.0, 0.0, 1.0]])
    view, light = np.radians([10.0, 20.0])
    toward = np.array([[math.cos(view), 0.0, math.sin(view)]])
    sun = np.array([[-math.cos(light), 0.0, math.sin(light)]])
    rough = Surface("", (0.4,) * 3, 0.0, 1.0, 0.0, maps=Maps(1.0, lean=0.25))
    every = np.zeros(1, np.int64)
    points = SurfacePoints(at, up, toward, np.zeros((1, 1)), *(np.zeros((1, 3)) for _ in range(3)))
    points.laws.append((rough, every, np.ones((1, 1)), np.full((1, 3), 0.4)))
    expected = 0.4 / np.pi * math.sin(light) * factor(facets.deviation(rough), 10.0, 20.0, 180.0)
    np.testing.assert_allclose(points.shown(sun), np.full((1, 3), expected), rtol=1e-9)


def test_a_stage_says_how_far_normals_lean(tmp_path: Path):
    cfg = small_cfg()
    cfg["materials"]["gravel"]["maps"] = {"procedural": {"type": "gravel", "resolution": 64}}
    out = compile_cfg(write_cfg(tmp_path, cfg), seed=3, out=tmp_path / "out").out
    stage = out / "batch_0000" / "stage.usda"
    found = {s.path.rsplit("/", 1)[1]: s for s in read_stage(stage).surfaces}
    maps = found["gravel"].maps
    assert maps is not None
    normals = map_values(maps, "normal")
    assert maps.lean == pytest.approx(np.sqrt(1.0 - normals[..., 2] ** 2).mean(), abs=2e-3)
    assert maps.lean > 0.02
    assert all(facets.deviation(own) == 0.0 for name, own in found.items() if name != "gravel")
    layer = Sdf.Layer.FindOrOpen(str(stage.parent / "looks" / "gravel.usda"))
    layer.GetPrimAtPath("/World/Looks/gravel").properties["scenec:surface:maps:lean"].default = 1.5
    layer.Save()
    with pytest.raises(StageError, match=r"maps:lean is 1.5, expected a number in \[0, 1\]"):
        read_stage(stage, allow_missing=True)


def test_no_sample_is_lost_on_glossy_facets_that_lean_away(tmp_path: Path):
    """From three degrees above the ground most do, and gloss has no direction to be drawn in."""
    looks.write_pictures(tmp_path)
    maps = Maps(0.5, normal=looks.write_picture(tmp_path, "normal"), lean=0.35)
    metal = Surface("", (0.5, 0.5, 0.5), 0.5, 0.3, 0.0, 0.3, maps)
    board = looks.Look(mesh(*plane(20.0)), [metal], (0.0, 10.0, 0.6), fov_deg=20.0, size=(48, 24))
    made = with_lights(looks.boards({"low": board}), [dome(1.0), sun(5.0, 80.0)])
    backend = Mitsuba()
    backend.load(made)
    drawn = backend.radiance(made.cameras[0][0], 0, 32, 0)
    assert drawn.dropped == 0
    assert np.isfinite(drawn.halves).all()
    assert drawn.halves.mean() > 0.0
