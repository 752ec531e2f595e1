"""What the Sky prim says at each sample: label maps and haze."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from pxr import Usd

from scenec.backends.stage import values
from scenec.backends.stage.frame import StageFrame
from scenec.backends.stage.labels import LabelTable
from scenec.backends.stage.scene import Haze, SkyLabelMap
from scenec.backends.stage.sources import Sources
from scenec.schemas import stage as names
from scenec.schemas.errors import StageError

#: A dome's frame (pole +Y, center +Z) stood up in a Z-up world, as OrientToStageUpAxis does.
_STANDING = np.array([[1.0, 0.0, 0.0], [0.0, 0.0, -1.0], [0.0, 1.0, 0.0]])


def read_sky_label_maps(
    stage: Usd.Stage, table: LabelTable, times: list[Usd.TimeCode], sources: Sources
) -> tuple[dict[str, SkyLabelMap], ...]:
    """Label maps by level, at each sample; () where the stage has none.

    Where one is missing, the sky has its one label.

    Raises:
        StageError: A value is not what it can be.
    """
    prim = stage.GetPrimAtPath(names.SKY_PRIM)
    found = tuple(_label_maps(prim, table, time, sources) if prim else {} for time in times)
    return found if any(found) else ()


def _label_maps(
    prim: Usd.Prim, table: LabelTable, time: Usd.TimeCode, sources: Sources
) -> dict[str, SkyLabelMap]:
    maps = {}
    for level in table.levels:
        attribute = prim.GetAttribute(names.ATTR_SKY_LABEL_MAP.format(level=level))
        file = sources.picture(attribute, time)
        if file is None:
            continue
        rotation = prim.GetAttribute(names.ATTR_SKY_ROTATION)
        turn = np.radians(values.number(rotation, 0.0, time))
        # Clockwise from above is negative about +Z.
        c, s = np.cos(turn), np.sin(turn)
        maps[level] = SkyLabelMap(
            file, np.array([[c, s, 0.0], [-s, c, 0.0], [0.0, 0.0, 1.0]]) @ _STANDING
        )
    return maps


def read_haze(
    stage: Usd.Stage, frame: StageFrame, times: list[Usd.TimeCode]
) -> tuple[Haze | None, ...]:
    """Haze at each sample; () where the stage has none.

    Raises:
        StageError: Its numbers are negative or not finite.
    """
    prim = stage.GetPrimAtPath(names.SKY_PRIM)
    found = tuple(_haze(prim, frame, time) if prim else None for time in times)
    return found if any(found) else ()


def _haze(prim: Usd.Prim, frame: StageFrame, time: Usd.TimeCode) -> Haze | None:
    extinction = _color(prim, names.ATTR_HAZE_EXTINCTION, time)
    if extinction is None or not extinction.any():
        return None
    scale = prim.GetAttribute(names.ATTR_HAZE_SCALE_HEIGHT)
    height = values.number(scale, np.inf, time, finite=False)
    if not height > 0.0:
        raise StageError(
            f"{prim.GetPath()}: {names.ATTR_HAZE_SCALE_HEIGHT} is {height}, expected above 0"
        )
    ground = prim.GetAttribute(names.ATTR_HAZE_FLOOR)
    floor = None
    if values.value_of(ground, time) is not None:
        floor = values.number(ground, 0.0, time) * frame.meters_per_unit
    return Haze(
        extinction=extinction / frame.meters_per_unit,
        scale_height_m=height * frame.meters_per_unit,
        airlight=_color(prim, names.ATTR_HAZE_AIRLIGHT, time),
        floor_m=floor,
    )


def _color(prim: Usd.Prim, name: str, time: Usd.TimeCode) -> NDArray[np.float64] | None:
    value = values.vector(prim.GetAttribute(name), 3, time)
    if value is None:
        return None
    if min(value) < 0.0:
        raise StageError(f"{prim.GetPath()}: {name} is {value}, expected three numbers from 0 on")
    return np.array(value)
