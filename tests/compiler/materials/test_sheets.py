"""Light through thin sheets, from cfg and model to stage, renderers and other formats."""

from __future__ import annotations

import numpy as np
import pytest
from pxr import Usd

from scenec.backends.check.stage import check_stage
from scenec.backends.stage.read import read_stage
from scenec.compiler.assets.model import read_model
from scenec.compiler.compile import compile_cfg
from scenec.schemas import stage as names
from scenec.testing.models import gltf_parts
from scenec.testing.overhangs import glb
from scenec.testing.small import small_cfg, write_cfg

THROUGH = "KHR_materials_diffuse_transmission"


def test_a_share_is_authored_where_it_is_above_zero_and_read_back(tmp_path):
    cfg = small_cfg()
    cfg["materials"]["sand"]["diffuse_transmission"] = 0.25
    cfg["materials"]["mud"]["diffuse_transmission"] = 1
    compile_cfg(write_cfg(tmp_path, cfg), seed=3, out=tmp_path / "out")
    root = tmp_path / "out/batch_0000/stage.usda"
    stage = Usd.Stage.Open(str(root))
    for surface in read_stage(root).surfaces:
        expected = {"sand": 0.25, "mud": 1.0}.get(surface.path.rpartition("/")[2], 0.0)
        attribute = stage.GetAttributeAtPath(f"{surface.path}.{names.ATTR_DIFFUSE_TRANSMISSION}")
        assert bool(attribute) == surface.transmits == (expected > 0.0)
        assert surface.diffuse_transmission == expected
    assert not list(check_stage(root))


def test_zero_is_the_same_bytes_as_nothing(tmp_path):
    written = []
    for name, said in (("a", {}), ("b", {"diffuse_transmission": 0})):
        cfg = small_cfg()
        cfg["materials"]["mud"] |= said
        (tmp_path / name).mkdir()
        compile_cfg(write_cfg(tmp_path / name, cfg), seed=3, out=tmp_path / name / "out")
        folder = tmp_path / name / "out/batch_0000"
        written.append({p.name: p.read_bytes() for p in sorted(folder.rglob("*.usd*"))})
    assert written[0] == written[1]


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
