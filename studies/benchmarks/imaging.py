"""What a sensor's picture costs: all stages of ``imaging``, together and one by one.

python studies/benchmarks/imaging.py [--size 1280 720] [--runs 15] [--json FILE]

Wall time and processor time of the fastest of several runs, milliseconds, after one that compiles.
"as shown" is the picture of a camera without imaging (``schemas.picture.develop``), for the ratio.
Issue 9 asks for at most 60 ms of wall time for the full model at 1280 x 720.
"""

from __future__ import annotations

import argparse
import json
import time
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from scenec.backends.imaging import optics, sensor
from scenec.backends.imaging.camera import take
from scenec.backends.imaging.jpeg import compressed
from scenec.backends.stage.scene import Camera
from scenec.schemas import picture
from scenec.schemas.imaging import Imaging

FULL = Imaging(
    pattern_seed=1,
    noise_seed=2,
    time_s=1e-3,
    iso=400.0,
    read_noise_e=2.3,
    dark_current_e_s=2.0,
    prnu=0.006,
    dsnu_e=0.6,
    hot=1e-4,
    hot_rate_e_s=500.0,
    dead=1e-5,
    mosaic="rggb",
    vignetting_power=4,
    bloom=0.02,
    bloom_sigma_px=8.0,
    jpeg_quality=90,
)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--size", nargs=2, type=int, default=(1280, 720))
    parser.add_argument("--runs", type=int, default=15)
    parser.add_argument("--json", type=Path)
    options = parser.parse_args()
    width, height = options.size
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
    rows = {name: _clock(run, options.runs) for name, run in cases.items()}
    base = rows["as shown (no imaging)"][0]
    print(f"{width} x {height}          wall ms   CPU ms   wall / as shown")
    for name, (wall, used) in rows.items():
        print(f"{name:28s} {wall:8.1f} {used:8.1f} {wall / base:10.2f}")
    if options.json:
        options.json.write_text(json.dumps(rows, indent=1))


def _scene(height: int, width: int) -> NDArray[np.float32]:
    """Texture over four stops, with a sun."""
    rng = np.random.default_rng(0)
    light = 30.0 * np.exp(rng.normal(size=(height, width, 3)) * 0.7)
    light[: height // 8, : width // 8] = 1e7
    return light.astype(np.float32)


def _clock(run: Callable[[], object], runs: int) -> tuple[float, float]:
    run()
    wall, used = [], []
    for _ in range(runs):
        start, before = time.perf_counter(), time.process_time()
        run()
        wall.append(time.perf_counter() - start)
        used.append(time.process_time() - before)
    return 1e3 * min(wall), 1e3 * min(used)


if __name__ == "__main__":
    main()
