"""Draws what sensors make of light, and finds exposures for the light there is."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from scenec.compiler.arithmetic import elementary
from scenec.compiler.cameras.plan import ImagingPlan, RigPlan
from scenec.compiler.distributions.resolve import resolve
from scenec.compiler.distributions.streams import Streams
from scenec.compiler.scene.rig import Rig, Sensor
from scenec.schemas import imaging as formulas
from scenec.schemas.errors import SceneError
from scenec.schemas.imaging import Imaging

#: Keys of a cfg's imaging that are fields.
_AS_GIVEN = (
    "f_number", "pixel_um", "full_well_e", "bits", "black_level", "shot_noise", "read_noise_e",
    "prnu", "dsnu_e", "mosaic", "demosaic", "clean", "raw",
)  # fmt: skip


def draw_imaging(
    cfg: dict[str, Any] | None, streams: Streams, path: str, samples: int
) -> ImagingPlan | None:
    """Draw a sensor's ``imaging``.

    Raises:
        SceneError: Drawn numbers do not go together.
    """
    if cfg is None:
        return None
    # A sensor is one thing through all batches: its pattern is drawn for the first.
    pattern = Streams(streams.seed, 0).key(f"{path}/pattern")
    noise = streams.key(f"{path}/noise")
    made = tuple(
        _at_sample(resolve(cfg, streams, path, sample=i), pattern, noise) for i in range(samples)
    )
    for imaging in made:
        # Metered ones have their time and speed only when there is light.
        faults = formulas.faults(dataclasses.replace(imaging, time_s=1.0, iso=1.0))
        low_high = imaging.time_range_s, imaging.iso_range
        if any(low > high for low, high in low_high):
            faults.append(f"ranges {low_high}: expected the smaller one first")
        if faults:
            raise SceneError(f"{path}: {faults[0]}")
    return ImagingPlan(made, cfg["exposure"]["type"] == "metered")


def expose(rigs: tuple[Rig, ...], plans: Sequence[RigPlan]) -> tuple[Rig, ...]:
    """The rigs, with imaging of sensors that make pictures; exposures say what those show."""
    out = []
    for rig, plan in zip(rigs, plans, strict=True):
        sensors = tuple(
            _exposed(sensor, drawn.imaging)
            if drawn.imaging is not None and "rgb" in sensor.outputs
            else sensor
            for sensor, drawn in zip(rig.sensors, plan.sensors, strict=True)
        )
        out.append(dataclasses.replace(rig, sensors=sensors))
    return tuple(out)


def _at_sample(cfg: dict[str, Any], pattern: int, noise: int) -> Imaging:
    exposure, dark, defects = cfg["exposure"], cfg["dark_current"], cfg["defects"]
    warmer = (dark["temperature_c"] - dark["reference_c"]) / dark["doubling_c"]
    # Within what a double holds; hotter than that all pixels are full anyway.
    heat = _two_to(min(max(warmer, -100.0), 60.0))
    vignetting = cfg["vignetting"] or {"power": 0, "polynomial": [0.0, 0.0, 0.0]}
    bloom = cfg["bloom"] or {"share": 0.0, "radius_px": 0.0}
    jpeg = cfg["jpeg"] or {"quality": 0, "subsampling": Imaging.jpeg_subsampling}
    matrix = cfg["color_matrix"]
    imaging = Imaging(
        **{key: cfg[key] for key in _AS_GIVEN},
        pattern_seed=pattern,
        noise_seed=noise,
        headroom=cfg["headroom_stops"],
        quantum_efficiency=_three(cfg["quantum_efficiency"]),
        color_matrix=(
            Imaging.color_matrix if matrix is None else tuple(k for row in matrix for k in row)
        ),
        white_balance=_three(cfg["white_balance"]),
        dark_current_e_s=min(dark["rate_e_s"] * heat, 1e11),
        hot=defects["hot"],
        hot_rate_e_s=min(defects["hot_rate_e_s"] * heat, 1e11),
        dead=defects["dead"],
        vignetting_power=vignetting["power"],
        vignetting_polynomial=_three(vignetting["polynomial"]),
        bloom=bloom["share"],
        bloom_sigma_px=bloom["radius_px"],
        jpeg_quality=jpeg["quality"],
        jpeg_subsampling=jpeg["subsampling"],
    )
    if exposure["type"] == "manual":
        iso = exposure["iso"]
        if iso is None:
            iso = formulas.iso_of_gain(imaging, exposure["gain_e"])
        return dataclasses.replace(imaging, time_s=exposure["time_s"], iso=iso)
    (shortest, longest), (lowest, highest) = exposure["time_range_s"], exposure["iso_range"]
    imaging = dataclasses.replace(
        imaging, time_range_s=(shortest, longest), iso_range=(lowest, highest)
    )
    if exposure["type"] == "metered":
        return imaging
    percentile = exposure["percentile"]
    return dataclasses.replace(
        imaging,
        rule="auto",
        target=exposure["target"],
        percentile=Imaging.percentile if percentile is None else percentile,
    )


def _exposed(sensor: Sensor, plan: ImagingPlan) -> Sensor:
    samples = plan.samples
    if plan.metered and sensor.exposure_per is not None:
        # Time and speed follow the exposure that renderers find.
        samples = tuple(dataclasses.replace(imaging, rule="metered") for imaging in samples)
        return dataclasses.replace(sensor, imaging=samples)
    if plan.metered:
        samples = tuple(
            _metered(imaging, float(ev))
            for imaging, ev in zip(samples, sensor.exposure_ev, strict=True)
        )
    ev = sensor.exposure_ev
    if all(imaging.rule == "fixed" for imaging in samples):
        ev = np.array([_shown_ev(imaging) for imaging in samples])
    # Manual ones, and those that meter each picture, have an exposure of their own.
    return dataclasses.replace(sensor, imaging=samples, exposure_ev=ev, exposure_per=None)


def _metered(imaging: Imaging, ev: float) -> Imaging:
    time_s, iso = formulas.time_and_iso(
        _two_to(ev),
        imaging.f_number,
        _two_to(imaging.headroom),
        imaging.time_range_s,
        imaging.iso_range,
    )
    none = Imaging.time_range_s
    return dataclasses.replace(imaging, time_s=time_s, iso=iso, time_range_s=none, iso_range=none)


def _shown_ev(imaging: Imaging) -> float:
    white = _two_to(imaging.headroom)
    shown = formulas.shown_per_value(imaging.f_number, imaging.time_s, imaging.iso, white)
    return float(elementary.log(shown) / elementary.log(2.0))


def _two_to(x: float) -> float:
    return float(elementary.exp(x * elementary.log(2.0)))


def _three(values: list[float] | NDArray[np.float64]) -> tuple[float, float, float]:
    a, b, c = values
    return float(a), float(b), float(c)
