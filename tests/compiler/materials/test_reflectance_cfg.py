"""Laws of reflectance from cfg to stage to what backends read."""

from __future__ import annotations

import math
import shutil
from pathlib import Path

import pytest
from pxr import Sdf, Usd

from scenec.backends.check.stage import check_stage
from scenec.backends.stage.read import read_stage
from scenec.compiler.compile import compile_cfg
from scenec.schemas.errors import StageError
from scenec.testing.small import small_cfg, write_cfg

LAWS = {
    "sand": {"type": "hapke", "b": {"type": "uniform", "min": 0.2, "max": 0.3}, "c": -0.4},
    "gravel": {"type": "lommel_seeliger", "opposition": 1.5},
    "mud": {"type": "lambert"},
}


@pytest.fixture(scope="module")
def batch(tmp_path_factory) -> Path:
    """A batch of which all materials but one name a law."""
    folder = tmp_path_factory.mktemp("laws")
    cfg = small_cfg()
    for name, law in LAWS.items():
        cfg["materials"][name]["reflectance"] = law
    compile_cfg(write_cfg(folder, cfg), seed=3, out=folder / "out")
    return folder / "out" / "batch_0000"


def test_laws_are_read_back_as_they_were_given(batch):
    surfaces = {s.path.rsplit("/")[-1]: s for s in read_stage(batch / "stage.usda").surfaces}
    hapke, dark = surfaces["sand"].reflectance, surfaces["gravel"].reflectance
    assert surfaces["mud"].reflectance is None
    assert surfaces["stone"].reflectance is None
    assert hapke.model == "hapke"
    assert 0.2 <= hapke.b <= 0.3
    assert (hapke.c, hapke.opposition) == pytest.approx((-0.4, 1.993))
    assert hapke.roughness == pytest.approx(math.radians(23.657))
    assert dark.model == "lommel_seeliger"
    assert (dark.b, dark.c, dark.opposition, dark.roughness) == (0.0, 0.0, 1.5, 0.0)


def test_the_stage_is_sound_and_lambert_is_not_written(batch):
    assert [str(finding) for finding in check_stage(batch / "stage.usda")] == []
    stage = Usd.Stage.Open(str(batch / "stage.usda"))
    named = [
        name
        for name in (*LAWS, "stone")
        if stage.GetAttributeAtPath(f"/World/Looks/{name}.scenec:surface:reflectance")
    ]
    assert named == ["sand", "gravel"]


@pytest.mark.parametrize(
    ("name", "kind", "value", "refused"),
    [
        ("reflectance", "Token", "minnaert", "; known: lambert, lommel_seeliger, hapke"),
        ("phase:b", "Float", 1.0, r"is 1.0, expected a number in \[0, 1\)"),
        ("phase:c", "Float", math.nan, "is nan, expected a number"),
        ("opposition", "Float", math.inf, r"is inf, expected a number in \[0, inf\)"),
        ("oppositionWidth", "Float", 0.0, r"expected a number in \(0, inf\)"),
        ("meanSlope", "String", "steep", "meanSlope: is of type string, expected a number"),
    ],
)
def test_a_stage_that_says_nonsense_is_refused(batch, tmp_path, name, kind, value, refused):
    folder = tmp_path / "batch"
    shutil.copytree(batch, folder)
    layer = Sdf.Layer.FindOrOpen(str(folder / "looks" / "sand.usda"))
    prim = layer.GetPrimAtPath("/World/Looks/sand")
    attribute = f"scenec:surface:{name}"
    del prim.properties[attribute]
    Sdf.AttributeSpec(prim, attribute, getattr(Sdf.ValueTypeNames, kind)).default = value
    layer.Save()
    with pytest.raises(StageError, match=refused):
        read_stage(folder / "stage.usda")
