"""What the Sky prim says at each sample: label maps and haze."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from pxr import Sdf, Usd

from scenec.backends.reader.frame import StageFrame
from scenec.backends.reader.labels import LabelTable
from scenec.backends.render_scene import Haze, SkyLabelMap
from scenec.schemas import stage as names
from scenec.schemas.errors import StageError

#: A dome's frame (pole +Y, center +Z) stood up in a Z-up world, as OrientToStageUpAxis does.
_STANDING = np.array([[1.0, 0.0, 0.0], [0.0, 0.0, -1.0], [0.0, 1.0, 0.0]])


def read_sky_label_maps(
    stage: Usd.Stage, table: LabelTable, times: list[Usd.TimeCode]
) -> tuple[dict[str, SkyLabelMap], ...]:
    """Label maps by level, at each sample; () where the stage has none.

    Raises:
        StageError: A picture does not exist.
    """
    prim = stage.GetPrimAtPath(names.SKY_PRIM)
    found = tuple(_label_maps(prim, table, time) if prim else {} for time in times)
    return found if any(found) else ()


def _label_maps(prim: Usd.Prim, table: LabelTable, time: Usd.TimeCode) -> dict[str, SkyLabelMap]:
    maps = {}
    for level in table.levels:
        asset = _value(prim, names.ATTR_SKY_LABEL_MAP.format(level=level), time)
        if not isinstance(asset, Sdf.AssetPath) or not asset.path:
            continue
        file = Path(asset.resolvedPath or asset.path)
        if not file.is_file():
            raise StageError(f"{prim.GetPath()}: its label map {asset.path} does not exist")
        turn = np.radians(float(_value(prim, names.ATTR_SKY_ROTATION, time) or 0.0))
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
    height = _value(prim, names.ATTR_HAZE_SCALE_HEIGHT, time)
    if height is not None and not float(height) > 0.0:
        raise StageError(
            f"{prim.GetPath()}: {names.ATTR_HAZE_SCALE_HEIGHT} is {height}, expected above 0"
        )
    floor = _value(prim, names.ATTR_HAZE_FLOOR, time)
    if floor is not None and not np.isfinite(float(floor)):
        raise StageError(f"{prim.GetPath()}: {names.ATTR_HAZE_FLOOR} is {floor}, expected a height")
    return Haze(
        extinction=extinction / frame.meters_per_unit,
        scale_height_m=np.inf if height is None else float(height) * frame.meters_per_unit,
        airlight=_color(prim, names.ATTR_HAZE_AIRLIGHT, time),
        floor_m=None if floor is None else float(floor) * frame.meters_per_unit,
    )


def _color(prim: Usd.Prim, name: str, time: Usd.TimeCode) -> NDArray[np.float64] | None:
    value = _value(prim, name, time)
    if value is None:
        return None
    color = np.array(value, np.float64)
    if color.shape != (3,) or not np.isfinite(color).all() or (color < 0.0).any():
        raise StageError(f"{prim.GetPath()}: {name} is {value}, expected three numbers from 0 on")
    return color


def _value(prim: Usd.Prim, name: str, time: Usd.TimeCode) -> Any:
    attribute = prim.GetAttribute(name)
    return attribute.Get(time) if attribute and attribute.HasValue() else None
