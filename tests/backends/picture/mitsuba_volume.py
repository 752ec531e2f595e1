"""Light in an exponential layer, by Mitsuba: prints means and standard errors, a line each.

First what is scattered once along one ray to a wall; then all light along ``WAYS_DEG``, of a sun
and a constant sky over ground.

python mitsuba_volume.py ASYMMETRY
"""

from __future__ import annotations

import sys
from typing import Any

import numpy as np
from numpy.typing import NDArray

from scenec.backends.mitsuba.variant import load_mitsuba

#: The layer, the sun above it (bearing 0, 1000 W/m^2), and a ray: elevation and bearing, length,
#: height of its origin.
SCALE_HEIGHT_M, EXTINCTION, SUN_DEG = 40.0, 0.02, 25.0
WAY_DEG, DISTANCE_M, HEIGHT_M = (-6.0, 30.0), 80.0, 12.0
#: Radiance of the sky, part of the light that ground reflects, and further rays from that height.
SKY, GROUND = 30.0, 0.2
WAYS_DEG = [(60.0, 90.0), (30.0, 30.0), (5.0, 60.0), (5.0, 180.0), (-10.0, 30.0), (-30.0, 180.0)]
#: Half the layer's width, in place of none; how high above z = 0 the ground is, to be within.
_HALF_M, _LIFT_M = 4e3, 0.01


def toward(elevation_deg: float, bearing_deg: float) -> NDArray[np.float64]:
    e, a = np.radians([elevation_deg, bearing_deg])
    return np.array([np.cos(e) * np.sin(a), np.cos(e) * np.cos(a), np.sin(e)])


def layer(mi: Any, g: float) -> dict[str, Any]:
    """The medium in its box, and the sun."""
    # Linear between nodes a 64th of a scale height apart, which errs by 3e-5.
    nodes = 64 * 10 + 1
    density = np.exp(-(np.arange(nodes) / 64.0)).astype(np.float32).reshape(nodes, 1, 1)
    top, half = 10.0 * SCALE_HEIGHT_M, _HALF_M
    box = mi.ScalarTransform4f().translate([0, 0, 0.5 * top]).scale([half, half, 0.5 * top])
    texels = (
        mi.ScalarTransform4f()
        .translate([-half, -half, -0.5 * top / (nodes - 1)])
        .scale([2 * half, 2 * half, top * nodes / (nodes - 1)])
    )
    volume = {
        "type": "gridvolume", "grid": mi.VolumeGrid(density), "to_world": texels, "raw": True,
        "wrap_mode": "clamp",
    }  # fmt: skip
    medium = {
        "type": "heterogeneous", "id": "air", "sigma_t": volume, "scale": EXTINCTION,
        "albedo": 1.0, "phase": {"type": "hg", "g": g},
    }  # fmt: skip
    return {
        "type": "scene",
        "air": medium,
        "box": {"type": "cube", "to_world": box, "bsdf": {"type": "null"},
                "interior": {"type": "ref", "id": "air"}},
        "sun": {"type": "directional", "direction": list(-toward(SUN_DEG, 0.0)),
                "irradiance": {"type": "rgb", "value": 1000.0}},
    }  # fmt: skip


def lambert(value: float) -> dict[str, Any]:
    return {"type": "diffuse", "reflectance": {"type": "rgb", "value": value}}


def seen(mi: Any, scene: dict[str, Any], way: NDArray[np.float64], spp: int) -> None:
    """Print what is seen along a ray from the height: 256 pixels of next to no width."""
    eye = np.array([0.0, 0.0, HEIGHT_M])
    camera = mi.ScalarTransform4f().look_at(origin=list(eye), target=list(eye + way), up=[0, 0, 1])
    film = {"type": "hdrfilm", "width": 16, "height": 16, "rfilter": {"type": "box"}}
    sensor = {
        "type": "perspective", "fov": 0.05, "to_world": camera, "film": film,
        "medium": {"type": "ref", "id": "air"},
    }  # fmt: skip
    made = mi.load_dict(scene | {"sensor": sensor})
    pixels = np.array(mi.render(made, spp=spp, seed=3))[..., 0].astype(float)
    print(pixels.mean(), pixels.std() / 16.0)


def main(g: float) -> None:
    mi = load_mitsuba()
    place = mi.ScalarTransform4f()
    eye, way = np.array([0.0, 0.0, HEIGHT_M]), toward(*WAY_DEG)
    # A black wall as large as the picture, so that it shades next to nothing.
    wall = place.look_at(origin=list(eye + DISTANCE_M * way), target=list(eye), up=[0, 0, 1])
    once = {
        "integrator": {"type": "volpath", "max_depth": 2, "rr_depth": 100},
        "wall": {"type": "rectangle", "to_world": wall @ place.scale(0.05), "bsdf": lambert(0.0)},
    }
    seen(mi, layer(mi, g) | once, way, 1024)
    ground = mi.ScalarTransform4f().translate([0, 0, _LIFT_M]).scale([_HALF_M, _HALF_M, 1.0])
    whole = {
        "integrator": {"type": "volpath", "max_depth": 64, "rr_depth": 16},
        "ground": {"type": "rectangle", "to_world": ground, "bsdf": lambert(GROUND)},
        "sky": {"type": "constant", "radiance": {"type": "rgb", "value": SKY}},
    }
    for degrees in WAYS_DEG:
        seen(mi, layer(mi, g) | whole, toward(*degrees), 128)


if __name__ == "__main__":
    main(float(sys.argv[1]))
