"""Writes docs/haze.md: the error and cost of haze, over its whole range.

    python lab/pages/haze.py [--fast] [-o FOLDER]

Seconds are CPU seconds on the machine that runs it; errors are facts of the code.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from itertools import pairwise, product
from typing import Any

import numpy as np
from numpy.typing import NDArray

from scenec.backends.picture.airlight import FAR_M, Air, air_of, ambient, arrive, phase
from scenec.backends.picture.sky import Sky
from scenec.backends.stage.scene import UPRIGHT, Haze, Sun
from scenec.lab.runner import Page, run, table

#: Sun's irradiance above the layer, radiance of the sky, part that the ground reflects.
SUN, SKY, GROUND = 1000.0, 20.0, 0.2
#: Of the layer beside Mitsuba, meters; eyes: low, and with half of the depth above; elevations and
#: bearings of rays.
LAYER_M, LOW_M, HALF_M = 40.0, 10.0, 27.7
WAYS = [(80, 0), (30, 15), (30, 90), (5, 15), (5, 90), (5, 180), (-5, 30), (-30, 30), (-30, 180)]
#: Vertical optical depth, g, albedo, elevation of the sun, part that the ground reflects, the eye.
VOLUMES = [
    (0.1, 0.7, 1.0, 30, 0.2, LOW_M), (0.3, 0.7, 1.0, 30, 0.2, LOW_M),
    (1.0, 0.7, 1.0, 30, 0.2, LOW_M), (3.0, 0.7, 1.0, 30, 0.2, LOW_M),
    (1.0, 0.0, 1.0, 30, 0.2, LOW_M), (1.0, 0.85, 1.0, 30, 0.2, LOW_M),
    (1.0, 0.7, 1.0, 8, 0.2, LOW_M), (1.0, 0.7, 1.0, 30, 0.8, LOW_M),
    (0.5, 0.65, 0.9, 30, 0.2, LOW_M), (3.0, 0.85, 1.0, 9, 0.2, LOW_M),
    (3.0, 0.85, 1.0, 9, 0.2, HALF_M), (5.0, 0.65, 0.97, 30, 0.2, HALF_M),
]  # fmt: skip

HEAD = """# Haze, measured

What [haze](light.md#haze) computes, against quadrature and against a volume that Mitsuba renders,
from next to nothing to beyond all that lets light through; and what a frame costs.
{cores} cores; {versions}.
"""


def toward(elevation_deg: float, bearing_deg: float) -> NDArray[np.float64]:
    """A unit vector."""
    e, a = np.radians([elevation_deg, bearing_deg])
    return np.array([np.cos(e) * np.sin(a), np.cos(e) * np.cos(a), np.sin(e)])


def air(haze: Haze, sun_deg: float, reflected: float) -> tuple[Air, float]:
    """Haze under the sun and a constant sky, and what the ground sends without it."""
    sun = Sun(toward(sun_deg, 0.0), np.full(3, SUN), np.radians(0.53))
    ground = reflected * (SKY + SUN * max(float(sun.to_light[2]), 0.0) / np.pi)
    picture = np.full((128, 256, 3), SKY, np.float32)
    picture[64:] = ground
    return air_of(haze, (sun,), Sky(picture, UPRIGHT), 0.0), ground


def _panels(end: float) -> Iterator[tuple[NDArray[np.float64], NDArray[np.float64]]]:
    """Nodes and weights of Gauss and Legendre on panels that shrink toward both ends."""
    x, weight = np.polynomial.legendre.leggauss(24)
    edges = 0.5 * end * np.concatenate([[0.0], np.geomspace(1e-13, 1.0, 140)])
    for low, high in pairwise(edges):
        half, middle = 0.5 * (high - low), 0.5 * (high + low)
        yield middle + half * x, half * weight
        yield end - (middle + half * x), half * weight


def dense(of: Air, way: NDArray[np.float64], top: float, depth: float) -> float:
    """Airlight by quadrature of its definition, first channel.

    Args:
        of: The haze.
        way: Direction, unit.
        top, depth: Optical depths: above the eye, and of the ray.
    """
    medium = of.medium
    cosine = medium.to_light @ way
    lobes = phase(cosine, medium.asymmetry**2)
    lobes = np.concatenate([lobes, phase(cosine, medium.asymmetry) - lobes])
    around = ambient(of, way[None])[0, ::3].astype(float)
    strength = np.concatenate([around[1:], np.zeros(len(cosine))])
    strength[-len(lobes) :] += np.tile(medium.beam[:, 0], 2) * lobes
    sight = medium.sight[:, 0]
    total = 0.0
    for t, weight in _panels(min(depth, 800.0 / float(sight.min()))):
        exponent = medium.rate[:, 0] * (top - way[2] * t)[:, None] + medium.offset[:, 0]
        lit = strength * np.exp(-np.maximum(exponent, 0.0) - sight * t[:, None])
        total += float((weight[:, None] * lit).sum())
    blurred = np.exp(-sight[0] * depth) - np.exp(-depth)
    return total + float(blurred * around[0])


def quadrature(page: Page) -> str:
    """The closed form against the integral, over all depths, heights and elevations."""
    heights = (1e-6, 1.0, 1e6)
    depths = (1e-6, 1.0, 1e6) if page.fast else (1e-6, 1e-3, 0.1, 1.0, 10.0, 1e3, 1e6)
    ways = [(e, 20.0) for e in (-90, -30, -1, -1e-3, 0, 1e-3, 1, 30, 90)]
    rows: list[list[str | float]] = []
    for height, depth in product(heights, depths):
        worst, finite, most = 0.0, True, 0.0
        for sun, above in product((0.3, 30.0, 90.0), (0.0, 1.0, 12.0)):
            of, _ = air(Haze(np.full(3, depth / height), height), sun, GROUND)
            for elevation, bearing in ways:
                way = toward(elevation, bearing)
                z, top = above * height, depth * np.exp(-above)
                down = way[2] < 0.0
                length = z / -way[2] if down else FAR_M
                whole = (depth - top) / -way[2] if down else min(top / max(way[2], 1e-300), FAR_M)
                origin = np.array([[0.0, 0.0, z]])
                _, added = arrive(
                    of, origin, way[None, None], np.array([[length]]), ambient(of, way[None])
                )
                value = float(added[0, 0])
                finite &= bool(np.isfinite(value) and value >= 0.0)
                truth = dense(of, way, top, whole)
                most = max(most, abs(truth))
                worst = max(worst, abs(value - truth) / max(truth, 1e-9))
        rows.append([f"{height:g}", f"{depth:g}", f"{worst:.0e}", "yes" if finite else "NO"])
    return (
        "## Against quadrature\n\nScale height and optical depth of the layer, straight up; the "
        "worst relative error over suns at 0.3°, 30° and 90°, eyes on the ground and 1 and 12 "
        "scale heights above it, and nine elevations from straight down over level to straight "
        "up, to the ground or the sky (6,720 nodes; below 1e-9 W/(m² sr) absolute).\n\n"
        + table(["scale height, m", "depth", "worst error", "finite, not negative"], rows)
    )


def volumes(page: Page) -> str:
    """All light against Mitsuba's, which follows it through as many scatterings as there are."""
    from scenec.backends.mitsuba.variant import load_mitsuba

    mi = load_mitsuba()
    rows: list[list[str | float]] = []
    for depth, g, albedo, sun, reflected, eye_m in VOLUMES[:2] if page.fast else VOLUMES:
        haze = Haze(np.full(3, depth / LAYER_M), LAYER_M, asymmetry=g, albedo=np.full(3, albedo))
        of, ground = air(haze, sun, reflected)
        errors, noise = [], 0.0
        for degrees in WAYS:
            way = toward(*degrees)
            length = eye_m / -way[2] if way[2] < 0.0 else FAR_M
            passed, added = arrive(
                of,
                np.array([[0.0, 0.0, eye_m]]),
                way[None, None],
                np.array([[length]]),
                ambient(of, way[None]),
            )
            behind = ground * of.dimming[0] if way[2] < 0.0 else SKY
            ours = float(passed[0, 0] * behind + added[0, 0])
            theirs, off = rendered(mi, haze, (float(sun), reflected), (eye_m, way), 64)
            errors.append(ours / theirs - 1.0)
            noise = max(noise, off / theirs)
        worst = max(errors, key=abs)
        of_all = (100.0 * value for value in (np.mean(errors), np.std(errors), worst, noise))
        cells = zip(of_all, ("+.0f", ".0f", "+.0f", ".1f"), strict=True)
        case = [f"{depth:g}", f"{g:g}", f"{albedo:g}", f"{sun}°", f"{reflected:g}", f"{eye_m:g} m"]
        rows.append([*case, *(f"{value:{digits}} %" for value, digits in cells)])
    return (
        "## Against a volume in Mitsuba\n\nRadiance along nine rays, air and what is behind it, by "
        f"`volpath` in an exponential layer of {LAYER_M:g} m over level ground, sun {SUN:g} W/m² "
        f"and a sky of {SKY:g} W/(m² sr); the eye is {LOW_M:g} m up, or {HALF_M:g} m with half of "
        "the depth above it. What is scattered once is exact; the rest is computed for 16 sines "
        "and 16 modes of azimuth (discrete ordinates). Mitsuba's noise is the largest standard "
        "error of a ray.\n\n"
        + table(
            ["depth", "g", "albedo", "sun", "ground", "eye", "mean error", "std over rays",
             "worst", "Mitsuba's noise"],
            rows,
        )
    )  # fmt: skip


def rendered(
    mi: Any,
    haze: Haze,
    light: tuple[float, float],
    ray: tuple[float, NDArray[np.float64]],
    spp: int,
) -> tuple[float, float]:
    """What Mitsuba sees along a ray, and its standard error.

    Args:
        mi: Its module.
        haze: The layer.
        light: Elevation of the sun, and what part of the light the ground reflects.
        ray: Height of its eye, meters, and its direction, unit.
        spp: Samples in each of 64 pixels.
    """
    place = mi.ScalarTransform4f
    nodes, half, top = 641, 100.0 * haze.scale_height_m, 10.0 * haze.scale_height_m
    density = np.exp(-np.arange(nodes) / 64.0).astype(np.float32).reshape(nodes, 1, 1)
    step = top / (nodes - 1)
    texels = place().translate([-half, -half, -0.5 * step]).scale([2 * half, 2 * half, top + step])
    grid = {
        "type": "gridvolume", "grid": mi.VolumeGrid(density), "to_world": texels, "raw": True,
        "wrap_mode": "clamp",
    }  # fmt: skip
    way, eye = ray[1], np.array([0.0, 0.0, ray[0]])
    up = [0, 1, 0] if abs(way[2]) > 0.9 else [0, 0, 1]
    gray = {"type": "rgb", "value": light[1]}
    scene = {
        "type": "scene",
        "integrator": {"type": "volpath", "max_depth": 128, "rr_depth": 32},
        "air": {"type": "heterogeneous", "id": "air", "sigma_t": grid,
                "scale": float(haze.extinction[0]), "albedo": float(haze.albedo[0]),
                "phase": {"type": "hg", "g": haze.asymmetry}},
        "box": {"type": "cube", "bsdf": {"type": "null"}, "interior": {"type": "ref", "id": "air"},
                "to_world": place().translate([0, 0, 0.5 * top]).scale([half, half, 0.5 * top])},
        "ground": {"type": "rectangle", "bsdf": {"type": "diffuse", "reflectance": gray},
                   "to_world": place().translate([0, 0, 0.01]).scale([half, half, 1])},
        "sun": {"type": "directional", "direction": list(-toward(light[0], 0.0)),
                "irradiance": {"type": "rgb", "value": SUN}},
        "sky": {"type": "constant", "radiance": {"type": "rgb", "value": SKY}},
        "eye": {"type": "perspective", "fov": 0.05, "medium": {"type": "ref", "id": "air"},
                "to_world": place().look_at(origin=list(eye), target=list(eye + way), up=up),
                "film": {"type": "hdrfilm", "width": 8, "height": 8, "rfilter": {"type": "box"}}},
    }  # fmt: skip
    made = mi.load_dict(scene)
    pixels = np.array(mi.render(made, spp=spp, seed=3))[..., 0].astype(float)
    return float(pixels.mean()), float(pixels.std() / 8.0)


def cost(page: Page) -> str:
    """CPU seconds of a frame's haze but for rays at edges."""
    rng = np.random.default_rng(0)
    rows: list[list[str | float]] = []
    for name, pixels in (("320 × 240", 76_800), ("1280 × 720", 921_600)):
        ways = rng.normal(size=(pixels, 3))
        origins, t = np.tile([0.0, 0.0, 2.0], (pixels, 1)), rng.uniform(1.0, 500.0, (pixels, 1))
        for what, color in (("gray", (1.0, 1.0, 1.0)), ("colored", (1.0, 1.2, 1.5))):
            haze = Haze(0.01 * np.array(color))
            made, _ = air(haze, 30.0, GROUND)
            glow = ambient(made, ways)
            arrive(made, origins, ways[:, None], t, glow)
            seconds = [
                cpu(lambda h=haze: air(h, 30.0, GROUND)),
                cpu(lambda m=made, w=ways: ambient(m, w)),
                cpu(lambda m=made, o=origins, w=ways, d=t, s=glow: arrive(m, o, w[:, None], d, s)),
            ]
            rows.append([name, what, *(f"{one:.3f}" for one in seconds)])
    return (
        "## Cost\n\nCPU seconds of one sample's light (once for all its cameras), of looking up "
        "the light of sky and ground, and of transmittance and airlight. Where surfaces leave some "
        "of a pixel to the sky the last two are due twice. At edges up to an eighth of a ray a "
        "pixel is cast beside, of 1 to 5 microseconds each.\n\n"
        + table(
            ["picture", "haze", "light of a sample", "look-up", "transmittance, airlight"], rows
        )
    )


def cpu(work: Callable[[], object]) -> float:
    """The least CPU seconds of five runs."""
    found = []
    for _ in range(5):
        start = time.process_time()
        work()
        found.append(time.process_time() - start)
    return min(found)


def main(page: Page) -> None:
    """Writes the page."""
    page.write(HEAD, ("numpy", "numba", "mitsuba"), (quadrature, volumes, cost))


if __name__ == "__main__":
    run(main, page="haze")
