"""The cut mesh: watertight, one label a face, on the right side of the line."""

from __future__ import annotations

import numpy as np
import pytest

from scenec.compiler.mesh.cut import cut as cut_mesh
from scenec.compiler.mesh.merge import Merge, center_for_coverage, label_index
from scenec.compiler.mesh.mesh import grid_mesh
from scenec.compiler.mesh.surface import GroundSurface
from scenec.compiler.mesh.tiles import build_tiles
from scenec.compiler.scene.ground import MeshTile
from scenec.compiler.terrain.grid import Grid, HeightField
from scenec.compiler.terrain.operators.multifractal import Multifractal

MERGES = (
    Merge(5, 9.0, 3, 0.5, 2.0, 0.0, 5.0, 0.5),
    Merge(6, 14.0, 3, 0.4, 2.0, 0.3, 7.0, 0.3, 0.1),
    Merge(8, 5.0, 2, 0.4, 2.0, 0.0, 3.0, 0.8, 0.0),
)


def relief(size: float = 40.0, spacing: float = 0.4) -> HeightField:
    grid = Grid.with_spacing((size, size), spacing)
    operator = Multifractal(key=1, amplitude_m=0.6, scale_m=8.0, octaves=5)
    return HeightField(grid, operator.apply(grid, np.zeros(grid.shape))[0])


def welded(tiles: tuple[MeshTile, ...]) -> tuple[np.ndarray, np.ndarray]:
    """World points (equal ones merged) and faces over all tiles."""
    points = np.concatenate([t.translate + t.points.astype(np.float64) for t in tiles])
    offsets = np.cumsum([0] + [len(t.points) for t in tiles])
    faces = np.concatenate([t.faces + o for t, o in zip(tiles, offsets, strict=False)])
    unique, index = np.unique(points, axis=0, return_inverse=True)
    return unique, index.reshape(-1)[faces]


def plan_area(points: np.ndarray, faces: np.ndarray) -> np.ndarray:
    a, b, c = (points[faces[:, i], :2] for i in range(3))
    u, v = b - a, c - a
    return 0.5 * (u[:, 0] * v[:, 1] - u[:, 1] * v[:, 0])


def assert_sound(points: np.ndarray, faces: np.ndarray, size: tuple[float, float]) -> None:
    """No crack, no T-junction, nothing folded, nothing lost."""
    area = plan_area(points, faces)
    assert area.min() > 0.0
    assert area.sum() == pytest.approx(size[0] * size[1], rel=1e-6)
    edges = np.sort(np.concatenate([faces[:, [0, 1]], faces[:, [1, 2]], faces[:, [2, 0]]]), axis=1)
    unique, uses = np.unique(edges, axis=0, return_counts=True)
    assert uses.max() == 2
    once = points[unique[uses == 1]][:, :, :2]
    border = np.abs(np.abs(once) - 0.5 * np.array(size)) < 1e-6 * max(size)
    assert border.all(axis=1).any(axis=1).all()


def side_of(merges, points: np.ndarray) -> list[np.ndarray]:
    x, y = np.ascontiguousarray(points[:, 0]), np.ascontiguousarray(points[:, 1])
    return [merge.side(x, y) for merge in merges]


@pytest.fixture(scope="module")
def cut():
    # 40 m at 0.2 m are 200 cells: four tiles.
    return build_tiles(GroundSurface(relief(spacing=0.2), MERGES), 77)


def test_the_cut_mesh_is_whole_keeps_the_area_and_folds_nothing(cut):
    assert len(cut[0]) == 4
    assert_sound(*welded(cut[0]), (40.0, 40.0))


def test_cut_vertices_stay_on_the_uncut_surface():
    field = relief()
    tiles, report = build_tiles(GroundSurface(field, MERGES), 1, color=False)
    points, _ = welded(tiles)
    height = field.height_at(points[:, 0].copy(), points[:, 1].copy())
    # Moving a vertex by float32 rounding also moves it along the slope.
    assert np.abs(points[:, 2] - height).max() < 10 * report["float32_error_max_m"] + 1e-12


def test_tiles_restore_shared_vertices_exactly(cut):
    tiles, _ = cut
    seen: dict[tuple[float, float], float] = {}
    shared = 0
    for tile in tiles:
        for x, y, z in (tile.translate + tile.points.astype(np.float64)).tolist():
            if (x, y) in seen:
                assert seen[x, y] == z
                shared += 1
            seen[x, y] = z
    # Two borders of about 200 vertices each, and those that the cut put on them.
    assert shared > 400


def test_labels_are_those_of_the_merge_function_outside_the_stated_error(cut):
    tiles, report = cut
    points, faces = welded(tiles)
    layer = np.concatenate([t.layer for t in tiles])
    rng = np.random.default_rng(0)
    for _ in range(4):
        bary = rng.dirichlet([1, 1, 1], len(faces))
        at = (bary[:, :, None] * points[faces]).sum(axis=1)
        sides = side_of(MERGES, at)
        wrong = label_index(sides) != layer
        bounds = [cut_report["side_error_bound"] for cut_report in report["cuts"]]
        near = np.any([np.abs(s) <= b for s, b in zip(sides, bounds, strict=True)], axis=0)
        assert not (wrong & ~near).any()
        assert wrong.mean() < 0.01


def test_the_chord_error_of_a_circle_falls_with_the_square_of_the_spacing():
    errors = []
    for cells in (16, 32, 64):
        field = HeightField(Grid((4.0, 4.0), (cells + 1, cells + 1)), np.zeros((cells + 1,) * 2))
        _, report = cut_mesh(grid_mesh(field), lambda x, y: x * x + y * y - 1.7)
        # A chord no longer than a cell's diagonal d is at most d^2 / (8 r) off its arc.
        assert report.chord_error_max_m <= 1.01 * (2 * (4.0 / cells) ** 2) / (8 * np.sqrt(1.7))
        errors.append(report.chord_error_rms_m)
    assert np.log2(errors[0] / errors[1]) == pytest.approx(2.0, abs=0.2)
    assert np.log2(errors[1] / errors[2]) == pytest.approx(2.0, abs=0.2)


def test_cut_vertices_lie_on_the_true_line():
    field = relief(spacing=0.4)
    for merge in MERGES:
        mesh, report = cut_mesh(grid_mesh(field), merge.side)
        cut_vertices = mesh.points[field.height.size :]
        (side,) = side_of([merge], cut_vertices)
        slope = 1.0 / merge.scale_m
        assert len(cut_vertices) == report.vertices > 100
        # In meters, to first order: five millionths of the spacing at worst.
        assert np.abs(side).max() / slope < 2e-6
        assert np.median(np.abs(side)) / slope < 1e-12


def test_a_straight_line_is_cut_exactly():
    field = HeightField(Grid.with_spacing((4.0, 4.0), 0.5), np.zeros((9, 9)))
    mesh, report = cut_mesh(grid_mesh(field), lambda x, y: x + 0.3 * y - 0.11)
    # On a straight line roots are exact; what is left is snapping.
    assert report.chord_error_max_m <= report.snap_max_m
    area = 0.0
    for face, above in zip(mesh.faces, mesh.above[0], strict=True):
        a, b, c = mesh.points[face]
        area += above * 0.5 * np.cross(b - a, c - a)[2]
    # The half plane's area within the square, by its width at the middle; snapping moves a little.
    assert area == pytest.approx(4.0 * (2.0 - 0.11), abs=report.snap_max_m * report.line_m + 1e-12)


def test_the_last_merge_above_its_threshold_wins_not_the_heaviest():
    sides = [np.array([0.5, 0.9, -0.1]), np.array([-0.2, 0.01, -0.3])]
    assert label_index(sides).tolist() == [1, 2, 0]


def test_the_label_line_is_where_the_weight_is_the_threshold():
    for threshold in (0.05, 0.3, 0.5, 0.8, 0.99):
        merge = Merge(5, 9.0, 3, 0.5, 2.0, 0.0, 5.0, threshold, 0.2)
        weight = merge.weight_of_side(np.array([0.0, 1e-9, -1e-9]))
        assert weight == pytest.approx(threshold, abs=1e-7)
        assert weight[1] > weight[2]


@pytest.mark.parametrize("coverage", [0.0, 0.1, 0.25, 0.9, 1.0])
def test_coverage_is_met(coverage):
    noise = np.random.default_rng(1).normal(size=10_001)
    center = center_for_coverage(noise, coverage)
    assert (noise >= center).mean() == pytest.approx(coverage, abs=1e-4)


@pytest.mark.parametrize("spread", [1.0, 1e-3, 1e-300])
def test_the_center_lies_between_the_two_samples_at_the_rank(spread):
    # Ties, a far outlier, and widths near the smallest number.
    noise = spread * np.random.default_rng(2).normal(size=4000).round(1)
    noise[7] = 40.0 * spread
    ordered = np.sort(noise)
    for rank in (1, 2, 999, 2000, 3998, 3999):
        expected = 0.5 * (ordered[rank - 1] + ordered[rank])
        assert center_for_coverage(noise, 1.0 - (rank + 0.5) / 4000) == expected


def test_without_labels_the_mesh_is_not_cut_and_without_color_there_are_no_weights():
    field = relief()
    whole, report = build_tiles(GroundSurface(field, MERGES), 1, color=False, cut_labels=False)
    assert report["faces"] == 2 * 100 * 100
    assert all(tile.weights.shape[0] == 0 for tile in whole)


def test_constant_relief_and_a_field_without_line_make_a_plain_grid():
    field = HeightField(Grid.with_spacing((4.0, 4.0), 1.0), np.full((5, 5), 3.25))
    never = Merge(5, 9.0, 3, 0.5, 2.0, 0.0, 5.0, 0.5, center=99.0)
    (tile,), report = build_tiles(GroundSurface(field, (never,)), 1)
    assert report["faces"] == 32
    assert report["cuts"][0]["line_m"] == 0.0
    assert (tile.layer == 0).all()
    assert np.array_equal(tile.translate[2] + tile.points[:, 2], np.full(25, 3.25))
