"""Writes assets/dems/*.tif: elevation models of places that are not, in the form of real products.

    .venv/bin/python lab/models/dems.py

Each is a program of relief of the compiler's own, sampled at the pixels' centers: the same numbers
on every machine. The finer one of a place begins with the coarser one, as a stereo model begins
with an altimeter's, and goes on below its pixel. Needs the extra "geotiff".
"""

from __future__ import annotations

import json
import tempfile
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import rasterio
from numpy.typing import NDArray

from scenec.compiler.cfg.load import load
from scenec.compiler.draw import draw
from scenec.compiler.mesh.build import build_relief
from scenec.testing.small import small_cfg

FOLDER = Path(__file__).resolve().parents[2] / "assets" / "dems"
_SOUTH_POLE, _MARS = "IAU_2015:30135", "IAU_2015:49910"


@dataclass(frozen=True)
class MadeUpDem:
    """Says how an elevation model is made.

    Attributes:
        crs: Its reference system.
        center: Of the middle of the file in it, meters.
        pixel_m, pixels: Of a side.
        step_m: Of a height: what one of its whole numbers is.
        relief: The program.
    """

    crs: str
    center: tuple[float, float]
    pixel_m: float
    pixels: int
    step_m: float
    relief: tuple[dict[str, Any], ...]


def _coarse(name: str, center: tuple[float, float], pixel_m: float, side: float) -> dict[str, Any]:
    """The elevation model that another one begins with."""
    window = {"x_m": center[0], "y_m": center[1], "size_m": [side + 4 * pixel_m] * 2}
    return {"type": "dem", "file": str(FOLDER / f"{name}.tif"), "pixel_m": pixel_m,
            "window": window}  # fmt: skip


def _fbm(amplitude_m: float, scale_m: float, octaves: int = 6, **keys: Any) -> dict[str, Any]:
    own = {"amplitude_m": amplitude_m, "scale_m": scale_m, "octaves": octaves}
    return {"type": "multifractal", "variant": "fbm", "gain": 0.5, **own, **keys}


def _near(x: float, y: float, softness: float, **keys: Any) -> dict[str, Any]:
    return {"type": "point", "x_m": x, "y_m": y, "softness_m": softness, **keys}


#: On a ridge beside a crater of 13 km, 89.45 degrees south.
_RIDGE = (-11_310.0, -12_260.0)
#: At the foot of a delta's front.
_FOOT = (4_593_500.0, 1_093_500.0)
_FRONT = (4_593_370.0, 1_093_530.0)
RASTERS = {
    "south_pole_40m": MadeUpDem(_SOUTH_POLE, _RIDGE, 40.0, 560, 0.1, (
        {"type": "plane"},
        _fbm(420, 9000, 8, gain=0.42),
        {"type": "plane", "height_m": -2300, "mask": [_near(5200, 5400, 5600, max_m=4700,
         ragged={"amplitude": 500, "scale_m": 4000})]},
        {"type": "plane", "height_m": 420, "mask": [_near(0, 0, 5000, max_m=900)]},
        {"type": "craters", "min_diameter_m": 200, "max_diameter_m": 4500, "degradation": 0.2,
         "irregularity": 0.12, "density_per_m2": 0.07, "rim_ratio": 0.05},
    )),
    "south_pole_5m": MadeUpDem(_SOUTH_POLE, _RIDGE, 5.0, 320, 0.02, (
        _coarse("south_pole_40m", _RIDGE, 40.0, 1600.0),
        {"type": "downscale", "slope": 3.8, "roughness": 0.7},
        {"type": "craters", "min_diameter_m": 18, "max_diameter_m": 250, "degradation": 0.25,
         "irregularity": 0.1, "density_per_m2": 0.05},
    )),
    "mars_delta_20m": MadeUpDem(_MARS, _FOOT, 20.0, 640, 0.1, (
        {"type": "plane", "slope": [-0.004, 0.002]},
        _fbm(16, 1600, 7, gain=0.45),
        {"type": "plane", "height_m": 62, "mask": [_near(-2300, 900, 150, max_m=2250,
         ragged={"amplitude": 420, "scale_m": 900})]},
        {"type": "multifractal", "variant": "ridged", "amplitude_m": 520, "scale_m": 2600,
         "octaves": 7, "gain": 0.48, "distortion": 0.12,
         "mask": [_near(1800, -600, 2600, min_m=5200, ragged={"amplitude": 600, "scale_m": 2500})]},
        {"type": "craters", "min_diameter_m": 60, "max_diameter_m": 900, "density_per_m2": 0.004,
         "degradation": 0.5, "irregularity": 0.1, "depth_ratio": 0.15},
    )),
    "mars_delta_1m": MadeUpDem(_MARS, _FRONT, 1.0, 640, 0.01, (
        _coarse("mars_delta_20m", _FRONT, 20.0, 640.0),
        {"type": "downscale", "roughness": 0.25, "slope": 3.6},
        {"type": "terraces", "step_m": 7, "riser": 0.45, "tread_slope": 0.55, "irregularity": 1,
         "bend_m": 5, "bend_scale_m": 60,
         "mask": [{"type": "slope", "min_deg": 6, "softness_deg": 6, "over_m": 25}]},
        {"type": "craters", "min_diameter_m": 4, "max_diameter_m": 50, "density_per_m2": 0.008,
         "degradation": 0.5, "irregularity": 0.1, "depth_ratio": 0.12},
    )),
}  # fmt: skip


def heights(raster: MadeUpDem) -> NDArray[np.int16]:
    """Returns the whole numbers of a raster, its northern row first."""
    side = (raster.pixels - 1) * raster.pixel_m
    cfg = small_cfg()
    cfg["terrain"] |= {"size_m": [side, side], "spacing_m": raster.pixel_m}
    cfg["terrain"]["relief"] = list(raster.relief)
    with tempfile.TemporaryDirectory() as folder:
        file = Path(folder, "cfg.json")
        file.write_text(json.dumps(cfg))
        made = build_relief(draw(load(file), 1, 0).terrain)[0].field.height
    return np.round(made[::-1] / raster.step_m).astype(np.int16)


def write(name: str, path: Path) -> None:
    """Writes a raster: whole numbers, with the scale that makes meters of them."""
    raster = RASTERS[name]
    corner = (c + sign * 0.5 * raster.pixels * raster.pixel_m
              for c, sign in zip(raster.center, (-1, 1), strict=True))  # fmt: skip
    place = rasterio.transform.from_origin(*corner, raster.pixel_m, raster.pixel_m)
    with rasterio.open(
        path, "w", driver="GTiff", width=raster.pixels, height=raster.pixels, count=1,
        dtype="int16", crs=raster.crs, transform=place, compress="deflate", predictor=2, zlevel=9,
        tiled=True,
    ) as file:  # fmt: skip
        file.write(heights(raster), 1)
        file.scales, file.units = (raster.step_m,), ("m",)
        file.set_band_description(1, "height, made up by scenec")


if __name__ == "__main__":
    FOLDER.mkdir(exist_ok=True)
    for each in RASTERS:
        write(each, FOLDER / f"{each}.tif")
        print(each, (FOLDER / f"{each}.tif").stat().st_size, "bytes")
