"""Times a sensor's picture: all stages of ``imaging``, together and one by one.

    python lab/benchmarks/imaging.py [--width 1280] [--height 720] [--runs 15] [--fast]

Milliseconds of the fastest of several runs after one that compiles. "As shown" is the picture of a
camera without imaging (``schemas.picture.develop``), for the ratio. Asked: at most 60 ms of wall
time for the full model at 1280 x 720.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from scenec.backends.imaging import optics, sensor
from scenec.backends.imaging.camera import take
from scenec.backends.imaging.jpeg import compressed
from scenec.backends.stage.scene import Camera
from scenec.lab.runner import Study, run, times
from scenec.schemas import picture
from scenec.schemas.imaging import Imaging

FULL = Imaging(
    pattern_seed=1, noise_seed=2, time_s=1e-3, iso=400.0, read_noise_e=2.3, dark_current_e_s=2.0,
    prnu=0.006, dsnu_e=0.6, hot=1e-4, hot_rate_e_s=500.0, dead=1e-5, mosaic="rggb",
    vignetting_power=4, bloom=0.02, bloom_sigma_px=8.0, jpeg_quality=90,
)  # fmt: skip


def _scene(height: int, width: int) -> NDArray[np.float32]:
    """Texture over four stops, with a sun."""
    rng = np.random.default_rng(0)
    light = 30.0 * np.exp(rng.normal(size=(height, width, 3)) * 0.7)
    light[: height // 8, : width // 8] = 1e7
    return light.astype(np.float32)


def main(study: Study) -> None:
    """Prints the table."""
    width, height = study.options.width, study.options.height
    light = _scene(height, width)
    k = np.array([[0.8 * width, 0, width / 2], [0, 0.8 * width, height / 2], [0, 0, 1.0]])
    camera = Camera("camera", "/camera", width, height, k, np.eye(4))
    taken = take(light, camera, FULL, 0)

    def pictured(**change: object) -> Callable[[], object]:
        imaging = replace(FULL, **change)  # type: ignore[arg-type]
        return lambda: take(light, camera, imaging, 0)

    cases: dict[str, Callable[[], object]] = {
        "as shown (no imaging)": lambda: picture.develop(light, taken.exposure_ev),
        "full": pictured(),
        "full, with a clean picture": pictured(clean=True),
        "full, bilinear": pictured(demosaic="bilinear"),
        "full, no mosaic": pictured(mosaic="none"),
        "full, few electrons (1 us)": pictured(time_s=1e-6),
        "without JPEG": pictured(jpeg_quality=0),
        "without JPEG and bloom": pictured(jpeg_quality=0, bloom=0.0),
        "bloom alone": lambda: optics.bloom(light, 0.02, 8.0),
        "JPEG alone": lambda: compressed(taken.picture, 90, "4:2:0"),
        "pattern, once a sensor": lambda: sensor.pattern.__wrapped__(
            1, (height, width, 1), 0.006, 0.6, 1e-4, 500.0, 1e-5
        ),
    }
    runs = 2 if study.fast else study.options.runs
    found = {name: times(work, runs) for name, work in cases.items()}
    base = min(next(iter(found.values())).wall)
    rows = ([name, 1e3 * min(t.wall), 1e3 * min(t.cpu), min(t.wall) / base]
            for name, t in found.items())  # fmt: skip
    study.table([f"{width} x {height}", "wall ms", "CPU ms", "wall / as shown"], rows)


if __name__ == "__main__":
    run(main, width=1280, height=720, runs=15)
