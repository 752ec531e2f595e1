"""The adaptive mesh: whole, within its tolerance in every view, and no finer than that takes."""

from __future__ import annotations

import numpy as np
import pytest
from elsewhere import printed_elsewhere, printed_here
from hypothesis import given
from hypothesis import strategies as st

from scenec.compiler.geometry.poses import look_at
from scenec.compiler.mesh import adaptive
from scenec.compiler.mesh.merge import Merge
from scenec.compiler.mesh.mesh import Meshing, grid_mesh
from scenec.compiler.mesh.surface import GroundSurface
from scenec.compiler.mesh.tiles import build_tiles
from scenec.compiler.scene.rig import Rig, Sensor
from scenec.compiler.terrain.grid import Grid, HeightField
from scenec.compiler.terrain.operators.multifractal import Multifractal
from scenec.compiler.views.resolution import pixels_per_meter, views_of
from scenec.testing.examples import examples

MERGES = (
    Merge(5, 9.0, 3, 0.5, 2.0, 0.0, 5.0, 0.5),
    Merge(6, 14.0, 3, 0.4, 2.0, 0.3, 7.0, 0.3, 0.1),
)


def relief(size: float = 60.0, spacing: float = 0.15) -> HeightField:
    grid = Grid.with_spacing((size, 0.8 * size), spacing)
    operator = Multifractal(key=1, amplitude_m=1.5, scale_m=12.0, octaves=7)
    return HeightField(grid, operator.apply(grid, np.zeros(grid.shape))[0])


def one_rig(field: HeightField, eye=(3.0, -20.0), target=(0.0, 0.0), height: float = 1.5) -> Rig:
    ground = field.height_at(np.array([eye[0]]), np.array([eye[1]]))[0]
    at = field.height_at(np.array([target[0]]), np.array([target[1]]))[0]
    pose = look_at(np.array([*eye, ground + height]), np.array([*target, at]), 0.0)
    sensor = Sensor(
        "eye", (640, 480), (500.0, 500.0, 320.0, 240.0, 0.0), np.eye(4), np.zeros(1), ()
    )
    return Rig("rig", pose[None], (sensor,))


@pytest.fixture(scope="module")
def field() -> HeightField:
    return relief()


@pytest.fixture(scope="module")
def sight(field) -> np.ndarray:
    return pixels_per_meter(field, views_of((one_rig(field),)), 0.125)


def faces_of(errors: np.ndarray, tolerance: float, shape: tuple[int, int]) -> np.ndarray:
    return adaptive.triangles(adaptive.activate(errors, tolerance), shape)


def heights(height: np.ndarray) -> adaptive.Channels:
    """Heights alone, a pixel a meter."""
    none = np.zeros((0, *height.shape))
    return adaptive.Channels(height, none, none, (1.0, 1.0), np.ones(height.shape))


def require_whole(faces: np.ndarray, shape: tuple[int, int]) -> None:
    """Every face counter-clockwise; together the rectangle; every inner edge used exactly twice."""
    ny, nx = shape
    x, y = faces.astype(np.int64) % nx, faces.astype(np.int64) // nx
    area = (x[:, 1] - x[:, 0]) * (y[:, 2] - y[:, 0]) - (x[:, 2] - x[:, 0]) * (y[:, 1] - y[:, 0])
    assert area.min() > 0
    assert area.sum() == 2 * (nx - 1) * (ny - 1)
    edges = np.sort(np.concatenate([faces[:, [0, 1]], faces[:, [1, 2]], faces[:, [2, 0]]]), axis=1)
    unique, uses = np.unique(edges, axis=0, return_counts=True)
    ex, ey = unique % nx, unique // nx
    border = np.zeros(len(unique), bool)
    for e, last in ((ex, nx - 1), (ey, ny - 1)):
        border |= (e == 0).all(axis=1) | (e == last).all(axis=1)
    assert (uses[border] == 1).all()
    assert (uses[~border] == 2).all()


@examples(40)
@given(st.integers(2, 300), st.integers(2, 300), st.integers(0, 2**32 - 1), st.floats(0.0, 1.0))
def test_any_choice_of_samples_gives_a_mesh_without_cracks(ny, nx, seed, part):
    root = adaptive.ROOT_CELLS
    shape = tuple(-(-(n - 1) // root) * root + 1 for n in (ny, nx))
    errors = np.random.default_rng(seed).random(shape).astype(np.float32)
    # The border must be kept whatever else is left out.
    forced = adaptive.vertex_errors(heights(np.zeros((ny, nx))), 1.0)
    errors = np.where(np.isinf(forced), forced, errors)
    require_whole(faces_of(errors, part, (ny, nx)), (ny, nx))


@examples(20)
@given(
    st.integers(2, 200), st.integers(2, 200), st.integers(0, 2**32 - 1), st.floats(0.1, 3.0),
    st.integers(0, 2),
)  # fmt: skip
def test_errors_measured_no_further_than_it_takes_choose_the_same_samples(
    ny, nx, seed, tolerance, count
):
    rng = np.random.default_rng(seed)
    y, x = np.meshgrid(np.linspace(0.0, 9.0, ny), np.linspace(0.0, 9.0, nx), indexing="ij")
    rough = 10.0 ** rng.uniform(-3.0, 0.5)
    channels = adaptive.Channels(
        np.sin(x) * np.cos(y) + rough * rng.random((ny, nx)),
        np.sin(rng.uniform(0.2, 2.0, (count, 1, 1)) * x + y),
        rng.uniform(0.0, 2.0, (2, 1, 1)) * np.sin(x - y),
        (0.3, 0.2),
        rng.uniform(0.1, 30.0) / (0.1 + x),
    )
    errors = adaptive.vertex_errors(channels, tolerance)
    active = adaptive.activate(errors, tolerance)
    assert (adaptive.needed(channels, tolerance) == active).all()


def test_a_plane_takes_the_coarsest_triangles_there_are():
    shape = (257, 385)
    y, x = np.meshgrid(np.arange(257.0), np.arange(385.0), indexing="ij")
    errors = adaptive.vertex_errors(heights(3.0 + 0.5 * x - 0.25 * y), 1.0)
    assert errors.max() < 1e-9
    assert len(faces_of(errors, 0.5, shape)) == 2 * 2 * 3


def test_all_samples_give_the_grid_s_own_triangles():
    shape = (131, 70)
    errors = np.ones((257, 129), np.float32)
    ours = np.sort(faces_of(errors, 0.5, shape), axis=1)
    grid = grid_mesh(HeightField(Grid((69.0, 130.0), shape), np.zeros(shape))).faces
    assert set(map(tuple, ours.tolist())) == set(map(tuple, np.sort(grid, axis=1).tolist()))


def test_the_height_error_stays_below_the_tolerance_in_pixels(field, sight):
    for tolerance in (0.25, 0.5, 2.0):
        tiles, report = build_tiles(
            GroundSurface(field, (), smooth=False), 1, Meshing(tolerance, 10**9, 0.125), sight
        )
        points = np.concatenate([t.translate + t.points.astype(float) for t in tiles])
        faces = np.concatenate(
            [t.faces + n for t, n in zip(
                tiles, np.cumsum([0] + [len(t.points) for t in tiles]), strict=False)]
        )  # fmt: skip
        # An interpolation that knows nothing of how the mesh was made.
        height = _height_of_mesh(points, faces, field)
        error = np.abs(height - field.height) * sight
        assert error.max() <= tolerance * (1 + 1e-3)
        assert report["mesh"]["height_error_max_px"] == pytest.approx(error.max(), rel=1e-3)
        assert report["mesh"]["triangles"] < 0.7 * report["mesh"]["triangles_of_grid"]


def _height_of_mesh(points, faces, field) -> np.ndarray:
    from matplotlib.tri import LinearTriInterpolator, Triangulation

    unique, index = np.unique(points[:, :2], axis=0, return_inverse=True)
    z = np.empty(len(unique))
    z[index.reshape(-1)] = points[:, 2]
    mesh = Triangulation(unique[:, 0], unique[:, 1], index.reshape(-1)[faces])
    x, y = np.meshgrid(field.grid.x(), field.grid.y())
    height = LinearTriInterpolator(mesh, z)(x, y).filled(np.nan)
    # The outermost samples may lie a rounding outside of the mesh.
    return np.where(np.isnan(height), field.height, height)


def test_labels_stray_no_farther_than_the_tolerance(field, sight):
    _, report = build_tiles(
        GroundSurface(field, MERGES, smooth=False), 1, Meshing(0.5, 10**9, 0.125), sight
    )
    # Snapping may add a thirty-second of an edge, which the finest edges near the camera show.
    assert report["mesh"]["label_error_max_px"] <= 0.5 + SNAPPED_PX(field, sight)
    assert report["mesh"]["triangles"] < 0.7 * report["mesh"]["triangles_of_grid"]


def SNAPPED_PX(field, sight) -> float:  # noqa: N802
    return float(sight.max() * max(field.grid.spacing_m) * 2**0.5 / 32)


def test_a_budget_that_binds_is_kept_and_the_error_it_cost_is_said(field, sight):
    free = build_tiles(
        GroundSurface(field, (), smooth=False), 1, Meshing(0.5, 10**9, 0.125), sight
    )[1]["mesh"]
    assert not free["budget_bound"]
    bound = build_tiles(
        GroundSurface(field, (), smooth=False),
        1,
        Meshing(0.5, free["triangles"] // 3, 0.125),
        sight,
    )[1]["mesh"]
    assert bound["budget_bound"]
    assert bound["triangles"] <= free["triangles"] // 3
    assert bound["tolerance_reached_px"] > 0.5
    assert bound["height_error_max_px"] <= bound["tolerance_reached_px"] * (1 + 1e-6)


def test_ground_near_a_camera_is_finer_than_far_and_seen_finer_than_unseen(field):
    rig = one_rig(field)
    tiles, _ = build_tiles(
        GroundSurface(field, (), smooth=False),
        1,
        Meshing(0.5, 10**9, 0.05),
        pixels_per_meter(field, views_of((rig,)), 0.05),
    )
    middles = np.concatenate([(t.translate + t.points[t.faces].mean(axis=1)) for t in tiles])

    def density(x: float, y: float) -> int:
        return int((np.abs(middles[:, :2] - [x, y]) < 4.0).all(axis=1).sum())

    near, far, behind = density(3.0, -14.0), density(0.0, 18.0), density(22.0, -19.0)
    assert near > far > 0
    assert near > 2 * behind


def test_pixels_per_meter_are_those_of_the_nearest_view(field):
    rigs = (one_rig(field), one_rig(field, (-10.0, 10.0), (0.0, 10.0)))
    both = pixels_per_meter(field, views_of(rigs), 0.125)
    single = [pixels_per_meter(field, views_of((rig,)), 0.125) for rig in rigs]
    np.testing.assert_array_equal(both, np.maximum(*single))
    # By hand, for a sample in the middle of the first picture.
    x, y = field.grid.x(), field.grid.y()
    i, j = int(np.argmin(np.abs(x))), int(np.argmin(np.abs(y)))
    eye = rigs[0].to_world[0][:3, 3]
    distance = np.linalg.norm([x[i], y[j], field.height[j, i]] - eye)
    assert single[0][j, i] == pytest.approx(500.0 / distance, rel=1e-12)


_HASH = """
import hashlib
import test_adaptive as t
from scenec.compiler.mesh.surface import GroundSurface
from scenec.compiler.mesh.tiles import build_tiles
from scenec.compiler.mesh.mesh import Meshing
from scenec.compiler.views.resolution import pixels_per_meter, views_of
field = t.relief(30.0)
sight = pixels_per_meter(field, views_of((t.one_rig(field, (3.0, -10.0)),)), 0.125)
surface = GroundSurface(field, t.MERGES, smooth=False)
tiles, _ = build_tiles(surface, 1, Meshing(0.5, 10**9, 0.125), sight)
digest = hashlib.sha256()
for tile in tiles:
    for array in (tile.points, tile.faces, tile.normals, tile.layer, tile.weights):
        digest.update(array.tobytes())
print(digest.hexdigest())
"""


def test_the_mesh_has_the_same_bytes_for_any_number_of_threads():
    assert printed_elsewhere(_HASH) == printed_here(_HASH)
