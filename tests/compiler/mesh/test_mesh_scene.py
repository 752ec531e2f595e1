"""Scenes on a mesh: rocks on every floor, faults of the cfg, and a stage that compiles."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
import trimesh
from test_mesh_surface import GRID, base, hits
from test_scatter import quaternions, shape

from scenec.compiler.build import BuildLog, build
from scenec.compiler.cfg.load import load
from scenec.compiler.draw import draw
from scenec.compiler.geometry.rotations import rotation_rows
from scenec.compiler.mesh.surface import GroundSurface
from scenec.compiler.objects.bodies import Bodies
from scenec.compiler.objects.density import Density, NoiseDensity, UniformDensity
from scenec.compiler.objects.mesh_candidates import STANDING, MeshCandidates, Spots
from scenec.compiler.objects.mesh_seating import seat_on_mesh
from scenec.compiler.objects.placement_context import PlacementContext
from scenec.compiler.objects.rocks import build_prototypes
from scenec.compiler.terrain.operators.multifractal import Multifractal
from scenec.compiler.terrain.program import run
from scenec.compiler.terrain.sources.mesh_surface import MeshSurface
from scenec.schemas.errors import CfgError, SceneError
from scenec.testing.overhangs import keys, shelter, write
from scenec.testing.small import small_cfg, write_cfg

N = 400
PROTOTYPES = build_prototypes([shape(1, level=2), shape(2, level=2)])
PROTOTYPE = (np.arange(N) % 2).astype(np.int32)
TURNS = quaternions(N).astype(np.float16)
EMBED = np.linspace(0.0, 0.5, N)


def place_on_mesh(surface: MeshSurface, density: Density, u: np.ndarray, name: str) -> Spots:
    """Spots that uniform numbers lead to."""
    around = PlacementContext(GroundSurface(surface), np.zeros((0, 3)))
    return MeshCandidates(surface, density, (), around, name).spots(u)


def table(folder: Path) -> Path:
    """A floor of 20 m by 20 m, and a slab of 8 m by 4 m whose top is 4 m above it."""
    floor = np.array([[-10, -10, 0], [10, -10, 0], [10, 10, 0], [-10, 10, 0]], float)
    slab = trimesh.creation.box(extents=(8, 4, 1)).apply_translation((0, 0, 3.5))
    points = np.concatenate([floor, slab.vertices])
    faces = np.concatenate([[[0, 1, 2], [0, 2, 3]], slab.faces + 4])
    return write(folder / "table.ply", points, faces)


def uniforms(n: int = N) -> np.ndarray:
    return np.random.default_rng(3).random((n, 3))


def seated(surface: MeshSurface, spots: Spots, size: np.ndarray) -> tuple[np.ndarray, list]:
    """Heights of rocks, and each one's vertices."""
    x, y = np.ascontiguousarray(spots.points[:, :2].T)
    bodies = Bodies.of(PROTOTYPES, PROTOTYPE, (x, y), TURNS, size, EMBED)
    z = seat_on_mesh(surface, spots, bodies)
    rocks = []
    for n in range(N):
        turn = np.array(rotation_rows(TURNS[n].astype(float))).reshape(3, 3)
        points = PROTOTYPES[PROTOTYPE[n]].points.astype(float) @ turn.T * size[n]
        rocks.append(points + np.array([x[n], y[n], z[n]]))
    return z, rocks


def test_rocks_lie_on_the_table_and_under_it_as_densely_as_around_it(tmp_path):
    surface = run([base(table(tmp_path))], GRID).field
    assert isinstance(surface, MeshSurface)
    spots = place_on_mesh(surface, UniformDensity(), uniforms(), "rocks")
    x, y, z = spots.points.T
    assert (np.minimum(np.abs(z), np.abs(z - 4.0)) < 1e-12).all()
    on, covered = z > 2.0, (np.abs(x) < 4) & (np.abs(y) < 2)
    # The slab's underside carries nothing; 432 m^2 do.
    assert on.mean() == pytest.approx(32 / 432, abs=0.04)
    assert (covered & ~on).mean() == pytest.approx(32 / 432, abs=0.04)
    assert np.array_equal(on & ~covered, np.zeros(N, bool))
    _, rocks = seated(surface, spots, np.full(N, 0.8))
    for n, rock in enumerate(rocks):
        # At an edge, of the table or of the floor, only what is over it counts.
        half = (4.0, 2.0) if on[n] else (10.0, 10.0)
        over = (np.abs(rock[:, :2]) < half).all(axis=1)
        depth = EMBED[n] * np.ptp(rock[:, 2])
        assert rock[over, 2].min() == pytest.approx(z[n] - depth, abs=1e-9)


def test_rocks_neither_float_over_a_cave_s_floor_nor_sink_into_it(tmp_path):
    relief = Multifractal(key=1, amplitude_m=0.3, scale_m=4.0, octaves=4)
    path = write(tmp_path / "cave.glb", *shelter(24))
    surface = run([base(path), relief], GRID).field
    assert isinstance(surface, MeshSurface)
    spots = place_on_mesh(surface, UniformDensity(), uniforms(), "rocks")
    _, rocks = seated(surface, spots, np.linspace(0.05, 0.6, N))
    corners = surface.points[surface.faces]
    low, high = corners.min(axis=1), corners.max(axis=1)
    roofed = exact = 0
    for n in range(0, N, 3):
        rock, height = rocks[n], np.ptp(rocks[n][:, 2])
        here = ((low <= rock.max(axis=0)) & (high >= rock.min(axis=0)))[:, :2].all(axis=1)
        layers = [hits(surface.points, surface.faces[here], x, y) for x, y, _ in rock]
        z = spots.points[n, 2]
        near = [h[np.argmin(np.abs(h - z))] if len(h) else -np.inf for h in layers]
        clearance = (rock[:, 2] - near).min()
        roofed += max(h[-1] for h in layers if len(h)) > z + 0.8
        # Beside a wall, the nearest surface can be the wall, which carries nothing.
        exact += abs(clearance + EMBED[n] * height) < 1e-6
        assert clearance < -EMBED[n] * height + 1e-6
    assert roofed > 8
    assert exact > 0.97 * N / 3


def test_rocks_stand_on_floors_only_and_turn_with_them(tmp_path):
    path = write(tmp_path / "cave.glb", *shelter(24))
    surface = run([base(path)], GRID).field
    assert isinstance(surface, MeshSurface)
    spots = place_on_mesh(surface, UniformDensity(), uniforms(), "rocks")
    mesh = trimesh.Trimesh(surface.points, surface.faces, process=False)
    own = mesh.face_normals[spots.face]
    assert (own[:, 2] >= STANDING - 1e-12).all()
    assert np.allclose(np.linalg.norm(spots.normals, axis=1), 1.0, atol=1e-12)
    assert ((spots.normals * own).sum(axis=1) >= STANDING - 1e-12).all()
    heights = [hits(surface.points, surface.faces, x, y) for x, y, _ in spots.points]
    away = [np.abs(h - p[2]).min() for h, p in zip(heights, spots.points, strict=True)]
    assert max(away) < 1e-9
    assert (np.abs(spots.points[:, :2]) <= 10.0 + 1e-9).all()


def test_more_rocks_leave_the_first_where_they_are_and_density_is_followed(tmp_path):
    surface = run([base(table(tmp_path))], GRID).field
    assert isinstance(surface, MeshSurface)
    density = NoiseDensity(key=5, scale_m=6.0, octaves=2, contrast=2.0)
    few = place_on_mesh(surface, density, uniforms(50), "rocks")
    many = place_on_mesh(surface, density, uniforms(4000), "rocks")
    assert np.array_equal(few.points, many.points[:50])
    got = density.at(*np.ascontiguousarray(many.points[:, :2].T))
    even = density.at(*np.random.default_rng(0).uniform(-10, 10, (2, 4000)))
    # Places go by density, so their mean density is the mean square over the mean.
    assert got.mean() == pytest.approx((even * even).mean() / even.mean(), rel=0.1)
    assert len(place_on_mesh(surface, density, uniforms(0), "rocks").face) == 0
    corners = np.array([[0, 0, 0], [1, 0, 0], [0, 0, 1]], float)
    wall = MeshSurface(GRID, surface.height, corners, np.array([[0, 1, 2]], np.int32))
    with pytest.raises(SceneError, match=r"objects/rocks: no face .* is flat enough"):
        place_on_mesh(wall, density, uniforms(3), "rocks")


def mesh_cfg(folder: Path, *rest: dict, **change) -> Path:
    path = folder / "cave.glb"
    if not path.exists():
        write(path, *shelter(16))
    cfg = small_cfg()
    cfg["terrain"] |= {"size_m": [20, 20], "spacing_m": 0.4}
    cfg["terrain"]["relief"] = [{"type": "mesh", "file": "cave.glb", **change}, *rest]
    cfg["objects"]["rocks"]["count"] = 60
    return write_cfg(folder, cfg)


def test_a_scene_on_a_mesh_is_built_and_reported(tmp_path):
    rough = {"amplitude_m": {"type": "uniform", "min": 0.05, "max": 0.1}, "scale_m": 2}
    hills = {"type": "multifractal", "amplitude_m": 0.2, "scale_m": 4, "octaves": 9}
    cfg = mesh_cfg(tmp_path, hills, roughness=rough, rotation_deg=90)
    log = BuildLog()
    scene = build(draw(load(cfg), 3, 0), log)
    step = log.facts["relief"][0]
    assert step["type"] == "mesh"
    assert step["overhang_fraction"] > 0.02
    assert step["edge_max_m"] <= 0.4
    assert step["roughness_octaves"] == 2
    assert scene.objects[0].count == 60
    assert sum(len(tile.faces) for tile in scene.ground.tiles) == log.facts["ground"]["faces"]
    again = build(draw(load(cfg), 3, 0), BuildLog())
    for a, b in zip(scene.ground.tiles, again.ground.tiles, strict=True):
        assert a.points.tobytes() == b.points.tobytes()
    other = build(draw(load(cfg), 4, 0), BuildLog())
    assert other.ground.tiles[0].points.tobytes() != scene.ground.tiles[0].points.tobytes()
    json.dumps(log.facts, allow_nan=False)


MASK = [{"type": "height", "min_m": 0}]


@pytest.mark.parametrize(
    ("change", "pointer", "words"),
    [
        ({"mask": MASK}, "/terrain/relief/0/mask", "the mesh is kept as it is"),
        (
            {"surface": "heights", "roughness": {"amplitude_m": 1, "scale_m": 1}},
            "/terrain/relief/0/roughness",
            "heights have none",
        ),
        ({"part": "attic"}, "/terrain/relief/0/file", "no part 'attic'; it has /shelter"),
        ({"file": "cave.obj"}, "/terrain/relief/0", 'the key "unit_m" is missing'),
        ({"file": "no.glb"}, "/terrain/relief/0/file", "no.glb"),
    ],
)
def test_faults_of_a_mesh_base_are_found_in_the_cfg(tmp_path, change, pointer, words):
    write(tmp_path / "cave.obj", *shelter(6))
    with pytest.raises(CfgError) as caught:
        load(mesh_cfg(tmp_path, **change))
    fault = caught.value.faults[0]
    assert fault.pointer == pointer
    assert words in fault.message


def test_a_mesh_later_in_the_program_becomes_heights_and_may_have_a_mask(tmp_path):
    cfg = json.loads(mesh_cfg(tmp_path).read_text())
    later = {"type": "mesh", "file": "cave.glb"}
    cfg["terrain"]["relief"] = [{"type": "plane"}, later]
    with pytest.raises(CfgError, match="can be kept by the first operator only"):
        load(write_cfg(tmp_path, cfg))
    later |= {"surface": "heights", "mask": MASK}
    plan = draw(load(write_cfg(tmp_path, cfg)), 0, 0)
    field = run(plan.terrain.relief, GRID).field
    assert not isinstance(field, MeshSurface)
    assert np.ptp(field.height) > 4.0


def test_keys_of_the_formats_are_those_that_a_cfg_must_give(tmp_path):
    for suffix in ("obj", "ply", "usda"):
        write(tmp_path / f"a.{suffix}", *shelter(8))
        cfg = mesh_cfg(tmp_path, file=f"a.{suffix}", **keys(suffix))
        assert load(cfg).files["terrain/relief/0/file"].path.name == f"a.{suffix}"
