"""Roughness variation from cfg to stage to arrays."""

from __future__ import annotations

import shutil
from pathlib import Path

import numpy as np
import pytest
from pxr import Sdf, Usd

from scenec.backends.check.stage import check_stage
from scenec.backends.stage.read import read_stage
from scenec.compiler.compile import compile_cfg
from scenec.schemas.errors import StageError
from scenec.testing.small import small_cfg, write_cfg

ATTRIBUTE = "scenec:surface:roughnessVariation"
AMOUNTS = {
    "sand": -0.4,
    "gravel": 1.0,
    "mud": 0.0,
    "stone": {"type": "uniform", "min": 0.2, "max": 0.3},
}


@pytest.fixture(scope="module")
def batch(tmp_path_factory) -> Path:
    """A batch of which all materials but one say something of it."""
    folder = tmp_path_factory.mktemp("rough")
    cfg = small_cfg()
    for name, amount in AMOUNTS.items():
        cfg["materials"][name] |= {"roughness_variation": amount, "specular": 0.1}
    compile_cfg(write_cfg(folder, cfg), seed=3, out=folder / "out")
    return folder / "out" / "batch_0000"


def test_it_is_authored_where_it_is_not_zero_and_read_back(batch):
    stage = Usd.Stage.Open(str(batch / "stage.usda"))
    surfaces = {s.path.rsplit("/")[-1]: s for s in read_stage(batch / "stage.usda").surfaces}
    for name in AMOUNTS:
        attribute = stage.GetAttributeAtPath(f"/World/Looks/{name}.{ATTRIBUTE}")
        assert bool(attribute) == (name != "mud")
        read = surfaces[name].roughness_variation
        if name == "stone":
            assert 0.2 <= read <= 0.3
        else:
            assert read == pytest.approx(AMOUNTS[name])
        assert surfaces[name].varies == (name != "mud")


def test_the_stage_is_sound(batch):
    assert [str(finding) for finding in check_stage(batch / "stage.usda")] == []


def test_a_cfg_that_says_zero_gives_the_bytes_of_one_that_says_nothing(tmp_path):
    looks = []
    for name, said in (("a", {}), ("b", {"roughness_variation": 0})):
        cfg = small_cfg()
        cfg["materials"]["mud"] |= said
        (tmp_path / name).mkdir()
        compile_cfg(write_cfg(tmp_path / name, cfg), seed=3, out=tmp_path / name / "out")
        folder = tmp_path / name / "out" / "batch_0000"
        looks.append({p.name: p.read_bytes() for p in sorted(folder.rglob("*.usd*"))})
    assert looks[0] == looks[1]
    assert not any(ATTRIBUTE.encode() in content for content in looks[0].values())


@pytest.mark.parametrize(
    ("kind", "value", "found", "refused"),
    [
        ("Float", 1.5, "is 1.5, expected -1 to 1", None),
        ("Float", np.nan, "is nan, expected a number", "is nan, expected a finite number"),
        ("String", "wet", "is of type string", "is of type string, expected a finite number"),
    ],
)
def test_a_stage_that_says_nonsense_is_found_and_refused(
    batch, tmp_path, kind, value, found, refused
):
    folder = tmp_path / "batch"
    shutil.copytree(batch, folder)
    layer = Sdf.Layer.FindOrOpen(str(folder / "looks" / "sand.usda"))
    prim = layer.GetPrimAtPath("/World/Looks/sand")
    del prim.properties[ATTRIBUTE]
    Sdf.AttributeSpec(prim, ATTRIBUTE, getattr(Sdf.ValueTypeNames, kind)).default = value
    layer.Save()
    findings = [str(finding) for finding in check_stage(folder / "stage.usda")]
    assert len(findings) == 1, findings
    assert found in findings[0]
    if refused is None:
        assert read_stage(folder / "stage.usda").surfaces
    else:
        with pytest.raises(StageError, match=f"/World/Looks/sand.{ATTRIBUTE}: {refused}"):
            read_stage(folder / "stage.usda")
