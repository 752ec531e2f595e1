"""Families of rocks: sound meshes, known shapes, levels of detail whose error is as stated."""

from __future__ import annotations

import hashlib
from collections.abc import Iterator
from functools import cache

import numpy as np
import pytest
import trimesh
from elsewhere import digest_elsewhere

from scenec.compiler.cfg.fill import fill
from scenec.compiler.distributions.streams import Streams
from scenec.compiler.geometry.icosphere import EDGE, face_neighbors, icosphere
from scenec.compiler.geometry.normals import faces_of_vertices
from scenec.compiler.kinds.context import Context
from scenec.compiler.kinds.declare import declared_keys
from scenec.compiler.kinds.draw import draw_kind
from scenec.compiler.kinds.table import ROCKS
from scenec.compiler.objects.creases import along_creases
from scenec.compiler.objects.families.rocks import Rocks, family_of
from scenec.compiler.objects.families.shape import Shape
from scenec.compiler.objects.lod import budget_factor, choose_levels, see_levels
from scenec.compiler.objects.plan import ScatterPlan
from scenec.compiler.objects.rocks import Chain, build_chains, build_prototypes
from scenec.compiler.scene.objects import Prototype, Scatter
from scenec.compiler.scene.rig import Rig, Sensor
from scenec.compiler.terrain.mask import Masked
from scenec.compiler.terrain.operators.dunes import Dunes
from scenec.compiler.views.resolution import NO_VIEWS, Views, views_of
from scenec.schemas.errors import SceneError
from scenec.testing.small import small_cfg


def drawn(cfg: dict, context: Context, name: str = "rocks") -> ScatterPlan:
    return draw_kind("objects", fill(cfg)["objects"][name], f"objects/{name}", context)


def plan(seed: int = 1, **change) -> ScatterPlan:
    cfg = small_cfg()
    cfg["objects"]["rocks"] |= {"prototypes": 6, "subdivisions": 3, "count": 40} | change
    return drawn(cfg, Context(Streams(seed, 0)))


def shapes(family: str, seed: int = 1, **change) -> tuple[Shape, ...]:
    return plan(seed, family=family, **change).source.shapes


@cache
def chains(family: str) -> tuple[Chain, ...]:
    return build_chains(shapes(family))


def mesh_of(rock: Prototype) -> trimesh.Trimesh:
    return trimesh.Trimesh(rock.points.astype(np.float64), rock.faces, process=False)


def meshes(family: str) -> Iterator[trimesh.Trimesh]:
    for chain in chains(family):
        for rock in chain:
            yield mesh_of(rock)


def crossings(mesh: trimesh.Trimesh) -> int:
    """Pairs of faces without a common vertex whose edges pierce one another."""
    corners, found = mesh.triangles, 0
    low, high = corners.min(axis=1), corners.max(axis=1)
    for f in range(len(corners)):
        near = ((low <= high[f]) & (high >= low[f])).all(axis=1)
        near &= ~np.isin(mesh.faces, mesh.faces[f]).any(axis=1)
        others = corners[near]
        normal = np.cross(others[:, 1] - others[:, 0], others[:, 2] - others[:, 0])
        for a, b in ((0, 1), (1, 2), (2, 0)):
            p, q = corners[f, a], corners[f, b]
            up = (normal * (p - others[:, 0])).sum(axis=1)
            down = (normal * (q - others[:, 0])).sum(axis=1)
            with np.errstate(invalid="ignore", divide="ignore"):
                at = p + (up / (up - down))[:, None] * (q - p)
            inside = up * down < 0
            for i, j in ((0, 1), (1, 2), (2, 0)):
                edge = np.cross(others[:, j] - others[:, i], at - others[:, i])
                inside &= (edge * normal).sum(axis=1) > 0
            found += int(inside.sum())
    return found


@pytest.mark.parametrize("family", ROCKS)
def test_every_level_is_closed_manifold_and_faces_outward(family):
    for mesh in meshes(family):
        assert mesh.is_watertight
        assert mesh.is_winding_consistent
        assert mesh.euler_number == 2
        assert mesh.volume > 0.01
        assert len(np.unique(mesh.faces)) == len(mesh.vertices)


@pytest.mark.parametrize("family", ROCKS)
def test_no_two_faces_cross(family):
    for chain in chains(family)[:2]:
        for rock in chain[1:]:
            assert crossings(mesh_of(rock)) == 0


def test_faces_that_cross_would_be_found():
    mesh = mesh_of(chains("weathered")[0][1])
    mesh.vertices[5] = -1.5 * mesh.vertices[5]
    assert crossings(mesh) > 0


@pytest.mark.parametrize("family", ROCKS)
@pytest.mark.parametrize("bumpiness", [0.0, 1.0])
@pytest.mark.parametrize("subdivisions", [1, 4])
def test_from_a_point_inside_every_face_is_seen_from_behind(family, bumpiness, subdivisions):
    # Star-shaped: each ray from that point leaves once, so the surface cannot meet itself.
    for edge in (0.0, 1.0):
        key = "angularity" if family == "weathered" else "wear"
        change = {"bumpiness": bumpiness, "subdivisions": subdivisions, "prototypes": 3, key: edge}
        for shape in shapes(family, **change):
            directions = along_creases(subdivisions, *shape.creases())
            radius, variation = shape.surface(directions, EDGE * 0.5**subdivisions)
            corners = (directions * radius[:, None])[icosphere(subdivisions)[1]]
            sides = (np.cross(corners[:, 0], corners[:, 1]) * corners[:, 2]).sum(axis=1)
            assert (sides > 0.0).all()
            assert radius.min() > 0.05
            assert radius.max() < 3.0
            assert np.abs(variation).max() <= 1.0


@pytest.mark.parametrize("family", ROCKS)
def test_no_triangle_is_a_sliver(family):
    for mesh in meshes(family):
        sides = np.linalg.norm(mesh.triangles - np.roll(mesh.triangles, 1, axis=1), axis=2)
        quality = 4.0 * np.sqrt(3.0) * mesh.area_faces / (sides**2).sum(axis=1)
        # A fifth of the length high or more, but for what stands steep in a step or a pit.
        assert np.quantile(quality, 0.02) > 0.12
        assert quality.min() > 1e-3


@pytest.mark.parametrize("family", ROCKS)
def test_meshes_fit_the_ball_of_diameter_1_and_the_finest_fills_it(family):
    for chain in chains(family):
        radii = [np.linalg.norm(rock.points, axis=1).max() for rock in chain]
        assert radii[0] == pytest.approx(0.5, abs=1e-6)
        assert max(radii) <= 0.5 + 1e-6
        middle = 0.5 * (chain[0].points.min(axis=0) + chain[0].points.max(axis=0))
        assert np.abs(middle).max() < 1e-6


@pytest.mark.parametrize(("family", "elongation", "flatness"), [
    ("weathered", 0.18, 0.4),
    ("angular", 1 - 1 / np.sqrt(2), 0.5),
    ("rounded", 0.22, 0.45),
    ("slab", 0.25, 0.8),
    ("vesicular", 0.2, 0.35),
    ("ventifact", 0.28, 0.5),
    ("bedded", 0.25, 0.45),
    ("breccia", 0.22, 0.4),
])  # fmt: skip
def test_axis_ratios_are_on_average_those_of_the_family(family, elongation, flatness):
    many = build_prototypes(shapes(family, prototypes=64, subdivisions=1))
    extents = np.array([np.ptp(rock.points, axis=0) for rock in many])
    ratios = extents / extents[:, :1]
    assert ratios[:, 1].mean() == pytest.approx(1 - elongation, abs=0.03)
    assert ratios[:, 2].mean() == pytest.approx(1 - flatness, abs=0.03)
    assert (ratios[:, 2] <= ratios[:, 1] + 1e-6).all()
    assert (ratios[:, 1] <= 1 + 1e-6).all()


@pytest.mark.parametrize("family", ROCKS)
def test_elongation_and_flatness_of_the_cfg_count(family):
    def ratios(**change) -> np.ndarray:
        many = build_prototypes(shapes(family, prototypes=24, subdivisions=1, **change))
        extents = np.array([np.ptp(rock.points, axis=0) for rock in many])
        return (extents / extents[:, :1]).mean(axis=0)

    assert ratios(elongation=0.6)[1] < 0.7 * ratios(elongation=0.0)[1]
    assert ratios(flatness=0.8, elongation=0.1)[2] < 0.5 * ratios(flatness=0.1, elongation=0.1)[2]


@pytest.mark.parametrize("family", ROCKS)
def test_wear_takes_from_edges_and_adds_nowhere(family):
    directions, _ = icosphere(4)

    def radii(wear: float) -> np.ndarray:
        change = {"angularity": 1.0 - wear} if family == "weathered" else {"wear": wear}
        # So coarse a mesh would have no bubbles, whose places go with the worn surface.
        return np.array([
            shape.surface(directions, 1.0)[0]
            for shape in shapes(family, bumpiness=0.0, subdivisions=4, **change)
        ])  # fmt: skip

    fresh, worn = radii(0.0), radii(1.0)
    assert (worn <= fresh + 1e-12).all()
    # Corners are what is farthest from the middle.
    far = fresh > np.quantile(fresh, 0.95, axis=1)[:, None]
    assert (worn / fresh)[far].mean() < (worn / fresh)[~far].mean() - 0.03


def test_without_wear_and_bumps_angular_rocks_have_plane_faces_that_meet_along_edges():
    shape = shapes("angular", wear=0.0, bumpiness=0.0, subdivisions=4)[0]
    normals, distances = shape.creases()
    directions = along_creases(4, normals, distances)
    # By the definition: which planes a direction meets first.
    inverse = directions @ (normals / distances[:, None]).T
    ordered = np.sort(inverse, axis=1)
    on_crease = ordered[:, -1] - ordered[:, -2] < 1e-12
    first = inverse.argmax(axis=1)
    start, end = icosphere(4)[1].T[:2]
    crosses = (first[start] != first[end]) & ~on_crease[start] & ~on_crease[end]
    plain, _ = icosphere(4)
    first = (plain @ (normals / distances[:, None]).T).argmax(axis=1)
    # Edges of the mesh that run across a crease, against those of the plain icosphere.
    assert crosses.sum() < 0.12 * (first[start] != first[end]).sum()


def test_a_weathered_rock_has_no_finer_relief_than_its_finest_mesh_shows():
    directions, _ = icosphere(6)
    for shape in shapes("weathered", prototypes=3, bumpiness=1.0):
        shown, _ = shape.surface(directions, EDGE * 0.5**6)
        whole, _ = shape.surface(directions, 0.0)
        assert np.array_equal(shown, whole)
        # Each coarser mesh lacks what is too fine for it, which is little of all there is.
        lacks = [
            np.sqrt(np.mean((shape.surface(directions, EDGE * 0.5**s)[0] - whole) ** 2))
            for s in (1, 3, 5)
        ]
        assert lacks[0] > 1.5 * lacks[1] > 3.0 * lacks[2] > 0.0
        assert lacks[0] < 0.15


def test_edges_of_weathered_rocks_are_rounded_and_those_of_fresh_breaks_are_not():
    # As many edges of the mesh lie along a crease as its step is shorter, and keep their angles;
    # where there is a tangent plane, angles fall with the step.
    def falls(family: str, **change) -> np.ndarray:
        angles = []
        for subdivisions, part in ((5, 0.98), (6, 0.99)):
            change |= {"subdivisions": subdivisions, "bumpiness": 0.0, "prototypes": 3}
            many = build_prototypes(shapes(family, **change))
            angles.append([np.quantile(mesh_of(r).face_adjacency_angles, part) for r in many])
        return np.array(angles[1]) / np.array(angles[0])

    assert (falls("weathered", angularity=0.0) < 0.7).all()
    assert (falls("weathered", angularity=0.6) < 0.8).all()
    assert (falls("angular", wear=0.0) > 0.95).all()


def test_faces_of_weathered_rocks_are_smoother_than_their_edges():
    directions, _ = icosphere(6)
    rough, smooth = [], []
    for bumpy, plain, sharp in zip(
        *(shapes("weathered", angularity=a, bumpiness=b) for a, b in ((0.6, 1), (0.6, 0), (1, 0))),
        strict=True,
    ):
        # What the finest octaves of the relief come to.
        coarse, fine = (bumpy.surface(directions, s)[0] for s in (0.09, 0.0))
        worn, fresh = (shape.surface(directions, 0.0)[0] for shape in (plain, sharp))
        edge = worn / fresh < np.quantile(worn / fresh, 0.1)
        change = np.abs(fine - coarse) / worn
        rough.append(change[edge].mean())
        smooth.append(change[~edge].mean())
    assert np.mean(rough) > 1.4 * np.mean(smooth)


def test_pits_are_darker_than_what_is_around_them():
    for shape in shapes("vesicular", subdivisions=5, prototypes=2, bumpiness=0.0):
        directions, _ = icosphere(5)
        spacing = EDGE * 0.5**5
        radius, variation = shape.surface(directions, spacing)
        # A mesh too coarse for any bubble has none.
        smooth, _ = shape.surface(directions, 10.0)
        deep = smooth - radius > 0.03
        assert 0.02 < deep.mean() < 0.6
        assert variation[deep].mean() < variation[~deep].mean() - 0.4


def distances(points: np.ndarray, mesh: trimesh.Trimesh) -> np.ndarray:
    """From each point to the nearest of all triangles."""
    n, m = len(points), len(mesh.faces)
    nearest = trimesh.triangles.closest_point(
        np.tile(mesh.triangles, (n, 1, 1)), np.repeat(points, m, axis=0)
    ).reshape(n, m, 3)
    return np.linalg.norm(nearest - points[:, None], axis=2).min(axis=1)


@pytest.mark.parametrize(
    "family",
    [pytest.param(f, marks=pytest.mark.slow if i else ()) for i, f in enumerate(ROCKS)],
)
def test_the_error_of_a_level_is_its_distance_from_the_finest(family):
    chain = chains(family)[1]
    fine = mesh_of(chain[0])
    errors = [rock.error for rock in chain]
    assert errors[0] == 0.0
    assert errors == sorted(errors)
    assert [len(rock.faces) for rock in chain] == [1280, 320, 80, 20]
    for level, rock in enumerate(chain[1:], start=1):
        coarse = mesh_of(rock)
        there = np.concatenate([fine.vertices, fine.triangles_center])
        back = trimesh.sample.sample_surface(coarse, 300, seed=2)[0]
        hausdorff = max(distances(there, coarse).max(), distances(back, fine).max())
        assert rock.error > 0.97 * hausdorff
        # It is an upper bound, but no idle one; no level counts as better than a finer one.
        assert rock.error < max(2.0 * hausdorff + 0.01, 1.001 * errors[level - 1])


class Ball:
    """A shape that is a sphere, as of ``Shape``."""

    subdivisions = 5
    axes = (1.0, 1.0, 1.0)

    def creases(self) -> tuple[np.ndarray, np.ndarray]:
        """None."""
        return np.zeros((0, 3)), np.zeros(0)

    def surface(self, directions: np.ndarray, spacing: float) -> tuple[np.ndarray, np.ndarray]:
        """Of radius 1."""
        return np.ones(len(directions)), np.zeros(len(directions))


def test_levels_of_a_ball_are_off_by_the_height_of_their_largest_cap():
    def cap(subdivisions: int) -> float:
        points, faces = icosphere(subdivisions)
        a, b, c = np.moveaxis(points[faces], 1, 0)
        normal = np.cross(b - a, c - a)
        return 0.5 * (1.0 - ((normal * a).sum(axis=1) / np.linalg.norm(normal, axis=1)).min())

    (chain,) = build_chains([Ball()])
    for level, rock in enumerate(chain[1:], start=1):
        assert rock.error == pytest.approx(cap(5 - level), abs=cap(5))


def test_neighbors_share_the_edge_they_are_listed_for():
    for subdivisions in (0, 2):
        _, faces = icosphere(subdivisions)
        for f, row in enumerate(face_neighbors(subdivisions)):
            for k, other in enumerate(row):
                edge = {faces[f, k], faces[f, (k + 1) % 3]}
                assert other != f
                assert edge <= set(faces[other])
        start, around = faces_of_vertices(faces.max() + 1, faces)
        for v in range(start.size - 1):
            assert set(around[start[v] : start[v + 1]]) == set(np.flatnonzero((faces == v).any(1)))


def scatter(n: int, family: str = "angular") -> tuple[Scatter, tuple[Chain, ...]]:
    rng = np.random.default_rng(3)
    size = rng.uniform(0.05, 1.0, n).astype(np.float32)
    return Scatter(
        name="rocks",
        material="stone",
        labels={},
        instances=True,
        prototypes=tuple(chain[0] for chain in chains(family)),
        prototype=rng.integers(0, 6, n).astype(np.int32),
        positions=rng.uniform(-20, 20, (n, 3)).astype(np.float32),
        orientations=np.tile(np.array([0, 0, 0, 1], np.float16), (n, 1)),
        scales=np.repeat(size[:, None], 3, axis=1),
        variation=np.zeros(n, np.float32),
        ids=np.arange(1, n + 1),
        drawn=n,
    ), chains(family)


@pytest.mark.parametrize("views", ["one", "none"])
@pytest.mark.parametrize("part", [0.9, 0.3, 0.05])
def test_a_budget_is_kept_by_the_least_factor_on_all_errors(views, part):
    seen = view() if views == "one" else NO_VIEWS
    classes = [see_levels(*scatter(400, f), seen, 1.0, 0.2) for f in ("angular", "rounded")]
    asked = sum(choose_levels(c)[1]["triangles"] for c in classes)
    budget = int(part * asked)
    factor = budget_factor(classes, budget)
    chosen = [choose_levels(c, factor) for c in classes]
    total = sum(facts["triangles"] for _, facts in chosen)
    assert total <= budget
    assert views == "none" or factor > 1.0
    for (after, facts), levels in zip(chosen, classes, strict=True):
        assert np.array_equal(after.ids, levels.scatter.ids)
        if views == "one":
            assert facts["lod_error_max_px"] <= 0.2 * factor
    # A little less would be too much.
    less = [choose_levels(c, factor * 0.999999)[1]["triangles"] for c in classes]
    assert sum(less) > budget
    assert budget_factor(classes, asked) is None
    coarsest = sum(20 * c.scatter.count for c in classes)
    assert budget_factor(classes, coarsest) > factor
    with pytest.raises(SceneError, match=rf"{coarsest + 7:,} triangles at their coarsest"):
        budget_factor(classes, coarsest + 6, base=7)


def view(focal: float = 500.0) -> Views:
    """One camera at the origin that looks along +x and sees half of the world."""
    pose = np.array([[0, 0, 1, 0], [-1, 0, 0, 0], [0, -1, 0, 0], [0, 0, 0, 1]], np.float64)
    intrinsics = (focal, focal, 1e6, 1e6, 0.0)
    half = Sensor("s", (2_000_000, 2_000_000), intrinsics, np.eye(4), np.zeros(1), ("depth",))
    return views_of((Rig("r", pose[None], (half,)),))


@pytest.mark.parametrize("tolerance", [0.1, 0.5, 4.0])
def test_each_instance_gets_the_coarsest_level_within_the_tolerance(tolerance):
    before, levels = scatter(400)
    after, facts = choose_levels(see_levels(before, levels, view(), 1.0, tolerance))
    size = before.scales[:, 0].astype(np.float64)
    distance = np.linalg.norm(before.positions.astype(np.float64), axis=1)
    pixels = 500.0 / np.maximum(distance - 0.5 * size, 0.05)
    seen = set()
    for i in range(400):
        chain = levels[before.prototype[i]]
        errors = np.array([rock.error for rock in chain]) * size[i] * pixels[i]
        coarsest = int(np.flatnonzero(errors <= tolerance)[-1])
        assert after.prototypes[after.prototype[i]] is chain[coarsest]
        seen.add((before.prototype[i], coarsest))
    assert len(after.prototypes) == len(seen)
    assert 0.0 < facts["lod_error_max_px"] <= tolerance
    assert facts["triangles"] == sum(len(after.prototypes[p].faces) for p in after.prototype)
    assert facts["triangles_finest"] == 400 * 1280
    for name in ("positions", "orientations", "scales", "variation"):
        assert np.array_equal(getattr(before, name), getattr(after, name))


def test_without_cameras_or_tolerance_rocks_are_at_their_finest():
    before, levels = scatter(30)
    for views, tolerance in ((NO_VIEWS, 0.5), (view(), 0.0)):
        after, facts = choose_levels(see_levels(before, levels, views, 1.0, tolerance))
        assert all(len(after.prototypes[p].faces) == 1280 for p in after.prototype)
        assert facts["lod_error_max_m"] == 0.0


def test_no_instances_need_no_prototypes():
    after, facts = choose_levels(see_levels(*scatter(0), view(), 1.0, 0.5))
    assert after.prototypes == ()
    assert facts["triangles"] == 0


def test_prototypes_that_no_instance_has_are_not_written():
    before, levels = scatter(1)
    after, _ = choose_levels(see_levels(before, levels, NO_VIEWS, 1.0, 0.5))
    assert len(after.prototypes) == 1
    assert after.prototypes[0] is levels[before.prototype[0]][0]


def test_another_family_leaves_everything_but_the_shapes():
    one, other = plan(family="angular"), plan(family="rounded")
    for name in ("position_u", "prototype", "orientations", "scale", "embed", "variation"):
        assert np.array_equal(getattr(one, name), getattr(other, name))


def test_a_size_that_is_drawn_once_a_batch_is_that_of_every_rock():
    law = {"type": "uniform", "min": 0.1, "max": 0.5}
    alike, each = (plan(size_m=law | {"per": per}).scale for per in ("batch", "instance"))
    assert len(set(alike)) == 1
    assert len(set(each)) == len(each)
    assert alike[0] == each[0]


@pytest.mark.parametrize("key", ["elongation", "flatness", "wear"])
def test_what_a_family_has_where_the_cfg_says_nothing_is_what_its_key_says_of_it(key):
    said = declared_keys(Rocks)[key][0]["description"]
    for family in ROCKS:
        usual = f"{family} {getattr(family_of(family).USUAL, key):g}"
        assert (usual in said) == (key != "wear" or family != "weathered")


def test_slabs_lie_unless_told_otherwise():
    assert plan(family="slab").align
    assert not plan(family="slab", orientation="random").align
    assert not plan(family="rounded").align


def winds_of(relief: tuple[object, ...], **change) -> tuple[np.ndarray, np.ndarray]:
    """Where the facet of each ventifact looks that is nearest to a wind to the east; degrees."""
    cfg = small_cfg()
    cfg["objects"]["rocks"] |= {"family": "ventifact", "count": 3000, "prototypes": 12} | change
    setting = Context(Streams(3, 0), relief=relief)
    made = drawn(cfg, setting)
    x, y, z, w = made.orientations.T
    assert np.allclose(x, 0.0)
    assert np.allclose(y, 0.0)
    yaw = np.arctan2(2 * w * z, w * w - z * z)
    looks = []
    for prototype, turn in zip(made.prototype, yaw, strict=True):
        shape = made.source.shapes[prototype]
        # Normals of what is stretched: by the inverse.
        facets = shape.drawn.facets / np.array(shape.axes)
        looks.append(np.rad2deg(np.arctan2(facets[:, 1], facets[:, 0]) + turn))
    off = [(each + 180.0) % 360.0 - 180.0 for each in looks]
    return np.array([each[np.abs(each).argmin()] for each in off]), yaw


@pytest.mark.parametrize("masked", [False, True])
def test_one_facet_of_each_ventifact_looks_into_the_wind_of_the_relief(masked):
    # A wind to the west blows on what looks east.
    dunes = Dunes(key=1, height_m=0.5, wavelength_m=8.0, wind_deg=180.0, repose_deg=33.0, order=0.0)
    looks, yaw = winds_of((Masked(dunes, ()) if masked else dunes,))
    assert np.abs(looks).max() <= 30.0
    assert abs(looks.mean()) < 1.0
    assert 8.0 < looks.std() < 14.0
    # Two stones of a shape do not all show the same face to it.
    assert np.histogram(np.rad2deg(yaw), 6, (-180.0, 180.0))[0].min() > 100


def test_ventifacts_of_a_batch_without_a_windy_relief_share_a_wind():
    directions = []
    for name in ("rocks", "stones"):
        cfg = small_cfg()
        cfg["objects"][name] = cfg["objects"]["rocks"] | {"family": "ventifact", "count": 500}
        made = drawn(cfg, Context(Streams(3, 0)), name)
        z, w = made.orientations[:, 2], made.orientations[:, 3]
        turns = np.arctan2(2 * w * z, w * w - z * z)
        bearings = [shape.bearings() * 2 * np.pi for shape in made.source.shapes]
        # Every facet of every stone: those that look into the wind outnumber all others.
        every = np.concatenate(
            [bearings[p] + t for p, t in zip(made.prototype, turns, strict=True)]
        )
        counts, edges = np.histogram(np.rad2deg(every) % 360.0, 18, (0.0, 360.0))
        assert counts.max() > 2.0 * np.median(counts)
        directions.append(edges[counts.argmax()])
    apart = abs(directions[0] - directions[1])
    assert min(apart, 360.0 - apart) <= 20.0


def test_leaning_ventifacts_lean_from_where_they_face():
    upright, leaning = (plan(family="ventifact", **change) for change in ({}, {"lean_deg": 0}))
    assert np.allclose(upright.orientations, leaning.orientations)


def digest() -> str:
    """Of everything that all chains of all families hold."""
    made = hashlib.sha256()
    for family in ROCKS:
        for chain in chains(family):
            for rock in chain:
                made.update(
                    rock.points.tobytes() + rock.normals.tobytes() + rock.variation.tobytes()
                )
                made.update(repr(rock.error).encode())
    return made.hexdigest()


@pytest.mark.invariant
@pytest.mark.slow
def test_bytes_do_not_depend_on_threads_or_the_cpu_s_extras():
    assert digest_elsewhere("test_rocks") == digest()
