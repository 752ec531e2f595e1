"""The land beyond the terrain's border: without gap, within its tolerance, labeled as its own."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from scenec.backends.annotation.annotate import annotate
from scenec.backends.exact.caster import ExactCaster
from scenec.backends.model.collect import coarse_model
from scenec.backends.stage.ground import relief
from scenec.backends.stage.read import read_stage
from scenec.compiler.build import BuildLog, build, build_to
from scenec.compiler.cfg.load import load
from scenec.compiler.compile import compile_cfg
from scenec.compiler.draw import draw
from scenec.compiler.emit.batch import write_batch
from scenec.compiler.mesh.build import build_surface
from scenec.compiler.mesh.horizon import Land
from scenec.compiler.mesh.surface import GroundSurface
from scenec.compiler.terrain.grid import Grid
from scenec.compiler.terrain.program import run
from scenec.compiler.views.resolution import pixels_of_balls, views_of
from scenec.schemas.errors import CfgError
from scenec.testing.small import small_cfg, write_cfg

REACH, BLEND = 4000.0, 30.0
HORIZON = {
    "reach_m": REACH,
    "blend_m": BLEND,
    "spacing_m": 30,
    "relief": [
        {"type": "plane"},
        {
            "type": "multifractal",
            "variant": "ridged",
            "amplitude_m": 250,
            "scale_m": 1800,
            "mask": [{"type": "point", "x_m": 0, "y_m": 0, "min_m": 900, "softness_m": 1200}],
        },
    ],
    "material": "hill",
    "labels": {"class": "ground", "surface": "hill"},
}


def hilly(**changes):
    cfg = small_cfg()
    cfg["terrain"]["horizon"] = HORIZON | changes
    cfg["labels"]["surface"]["hill"] = 40
    cfg["materials"]["hill"] = {"base_color": [0.3, 0.25, 0.2], "variation": 0.3}
    return cfg


@pytest.fixture(scope="module")
def spec(tmp_path_factory):
    return load(write_cfg(tmp_path_factory.mktemp("horizon"), hilly()))


@pytest.fixture(scope="module")
def plan(spec):
    return draw(spec, 1, 0)


@pytest.fixture(scope="module")
def built(plan):
    log = BuildLog()
    return build(plan, log), log.facts["horizon"]


@pytest.fixture(scope="module")
def stage(built, tmp_path_factory):
    folder = tmp_path_factory.mktemp("stage")
    write_batch(folder, built[0])
    return read_stage(folder / "stage.usda")


@pytest.fixture(scope="module")
def land(plan):
    terrain = build_to(build_surface, plan)["surface"]
    horizon = plan.terrain.horizon
    size = tuple(side + 2.0 * REACH for side in plan.terrain.size_m)
    far = run(horizon.relief, Grid.with_spacing(size, horizon.spacing_m))
    return Land.around(terrain, GroundSurface(far.field, details=far.details), BLEND)


def triangles(tiles):
    """All vertices in the world, as float64 has them, and faces that name equal ones alike."""
    at = np.concatenate([tile.translate + tile.points.astype(float) for tile in tiles])
    first = np.cumsum([0, *(len(tile.points) for tile in tiles)])
    faces = np.concatenate([t.faces + n for t, n in zip(tiles, first[:-1], strict=True)])
    points, number = np.unique(at, axis=0, return_inverse=True)
    return points, number.ravel()[faces]


def test_terrain_and_horizon_are_one_sheet_without_gap_or_fold(built):
    points, faces = triangles(built[0].ground.meshes)
    ends = np.concatenate([faces[:, [0, 1]], faces[:, [1, 2]], faces[:, [2, 0]]]).astype(np.int64)
    edges, backward = ends @ [len(points), 1], ends @ [1, len(points)]
    assert len(np.unique(edges)) == len(edges)
    border = points[ends[~np.isin(edges, backward)]][..., :2]
    assert (np.abs(border).max(axis=(1, 2)) >= REACH).all()
    a, b, c = (points[faces[:, k], :2] for k in range(3))
    area = 0.5 * ((b - a)[:, 0] * (c - a)[:, 1] - (b - a)[:, 1] * (c - a)[:, 0])
    assert (area > 0.0).all()
    assert area.sum() == pytest.approx((2 * REACH + 20) * (2 * REACH + 16), rel=1e-6)


def test_its_mesh_is_near_the_land_in_what_is_seen_and_small(built, land):
    scene, facts = built
    tile = scene.ground.horizon.tile
    rng = np.random.default_rng(4)
    shares = rng.dirichlet([1, 1, 1], (len(tile.faces), 8))
    corners = tile.points.astype(float)[tile.faces]
    at = np.einsum("fnk,fkx->fnx", shares, corners).reshape(-1, 3)
    # In the strip beside the border its roughness, which the land does not have, fades out.
    at = at[land.distance_m(at[:, 0], at[:, 1]) > 1.0]
    error = np.abs(land.height_at(*np.ascontiguousarray(at[:, :2].T)) - at[:, 2])
    pixels = error * pixels_of_balls(views_of(scene.rigs), at, np.zeros(len(at)), 0.0, 1.0)
    assert np.percentile(pixels[pixels > 0.0], 99.9) < facts["tolerance_px"]
    assert pixels.max() < 2.0 * facts["tolerance_px"]
    assert facts["triangles"] < 0.05 * facts["triangles_of_grid"]
    assert facts["height_error_max_px"] < 2.0 * facts["tolerance_px"]


def test_land_begins_as_the_border_and_becomes_its_own_relief(plan, land):
    terrain = build_to(build_surface, plan)["surface"]
    t = np.linspace(-0.99, 0.99, 50)
    for x, y in ((10.0 + 0 * t, 8.0 * t), (-10.0 + 0 * t, 8.0 * t), (10.0 * t, 8.0 + 0 * t)):
        off = land.height_at(x, y) - terrain.field.height_at(x, y)
        assert np.abs(off).max() < 0.3
        assert np.abs(off).mean() < 0.1
    away = BLEND + 10.0 + 1.0
    assert land.height_at(away + 0 * t, t) == pytest.approx(land.surface.height_at(away + 0 * t, t))


def test_pixels_show_hills_and_their_label_where_sky_was(stage):
    found = annotate(stage, ExactCaster(stage), stage.cameras[0][0], ("label", "depth"), 0).arrays
    far = found["label.surface"] == 40
    assert far.any()
    # A pixel of it may be the first beyond the border.
    assert 2.0 < found["depth"][far].min() < 30.0
    assert 200.0 < found["depth"][far].max() < 6000.0
    sky = found["label.surface"] == 7
    assert not sky[-10:].any()


def test_a_budget_raises_its_tolerance(plan):
    coarse = replace(plan.terrain, meshing=replace(plan.terrain.meshing, max_triangles=2500))
    log = BuildLog()
    build(replace(plan, terrain=coarse), log)
    facts = log.facts["horizon"]
    assert facts["tolerance_reached_px"] > facts["tolerance_px"]


def test_maps_from_above_end_at_the_terrain_and_pages_show_it_as_an_object(stage):
    _, step, heights = relief(stage, 10)
    assert step[0] * heights.shape[1] == pytest.approx(20.0)
    model = coarse_model(stage, "b", ground_faces=5000, object_faces=5000, instances=100)
    ground, *others = model.placements
    assert ground.owner == ""
    assert "/World/Terrain/horizon" in [each.owner for each in others]


def test_without_color_there_are_labels_alone(tmp_path):
    cfg = hilly() | {"outputs": ["label"]}
    compile_cfg(load(write_cfg(tmp_path, cfg)), seed=1, out=tmp_path / "out")
    read = read_stage(tmp_path / "out" / "batch_0000" / "stage.usda")
    far = next(mesh for mesh in read.meshes if mesh.path.endswith("/horizon"))
    assert (far.labels["surface"] == 40).all()


@pytest.mark.parametrize(
    ("changes", "pointer", "said"),
    [
        ({"material": "hil"}, "/terrain/horizon/material", "hill"),
        ({"spacing_m": 0.1}, "/terrain/horizon/spacing_m", "expected a spacing of"),
        ({"blend_m": 0}, "/terrain/horizon/blend_m", "0"),
    ],
)
def test_faults_have_their_place(changes, pointer, said, tmp_path):
    with pytest.raises(CfgError) as caught:
        load(write_cfg(tmp_path, hilly(**changes)))
    found = {fault.pointer: str(fault) for fault in caught.value.faults}
    assert said in found[pointer]
