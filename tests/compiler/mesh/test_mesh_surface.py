"""Terrain that is a mesh: seen from above, halved, lifted, roughened, meshed and labeled."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import trimesh

from scenec.compiler.mesh.merge import Merge, label_index
from scenec.compiler.mesh.surface import GroundSurface
from scenec.compiler.mesh.tiles import build_tiles
from scenec.compiler.terrain.grid import Grid, HeightField
from scenec.compiler.terrain.operators.multifractal import Multifractal
from scenec.compiler.terrain.program import run
from scenec.compiler.terrain.sources.mesh_base import MeshBase, Roughness
from scenec.compiler.terrain.sources.mesh_plan import PlanBins, see, top_at
from scenec.compiler.terrain.sources.mesh_surface import MeshSurface, roughened, subdivided
from scenec.schemas.errors import SceneError
from scenec.testing.overhangs import FORMATS, keys, shelter, triangles, write

GRID = Grid.with_spacing((20.0, 20.0), 0.5)
MERGE = Merge(3, 5.0, 4, 0.5, 2.0, 0.2, 4.0, 0.5)


def base(path: Path, **change) -> MeshBase:
    values = {
        "file": path,
        "surface": "mesh",
        "part": None,
        "unit_m": None,
        "up": None,
        "scale": 1.0,
        "rotation_deg": 0.0,
        "place": "center",
        "position_m": (0.0, 0.0, 0.0),
        "holes": "error",
        **keys(path.suffix[1:]),
    }
    return MeshBase(**(values | change))


@pytest.fixture(scope="module")
def cave(tmp_path_factory) -> Path:
    return write(tmp_path_factory.mktemp("cave") / "cave.glb", *shelter(24))


def hits(points: np.ndarray, faces: np.ndarray, x: float, y: float) -> np.ndarray:
    """Heights of all surfaces at (x, y), from barycentric coordinates of every triangle."""
    a, b, c = (points[faces[:, k]] for k in range(3))
    area = (b[:, 0] - a[:, 0]) * (c[:, 1] - a[:, 1]) - (b[:, 1] - a[:, 1]) * (c[:, 0] - a[:, 0])
    with np.errstate(divide="ignore", invalid="ignore"):
        v = ((x - a[:, 0]) * (c[:, 1] - a[:, 1]) - (y - a[:, 1]) * (c[:, 0] - a[:, 0])) / area
        w = ((b[:, 0] - a[:, 0]) * (y - a[:, 1]) - (b[:, 1] - a[:, 1]) * (x - a[:, 0])) / area
        inside = (area != 0) & (v >= -1e-12) & (w >= -1e-12) & (v + w <= 1 + 1e-12)
        z = a[:, 2] + v * (b[:, 2] - a[:, 2]) + w * (c[:, 2] - a[:, 2])
    return np.sort(z[inside])


def edges_of(faces: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    ends = np.sort(np.concatenate([faces[:, [0, 1]], faces[:, [1, 2]], faces[:, [2, 0]]]), axis=1)
    return np.unique(ends, axis=0, return_counts=True)


def test_from_above_the_topmost_surface_is_that_of_every_triangle_tried():
    points, quads = shelter(16)
    faces = triangles(quads)
    frame = HeightField(GRID, np.zeros(GRID.shape)).frame()
    seen = see(points, faces.astype(np.int32), frame, GRID.shape)
    rng = np.random.default_rng(0)
    x, y = rng.uniform(-10, 10, (2, 300))
    bins = PlanBins.of(points, faces.astype(np.int32))
    top = top_at(points, faces.astype(np.int32), bins, 1e-10, x, y)
    for n in range(len(x)):
        assert top[n] == pytest.approx(hits(points, faces, x[n], y[n])[-1], abs=1e-9)
    for j, i in rng.integers(0, GRID.shape[0], (200, 2)):
        expected = hits(points, faces, GRID.x()[i], GRID.y()[j])
        assert seen.top[j, i] == pytest.approx(expected[-1], abs=1e-9)
        assert seen.floor[j, i] == pytest.approx(expected[0], abs=1e-9)
    assert not seen.down.any()
    assert (np.array([len(hits(points, faces, a, b)) for a, b in zip(x, y, strict=True)]) > 1).any()


@pytest.mark.parametrize("turn", [0.0, 0.3, np.pi / 4])
def test_nothing_falls_between_faces(turn):
    n = 41
    v, u = np.meshgrid(np.linspace(-1, 1, n), np.linspace(-1, 1, n), indexing="ij")
    # Slivers of a millionth, and vertices on the samples.
    v = np.round(v * 20) / 20 + np.where(np.arange(n) % 2, 1e-6, 0.0)[:, None]
    points = np.stack([u, v, 0.2 * u], axis=-1).reshape(-1, 3) * 16.0
    points[:, :2] = points[:, :2] @ [[np.cos(turn), np.sin(turn)], [-np.sin(turn), np.cos(turn)]]
    a = (np.arange(n - 1)[:, None] * n + np.arange(n - 1)).ravel()
    faces = triangles(np.stack([a, a + 1, a + n + 1, a + n], axis=1)).astype(np.int32)
    frame = HeightField(GRID, np.zeros(GRID.shape)).frame()
    seen = see(points, faces, frame, GRID.shape)
    assert np.isfinite(seen.top).all()
    assert np.isfinite(
        top_at(points, faces, PlanBins.of(points, faces), 1e-10, *GRID.points())
    ).all()


def test_halving_keeps_the_surface_whole_and_makes_edges_short():
    points, quads = shelter(10)
    faces = triangles(quads).astype(np.int32)
    new_points, new_faces, edge = subdivided(points, faces, 0.6, 10**6)
    before = trimesh.Trimesh(points, faces, process=False)
    after = trimesh.Trimesh(new_points, new_faces, process=False)
    assert after.edges_unique_length.max() == pytest.approx(edge)
    assert edge <= 0.6
    assert after.area == pytest.approx(before.area, rel=1e-12)
    assert np.array_equal(new_points[: len(points)], points)
    assert after.is_winding_consistent
    ends, count = edges_of(new_faces)
    assert count.max() == 2
    # No T-junction: the border is as long as it was.
    old, old_count = edges_of(faces)
    length = np.linalg.norm(new_points[ends[:, 0]] - new_points[ends[:, 1]], axis=1)
    old_length = np.linalg.norm(points[old[:, 0]] - points[old[:, 1]], axis=1)
    assert length[count == 1].sum() == pytest.approx(old_length[old_count == 1].sum(), rel=1e-12)


def test_what_lies_beyond_the_terrain_stays_coarse(tmp_path):
    points = np.array([[-900, -900, 0], [900, -900, 0], [900, 900, 5], [-900, 900, 0]], float)
    path = write(tmp_path / "wide.ply", points, np.array([[0, 1, 2, 3]]))
    surface, report = base(path).stage(GRID, 10**6)
    assert report["beyond_terrain_m"] == 890.0
    assert report["edge_max_m"] <= 0.5
    # The terrain alone is more than 3200 triangles; about it they double in size, ring by ring.
    assert 3200 < len(surface.faces) < 20000
    ends, count = edges_of(surface.faces)
    assert (np.abs(surface.points[ends[count == 1]])[..., :2].max(axis=2) == 900.0).all()


def test_a_budget_that_binds_is_kept_and_the_edge_reached_is_told(cave):
    surface, report = base(cave).stage(GRID, 3000)
    assert len(surface.faces) <= 3000
    assert report["budget_bound"]
    mesh = trimesh.Trimesh(surface.points, surface.faces, process=False)
    assert report["edge_max_m"] == pytest.approx(mesh.edges_unique_length.max())
    assert report["edge_max_m"] > 0.5
    assert not base(cave).stage(GRID, 10**6)[1]["budget_bound"]


def test_the_surface_s_height_is_the_topmost_one_and_beyond_the_mesh_the_grid_s(cave):
    surface, _ = base(cave).stage(GRID, 10**6)
    rng = np.random.default_rng(1)
    x, y = rng.uniform(-10, 10, (2, 100))
    expected = [hits(surface.points, surface.faces, a, b)[-1] for a, b in zip(x, y, strict=True)]
    assert np.allclose(surface.height_at(x, y), expected, atol=1e-9)
    assert surface.height_at(np.array([30.0]), np.array([0.0])) == surface.height[20, -1]


def test_a_plane_lifts_every_layer_by_itself(cave):
    surface, _ = base(cave).stage(GRID, 10**6)
    x, y = np.meshgrid(GRID.x(), GRID.y())
    slope = 0.3 * x - 0.2 * y + 1.0
    lifted = surface.lifted(surface.height + slope)
    moved = lifted.points - surface.points
    assert np.array_equal(moved[:, :2], 0 * moved[:, :2])
    expected = 0.3 * surface.points[:, 0] - 0.2 * surface.points[:, 1] + 1.0
    assert np.allclose(moved[:, 2], expected, atol=1e-12)
    assert np.allclose(lifted.height, surface.height + slope, atol=1e-9)
    assert np.array_equal(lifted.faces, surface.faces)


def test_relief_crosses_no_surfaces_and_keeps_the_gaps_between_layers(cave):
    relief = Multifractal(key=1, amplitude_m=2.0, scale_m=4.0, octaves=4)
    before, _ = base(cave).stage(GRID, 10**6)
    after = run([base(cave), relief], GRID).field
    assert isinstance(after, MeshSurface)
    # What a triangle misses of the relief between its vertices.
    slack = 2.0 * np.abs(np.diff(after.height - before.height, n=2, axis=1)).max()
    rng = np.random.default_rng(2)
    overhung = 0
    for x, y in rng.uniform(-9.9, 9.9, (400, 2)):
        old = hits(before.points, before.faces, x, y)
        new = hits(after.points, after.faces, x, y)
        assert len(old) == len(new)
        assert np.abs(np.diff(old) - np.diff(new)).max(initial=0.0) <= slack
        overhung += len(old) > 1
    assert overhung > 20


def test_roughness_moves_walls_along_their_normals_by_no_more_than_the_noise():
    points = np.array([[0, 0, 0], [8, 0, 0], [8, 0, 8], [0, 0, 8]], float)
    points, faces, _ = subdivided(points, np.array([[0, 1, 2], [0, 2, 3]], np.int32), 0.3, 10**6)
    rough = roughened(points, faces, 7, 0.2, 1.5, 3, 0.5)
    moved = rough - points
    assert np.array_equal(moved[:, [0, 2]], 0 * moved[:, [0, 2]])
    assert 0.02 < moved[:, 1].std() < 0.2 * 1.75
    assert np.abs(moved).max() <= 0.2 * 1.75
    assert np.array_equal(roughened(points, faces, 7, 0.0, 1.5, 3, 0.5), points)


def test_a_planar_mesh_becomes_its_heights_exactly(tmp_path):
    n = 21
    v, u = np.meshgrid(np.linspace(-11, 11, n), np.linspace(-11, 11, n), indexing="ij")
    points = np.stack([u, v, 0.25 * u - 0.5 * v + 3.0], axis=-1).reshape(-1, 3)
    a = (np.arange(n - 1)[:, None] * n + np.arange(n - 1)).ravel()
    path = write(tmp_path / "p.obj", points, np.stack([a, a + 1, a + n + 1, a + n], axis=1))
    height, report = base(path, surface="heights").apply(GRID, np.ones(GRID.shape))
    x, y = np.meshgrid(GRID.x(), GRID.y())
    assert np.allclose(height, 1.0 + 0.25 * x - 0.5 * y + 3.0, atol=1e-12)
    assert report["overhang_fraction"] == 0.0
    turned = base(path, surface="heights", rotation_deg=90.0, scale=2.0, position_m=(1, 0, -1))
    height, _ = turned.apply(GRID, np.zeros(GRID.shape))
    # x' = -y and y' = x, twice as large, then 1 m to the east and 1 m down.
    assert np.allclose(height, 0.25 * y + 0.5 * (x - 1.0) + 6.0 - 1.0, atol=1e-12)


def test_heights_say_what_of_an_overhang_they_lose(tmp_path):
    floor = np.array([[-10, -10, 0], [10, -10, 0], [10, 10, 0], [-10, 10, 0]], float)
    slab = trimesh.creation.box(extents=(8.2, 4.2, 1.0)).apply_translation((0, 0, 3.5))
    points = np.concatenate([floor, slab.vertices])
    faces = np.concatenate([[[0, 1, 2], [0, 2, 3]], slab.faces + 4])
    path = write(tmp_path / "table.ply", points, faces)
    height, report = base(path, surface="heights").apply(GRID, np.zeros(GRID.shape))
    x, y = np.meshgrid(GRID.x(), GRID.y())
    under = (np.abs(x) <= 4.1) & (np.abs(y) <= 2.1)
    assert np.allclose(height, np.where(under, 4.0, 0.0), atol=1e-6)
    assert report["overhang_fraction"] == pytest.approx(under.mean())
    assert report["overhang_height_max_m"] == pytest.approx(4.0)


def test_where_there_is_no_mesh_heights_are_an_error_or_a_membrane(tmp_path):
    points = np.array([[-8, -8, 2], [8, -8, 2], [8, 8, 2], [-8, 8, 2]], float)
    path = write(tmp_path / "small.ply", points, np.array([[0, 1, 2, 3]]))
    for surface in ("mesh", "heights"):
        with pytest.raises(SceneError, match=r'592 of 1681 samples .* say "holes": "fill"'):
            run([base(path, surface=surface)], GRID)
        relief = run([base(path, surface=surface, holes="fill")], GRID)
        assert np.allclose(relief.field.height, 2.0, atol=1e-9)
        assert relief.steps[0]["holes_filled"] == 592
    with pytest.raises(SceneError, match=r"no part of it lies over a sample of the terrain"):
        run([base(path, position_m=(50.0, 0.0, 0.0))], GRID)


def test_a_mesh_inside_out_is_turned_and_said_so(tmp_path, cave):
    points, quads = shelter(24)
    path = write(tmp_path / "in.glb", points, triangles(quads)[:, ::-1])
    surface, report = base(path).stage(GRID, 10**6)
    right, right_report = base(cave).stage(GRID, 10**6)
    assert (report["turned_inside_out"], right_report["turned_inside_out"]) == (True, False)
    assert np.array_equal(surface.height, right.height)
    mesh = trimesh.Trimesh(surface.points, surface.faces, process=False)
    assert mesh.face_normals[:, 2].mean() > 0.3


def test_every_format_gives_the_same_tiles_to_the_bit(tmp_path):
    made = []
    points, quads = shelter(16)
    for suffix in FORMATS:
        path = write(tmp_path / f"a.{suffix}", points, quads)
        rough = Roughness(key=9, amplitude_m=0.1, scale_m=2.0, octaves=4, gain=0.5)
        field = run([base(path, roughness=rough)], GRID).field
        made.append(build_tiles(GroundSurface(field, (MERGE,)), 5)[0])
    for tiles in made[1:]:
        for a, b in zip(made[0], tiles, strict=True):
            for key in ("translate", "points", "faces", "normals", "layer", "weights", "variation"):
                assert np.array_equal(getattr(a, key), getattr(b, key)), key


def test_a_label_line_down_a_wall_alone_is_reported_in_finite_numbers():
    corners = np.array([[-4, 0, 0], [4, 0, 0], [4, 0, 5], [-4, 0, 5]], float)
    points, faces, _ = subdivided(corners, np.array([[0, 1, 2], [0, 2, 3]], np.int32), 0.5, 10**6)
    wall = MeshSurface(GRID, np.zeros(GRID.shape), points, faces)
    tiles, report = build_tiles(GroundSurface(wall, (MERGE,)), 5)
    assert {0, 1} == {int(layer) for tile in tiles for layer in tile.layer}
    assert np.isfinite(list(report["cuts"][0].values())).all()


@pytest.mark.parametrize("walls", ["cave", "blocks"])
def test_labels_are_one_a_face_without_crack_or_junction_on_walls_and_overhangs(
    tmp_path, cave, walls
):
    path = cave
    if walls == "blocks":
        # Vertical walls, each of two triangles: label lines run straight down them.
        floor = np.array([[-10, -10, 0], [10, -10, 0], [10, 10, 0], [-10, 10, 0]], float)
        block = trimesh.creation.box(extents=(8, 4, 2)).apply_translation((1, 1, 3))
        points = np.concatenate([floor, block.vertices])
        path = write(
            tmp_path / "b.ply", points, np.concatenate([[[0, 1, 2], [0, 2, 3]], block.faces + 4])
        )
    field = run([base(path)], GRID).field
    tiles, report = build_tiles(GroundSurface(field, (MERGE,)), 5)
    points = np.concatenate([t.translate + t.points.astype(float) for t in tiles])
    starts = np.cumsum([0] + [len(t.points) for t in tiles])
    faces = np.concatenate([t.faces + s for t, s in zip(tiles, starts, strict=False)])
    layer = np.concatenate([t.layer for t in tiles])
    points, inverse = np.unique(points, axis=0, return_inverse=True)
    faces = inverse.reshape(-1)[faces]
    assert 0.1 < layer.mean() < 0.9
    # Every edge has two faces, but for those at the sheet's border: no crack, no T-junction.
    ends, count = edges_of(faces)
    assert count.max() == 2
    at = points[ends[count == 1]]
    assert (np.abs(np.abs(at[..., :2]).max(axis=2) - 10.0) < 1e-4).all()
    # The label is the merge's, but where the line's chord cuts a corner.
    middle = points[faces].mean(axis=1)
    side = MERGE.side(middle[:, 0].copy(), middle[:, 1].copy())
    wrong = label_index([side]) != layer
    assert np.abs(side[wrong]).max(initial=0.0) <= report["cuts"][0]["side_error_bound"]
    assert np.isfinite(points).all()
    assert all(np.allclose(np.linalg.norm(t.normals, axis=1), 1.0, atol=1e-6) for t in tiles)
