"""Scan patterns of another package: the rosette of docs/example_plugins over level ground."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import trimesh

from scenec.backends.run.scan import scan_output
from scenec.compiler.cfg.load import load
from scenec.compiler.compile import compile_cfg
from scenec.compiler.draw import draw
from scenec.compiler.kinds import schema
from scenec.schemas import plugins
from scenec.schemas.errors import CfgError, SceneError
from scenec.schemas.scans import read_scan
from scenec.testing.small import small_cfg

EXAMPLE = Path(__file__).resolve().parents[2] / "docs" / "example_plugins"


def cfg(**lidar: Any) -> dict[str, Any]:
    """Level ground, and a rig 3 m above it that looks down at it, with a lidar."""
    document = small_cfg(samples=1, objects={})
    del document["materials"]["stone"]
    del document["labels"]["class"]["rock"], document["labels"]["surface"]["stone"]
    document["terrain"] |= {"size_m": [40, 40], "relief": [{"type": "plane"}]}
    rig = document["rigs"]["rover"]
    rig["pose"]["position"] |= {"x_m": 0, "y_m": 0, "height_m": 3}
    rig["pose"]["target"]["distance_m"] = 5
    rig["sensors"]["front"]["outputs"] = ["depth", "label"]
    rig["lidars"] = {"top": {"noise": {"range_m": 0}} | lidar}
    return document


@pytest.fixture(autouse=True)
def _package(tmp_path, monkeypatch):
    """Offers the example's rosette."""
    info = tmp_path / "site" / "scenec_farmland-1.0.dist-info"
    info.mkdir(parents=True)
    (info / "METADATA").write_text("Metadata-Version: 2.1\nName: scenec-farmland\nVersion: 1.0\n")
    (info / "entry_points.txt").write_text("[scenec.scans]\nrosette = scenec_farmland:Rosette\n")
    monkeypatch.syspath_prepend(str(EXAMPLE))
    monkeypatch.syspath_prepend(str(tmp_path / "site"))
    for found in (plugins.load_kind, schema.kind_schema):
        found.cache_clear()
    yield
    for found in (plugins.load_kind, schema.kind_schema):
        found.cache_clear()


def written(folder: Path, document: dict[str, Any]) -> Path:
    path = folder / "rosette.json"
    path.write_text(json.dumps(document))
    return path


@pytest.mark.usefixtures("workers_here")
def test_rays_of_a_pattern_meet_level_ground_where_they_should(tmp_path):
    law = {"type": "uniform", "min": 15, "max": 20}
    pattern = {"type": "rosette", "radius_deg": law, "petals": 3, "count": 500}
    compile_cfg(written(tmp_path, cfg(pattern=pattern)), seed=3, out=tmp_path / "out")
    (stem,) = scan_output(tmp_path / "out", clouds=["ply"]).scans
    scan = read_scan(stem)
    assert scan.sidecar.version == "1.1"
    up, left = (np.radians(scan.arrays[f"{name}_deg"]) for name in ("elevation", "azimuth"))
    assert up.shape == left.shape == (1, 500)
    # A rose of three petals: r = R cos(3 t).
    turn = np.arange(500) * 2.0 * np.pi / 500
    assert left[0, 0] == pytest.approx(np.hypot(up, left).max())
    assert 15.0 < np.degrees(left[0, 0]) < 20.0
    np.testing.assert_allclose(np.hypot(up, left)[0], left[0, 0] * np.abs(np.cos(3.0 * turn)))
    own = np.stack([np.cos(up) * np.cos(left), np.cos(up) * np.sin(left), np.sin(up)], axis=-1)
    pose = np.array(scan.sidecar.lidar_to_world)
    assert pose[:3, 3] == pytest.approx([0.0, 0.0, 3.0])
    toward = own @ pose[:3, :3].T
    assert scan.arrays["range_true"] == pytest.approx(-3.0 / toward[..., 2], rel=1e-9)
    assert scan.arrays["incidence"] == pytest.approx(-toward[..., 2], abs=1e-6)
    assert (scan.arrays["label.class"] == 2).all()
    # A reader of point clouds sees the ground where it is.
    points = np.asarray(trimesh.load(stem.with_suffix(".ply")).vertices)
    assert points == pytest.approx((own * scan.arrays["range_true"][..., None])[0], rel=1e-6)
    assert (points @ pose[:3, :3].T + pose[:3, 3])[:, 2] == pytest.approx(0.0, abs=1e-5)


@pytest.mark.parametrize(
    ("lidar", "place", "message"),
    [
        ({"pattern": {"type": "rosete"}}, "/pattern/type", 'did you mean "rosette"?'),
        ({"pattern": {"type": "rosette", "petal": 3}}, "/pattern/petal", 'mean "petals"'),
        ({"pattern": {"type": "rosette", "count": 0}}, "/pattern/count", "expected at least 1"),
        ({"pattern": {"type": "rosette"}, "beams": 4}, "/beams", "both say where its rays go"),
        ({"pattern": {"type": "rosette"}, "azimuths": 4}, "/azimuths", "take one away"),
        ({"beams": 4}, "", 'the key "azimuths" is missing (Directions of each beam in a scan'),
        ({"azimuths": 4}, "", "expected either the key beams or the key elevations_deg"),
    ],
)
def test_a_pattern_stands_in_place_of_beams_and_its_keys_are_checked(
    lidar, place, message, tmp_path
):
    with pytest.raises(CfgError) as info:
        load(written(tmp_path, cfg(**lidar)))
    (fault,) = info.value.faults
    assert fault.pointer == f"/rigs/rover/lidars/top{place}"
    assert message in fault.message


@pytest.mark.parametrize(
    "made",
    [
        None,
        (np.zeros((1, 3)), np.zeros((1, 4))),
        (np.zeros(3), np.zeros(3)),
        (np.zeros((0, 3)), np.zeros((0, 3))),
        (np.full((1, 3), 91.0), np.zeros((1, 3))),
        (np.zeros((1, 3)), np.full((1, 3), np.nan)),
    ],
)
def test_what_is_no_rays_is_told(made, tmp_path, monkeypatch):
    spec = load(written(tmp_path, cfg(pattern={"type": "rosette"})))
    monkeypatch.setattr(plugins.load_kind("scenec.scans", "rosette"), "rays", lambda self: made)
    with pytest.raises(SceneError, match="scan pattern scenec_farmland:Rosette: returned"):
        draw(spec, 3, 0)
