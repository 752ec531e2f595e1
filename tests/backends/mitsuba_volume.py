"""Single scattering in an exponential layer, by Mitsuba: prints its mean and standard error.

python mitsuba_volume.py ASYMMETRY
"""

from __future__ import annotations

import sys

import numpy as np
from numpy.typing import NDArray

from scenec.backends.mitsuba.variant import load_mitsuba

#: The layer, the sun above it (bearing 0, 1000 W/m^2), and a ray: elevation and bearing, length,
#: height of its origin.
SCALE_HEIGHT_M, EXTINCTION, SUN_DEG = 40.0, 0.02, 25.0
WAY_DEG, DISTANCE_M, HEIGHT_M = (-6.0, 30.0), 80.0, 12.0


def toward(elevation_deg: float, bearing_deg: float) -> NDArray[np.float64]:
    e, a = np.radians([elevation_deg, bearing_deg])
    return np.array([np.cos(e) * np.sin(a), np.cos(e) * np.cos(a), np.sin(e)])


def main(g: float) -> None:
    mi = load_mitsuba()
    eye, way = np.array([0.0, 0.0, HEIGHT_M]), toward(*WAY_DEG)
    # Linear between nodes a 64th of a scale height apart, which errs by 3e-5.
    nodes = 64 * 10 + 1
    layer = np.exp(-(np.arange(nodes) / 64.0)).astype(np.float32).reshape(nodes, 1, 1)
    top, half = 10.0 * SCALE_HEIGHT_M, 4e3
    box = mi.ScalarTransform4f().translate([0, 0, 0.5 * top]).scale([half, half, 0.5 * top])
    texels = (
        mi.ScalarTransform4f()
        .translate([-half, -half, -0.5 * top / (nodes - 1)])
        .scale([2 * half, 2 * half, top * nodes / (nodes - 1)])
    )
    volume = {
        "type": "gridvolume", "grid": mi.VolumeGrid(layer), "to_world": texels, "raw": True,
        "wrap_mode": "clamp",
    }  # fmt: skip
    medium = {
        "type": "heterogeneous", "id": "air", "sigma_t": volume, "scale": EXTINCTION,
        "albedo": 1.0, "phase": {"type": "hg", "g": g},
    }  # fmt: skip
    # A black wall as large as the picture, so that it shades next to nothing.
    wall = mi.ScalarTransform4f().look_at(
        origin=list(eye + DISTANCE_M * way), target=list(eye), up=[0, 0, 1]
    )
    camera = mi.ScalarTransform4f().look_at(origin=list(eye), target=list(eye + way), up=[0, 0, 1])
    black = {"type": "diffuse", "reflectance": {"type": "rgb", "value": 0.0}}
    scene = mi.load_dict({
        "type": "scene",
        "integrator": {"type": "volpath", "max_depth": 2, "rr_depth": 100},
        "air": medium,
        "box": {"type": "cube", "to_world": box, "bsdf": {"type": "null"},
                "interior": {"type": "ref", "id": "air"}},
        "wall": {"type": "rectangle", "to_world": wall @ mi.ScalarTransform4f().scale(0.05),
                 "bsdf": black},
        "sun": {"type": "directional", "direction": list(-toward(SUN_DEG, 0.0)),
                "irradiance": {"type": "rgb", "value": 1000.0}},
        "sensor": {"type": "perspective", "fov": 0.05, "to_world": camera,
                   "medium": {"type": "ref", "id": "air"},
                   "film": {"type": "hdrfilm", "width": 16, "height": 16,
                            "rfilter": {"type": "box"}}},
    })  # fmt: skip
    pixels = np.array(mi.render(scene, spp=1024, seed=3))[..., 0].astype(float)
    print(pixels.mean(), pixels.std() / 16.0)


if __name__ == "__main__":
    main(float(sys.argv[1]))
