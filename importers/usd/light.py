"""Makes the light of a cfg, of a stage's suns, domes and lamps."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, fields
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from scenec.backends.stage.lights import light_over_time, light_prims
from scenec.backends.stage.scene import UPRIGHT, Dome, Lamp, Sun
from scenec.backends.stage.sources import Sources
from scenec.backends.stage.times import time_codes
from scenec.compiler.light.latlong import directions, luminance
from scenec.importers.numbers import tidy, uniform
from scenec.importers.report import APPROXIMATED, DROPPED, TRANSLATED
from scenec.importers.scene import unused, varied_sun
from scenec.importers.usd.scene import Scene, name_of
from scenec.schemas import maps
from scenec.schemas.errors import ScenecError
from scenec.schemas.exr import read_rgb, write_rgb
from scenec.schemas.packages import as_file, packaged_name

#: Irradiance of a clear sky that is added, as a share of the sun's: as of the cfg's defaults.
_SKY_SHARE = 0.2
#: Rows of a picture of one even color.
_ROWS = 8


@dataclass(frozen=True)
class _Shining[T: (Sun, Dome, Lamp)]:
    """Holds a light of the stage at the first sample at which it gives light."""

    path: str
    light: T
    notes: tuple[str, ...]


def add_light(scene: Scene, sources: Sources) -> None:
    """Adds suns, the domes as one sky, and lamps; daylight where the stage has no light."""
    prims = light_prims(scene.stage)
    times = time_codes(scene.stage)
    lights: list[_Shining[Any]] = []
    for prim in prims:
        column = light_over_time(prim, scene.frame, times, sources)
        shining = [i for i, one in enumerate(column) if one is not None and _strength(one) > 0.0]
        if not shining:
            why = "gives no light: it is hidden, of no intensity, or scaled to nothing"
            scene.imported.report.add(DROPPED, str(prim.GetPath()), None, "", why)
            continue
        first = column[shining[0]]
        assert first is not None, "a light without strength"
        same = len(shining) == len(column) and all(_same(first, one) for one in column)
        notes = () if same else ("as it is at the first sample that it shines at",)
        lights.append(_Shining(str(prim.GetPath()), first, notes))
    light: dict[str, Any] = {"sun": None, "sky": {"type": "none"}}
    scene.imported.cfg["light"] = light
    suns = [one for one in lights if isinstance(one.light, Sun)]
    domes = [one for one in lights if isinstance(one.light, Dome)]
    for one in suns:
        _add_sun(scene, light, one)
    for one in lights:
        if isinstance(one.light, Lamp):
            _add_lamp(scene, light, one)
    if domes:
        light["sky"] = _sky(scene, domes)
    elif not prims:
        light["sky"], light["sun"] = {"type": "clear"}, varied_sun()
        scene.imported.report.added("light/sky", "the stage has no light: a clear sky")
        scene.imported.report.added("light/sun", "a sun that stands anywhere by day")
    elif light["sun"] and "light" not in scene.keep:
        share = tidy(_SKY_SHARE * light["sun"]["irradiance"])
        light["sky"] = {"type": "clear", "irradiance": share}
        scene.imported.report.added("light/sky", "a clear sky; --keep light adds none")
    else:
        scene.imported.report.added("light/sky", "black, as the stage's")
    if labels := scene.labels.sky():
        light["sky"]["labels"] = labels


def _strength(light: Sun | Dome | Lamp) -> float:
    if isinstance(light, Sun):
        return float(luminance(light.irradiance))
    return float(luminance(light.scale if isinstance(light, Dome) else light.intensity))


def _same(a: Sun | Dome | Lamp, b: Sun | Dome | Lamp | None) -> bool:
    return b is not None and all(
        np.array_equal(getattr(a, f.name), getattr(b, f.name)) for f in fields(a)
    )


def _colored(rgb: NDArray[np.float64]) -> list[float | int]:
    """Converts a color to one of a cfg: in [0, 1], of any luminance."""
    positive = np.maximum(rgb, 0.0)
    return [tidy(value) for value in (positive / positive.max()).tolist()]


def _add_sun(scene: Scene, light: dict[str, Any], one: _Shining[Sun]) -> None:
    sun, report = one.light, scene.imported.report
    elevation = math.degrees(math.asin(min(max(float(sun.to_light[2]), -1.0), 1.0)))
    azimuth = math.degrees(math.atan2(float(sun.to_light[0]), float(sun.to_light[1]))) % 360.0
    diameter = min(math.degrees(sun.diameter_rad), 90.0)
    entry: dict[str, Any] = {
        "elevation_deg": tidy(round(elevation, 6)),
        "azimuth_deg": tidy(round(azimuth, 6)),
        "irradiance": tidy(float(luminance(sun.irradiance))),
        "diameter_deg": tidy(diameter),
        "color": _colored(sun.irradiance),
    }
    notes = list(one.notes)
    if sun.gobo is not None:
        notes.append("shadows of clouds are left out")
    first = light["sun"] is None
    to = "light/sun" if first else f"light/more/{unused(name_of(one.path), light.get('more', {}))}"
    if first and "light" not in scene.keep:
        entry |= varied_sun()
        where = f"elevation {elevation:.1f}, azimuth {azimuth:.1f} there"
        notes.append(f"anywhere by day: {where}")
    elif elevation + 0.5 * diameter <= 0.0:
        why = f"it shines from below the horizon ({elevation:.1f}°), where no sun of a cfg does"
        report.add(DROPPED, one.path, None, "", why)
        return
    if first:
        light["sun"] = entry
    else:
        light.setdefault("more", {})[to.rpartition("/")[2]] = {"type": "sun", **entry}
    report.add(APPROXIMATED if notes else TRANSLATED, one.path, None, to, "; ".join(notes))
    report.add(TRANSLATED, f"{one.path}.inputs:intensity", entry["irradiance"], f"{to}/irradiance")


def _add_lamp(scene: Scene, light: dict[str, Any], one: _Shining[Lamp]) -> None:
    lamp, lamps = one.light, light.setdefault("lamps", {})
    name = unused(name_of(one.path), lamps)
    x, y, z = (lamp.position + scene.shift).tolist()
    elevation = math.degrees(math.asin(min(max(float(lamp.axis[2]), -1.0), 1.0)))
    bearing = math.degrees(math.atan2(float(lamp.axis[0]), float(lamp.axis[1]))) % 360.0
    lamps[name] = {
        "mount": {
            "type": "world",
            "heights": "world",
            **{k: float(f"{v:.12g}") for k, v in (("x_m", x), ("y_m", y), ("z_m", z))},
            "bearing_deg": tidy(round(bearing, 6)),
            "elevation_deg": tidy(round(elevation, 6)),
        },
        "intensity": tidy(float(luminance(lamp.intensity))),
        "color": _colored(lamp.intensity),
        "radius_m": tidy(lamp.radius_m),
        "cone_deg": tidy(min(math.degrees(lamp.cone), 180.0)),
        "softness": tidy(lamp.softness),
    }
    fate = APPROXIMATED if one.notes else TRANSLATED
    scene.imported.report.add(fate, one.path, None, f"light/lamps/{name}", "; ".join(one.notes))


def _sky(scene: Scene, domes: Sequence[_Shining[Dome]]) -> dict[str, Any]:
    """Makes the domes one picture: the stage's own if a cfg can turn and dim it."""
    notes = {note for one in domes for note in one.notes}
    sky: dict[str, Any] = {"type": "image"}
    dome, turn = domes[0].light, 0.0
    # What is left of its turn once it stands.
    stood = dome.to_world @ UPRIGHT.T
    upright = np.allclose(stood[2], (0.0, 0.0, 1.0), atol=1e-9) and np.linalg.det(stood) > 0.0
    even = len(domes) == 1 and float(np.ptp(dome.scale)) == 0.0
    if even and upright and isinstance(dome.texture, Path) and dome.texture.suffix == ".exr":
        sky["files"] = [scene.imported.refer(dome.texture)]
        if dome.scale[0] != 1.0:
            sky["strength"] = tidy(float(dome.scale[0]))
        # Counterclockwise from above in the stage, clockwise in a cfg.
        turn = -math.degrees(math.atan2(float(stood[1, 0]), float(stood[0, 0]))) % 360.0
    else:
        picture, blurred = _picture([one.light for one in domes])
        if blurred:
            notes.add("laid anew in one upright picture")
        sky["files"] = [scene.imported.make("sky.exr", lambda path: write_rgb(path, picture))]
    if "light" in scene.keep:
        if turn:
            sky["rotation_deg"] = tidy(round(turn, 6))
    else:
        sky["rotation_deg"] = uniform(0, 360)
        notes.add("turned by chance in each sample")
    for one in domes:
        fate = APPROXIMATED if notes else TRANSLATED
        scene.imported.report.add(fate, one.path, None, "light/sky", "; ".join(sorted(notes)))
    return sky


def _picture(domes: Sequence[Dome]) -> tuple[NDArray[np.float32], bool]:
    """Sums domes into one picture in a cfg's frame; tells whether one was resampled."""
    pictures = [
        None if dome.texture is None else _radiance(Path(str(dome.texture))) for dome in domes
    ]
    rows = max([_ROWS, *(len(picture) for picture in pictures if picture is not None)])
    total = np.zeros((rows, 2 * rows, 3))
    blurred = False
    for dome, picture in zip(domes, pictures, strict=True):
        if picture is None:
            total += dome.scale
            continue
        same = picture.shape[:2] == total.shape[:2]
        if same and np.allclose(dome.to_world, UPRIGHT, atol=1e-9):
            total += picture * dome.scale
            continue
        blurred = True
        total += _looked_up(picture, directions(rows) @ dome.to_world) * dome.scale
    return np.maximum(total, 0.0).astype(np.float32), blurred


def _radiance(file: Path) -> NDArray[np.float32]:
    try:
        if packaged_name(file).lower().endswith(".exr"):
            with as_file(file) as own:
                return np.maximum(read_rgb(own), np.float32(0.0))
        return maps.decode(maps.read_pixels(file), "emission")
    except ValueError as error:
        raise ScenecError(f"{file}: {error}") from error


def _looked_up(picture: NDArray[np.float32], at: NDArray[np.float64]) -> NDArray[np.float64]:
    """Returns radiance from directions in a dome's frame, [..., 3], bilinear between texels."""
    height, width = picture.shape[:2]
    u = (0.5 - np.arctan2(at[..., 0], at[..., 2]) / (2.0 * np.pi)) * width - 0.5
    v = np.arctan2(np.hypot(at[..., 0], at[..., 2]), at[..., 1]) / np.pi * height - 0.5
    v = np.clip(v, 0.0, height - 1.0)
    column, row = np.floor(u).astype(np.int64), np.floor(v).astype(np.int64)
    right, below = (u - column)[..., None], (v - row)[..., None]
    under = np.minimum(row + 1, height - 1)

    def texel(i: NDArray[np.int64], j: NDArray[np.int64]) -> NDArray[np.float64]:
        value: NDArray[np.float64] = picture[i, j % width].astype(np.float64)
        return value

    top = (1.0 - right) * texel(row, column) + right * texel(row, column + 1)
    bottom = (1.0 - right) * texel(under, column) + right * texel(under, column + 1)
    return (1.0 - below) * top + below * bottom
