"""Levels of detail of plants: fewer leaves of the same area, wood and labels as they were."""

from __future__ import annotations

import json
from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest

from scenec.backends.stage.read import read_stage
from scenec.compiler.assets.looks import ModelMaterial
from scenec.compiler.assets.model import MeshModel, cached_model
from scenec.compiler.compile import compile_cfg
from scenec.compiler.objects.foliage import LEVELS, foliage_chain
from scenec.compiler.objects.lod import choose_levels, see_levels
from scenec.compiler.objects.rocks import Chain
from scenec.compiler.scene.objects import MeshPart, Prototype, Scatter
from scenec.compiler.views.needed import Keep
from scenec.compiler.views.resolution import Views
from scenec.testing.small import small_cfg, write_cfg

MODELS = Path(__file__).parents[3] / "assets" / "models"
SIDE, HEIGHT, WIDTH = 0.1, 1.0, 0.01


def _model(points: list, faces: list, materials: list[int], through: float = 0.5) -> MeshModel:
    looks = [
        ModelMaterial("leaf", (0.1, 0.2, 0.1), 0.5, 0.0, 0.04, diffuse_transmission=through),
        ModelMaterial("wood", (0.1, 0.1, 0.1), 0.5, 0.0, 0.04),
    ]
    return MeshModel(
        np.array(points, np.float64), np.array(faces, np.int32), None,
        np.zeros(len(faces), np.int32), ("all",), np.array(materials, np.int32), tuple(looks),
        None, (), (), 0, 0,
    )  # fmt: skip


def _chain(model: MeshModel) -> Chain:
    """Its levels, as a prototype whose parts are its materials."""
    parts = tuple(
        MeshPart(name, np.flatnonzero(model.material_of_face == i).astype(np.int32), name, None)
        for i, name in enumerate(("leaf", "wood"))
    )
    n = len(model.points)
    return foliage_chain(
        Prototype(
            "plant", model.points.astype(np.float32), model.faces, np.zeros((n, 3), np.float32),
            np.zeros(n, np.float32), parts=parts,
        ),
        model,
    )  # fmt: skip


def _leaves(count: int, wood: int = 0, through: float = 0.5) -> MeshModel:
    """Square leaves at random, all alike; and pieces of wood of 20 triangles, strips."""
    rng = np.random.Generator(np.random.Philox(3))
    points, faces, materials = [], [], []
    for center in rng.uniform(-2, 2, (count, 3)):
        first = len(points)
        turn = np.linalg.qr(rng.normal(size=(3, 3)))[0]
        square = np.array([[-1, -1, 0], [1, -1, 0], [1, 1, 0], [-1, 1, 0]]) * 0.5 * SIDE
        points += list(square @ turn.T + center)
        faces += [[first, first + 1, first + 2], [first, first + 2, first + 3]]
        materials += [0, 0]
    for center in rng.uniform(-2, 2, (wood, 3)):
        first = len(points)
        points += list(center + [[0.1 * (i // 2), 0.2 * (i % 2), 0] for i in range(22)])
        faces += [[first + i, first + i + 1, first + i + 2] for i in range(20)]
        materials += [1] * 20
    return _model(points, faces, materials, through)


def _blades(count: int) -> MeshModel:
    """Upright blades: two rungs and a tip."""
    rng = np.random.Generator(np.random.Philox(4))
    points, faces = [], []
    for x, y in rng.uniform(-1, 1, (count, 2)):
        first = len(points)
        for z in (0.0, 0.5 * HEIGHT):
            points += [[x - 0.5 * WIDTH, y, z], [x + 0.5 * WIDTH, y, z]]
        points.append([x, y, HEIGHT])
        faces += [
            [first + a, first + b, first + c] for a, b, c in ((0, 1, 3), (0, 3, 2), (2, 3, 4))
        ]
    return _model(points, faces, [0] * len(faces))


def _area(mesh: Prototype, faces: np.ndarray | slice = slice(None)) -> float:
    a, b, c = np.moveaxis(mesh.points.astype(np.float64)[mesh.faces[faces]], 1, 0)
    return float(0.5 * np.sqrt((np.cross(b - a, c - a) ** 2).sum(axis=1)).sum())


def test_each_level_has_half_of_the_leaves_and_all_of_their_area():
    chain = _chain(_leaves(1024))
    assert [len(mesh.faces) for mesh in chain] == [2048 >> level for level in range(LEVELS + 1)]
    for mesh in chain:
        assert _area(mesh) == pytest.approx(1024 * SIDE**2, rel=1e-5)


def test_the_error_is_by_how_much_corners_of_leaves_move():
    # A corner is half a diagonal off the center; sides grow by the root of two a level.
    for level, mesh in enumerate(_chain(_leaves(1024))):
        expected = SIDE / np.sqrt(2.0) * (np.sqrt(2.0) ** level - 1.0)
        assert mesh.error == pytest.approx(expected, rel=1e-5)


def test_levels_are_nested_about_the_same_middles():
    def middles(mesh: Prototype) -> set[tuple[float, ...]]:
        corners = mesh.points.astype(np.float64)[mesh.faces.reshape(-1, 6)[:, [0, 1, 2, 5]]]
        return {tuple(row) for row in np.round(corners.mean(axis=1), 4).tolist()}

    chain = _chain(_leaves(512))
    for fine, coarse in pairwise(chain):
        assert middles(coarse) < middles(fine)


def test_what_stays_is_spread_over_the_crown_evenly():
    # Eight octants of 512 leaves in the mean: at random, 64 of them would be off by 7.5.
    mesh = _chain(_leaves(4096))[3]
    corners = mesh.points[mesh.faces.reshape(-1, 6)[:, [0, 1, 2, 5]]].mean(axis=1)
    counts = np.bincount(((corners > 0) * [1, 2, 4]).sum(axis=1), minlength=8)
    whole = _leaves(4096).points.reshape(-1, 4, 3).mean(axis=1)
    expected = np.bincount(((whole > 0) * [1, 2, 4]).sum(axis=1), minlength=8) / 8.0
    assert np.abs(counts - expected).max() < 7.0


def test_wood_of_many_triangles_and_labels_stay():
    model = _leaves(256, wood=5)
    for mesh in _chain(model):
        leaf, wood = mesh.parts
        assert (leaf.name, wood.name) == ("leaf", "wood")
        assert len(leaf.faces) + len(wood.faces) == len(mesh.faces)
        kept = mesh.points[mesh.faces[wood.faces]]
        assert np.array_equal(kept, model.points.astype(np.float32)[model.faces[512:]])
        assert _area(mesh, leaf.faces) == pytest.approx(256 * SIDE**2, rel=1e-5)


def test_blades_of_grass_get_wider_not_longer():
    chain = _chain(_blades(64))
    for level, mesh in enumerate(chain):
        blades = mesh.points.astype(np.float64).reshape(-1, 5, 3)
        assert len(blades) == 64 >> level
        assert np.allclose(blades[:, 4, 2], HEIGHT)
        assert np.allclose(np.ptp(blades[:, :, 0], axis=1), WIDTH * 2**level, rtol=1e-4)
        assert _area(mesh) == pytest.approx(64 * 0.75 * WIDTH * HEIGHT, rel=1e-4)


def test_what_lets_no_light_through_keeps_all():
    assert len(_chain(_leaves(512, through=0.0))) == 1


def test_what_is_one_large_piece_has_one_level():
    points = [[0.1 * (i // 2), 0.2 * (i % 2), 0.0] for i in range(18)]
    model = _model(points, [[i, i + 1, i + 2] for i in range(16)], [0] * 16)
    assert len(_chain(model)) == 1


@pytest.mark.parametrize("name", ["oak", "spruce_old", "fern", "grass_tall"])
def test_models_that_ship_keep_their_colors_areas(name):
    model = cached_model(MODELS / f"{name}.glb", None, None, None)
    parts = [
        MeshPart(f"m{i}", np.flatnonzero(model.material_of_face == i).astype(np.int32), None, None)
        for i in range(len(model.materials))
    ]
    n = len(model.points)
    finest = Prototype(
        name, model.points.astype(np.float32), model.faces, np.zeros((n, 3), np.float32),
        np.zeros(n, np.float32), parts=tuple(parts),
    )  # fmt: skip
    chain = foliage_chain(finest, model)
    assert len(chain) >= 4
    for mesh in chain[1:]:
        for before, part in zip(finest.parts, mesh.parts, strict=True):
            assert _area(mesh, part.faces) == pytest.approx(_area(finest, before.faces), rel=0.02)
        assert np.sqrt((mesh.points.astype(np.float64) ** 2).sum(axis=1)).max() <= mesh.radius


def test_a_tree_counts_as_near_as_its_nearest_leaf():
    rng = np.random.Generator(np.random.Philox(5))
    leaves = _leaves(512)
    # A crown 20 m above its foot: the ball around the foot would reach the camera.
    model = _model(np.add(leaves.points, (0, 0, 20)).tolist(), leaves.faces.tolist(), [0] * 1024)
    chain = _chain(model)
    eye = np.array([[0.0, 0.0, 1.0]])
    far = rng.uniform(30, 60, 8)
    views = _looking_about(eye)
    levels = see_levels(_along_x(chain[0], far), (chain,), views, 1.0, 0.5, small_pieces=True)
    for i, x in enumerate(far.tolist()):
        nearest = np.sqrt((np.add(model.points, (x, 0, 0) - eye) ** 2).sum(axis=1)).min()
        assert 500.0 / nearest <= levels.near[i] * 1.0001
        # Parts are balls of at most 2.5 m.
        assert levels.near[i] <= 500.0 / (nearest - 5.0)


def _along_x(mesh: Prototype, x: np.ndarray) -> Scatter:
    n = len(x)
    return Scatter(
        "trees", None, {}, True, (mesh,), np.zeros(n, np.int32), np.arange(1, n + 1), n,
        np.stack([x, 0 * x, 0 * x], axis=1).astype(np.float32),
        np.tile(np.array([0, 0, 0, 1], np.float16), (n, 1)), np.ones((n, 3), np.float32),
        np.zeros(n, np.float32),
    )  # fmt: skip


def _looking_about(eye: np.ndarray) -> Views:
    """Cameras of 500 px a radian that see all."""
    n = len(eye)
    return Views(
        eye, np.zeros((n, 5, 3)), np.tile([0.0, 0.0, 1.0], (n, 1)),
        np.tile([-1.0, 0.0, np.inf], (n, 1)),
        np.full(n, 500.0), np.zeros(n, np.uint8), np.zeros((n, 0, 0), np.float32), np.zeros(4),
    )  # fmt: skip


def test_levels_leave_places_and_ids_as_they_are(tmp_path):
    found = {}
    for lod_px in (0.0, 0.5):
        folder = tmp_path / f"{lod_px}"
        folder.mkdir()
        cfg = small_cfg(samples=1, outputs=["label", "instance"])
        cfg["objects"]["ferns"] = {
            "type": "meshes", "models": [{"file": "package:assets/models/fern.glb"}], "count": 60,
            "labels": cfg["objects"]["rocks"]["labels"], "lod_px": lod_px,
        }  # fmt: skip
        compile_cfg(write_cfg(folder, cfg), seed=3, out=folder / "out", keep=Keep.UNPRUNED)
        batch = next((folder / "out").glob("batch_*"))
        ferns = json.loads((batch / "report.json").read_text())["objects"]["ferns"]
        found[lod_px] = (read_stage(next(batch.glob("*.usda"))), ferns)
    (fine, all_of_it), (coarse, less) = found[0.0], found[0.5]
    ids = [scene.rows.instance_id for scene in (fine, coarse)]
    orders = [np.argsort(own, kind="stable") for own in ids]
    assert np.array_equal(ids[0][orders[0]], ids[1][orders[1]])
    assert (ids[0] > 0).sum() >= 60
    poses = [
        scene.rows.to_world[order] for scene, order in zip((fine, coarse), orders, strict=True)
    ]
    assert np.array_equal(*poses)
    assert all_of_it["triangles"] == all_of_it["triangles_finest"] == less["triangles_finest"]
    assert less["triangles"] < less["triangles_finest"]
    assert 0.0 < less["lod_error_max_px"] <= 0.5


def test_levels_tell_how_far_their_mean_color_is_off():
    count = 1024
    rng = np.random.Generator(np.random.Philox(6))
    of_leaf = rng.uniform(0.0, 1.0, (count, 3)).astype(np.float32)
    corners = np.repeat(np.repeat(of_leaf, 2, axis=0)[:, None], 3, axis=1)
    model = _leaves(count)
    n = len(model.points)
    finest = Prototype(
        "plant", model.points.astype(np.float32), model.faces, np.zeros((n, 3), np.float32),
        np.zeros(n, np.float32), colors=corners,
    )  # fmt: skip
    chain = foliage_chain(finest, model)
    far = np.geomspace(2.0, 2000.0, 64)
    eye = np.zeros((1, 3))
    levels = see_levels(_along_x(finest, far), (chain,), _looking_about(eye), 1.0, 1.0)
    facts = choose_levels(levels)[1]["levels"]
    assert len(facts) >= 5
    told = [facts[mesh.name]["color_error"] for mesh in chain if mesh.name in facts]
    for mesh in chain:
        if mesh.name not in facts:
            continue
        # All leaves have one area; each is two triangles of one color.
        kept = mesh.colors[::2, 0].astype(np.float64)
        error = facts[mesh.name]["color_error"]
        off = np.abs(kept.mean(axis=0) - of_leaf.mean(axis=0, dtype=np.float64)).max()
        assert error == pytest.approx(off, abs=1e-6)
        # What a sample of k of N leaves is off by, of uniform colors.
        assert error <= 4.0 * np.sqrt((1.0 / len(kept) - 1.0 / count) / 12.0) + 1e-6
    assert max(told) > 0.005
    assert (
        "color_error"
        not in choose_levels(
            see_levels(
                _along_x(_chain(model)[0], far), (_chain(model),), _looking_about(eye), 1.0, 1.0
            )
        )[1]["levels"]["plant"]
    )
