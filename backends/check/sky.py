"""Checks of the Sky prim: what label maps hold, the label table knows."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import numpy as np
from pxr import Sdf, Usd

from scenec.backends.check.finding import Finding
from scenec.backends.stage.labels import LabelTable
from scenec.backends.stage.sky_labels import load_label_map
from scenec.schemas import stage as names
from scenec.schemas.errors import StageError


def check_sky(stage: Usd.Stage, table: LabelTable) -> Iterator[Finding]:
    """Label maps are pictures of one channel, with ids that the table knows."""
    prim = stage.GetPrimAtPath(names.SKY_PRIM)
    if not prim:
        return
    for level, file in _label_maps(prim, table):
        try:
            ids = set(np.unique(load_label_map(file)).tolist())
        except StageError as error:
            yield Finding("sky-labels", "error", str(prim.GetPath()), str(error))
            continue
        unknown = sorted(ids - {0, *table.ids[level].values()})
        if unknown:
            message = f"{file.name} has ids {unknown[:5]} that the level {level} lacks"
            yield Finding("sky-labels", "error", str(prim.GetPath()), message)


def _label_maps(prim: Usd.Prim, table: LabelTable) -> list[tuple[str, Path]]:
    """Level and file of each label map, once."""
    found: dict[tuple[str, Path], None] = {}
    for level in table.levels:
        attribute = prim.GetAttribute(names.ATTR_SKY_LABEL_MAP.format(level=level))
        if not attribute:
            continue
        for time in attribute.GetTimeSamples() or [Usd.TimeCode.Default()]:
            asset = attribute.Get(time)
            # One that is not there is another check's.
            if isinstance(asset, Sdf.AssetPath) and asset.resolvedPath:
                found[level, Path(asset.resolvedPath)] = None
    return list(found)
