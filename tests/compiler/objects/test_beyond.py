"""Objects on the land beyond the terrain's border: as many as asked, on it, none on the terrain."""

from __future__ import annotations

import json

import numpy as np
import pytest
from pxr import Usd, UsdGeom

from scenec.backends.annotation.annotate import annotate
from scenec.backends.exact.caster import ExactCaster
from scenec.backends.stage.read import read_stage
from scenec.compiler.build import BuildLog, build, build_to
from scenec.compiler.cfg.load import load
from scenec.compiler.compile import compile_cfg
from scenec.compiler.draw import draw
from scenec.compiler.estimate import needs_of
from scenec.compiler.mesh.build import build_land
from scenec.compiler.objects.conditions import OffTerrain
from scenec.compiler.objects.lattice import PlanLattice
from scenec.compiler.objects.scattered import LEAST_BEYOND
from scenec.compiler.views.needed import Keep
from scenec.schemas.errors import CfgError
from scenec.testing.small import small_cfg, write_cfg

BEYOND, HALF = 150.0, np.array([10.0, 8.0])
FAR = {
    "type": "rocks",
    "material": "stone",
    "labels": {"class": "rock"},
    "prototypes": 3,
    "subdivisions": 2,
    "beyond_m": BEYOND,
    "per_m2": 0.05,
    "size_m": {"type": "uniform", "min": 0.4, "max": 2},
    "embed": 0.25,
}
LEVEL = [{"type": "plane", "height_m": 3}]
CRATERS = {
    "type": "craters", "min_diameter_m": 1, "max_diameter_m": 4, "density_per_m2": 0.02,
    "reference_diameter_m": 1, "exponent": 2,
}  # fmt: skip
HILLS = [
    {"type": "plane", "slope": [0.02, 0.01]},
    {"type": "multifractal", "variant": "fbm", "amplitude_m": 4, "scale_m": 120, "octaves": 6},
]


def scene_cfg(terrain, land, **changes):
    cfg = small_cfg(samples=2)
    cfg["terrain"]["relief"] = terrain
    cfg["terrain"]["horizon"] = {
        "reach_m": 2000, "spacing_m": 20, "blend_m": 40, "relief": land,
        "material": "sand", "labels": {"class": "ground"},
    }  # fmt: skip
    cfg["objects"]["far"] = FAR | changes
    return cfg


@pytest.fixture(scope="module")
def level(tmp_path_factory):
    """On level ground, all of it kept."""
    folder = tmp_path_factory.mktemp("level")
    plan = draw(load(write_cfg(folder, scene_cfg(LEVEL, LEVEL, lod_px=0))), 1, 0)
    return build(plan, BuildLog(), Keep.ALL).objects[1]


def test_as_many_lie_on_the_land_as_its_area_asks_for_and_none_on_the_terrain(level):
    away = (np.abs(level.positions[:, :2]) - HALF).max(axis=1)
    assert away.min() > 0.0
    assert away.max() <= BEYOND
    area = np.prod(2.0 * (HALF + BEYOND)) - np.prod(2.0 * HALF)
    # Cells that the border cuts have none.
    assert level.count == pytest.approx(0.05 * area, rel=0.005)
    # Evenly: a chi-square over equal areas on the four sides and far and near.
    side = (level.positions[:, 0] > 0.0) + 2 * (level.positions[:, 1] > 0.0)
    counts = np.bincount(side, minlength=4)
    assert ((counts - level.count / 4) ** 2 / (level.count / 4)).sum() < 16.3


def test_on_level_land_a_quarter_of_each_is_below_it(level):
    for number in range(0, level.count, 40):
        own = level.prototypes[level.prototype[number]].points * level.scales[number]
        x, y, z, w = level.orientations[number].astype(float)
        up = (2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y))
        height = own @ np.array(up) + level.positions[number, 2]
        # Half floats hold the turn.
        below = (3.0 - height.min()) / (height.max() - height.min())
        assert below == pytest.approx(0.25, abs=0.01)


def test_on_hills_cells_are_near_the_land(tmp_path):
    plan = draw(load(write_cfg(tmp_path, scene_cfg(HILLS, HILLS))), 1, 0)
    land = build_to(build_land, plan)["land"]
    surface = land.near(BEYOND)
    rng = np.random.default_rng(2)
    x, y = (rng.uniform(-half - BEYOND, half + BEYOND, 20_000) for half in HALF)
    off = np.abs(surface.height_at(x, y) - land.height_at(x, y))
    # From a few meters on what the border's roughness leaves is small beside the embedding.
    away = land.distance_m(x, y)
    assert off[away > 5.0].max() < 0.03
    assert off[away > 0.0].max() < 0.2


@pytest.mark.parametrize(("relief", "low", "high"), [(LEVEL, 0.0, 1e-9), (HILLS, 1e-4, 0.2)])
def test_the_report_states_how_far_the_land_is_from_what_they_are_seated_on(
    relief, low, high, tmp_path
):
    log = BuildLog()
    plan = draw(load(write_cfg(tmp_path, scene_cfg(relief, relief))), 1, 0)
    far = build(plan, log, Keep.ALL).objects[1]
    land = build_to(build_land, plan)["land"]
    x, y = np.ascontiguousarray(far.positions[:, :2].T, np.float64)
    off = np.abs(land.height_at(x, y) - land.near(BEYOND).height_at(x, y)).max()
    stated = {n: own.get("land_error_max_m") for n, own in log.facts["objects"].items()}
    assert stated == {"rocks": None, "far": pytest.approx(off, abs=1e-12)}
    assert low <= stated["far"] <= high


def test_the_narrowest_land_is_eight_whole_cells_wide(tmp_path):
    narrow = LEAST_BEYOND * 2.0 * HALF.max()
    plan = draw(load(write_cfg(tmp_path, scene_cfg(LEVEL, LEVEL, beyond_m=narrow * 1.001))), 1, 0)
    land = build_to(build_land, plan)["land"]
    lattice = PlanLattice.over(land.near(narrow * 1.001).field.grid)
    off = OffTerrain(tuple(HALF)).weight(lattice, None) > 0.0
    assert [row.tolist() for row in np.argwhere(~off)[[0, -1]]] == [
        [8, 8], [n - 9 for n in lattice.shape]
    ]  # fmt: skip


@pytest.mark.parametrize("outputs", [["label", "instance", "depth"], ["rgb", "instance"]])
def test_what_pruning_leaves_shows_the_same(outputs, tmp_path):
    cfg = scene_cfg(HILLS, HILLS) | {"outputs": outputs, "batches": 1}
    file, found, kept = write_cfg(tmp_path, cfg), [], []
    for keep in (Keep.SEEN, Keep.UNPRUNED):
        compile_cfg(file, seed=3, out=tmp_path / keep, keep=keep)
        stage = read_stage(tmp_path / keep / "batch_0000" / "stage.usda")
        caster = ExactCaster(stage)
        arrays = [
            annotate(stage, caster, stage.cameras[0][0], ("instance", "depth"), sample).arrays
            for sample in range(2)
        ]
        found.append(arrays)
        usd = Usd.Stage.Open(str(tmp_path / keep / "batch_0000" / "stage.usda"))
        instancer = UsdGeom.PointInstancer(usd.GetPrimAtPath("/World/Objects/far"))
        kept.append(len(instancer.GetIdsAttr().Get()))
    for one, other in zip(*found, strict=True):
        assert one.keys() == other.keys()
        assert all(np.array_equal(one[name], other[name]) for name in one)
    assert 0 < kept[0] < 0.95 * kept[1]
    report = json.loads((tmp_path / "seen" / "batch_0000" / "report.json").read_text())
    assert report["prune"]["objects"]["far"]["seen"] > 0


def test_the_same_bytes_each_time(tmp_path):
    file, texts = write_cfg(tmp_path, scene_cfg(HILLS, HILLS) | {"batches": 1}), []
    for out in (tmp_path / "a", tmp_path / "b"):
        compile_cfg(file, seed=3, out=out)
        texts.append([p.read_bytes() for p in sorted((out / "batch_0000").glob("*.usd*"))])
    assert texts[0] == texts[1]


@pytest.mark.parametrize(
    ("changes", "pointer", "said"),
    [
        ({"beyond_m": 3000}, "/objects/far/beyond_m", "2000 m beyond the border"),
        ({"fillet": {}}, "/objects/far/fillet", "not heaped"),
        (
            {"where": [{"type": "material", "material": "sand"}]},
            "/objects/far/where/0/type",
            "layers of the ground end",
        ),
        (
            {"where": [{"type": "crater_freshness", "min": 0.5}]},
            "/objects/far/where/0/type",
            "craters end",
        ),
        ({"density": {"type": "rings"}}, "/objects/far/density/type", "craters end"),
        ({"beyond_m": 0.4}, "/objects/far/beyond_m", "expected 0.435 m or more"),
    ],
)
def test_faults_have_their_place(changes, pointer, said, tmp_path):
    with pytest.raises(CfgError) as caught:
        load(write_cfg(tmp_path, scene_cfg([*LEVEL, CRATERS], LEVEL, **changes)))
    found = {fault.pointer: str(fault) for fault in caught.value.faults}
    assert said in found[pointer]


def test_the_estimate_counts_what_lies_there(tmp_path):
    spec = load(write_cfg(tmp_path, scene_cfg(LEVEL, LEVEL)))
    needs = {need.pointer: need.bytes for need in needs_of(spec, 1, 0)}
    far, near = needs["objects/far/per_m2"], needs["objects/rocks/count"]
    # The square about the border is drawn for as a whole, as the terrain is.
    assert far / near == pytest.approx(0.05 * 320.0 * 316.0 / 300.0)


def test_without_a_horizon_nothing_is_there(tmp_path):
    cfg = scene_cfg(LEVEL, LEVEL)
    del cfg["terrain"]["horizon"]
    with pytest.raises(CfgError, match=r"expected a terrain\.horizon"):
        load(write_cfg(tmp_path, cfg))
