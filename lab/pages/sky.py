"""Writes docs/sky.md: skies by scattering, beside Blender's, with their error and cost.

    python lab/pages/sky.py [--fast] [-o FOLDER]

Seconds are single readings on the machine that runs it; errors are facts of the code.
"""

from __future__ import annotations

import json
import subprocess
import sys
import tempfile
import time
from itertools import product
from pathlib import Path
from typing import Any

import matplotlib.pyplot as plt
import numpy as np
from numpy.typing import NDArray

from scenec.compiler.light import atmosphere
from scenec.compiler.light.atmosphere_planets import MEDIA
from scenec.compiler.light.atmosphere_sky import resolution_error
from scenec.compiler.light.atmosphere_spectra import black_body, weights, weights_of
from scenec.compiler.light.latlong import horizontal_irradiance, luminance
from scenec.lab.runner import ROOT, Page, run, table
from scenec.testing import nishita, photons

SAND, RUST = (0.3, 0.26, 0.22), (0.3, 0.16, 0.09)
#: Planet, elevation of the sun, altitude, factors on air, dust, ozone.
Case = tuple[str, float, float, tuple[float, float, float]]
USUAL = (1.0, 1.0, 1.0)
ROWS: dict[str, Case] = {
    "Earth, sun at 60°": ("earth", 60.0, 0.0, USUAL),
    "Earth, sun at 8°": ("earth", 8.0, 0.0, USUAL),
    "Earth, sun at 0.5°": ("earth", 0.5, 0.0, USUAL),
    "Earth, sun at -5°": ("earth", -5.0, 0.0, USUAL),
    "Earth, sun at 30°, dust 8": ("earth", 30.0, 0.0, (1.0, 8.0, 1.0)),
    "Earth, sun at 30°, 30 km high": ("earth", 30.0, 30_000.0, USUAL),
    "Mars, sun at 55°": ("mars", 55.0, 0.0, USUAL),
    "Mars, sun at 6°": ("mars", 6.0, 0.0, USUAL),
    "Mars, sun at 6°, exposed for the sun": ("mars", 6.0, 0.0, USUAL),
    "Mars, sun at 30°, dust 4": ("mars", 30.0, 0.0, (1.0, 4.0, 1.0)),
}
#: Of the comparison with Blender: elevation, altitude, factors.
BESIDE = [
    (30.0, 100.0, (1.0, 1.0, 1.0)),
    (5.0, 100.0, (1.0, 1.0, 1.0)),
    (60.0, 3000.0, (2.0, 0.5, 3.0)),
    (50.0, 2000.0, (1.0, 0.0, 1.0)),
]

HEAD = f"""# Skies by scattering

`light.sky.type = "atmosphere"` bakes the sky of Earth or Mars: sunlight scattered once by gas and
aerosol on a sphere (Nishita et al. 1993), at {atmosphere.WAVELENGTHS} wavelengths, in W/(m² sr).
The sunlight that the air lets through goes into the stage's DistantLight; the picture has no
disc. This page shows such skies, compares them with Blender's, and measures their error and cost.
Seconds are single readings on {{cores}} cores ({{versions}}), with other work beside them; errors
do not depend on the machine.
"""


def baked(case: Case, height: int, **how: Any) -> NDArray:
    """A sky under sunlight of luminance 1."""
    planet, elevation, altitude, factors = case
    count = how.pop("wavelengths", atmosphere.WAVELENGTHS)
    ground = np.array(RUST if planet == "mars" else SAND)
    medium = MEDIA[planet](count, *factors)
    return atmosphere.bake(
        medium, weights(count), altitude, np.radians(elevation), ground, height, **how
    )


def displayed(picture: NDArray, gray: float) -> NDArray:
    """sRGB, the luminance ``gray`` at 0.4."""
    x = np.clip(picture * (0.4 / gray), 0.0, 1.0)
    return np.where(x < 0.0031308, 12.92 * x, 1.055 * x ** (1 / 2.4) - 0.055)


def pictures(page: Page) -> str:
    """Skies from the zenith to 20 degrees below the horizon."""
    height = 64 if page.fast else 180
    figure, axes = plt.subplots(len(ROWS), 2, figsize=(13, 1.6 * len(ROWS)))
    for (name, case), pair in zip(ROWS.items(), axes, strict=True):
        for axis, multiple in zip(pair, (False, True), strict=True):
            picture = baked(case, height, multiple=multiple)[: height * 11 // 18]
            part = 99.9 if "exposed" in name else 75
            gray = float(np.percentile(luminance(picture[: height // 2]), part))
            axis.imshow(displayed(picture, gray), extent=(-180, 180, -20, 90), aspect="auto")
            how = "multiple" if multiple else "single"
            zenith = luminance(picture[0]).mean()
            axis.set_title(f"{name}, {how} (zenith {zenith:.1e}/sr)", fontsize=8)
            axis.set_yticks((0, 30, 60, 90))
            axis.set_xticks(())
    text = page.save(figure, "rows")
    low = baked(ROWS["Mars, sun at 6°"], 360)
    angle = np.radians(6.0)
    row = round(360 * (0.5 - angle / np.pi))
    ratio = low[row, 360:720, 0] / low[row, 360:720, 2]
    degrees = (np.arange(360) + 0.5) / 2
    figure, axis = plt.subplots(figsize=(6, 2.6))
    axis.plot(degrees, ratio)
    axis.axhline(1.0, color="gray", linewidth=0.7)
    axis.set(xlabel="bearing off the sun's, degrees", ylabel="red / blue")
    plot = page.save(figure, "aureole")
    return (
        "## What they look like\n\nThe sun is in the middle of each picture, and each picture has "
        'its own exposure. On the left `scattering: "single"`, on the right `"multiple"`. '
        "The number is the zenith's luminance under sunlight of 1 W/m² above the air.\n\n"
        + text
        + "\nDust on Mars absorbs blue light, and diffracts it into a narrower cone than red "
        f"light. At the height of a sun 6° up, red over blue is {ratio[0]:.2f} at the sun and "
        f"{ratio[180]:.2f} at a right angle to it:\n\n" + plot
    )


def blenders(kind: str, height: int) -> list[NDArray]:
    """Blender's skies above the horizon, under sunlight of luminance 1 (single scattering's)."""
    asked = json.dumps([[kind, e, a, *factors] for e, a, factors in BESIDE])
    script = ROOT / "testing" / "blender_sky.py"
    with tempfile.TemporaryDirectory() as folder:
        out = Path(folder, "sky.npz")
        subprocess.run([sys.executable, str(script), str(out), str(height), asked], check=True)
        with np.load(out) as found:
            return [found[name][: height // 2].astype(float) for name in found.files]


def beside_blender(page: Page) -> str:
    """Relative difference to Blender's single scattering, and what its sums err."""
    height = 32 if page.fast else 64
    up = (np.pi / 2 - np.pi * (np.arange(height // 2) + 0.5) / height)[:, None]
    bearing = (np.pi - np.pi * (np.arange(2 * height) + 0.5) / height)[None]
    to = nishita.looking(up, bearing)
    count = atmosphere.WAVELENGTHS
    ours_sun = weights(count).sum(axis=0)
    tint = weights_of(black_body(5777.0), count).sum(axis=0) / ours_sun
    single = blenders("SINGLE_SCATTERING", height)
    figure, axes = plt.subplots(len(BESIDE), 3, figsize=(11, 1.9 * len(BESIDE)))
    rows = []
    for case, theirs, row in zip(BESIDE, single, axes, strict=True):
        elevation, altitude, factors = case
        blender = theirs / nishita.unit()
        medium = MEDIA["earth"](count, *factors)
        ours = (
            tint
            * atmosphere.bake(
                medium, weights(count), altitude, np.radians(elevation), np.zeros(3), height
            )[: height // 2]
        )
        there = nishita.sky(nishita.as_blender_looks(up, bearing), *case)
        fine = nishita.sky(to, *case, fine=64 if page.fast else 256)
        away = to @ nishita.sun_direction(elevation) < np.cos(np.radians(10.0))

        def differ(a: NDArray, b: NDArray) -> NDArray:
            return 100.0 * (luminance(a) / luminance(b) - 1.0)

        maps = (differ(ours, blender), differ(fine, there), differ(ours * there / fine, blender))
        for axis, values in zip(row, maps, strict=True):
            shown = np.where(away, values, np.nan)
            image = axis.imshow(
                shown, cmap="RdBu_r", vmin=-5, vmax=5, extent=(-180, 180, 0, 90), aspect="auto"
            )
            axis.set_xticks(())
        figure.colorbar(image, ax=row[2], label="%")
        name = f"{elevation:g}°, {altitude:g} m, {', '.join(f'{f:g}' for f in factors)}"
        row[0].set_ylabel(name, fontsize=7)
        worst = [np.abs(m)[away].max() for m in maps]
        channel = 100.0 * np.abs(ours * (there / fine) / blender - 1.0)[away].max()
        high = away & (up > np.radians(30.0))
        rows.append(
            [
                name,
                f"{np.abs(maps[0])[away].mean():.2f}",
                f"{np.abs(maps[0])[high].mean():.2f}",
                f"{worst[0]:.1f}",
                f"{np.abs(differ(there, blender))[away].max():.2f}",
                f"{np.abs(differ(ours, fine))[away].max():.2f}",
                f"{worst[2]:.2f}",
                f"{channel:.2f}",
            ]
        )
    for axis, name in zip(
        axes[0], ("ours against Blender's", "what Blender's sums err", "the rest"), strict=True
    ):
        axis.set_title(name, fontsize=9)
    plot = page.save(figure, "blender")
    scale = 1361.0 / nishita.unit()
    return (
        "## Beside Blender's sky texture\n\n"
        "Blender's `SINGLE_SCATTERING`, rendered by Cycles through a panoramic camera, has the "
        "same "
        "model with the same constants, at 21 wavelengths. Its unit is W/(m² sr) of the eye's "
        f"luminance, under a black body of 5777 K that has {nishita.unit():.2f} in it; ours is "
        "scaled "
        "so that sunlight above the air has the luminance `light.sun.irradiance`: a factor of "
        f"{scale:.3f} for 1361 W/m². We take measured sunlight instead of the black body, which "
        "makes "
        f"the factor {', '.join(f'{v:.3f}' for v in scale / tint)} for red, green and blue; "
        "the tables below compare with these. Over the sky more than 10° from the sun and above "
        f"{90 / height:.1f}°, percent of luminance (the last column: of the worst channel):\n\n"
        + table(
            [
                "sun, altitude, air/dust/ozone",
                "mean",
                "mean above 30°",
                "worst",
                "Blender's sums done anew, against Blender",
                "ours against the model summed finely",
                "ours with what Blender's sums err, against Blender",
                "worst channel",
            ],
            rows,
        )
        + "\nWhere the two differ by more than 2 %, Blender errs: it takes 32 equal steps through "
        "60 km "
        "of air, which are longer than its aerosol is thick (1.2 km) and, along the horizon, 27 "
        "km, "
        "and looks up its table half a texel too low and too far from the sun. The same model in "
        "NumPy (`testing/nishita.py`) with Blender's steps gives Blender's picture (fifth "
        "column), and with fine ones ours (sixth). With that error taken out the luminance is "
        "within 2 % everywhere (seventh), and so is every channel but where a low sun leaves next "
        "to no blue at the horizon: there it matters which sunlight it was.\n\n" + plot
    )


def left_out(page: Page) -> str:
    """Single scattering against Blender's approximation of multiple scattering."""
    height = 32
    single, multiple = (blenders(f"{kind}_SCATTERING", height) for kind in ("SINGLE", "MULTIPLE"))
    rows = []
    for (elevation, altitude, factors), one, more in zip(BESIDE, single, multiple, strict=True):
        case: Case = ("earth", elevation, altitude, factors)
        own = [
            luminance(horizontal_irradiance(baked(case, 64, multiple=both)))
            for both in (False, True)
        ]
        name = f"{elevation:g}°, {altitude:g} m, {', '.join(f'{f:g}' for f in factors)}"
        a, b = (horizontal_irradiance(np.concatenate([p, 0 * p])) for p in (one, more))
        near = [luminance(p[-4:]).mean() for p in (one, more)]
        rows.append(
            [name, f"{luminance(b) / luminance(a):.2f}", f"{near[1] / near[0]:.2f}"]
            + [f"{p[2] / p[0]:.2f}" for p in (a, b)]
            + [f"{own[1] / own[0]:.2f}"]
        )
    return (
        "## What single scattering leaves out\n\n"
        "Blender's `MULTIPLE_SCATTERING` is another model (other aerosol, other ozone, ground of "
        "albedo 0.3, a fit for all light scattered twice or more), so the table shows a "
        "difference, not an error: its skylight on level ground over that of single scattering, "
        "the same for the lowest 20°, and blue over red in either.\n\n"
        + table(
            [
                "sun, altitude, air/dust/ozone",
                "skylight, times",
                "near the horizon, times",
                "blue / red, single",
                "blue / red, multiple",
                'skylight, times, with our `"multiple"`',
            ],
            rows,
        )
        + "\nSo single scattering makes skylight too weak, most of all in hazy air and near the "
        "horizon. Under much dust, as on Mars with a low sun, the horizon away from the sun is "
        "too dark.\n"
    )


def several(page: Page) -> str:
    """The approximation of multiple scattering against photons."""
    rows = []
    for depth, albedo, forward, g in photons.SLABS:
        for elevation in (15.0, 30.0, 60.0):
            medium = photons.gray_dust(depth, albedo, forward, g)
            sine = float(np.sin(np.radians(elevation)))
            rng = np.random.default_rng(1)
            truth = sine * photons.scattered_down(rng, depth, albedo, forward, g, sine)
            light = [photons.level_irradiance(medium, elevation, both) for both in (False, True)]
            rows.append(
                [f"{depth:g}", f"{albedo:g}", f"{forward:g} at {g:g}", f"{elevation:g}"]
                + [f"{truth:.4f}"]
                + [f"{100.0 * (value / truth - 1.0):+.1f}" for value in light]
            )
    times = [
        page.timed(lambda both=both: baked(ROWS["Mars, sun at 6°"], 128, multiple=both))
        for both in (False, True)
    ]
    return (
        '## What `scattering: "multiple"` adds\n\nAll further orders, approximated '
        "(`compiler/light/atmosphere_multiple.py`: Hillaire 2020, with the forward lobe taken out "
        "first). Skylight on level black ground under a slab of gray dust of some optical depth "
        f"and albedo, against {photons.PHOTONS:,} photons followed one by one (noise 0.3 %), over "
        "the sun's irradiance; errors in percent:\n\n"
        + table(
            ["depth", "albedo", "forward lobe", "sun, °", "photons", "single, %", "multiple, %"],
            rows,
        )
        + f"\nAt 128 rows a sky takes {times[0]:.2f} s with single scattering, {times[1]:.2f} s "
        "with multiple. It makes two further errors: light that was scattered several times has "
        "no lobe but the forward one, and the ground illuminates the air only once.\n"
    )


CURVE: list[Case] = [
    ROWS[name]
    for name in ("Earth, sun at 60°", "Earth, sun at 0.5°", "Earth, sun at -5°", "Mars, sun at 6°")
]


def curves(page: Page) -> str:
    """Error against seconds over steps, wavelengths, bearings and rows."""
    height = 32
    best = {"steps": 192, "wavelengths": 41, "bearings": 97}
    tried = {
        "steps": (8, 16, 24, 32, 48, 64),
        "wavelengths": (5, 7, 9, 11, 17, 21),
        "bearings": (9, 17, 33, 65),
    }
    usual = {
        "steps": atmosphere.STEPS,
        "wavelengths": atmosphere.WAVELENGTHS,
        "bearings": atmosphere.BEARINGS,
    }
    cases = CURVE[:2] if page.fast else CURVE
    truth = [baked(case, height, **best) for case in cases]
    rows = []
    figure, axis = plt.subplots(figsize=(6.5, 3.4))
    for what, values in tried.items():
        points = []
        for value in values:
            errors, seconds = [], 0.0
            for case, true in zip(cases, truth, strict=True):
                got = baked(case, height, **{**best, what: value})
                seconds += page.timed(
                    lambda c=case, v=value, w=what: baked(c, 128, **{**usual, w: v}),
                    repeat=1,
                )
                level = luminance(true[: height // 2])
                wrong = luminance(np.abs(got - true)[: height // 2])
                errors.append(100 * np.sqrt((wrong**2).mean() / (level**2).mean()))
            points.append((seconds / len(cases), max(errors)))
            mark = " (default)" if value == usual[what] else ""
            rows.append(
                [f"{what} {value}{mark}"]
                + [f"{e:.3f}" for e in errors]
                + [f"{seconds / len(cases):.2f}"]
            )
        x, y = np.array(points).T
        axis.loglog(x, np.maximum(y, 1e-4), "o-", label=what)
        for value, (px, py) in zip(values, points, strict=True):
            axis.annotate(str(value), (px, max(py, 1e-4)), fontsize=7)
    axis.set(xlabel="seconds a sky, 128 rows", ylabel="worst relative rms error, %")
    axis.legend()
    plot = page.save(figure, "curves")
    sizes = [
        [f"{count}{' (default)' if count == 128 else ''}"]
        + [f"{100 * resolution_error(baked(case, count)):.2f}" for case in cases]
        + [f"{page.timed(lambda count=count: baked(CURVE[0], count), 1):.2f}"]
        for count in ((32, 64, 128) if page.fast else (32, 64, 128, 256))
    ]
    names = [f"{c[0]} {c[1]:g}°, %" for c in cases]
    return (
        "## Error against seconds\n\n"
        f"Root mean square difference to the converged picture ({best['steps']} steps up or down, "
        f"{best['wavelengths']} wavelengths, {best['bearings']} bearings) over that picture's root "
        "mean square, above the horizon, one setting changed at a time; seconds with the others at "
        "their defaults, the mean of these skies.\n\n"
        + table(["setting", *names, "s"], rows)
        + "\n"
        + plot
        + "\nThe defaults leave an error below 1 %. Half of the bearings would suffice, except "
        "for the few texels at the edge of the planet's shadow. The next table shows the error "
        "of linear interpolation between texels (`resolution_error` in report.json), relative to "
        "the sky's mean, for different heights of the picture:\n\n"
        + table(["rows", *names, "s"], sizes)
    )


def extremes(page: Page) -> str:
    """Smallest, largest, steps between neighbors and seconds over the corners of the ranges."""
    rows = []
    elevations = (-10.0, 0.0, 90.0) if page.fast else (-90.0, -10.0, -1.0, 0.0, 1.0, 90.0)
    for planet, density, altitude in product(("earth", "mars"), (0.0, 10.0), (0.0, 60_000.0)):
        for elevation in elevations:
            case = (planet, elevation, altitude, (density,) * 3)
            start = time.perf_counter()
            picture = baked(case, 64)
            seconds = time.perf_counter() - start
            level = luminance(picture)
            steps = max(np.abs(np.diff(level, axis=k)).max() for k in (0, 1))
            share = steps / level.max() if level.any() else 0.0
            rows.append(
                [
                    planet,
                    f"{density:g}",
                    f"{altitude / 1000:g}",
                    f"{elevation:g}",
                    f"{picture.min():.1e}",
                    f"{picture.max():.1e}",
                    "yes" if np.isfinite(picture).all() else "NO",
                    f"{share:.2f}",
                    f"{seconds:.2f}",
                ]
            )
    return (
        "## Extremes\n\n64 rows, all densities alike, under sunlight of luminance 1. The step is "
        "the "
        "largest between neighboring texels over the picture's largest: without air, it is the "
        "horizon between black and ground.\n\n"
        + table(
            ["planet", "density", "altitude, km", "sun, °", "min", "max", "finite", "step", "s"],
            rows,
        )
    )


def main(page: Page) -> None:
    """Writes the page."""
    baked(ROWS["Earth, sun at 60°"], 16)
    parts = (pictures, beside_blender, left_out, several, curves, extremes)
    page.write(HEAD, ("numpy", "numba", "bpy"), parts)


if __name__ == "__main__":
    run(main, page="sky")
