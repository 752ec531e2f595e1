"""Laws of reflectance, roughness variation and thin sheets: from cfg and model to the stage."""

from __future__ import annotations

import math
import shutil
from pathlib import Path

import numpy as np
import pytest
from pxr import Sdf, Usd

from scenec.backends.check.stage import check_stage
from scenec.backends.stage.read import read_stage
from scenec.compiler.assets.model import read_model
from scenec.compiler.compile import compile_cfg
from scenec.schemas import stage as names
from scenec.schemas.errors import StageError
from scenec.testing.models import gltf_parts
from scenec.testing.overhangs import glb
from scenec.testing.small import small_cfg, write_cfg

LAW, VARIATION = "scenec:surface:reflectance", "scenec:surface:roughnessVariation"
THROUGH = "KHR_materials_diffuse_transmission"
KEYS = {
    "sand": {
        "reflectance": {
            "type": "hapke",
            "b": {"type": "uniform", "min": 0.2, "max": 0.3},
            "c": -0.4,
        },
        "roughness_variation": -0.4,
        "diffuse_transmission": 0.25,
    },
    "gravel": {
        "reflectance": {"type": "lommel_seeliger", "opposition": 1.5},
        "roughness_variation": 1.0,
    },
    "mud": {
        "reflectance": {"type": "lambert"},
        "roughness_variation": 0,
        "diffuse_transmission": 1,
    },
    "stone": {"roughness_variation": {"type": "uniform", "min": 0.2, "max": 0.3}},
}


@pytest.fixture(scope="module")
def batch(tmp_path_factory) -> Path:
    """A batch whose materials say something of each, and one nothing of two."""
    folder = tmp_path_factory.mktemp("laws")
    cfg = small_cfg()
    for name, keys in KEYS.items():
        cfg["materials"][name] |= {"specular": 0.1} | keys
    compile_cfg(write_cfg(folder, cfg), seed=3, out=folder / "out")
    return folder / "out" / "batch_0000"


@pytest.fixture(scope="module")
def surfaces(batch) -> dict:
    return {s.path.rsplit("/")[-1]: s for s in read_stage(batch / "stage.usda").surfaces}


def test_laws_are_read_back_as_they_were_given(surfaces):
    hapke, dark = surfaces["sand"].reflectance, surfaces["gravel"].reflectance
    assert surfaces["mud"].reflectance is None
    assert surfaces["stone"].reflectance is None
    assert hapke.model == "hapke"
    assert 0.2 <= hapke.b <= 0.3
    assert (hapke.c, hapke.opposition) == pytest.approx((-0.4, 1.993))
    assert hapke.roughness == pytest.approx(math.radians(23.657))
    assert dark.model == "lommel_seeliger"
    assert (dark.b, dark.c, dark.opposition, dark.roughness) == (0.0, 0.0, 1.5, 0.0)


def test_variation_and_transmission_are_read_back_as_they_were_given(surfaces):
    found = [surfaces[name].roughness_variation for name in ("sand", "gravel", "mud", "stone")]
    assert found == pytest.approx([-0.4, 1.0, 0.0, 0.25], abs=0.05 + 1e-6)
    assert found[:3] == pytest.approx([-0.4, 1.0, 0.0])
    assert [surfaces[name].varies for name in KEYS] == [True, True, False, True]
    assert [surfaces[name].diffuse_transmission for name in KEYS] == [0.25, 0.0, 1.0, 0.0]
    assert [surfaces[name].transmits for name in KEYS] == [True, False, True, False]


def test_the_stage_is_sound_and_what_is_zero_or_lambert_is_not_written(batch):
    assert [str(finding) for finding in check_stage(batch / "stage.usda")] == []
    stage = Usd.Stage.Open(str(batch / "stage.usda"))
    for attribute, authored in (
        (LAW, {"sand", "gravel"}),
        (VARIATION, {"sand", "gravel", "stone"}),
        (names.ATTR_DIFFUSE_TRANSMISSION, {"sand", "mud"}),
    ):
        there = {n for n in KEYS if stage.GetAttributeAtPath(f"/World/Looks/{n}.{attribute}")}
        assert there == authored


def test_a_cfg_that_says_zero_gives_the_bytes_of_one_that_says_nothing(tmp_path):
    written = []
    for name, said in (("a", {}), ("b", {"diffuse_transmission": 0, "roughness_variation": 0})):
        cfg = small_cfg()
        cfg["materials"]["mud"] |= said
        (tmp_path / name).mkdir()
        compile_cfg(write_cfg(tmp_path / name, cfg), seed=3, out=tmp_path / name / "out")
        folder = tmp_path / name / "out/batch_0000"
        written.append({p.name: p.read_bytes() for p in sorted(folder.rglob("*.usd*"))})
    assert written[0] == written[1]
    assert not any(VARIATION.encode() in content for content in written[0].values())


@pytest.mark.parametrize(
    ("name", "kind", "value", "refused", "found"),
    [
        ("reflectance", "Token", "minnaert", "; known: lambert, lommel_seeliger, hapke", None),
        ("phase:b", "Float", 1.0, r"is 1.0, expected a number in \[0, 1\)", None),
        ("phase:c", "Float", math.nan, "is nan, expected a number", None),
        ("opposition", "Float", math.inf, r"is inf, expected a number in \[0, inf\)", None),
        ("oppositionWidth", "Float", 0.0, r"expected a number in \(0, inf\)", None),
        ("meanSlope", "String", "steep", "meanSlope: is of type string, expected a number", None),
        ("roughnessVariation", "Float", 1.5, None, "is 1.5, expected -1 to 1"),
        ("roughnessVariation", "Float", math.nan, "expected a finite number", "is nan, expected a"),
        ("roughnessVariation", "String", "wet", "of type string, expected a", "is of type string"),
    ],
)
def test_a_stage_that_says_nonsense_is_found_and_refused(
    batch, tmp_path, name, kind, value, refused, found
):
    folder = tmp_path / "batch"
    shutil.copytree(batch, folder)
    layer = Sdf.Layer.FindOrOpen(str(folder / "looks" / "sand.usda"))
    prim = layer.GetPrimAtPath("/World/Looks/sand")
    attribute = f"scenec:surface:{name}"
    del prim.properties[attribute]
    Sdf.AttributeSpec(prim, attribute, getattr(Sdf.ValueTypeNames, kind)).default = value
    layer.Save()
    if found is not None:
        (finding,) = map(str, check_stage(folder / "stage.usda"))
        assert found in finding
    if refused is None:
        assert read_stage(folder / "stage.usda").surfaces
    else:
        with pytest.raises(StageError, match=refused):
            read_stage(folder / "stage.usda")


@pytest.mark.parametrize(
    ("said", "share", "noted"),
    [
        ({}, 0.0, False),
        ({"diffuseTransmissionFactor": 0.4, "diffuseTransmissionColorFactor": None}, 0.4, False),
        # By the extension white, where it is left out.
        ({"diffuseTransmissionFactor": 0.4}, 0.4, True),
        ({"diffuseTransmissionFactor": 3, "diffuseTransmissionColorFactor": None}, 1.0, False),
    ],
)
def test_models_say_what_their_sheets_transmit(tmp_path, said, share, noted):
    document, binary = gltf_parts(False)
    (material,) = [m for m in document["materials"] if m["name"] == "plain"]
    color = material["pbrMetallicRoughness"].get("baseColorFactor", [1, 1, 1, 1])[:3]
    said = {key: color if value is None else value for key, value in said.items()}
    material["extensions"] = {THROUGH: said}
    (tmp_path / "a.glb").write_bytes(glb(document, binary))
    model = read_model(tmp_path / "a.glb")
    found = {m.name: m for m in model.materials}
    assert found["plain"].diffuse_transmission == share
    assert found["painted"].diffuse_transmission == 0.0
    assert any("the color of what it reflects" in note for note in model.notes) == noted
    np.testing.assert_allclose(found["plain"].base_color, color)
