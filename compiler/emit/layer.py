"""Begins layers, and authors values over the samples."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray
from pxr import Gf, Sdf, Usd, UsdGeom, UsdSemantics

from scenec.compiler.scene.labels import Labels
from scenec.compiler.scene.material import Material
from scenec.schemas import stage as names

TYPES = Sdf.ValueTypeNames


class Appearance(NamedTuple):
    """Holds the materials and labels that the outputs show.

    Attributes:
        materials: By name; empty where no color is asked for.
        label_table: Per level, label name -> id; empty where no labels are asked for.
    """

    materials: Mapping[str, Material]
    label_table: Mapping[str, Mapping[str, int]]


@contextmanager
def new_layer(path: Path) -> Iterator[Usd.Stage]:
    """A stage on a new layer in meters, Z up, with ``/World`` as default prim; saved on leaving."""
    path.parent.mkdir(parents=True, exist_ok=True)
    if path.suffix == ".usda":
        # Written once, not empty first; of a binary layer that would move bytes.
        layer = Sdf.Layer.New(Sdf.FileFormat.FindById("usda"), str(path))
        stage = Usd.Stage.Open(layer)
    else:
        stage = Usd.Stage.CreateNew(str(path))
    UsdGeom.SetStageMetersPerUnit(stage, 1.0)
    UsdGeom.SetStageUpAxis(stage, UsdGeom.Tokens.z)
    # In every layer alike: USD scales the time samples of a sublayer that differs from its root.
    stage.SetTimeCodesPerSecond(1.0)
    stage.SetFramesPerSecond(1.0)
    stage.SetDefaultPrim(stage.OverridePrim(names.ROOT))
    yield stage
    stage.GetRootLayer().Save()


def author(attribute: Usd.Attribute, values: Sequence[Any]) -> None:
    """Authors one value a sample.

    The default is sample 0's, so that viewers at the default time show something; time samples are
    left out where all are equal.
    """
    attribute.Set(values[0])
    if any(value != values[0] for value in values[1:]):
        for time_code, value in enumerate(values):
            attribute.Set(value, float(time_code))


def custom(prim: Usd.Prim, name: str, kind: Sdf.ValueTypeName) -> Usd.Attribute:
    """An attribute that no schema of USD's has."""
    return prim.CreateAttribute(name, kind, custom=True)


def matrix(columns: NDArray[np.float64]) -> Gf.Matrix4d:
    """A transform [3 or 4, 4] of column vectors; Gf's act on row vectors: the transpose."""
    rows = np.eye(4)
    rows[:, : len(columns)] = columns.T
    return Gf.Matrix4d(*rows.ravel().tolist())


def label(prim: Usd.Prim, labels: dict[str, str]) -> None:
    """Standard semantic labels: one taxonomy a level, the label's name as its only entry."""
    for level, name in labels.items():
        UsdSemantics.LabelsAPI.Apply(prim, level).CreateLabelsAttr([name])


def label_names(table: Mapping[str, Mapping[str, int]], labels: Labels) -> dict[str, str]:
    """Names of label ids, on the levels of a table (name -> id) that know them."""
    found = {}
    for level, ids in table.items():
        by_id = {number: name for name, number in ids.items()}
        if labels.get(level) in by_id:
            found[level] = by_id[labels[level]]
    return found


def constant_label_ids(prim: Usd.Prim, labels: Labels) -> None:
    """One label id for all faces below a prim, per level, as an inherited primvar."""
    api = UsdGeom.PrimvarsAPI(prim)
    for level, label_id in labels.items():
        primvar = api.CreatePrimvar(names.label_primvar(level), TYPES.Int, UsdGeom.Tokens.constant)
        primvar.Set(label_id)
