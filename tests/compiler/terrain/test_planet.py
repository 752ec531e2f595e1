"""The ground as a part of a sphere: its drop, its horizon, and what reaches beyond it."""

from __future__ import annotations

from decimal import Decimal, localcontext

import numpy as np
import pytest

from scenec.backends.stage.read import read_stage
from scenec.compiler.build import BuildLog, build
from scenec.compiler.cfg.load import load
from scenec.compiler.draw import draw
from scenec.compiler.emit.batch import write_batch
from scenec.compiler.terrain.planet import RADII_M, TerrainPlanet
from scenec.schemas.errors import CfgError
from scenec.testing.small import small_cfg, write_cfg
from scenec.testing.sphere_views import seen_horizon, true_horizon

EYE_M, MOON_M = 1.7, RADII_M["moon"]


def curved(planet, reach_m=6000.0, **mesh):
    """A smooth sphere and nothing else."""
    cfg = small_cfg(objects={}, outputs=["depth", "label"])
    del cfg["labels"]["class"]["rock"], cfg["labels"]["surface"]["stone"], cfg["materials"]["stone"]
    ground = {"relief": [{"type": "plane"}], "mesh": mesh}
    cfg["terrain"] |= ground | ({} if planet is None else {"planet": planet})
    cfg["terrain"]["horizon"] = {"reach_m": reach_m, "relief": [{"type": "plane"}],
                                 "material": "sand"}  # fmt: skip
    return cfg


def built(folder, cfg):
    """The stage as it is read back, and the facts."""
    log = BuildLog()
    scene = build(draw(load(write_cfg(folder, cfg)), 1, 0), log)
    write_batch(folder, scene)
    return read_stage(folder / "stage.usda"), log.facts


@pytest.mark.parametrize("radius", [1.0, MOON_M, 6.37e6, 1e12])
@pytest.mark.parametrize("share", [1e-9, 1e-5, 0.01, 0.5, 0.999999])
def test_the_drop_is_that_of_the_sphere_to_the_last_bits(radius, share):
    d = share * radius
    with localcontext() as context:
        context.prec = 60
        exact = Decimal(radius) - (Decimal(radius) ** 2 - Decimal(d) ** 2).sqrt()
    found = TerrainPlanet(radius_m=radius).drop_m(np.array(d), np.array(0.0))
    # The root loses bits of R^2 - d^2 beside the pole's circle alone.
    assert float(found) == pytest.approx(float(exact), rel=1e-15 if share < 0.9 else 1e-9)


def test_the_horizon_is_as_far_off_as_the_closed_form_says(tmp_path):
    stage, facts = built(tmp_path, curved({"body": "moon"}, tolerance_px=0))
    dip, away = seen_horizon(stage, EYE_M)
    dipped, expected = true_horizon(MOON_M, EYE_M)
    # From a person's eye on the Moon.
    assert expected == pytest.approx(2430.5, abs=0.1)
    # Samples of the far mesh are 0.6 % of their distance apart, and triangles lie below the sphere.
    assert np.abs(away / expected - 1.0).max() < 0.007
    assert dip == pytest.approx(dipped, rel=5e-5)
    assert facts["horizon"]["planet"]["drop_max_m"] == pytest.approx(
        (6010.0**2 + 6008.0**2) / (2.0 * MOON_M), rel=1e-5
    )


def test_on_a_plane_one_sees_to_its_end(tmp_path):
    stage, _ = built(tmp_path, curved(None, tolerance_px=0))
    _, away = seen_horizon(stage, EYE_M)
    assert away.min() > 6000.0


def test_all_vertices_of_terrain_and_horizon_lie_on_the_sphere(tmp_path):
    radius = 40_000.0
    stage, facts = built(tmp_path, curved({"radius_m": radius}, reach_m=20_000.0))
    for mesh in stage.meshes:
        points = mesh.points.astype(np.float64)
        off = np.sqrt((points[:, :2] ** 2).sum(axis=1) + (points[:, 2] + radius) ** 2) - radius
        # Positions are float32.
        assert np.abs(off).max() < 2e-3
    assert facts["relief"][-1]["type"] == "planet"


@pytest.mark.parametrize(
    ("planet", "pointer", "said"),
    [
        ({"body": "moon", "radius_m": 2}, "/terrain/planet/radius_m", "take one away"),
        ({}, "/terrain/planet", "expected either the key body or the key radius_m"),
        ({"body": "mon"}, "/terrain/planet/body", "moon"),
        ({"radius_m": 8000}, "/terrain/planet", "expected less than the radius, 8000 m"),
        ({"radius_m": {"type": "uniform", "min": 8000, "max": 1e6}}, "/terrain/planet", "8000 m"),
        ({"radius_m": 0}, "/terrain/planet/radius_m", "0"),
    ],
)
def test_faults_have_their_place(planet, pointer, said, tmp_path):
    with pytest.raises(CfgError) as caught:
        load(write_cfg(tmp_path, curved(planet)))
    found = {fault.pointer: str(fault) for fault in caught.value.faults}
    assert said in found[pointer]
