"""Measures the error and cost of haze for docs/light.md.

    python lab/pages/haze.py [--fast] [-o FOLDER]

Seconds are CPU seconds on the machine that runs it; errors are facts of the code.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from scenec.backends.picture.airlight import FAR_M, Air, air_of, ambient, arrive
from scenec.backends.picture.sky import Sky
from scenec.backends.stage.scene import UPRIGHT, Haze, Sun
from scenec.lab.runner import Page, run, times

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


def volumes(page: Page) -> None:
    """All light against Mitsuba's, which follows it through as many scatterings as there are."""
    from scenec.backends.mitsuba.variant import load_mitsuba

    mi = load_mitsuba()
    means, worst_of_all, noisiest = [], 0.0, 0.0
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
        means.append(100.0 * float(np.mean(errors)))
        worst_of_all = max(worst_of_all, 100.0 * max(map(abs, errors)))
        noisiest = max(noisiest, 100.0 * noise)
    said = f"{min(means):+.0f} to {max(means):+.0f} %; the worst ray {worst_of_all:.0f} %"
    page.value("haze_mean", f"{said}, where volpath's standard error is up to {noisiest:.0f} %")


def rendered(
    mi: Any,
    haze: Haze,
    light: tuple[float, float],
    ray: tuple[float, NDArray[np.float64]],
    spp: int,
) -> tuple[float, float]:
    """Renders a ray by Mitsuba; its radiance and standard error.

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


def cost(page: Page) -> None:
    """CPU seconds of a frame's haze but for rays at edges."""
    rng = np.random.default_rng(0)
    told = []
    for pixels in (76_800, 921_600):
        spent = []
        ways = rng.normal(size=(pixels, 3))
        origins, t = np.tile([0.0, 0.0, 2.0], (pixels, 1)), rng.uniform(1.0, 500.0, (pixels, 1))
        for color in ((1.0, 1.0, 1.0), (1.0, 1.2, 1.5)):
            haze = Haze(0.01 * np.array(color))
            made, _ = air(haze, 30.0, GROUND)
            glow = ambient(made, ways)
            arrive(made, origins, ways[:, None], t, glow)
            works = [
                lambda h=haze: air(h, 30.0, GROUND),
                lambda m=made, w=ways: ambient(m, w),
                lambda m=made, o=origins, w=ways, d=t, s=glow: arrive(m, o, w[:, None], d, s),
            ]
            seconds = [min(times(work, 5).cpu) for work in works]
            spent.append(sum(seconds))
        told.append(f"{spent[0]:.2f} CPU s (colored {spent[1]:.2f})")
    page.value("haze_cost", "; ".join(told))


def main(page: Page) -> None:
    """Refreshes the page."""
    page.refresh(("mitsuba",), (volumes, cost))


if __name__ == "__main__":
    run(main, page="light")
