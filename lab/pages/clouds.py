"""Makes what docs/light.md shows: skies with clouds, their error against volumes, their cost.

    python lab/pages/clouds.py [--fast] [-o FOLDER]

Seconds are CPU seconds on the machine that runs it; errors are facts of the code.
"""

from __future__ import annotations

import json
import time
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from PIL import Image

from scenec.backends.picture.exposure import expose
from scenec.backends.picture.metering import Metering
from scenec.backends.picture.sky import Sky, lookup
from scenec.backends.registry import open_backend
from scenec.backends.stage.read import read_stage
from scenec.compiler.light import atmosphere
from scenec.compiler.light.atmosphere_planets import MEDIA
from scenec.compiler.light.atmosphere_spectra import weights
from scenec.compiler.light.cloud_fields import (
    Cirrus,
    CirrusClouds,
    CirrusField,
    Cumulus,
    CumulusClouds,
    CumulusField,
    density_at,
    no_cirrus,
    no_cumulus,
    rise_at,
)
from scenec.compiler.light.cloud_rays import Shine, through_cumulus
from scenec.compiler.light.clouds import draw_clouds
from scenec.compiler.light.latlong import luminance, resampled
from scenec.compiler.light.overcast import overcast_sky
from scenec.lab.pictures import frames, photograph, save, sheet
from scenec.lab.runner import Page, held, in_turns, run
from scenec.schemas.kernels import kernel
from scenec.schemas.picture import develop

GROUND = np.array([0.2, 0.2, 0.15])
#: Above the air, W/m^2.
SUN = 1361.0
#: A view: pixels, and how wide it is.
SIZE, FOV_DEG = (460, 300), 75.0
#: The dome's frame to the world: +Y is up in the one, +Z in the other; north is the other's -Z.
TO_WORLD = np.array([[1.0, 0.0, 0.0], [0.0, 0.0, -1.0], [0.0, 1.0, 0.0]])
#: Of the volume that Mitsuba renders: half its width and a cell, meters; the view's pixels.
HALF_M, CELL_M, PIXELS = 9000.0, 25.0, (32, 20)
BACKENDS = ("mitsuba", "cycles", "pyrender")
HEADER = ("rows", "cumulus, s", "cirrus, s", "difference, rms", "pixels off by more than 16")
#: Hills of heath and sand, 2.4 km wide, seen from 40 m above.
HEATH: dict[str, Any] = json.loads(
    Path(__file__).with_name("heath.json").read_text(encoding="utf-8")
)


def cumulus(coverage: float = 0.35, key: int = 11, **more: float) -> Cumulus:
    """A layer with the cfg's defaults."""
    drawn = {
        "coverage": coverage, "optical_depth": 40.0, "base_m": 1200.0, "thickness_m": 900.0,
    } | more  # fmt: skip
    size = drawn.pop("size_m", 1800.0)
    arrays = {name: np.array([value]) for name, value in drawn.items()}
    return CumulusField(
        CumulusClouds(key=key, size_m=size, offset_m=np.zeros((1, 2)), **arrays)
    ).at(0)


def cirrus(**more: float) -> Cirrus:
    """A sheet with the cfg's defaults."""
    drawn = {
        "coverage": 0.5, "optical_depth": 0.5, "height_m": 9000.0, "bearing_deg": 60.0,
    } | more  # fmt: skip
    arrays = {name: np.array([value]) for name, value in drawn.items()}
    return CirrusField(CirrusClouds(key=9, size_m=4000.0, offset_m=np.zeros((1, 2)), **arrays)).at(
        0
    )


def clear(elevation: float) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Earth's clear sky, the sun in the south, and the sun's irradiance below it."""
    medium, of_nodes = MEDIA["earth"](17, 1.0, 1.0, 1.0), weights(17)
    at = np.radians(elevation)
    picture = atmosphere.bake(medium, of_nodes, 0.0, at, GROUND, 128, multiple=True)
    return SUN * picture, SUN * atmosphere.direct(medium, of_nodes, 0.0, at, np.radians(0.53))


def sky_with(elevation: float, heaps: Cumulus, streaks: Cirrus, rows: int) -> NDArray[np.float64]:
    """A picture of clouds below such a sky."""
    picture, beam = clear(elevation)
    picture = resampled(picture, rows)
    at = np.radians(elevation)
    to_sun = np.array([0.0, -np.cos(at), np.sin(at)])
    draw_clouds(picture, 0.0, to_sun, beam, GROUND, heaps, streaks)
    return picture


def ways(bearing: float, elevation: float, size: tuple[int, int], fov: float) -> NDArray:
    """Directions of a view's pixels, float64 [h, w, 3]."""
    width, height = size
    scale = np.tan(np.radians(fov) / 2.0) / (0.5 * width)
    x = (np.arange(width) + 0.5 - 0.5 * width) * scale
    y = (0.5 * height - np.arange(height) - 0.5) * scale
    right, up = np.meshgrid(x, y)
    b, e = np.radians([bearing, elevation])
    level, high = np.cos(e) - up * np.sin(e), np.sin(e) + up * np.cos(e)
    east, north = right * np.cos(b) + level * np.sin(b), level * np.cos(b) - right * np.sin(b)
    out = np.stack([east, north, high], axis=-1)
    return np.asarray(out / np.sqrt((out * out).sum(axis=-1, keepdims=True)))


def pictures(page: Page) -> None:
    """Six skies through a camera."""
    rows = 128 if page.fast else 768
    gray = overcast_sky(rows, np.array([0.95, 1.0, 1.07]), GROUND).astype(np.float64)
    none, bare = no_cumulus(), no_cirrus()
    views = {
        "coverage 0.2, sun at 50°, behind": (50, cumulus(0.2), cirrus(), 0, 20),
        "coverage 0.5, sun at 50°, before": (50, cumulus(0.5), bare, 180, 28),
        "coverage 0.8, sun at 40°, aside": (40, cumulus(0.8), bare, 90, 20),
        "cirrus, coverage 0.7, sun at 35°": (35, none, cirrus(coverage=0.7), 100, 35),
        "both, sun at 6°, aside": (6, cumulus(0.35, key=12), cirrus(), 110, 18),
        "overcast": (0, none, bare, 0, 20),
    }
    tiles = []
    for name, (sun, heaps, streaks, bearing, up) in views.items():
        picture = gray if name == "overcast" else sky_with(sun, heaps, streaks, rows)
        sky = Sky(np.ascontiguousarray(picture, np.float32), TO_WORLD)
        to = ways(bearing, up, SIZE, FOV_DEG)
        seen = lookup(sky, np.ascontiguousarray(to.reshape(-1, 3))).reshape(to.shape)
        level = luminance(seen).astype(np.float64).ravel()
        shown = develop(seen, expose(Metering(np.zeros(0), level), 1).ev + 1.0)
        tiles.append((name, Image.fromarray(shown)))
    save(sheet([tiles[k : k + 2] for k in (0, 2, 4)], SIZE[0]), page.picture("clouds"))


@kernel
def _fill_grid(layer, cell, half, out):  # type: ignore[no-untyped-def]
    for k in range(out.shape[0]):
        for j in range(out.shape[1]):
            for i in range(out.shape[2]):
                east, north = (i + 0.5) * cell - half, (j + 0.5) * cell - half
                rise = rise_at(layer, east, north)
                out[k, j, i] = density_at(layer, rise, east, north, (k + 0.5) * cell, 0.5 * cell)


@kernel
def _look(layer, shine, to, texel, left, out):  # type: ignore[no-untyped-def]
    for k in range(len(to)):
        left[k], _ = through_cumulus(layer, shine, to[k], texel, out[k])


def volumes(page: Page) -> None:
    """The sun's light in cumulus, against all that Mitsuba follows through the same densities."""
    from scenec.backends.mitsuba.variant import load_mitsuba

    mi = load_mitsuba()
    layer = cumulus(0.4)
    side = round(2.0 * HALF_M / CELL_M)
    grid = np.zeros((round(layer.thickness_m / CELL_M), side, side), np.float32)
    _fill_grid(layer, CELL_M, HALF_M, grid)
    errors: dict[float, list[float]] = {}
    cases = [(40.0, 0.0), (40.0, 90.0), (40.0, 180.0), (10.0, 90.0)]
    for elevation, aside in cases[:1] if page.fast else cases:
        at, turn = np.radians([elevation, 30.0 + aside])
        to_sun = np.array([np.cos(at) * np.sin(turn), np.cos(at) * np.cos(turn), np.sin(at)])
        to = ways(210.0, 38.0, PIXELS, 50.0)
        none = np.zeros(3)
        flat = np.ascontiguousarray(to.reshape(-1, 3))
        left, ours = np.empty(len(flat)), np.empty((len(flat), 3))
        texel = np.radians(50.0) / PIXELS[0]
        _look(layer, Shine(to_sun, np.full(3, 1000.0), none, none), flat, texel, left, ours)
        theirs = rendered(mi, layer, grid, to_sun, 16 if page.fast else 96)
        # Blocks of pixels that clouds fill: Mitsuba's noise is large in single ones.
        mine, other = (_blocks(one.reshape(to.shape[:2])) for one in (ours[:, 0], theirs))
        full = _blocks((left < 0.02).reshape(to.shape[:2]).astype(float)) == 1.0
        mine, other = mine[full], other[full]
        errors.setdefault(elevation, []).append(100.0 * (mine.mean() / other.mean() - 1.0))
    said = (
        f"{' to '.join(f'{error:+.0f}' for error in sorted({min(e), max(e)}))} % at {sun:g}°"
        for sun, e in errors.items()
    )
    page.value("cloud_volumes", ", ".join(said) + " of the sun")


def _blocks(picture: NDArray[np.float64]) -> NDArray[np.float64]:
    """Means of 2 x 2 pixels."""
    height, width = picture.shape
    return np.asarray(picture.reshape(height // 2, 2, width // 2, 2).mean(axis=(1, 3)))


def rendered(
    mi: Any, layer: Cumulus, grid: NDArray[np.float32], to_sun: NDArray[np.float64], spp: int
) -> NDArray[np.float64]:
    """Renders clouds by Mitsuba, [h, w]."""
    place = mi.ScalarTransform4f
    low, high = layer.base_m, layer.base_m + layer.thickness_m
    texels = place().translate([-HALF_M, -HALF_M, low]).scale([2 * HALF_M, 2 * HALF_M, high - low])
    middle, half = 0.5 * (low + high), 0.5 * (high - low)
    to = ways(210.0, 38.0, (1, 1), 50.0)[0, 0]
    width, height = PIXELS
    scene = {
        "type": "scene",
        "integrator": {"type": "volpath", "max_depth": 1000, "rr_depth": 1000},
        "box": {"type": "cube", "bsdf": {"type": "null"},
                "to_world": place().translate([0, 0, middle]).scale([HALF_M, HALF_M, half]),
                "interior": {
                    "type": "heterogeneous", "scale": layer.extinction, "albedo": 1.0,
                    "sigma_t": {"type": "gridvolume", "grid": mi.VolumeGrid(grid[..., None]),
                                "to_world": texels, "raw": True},
                    "phase": {"type": "hg", "g": 0.85}}},
        "sun": {"type": "directional", "direction": list(-to_sun),
                "irradiance": {"type": "rgb", "value": 1000.0}},
        "eye": {"type": "perspective", "fov": 50.0, "fov_axis": "x",
                "to_world": place().look_at(origin=[0, 0, 0], target=list(to), up=[0, 0, 1]),
                "film": {"type": "hdrfilm", "width": width, "height": height,
                         "rfilter": {"type": "box"}}},
    }  # fmt: skip
    return np.array(mi.render(mi.load_dict(scene), spp=spp, seed=3))[..., 0].astype(float)


def shadows(page: Page) -> None:
    """Draws shadows on the land in all renderers, and times a frame with and without."""
    out, tiles = page.scratch / "heath", []
    for name in BACKENDS:
        (frame,) = frames(page.cfg(HEATH), out, name, spp=4 if page.fast else 48)
        tiles.append(("", photograph(frame)))
    save(sheet([tiles], 460), page.picture("cloud_shadows"))
    _frames(page, out / "batch_0000" / "stage.usda")


def _frames(page: Page, stage: Path) -> None:
    """Times frames with shadows and without, by renderer."""
    told = []
    for name in BACKENDS:
        with held() as process:
            cost, over = process(frame_cost, name, stage, 2 if page.fast else 7).value
        told.append(f"{name} {100.0 * (over - 1.0):+.0f} % of {cost:.1f}")
    page.value("cloud_frames", ", ".join(told) + " CPU s")


def frame_cost(name: str, stage: Path, runs: int) -> tuple[float, float]:
    """CPU seconds of a frame without shadows, and those with over those."""
    scene = read_stage(stage)
    (camera,) = scene.cameras[0]
    k = camera.intrinsics.copy()
    k[0] *= 320 / camera.width
    k[1] *= 240 / camera.height
    camera = replace(camera, width=320, height=240, intrinsics=k)
    with_, suns = scene.lighting[0], scene.lighting[0].suns
    without = replace(with_, suns=tuple(replace(sun, gobo=None) for sun in suns))
    both = replace(
        scene, samples=2, lighting=(with_, without), cameras=((camera,),) * 2, haze=(),
        times=np.zeros(2),
    )  # fmt: skip
    backend = open_backend(name)
    backend.load(both)
    found = in_turns(
        {
            "with": lambda turn: backend.radiance(camera, 0, 32, turn),
            "without": lambda turn: backend.radiance(camera, 1, 32, turn),
        },
        runs,
    )
    # The least: what else the machine does only adds.
    cost = {name: min(one.cpu) for name, one in found.items()}
    return cost["without"], cost["with"] / cost["without"]


def cost(page: Page) -> None:
    """CPU seconds of a picture."""
    sky_with(50.0, cumulus(), cirrus(), 32)
    rows: list[list[str | float]] = []
    shown: list[NDArray[np.float64]] = []
    to = ways(150.0, 30.0, (640, 480), 90.0)
    for height in (128, 256) if page.fast else (256, 512, 768, 1024):
        row: list[str | float] = [f"{height}{' (default)' if height == 768 else ''}"]
        for heaps, streaks in (
            (cumulus(0.35), no_cirrus()), (no_cumulus(), cirrus()),
        ):  # fmt: skip
            start = time.process_time()
            picture = sky_with(50.0, heaps, streaks, height)
            row.append(f"{time.process_time() - start:.1f}")
            if heaps.extinction > 0.0 and len(row) == 2:
                sky = Sky(np.ascontiguousarray(picture, np.float32), TO_WORLD)
                seen = lookup(sky, np.ascontiguousarray(to.reshape(-1, 3))).reshape(to.shape)
                ev = -np.log2(np.percentile(luminance(seen), 90))
                shown.append(develop(seen, float(ev)).astype(np.float64))
        rows.append(row)
    for row, one in zip(rows, shown, strict=True):
        off = np.abs(one - shown[-1])
        row += [
            f"{np.sqrt((off * off).mean()):.1f}",
            f"{100.0 * (off.max(axis=-1) > 16).mean():.1f} %",
        ]
    page.block("cloud_rows", HEADER, rows)


def main(page: Page) -> None:
    """Refreshes the page."""
    page.refresh(("mitsuba", "bpy"), (pictures, shadows, volumes, cost))


if __name__ == "__main__":
    run(main, page="light")
