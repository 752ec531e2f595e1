"""Classes of objects among each other and among cameras: counts, distances, clearance, ids."""

from __future__ import annotations

import hashlib
from dataclasses import replace

import numpy as np
import pytest
import trimesh
from elsewhere import digest_elsewhere
from laying import laid, plan, surroundings
from scipy.spatial import cKDTree
from scipy.spatial.transform import Rotation

from scenec.compiler.distributions.laws import golombek_rapp_per_m2
from scenec.compiler.geometry.rotations import rotation_rows
from scenec.compiler.objects.scatter import scatter
from scenec.compiler.scene.objects import Prototype
from scenec.schemas.errors import SceneError

POWER = {"type": "power_law", "exponent": 2.5, "min": 0.1, "max": 3}


def overlaps(a, b, gap: float = 0.0, radius: float | None = 1.0) -> int:
    """Pairs of circles that are nearer to each other than asked, by brute force.

    Args:
        radius: As ``apart`` has it; None: circles are as wide as all vertices seen from above.
    """
    at = [s.positions[:, :2].astype(np.float64) for s in (a, b)]
    wide = [widths(s) if radius is None else radius * s.radii() for s in (a, b)]
    away = np.hypot(*(at[0][:, None] - at[1][None]).transpose(2, 0, 1))
    # Widths are of turns in float32.
    near = away < (wide[0][:, None] + wide[1][None] + gap) * (1.0 - 1e-6 * (radius is None) - 1e-12)
    return int(near.sum() - (len(at[0]) if a is b else 0)) // (2 if a is b else 1)


def widths(scatter):
    """Farthest of each instance's turned vertices from the vertical through its origin, meters."""
    turns = Rotation.from_quat(scatter.orientations.astype(float)).as_matrix()
    points = [scatter.prototypes[k].points.astype(float) for k in scatter.prototype]
    wide = [np.hypot(*(p @ turn.T)[:, :2].T).max() for p, turn in zip(points, turns, strict=True)]
    return np.array(wide) * scatter.scales[:, 0]


@pytest.mark.parametrize(
    ("k", "tenth", "half"),
    [
        (0.02, 0.3888, 0.000678),
        (0.05, 1.0342, 0.01355),
        (0.10, 1.8635, 0.04993),
        (0.19, 3.1858, 0.12171),
        (0.40, 6.1225, 0.28979),
    ],
)
def test_the_law_of_golombek_and_rapp_gives_the_numbers_of_its_table(k, tenth, half):
    # Numerical integration up to 50 m, by another program.
    assert golombek_rapp_per_m2(0.1, 50.0, k) == pytest.approx(tenth, rel=2e-4)
    assert golombek_rapp_per_m2(0.5, 50.0, k) == pytest.approx(half, rel=1e-3)


def test_without_a_count_there_are_as_many_as_golombek_and_rapp_say():
    size = {"type": "golombek_rapp", "k": 0.19, "min": 0.1, "max": 50}
    scatter = laid(surroundings(), size_m=size)
    assert abs(scatter.count - 3.1858 * 1280) <= 0.01 * 3.1858 * 1280
    sizes = scatter.scales[:, 0]
    # Counts of a sample of that many: four standard deviations.
    assert (sizes > 0.5).sum() == pytest.approx(0.12171 * 1280, abs=4 * np.sqrt(0.12171 * 1280))


@pytest.mark.parametrize("k", [0.001, 0.4, 1.0])
def test_the_law_holds_at_its_ends(k):
    size = {"type": "golombek_rapp", "k": k, "min": 0.2, "max": 20}
    scatter = laid(surroundings(), size_m=size)
    assert scatter.count == pytest.approx(1280 * golombek_rapp_per_m2(0.2, 20, k), abs=1)


def test_a_number_per_square_meter_is_that_of_the_part_where_they_may_lie():
    around = surroundings(amplitude_m=0.0)
    half = [{"type": "point", "x_m": 0, "y_m": 0, "max_m": 10}]
    for change, share in (({}, 1.0), ({"where": half}, np.pi * 100 / 1280)):
        counts = [laid(around, per_m2=0.5, seed=seed, **change).count for seed in range(20)]
        assert np.mean(counts) == pytest.approx(640 * share, rel=0.02)
        assert max(counts) - min(counts) <= 1
    assert laid(around, per_m2=0).count == 0
    # What is left of a whole one decides at random.
    few = [laid(around, per_m2=0.3 / 1280, seed=seed).count for seed in range(200)]
    assert np.mean(few) == pytest.approx(0.3, abs=0.13)


def test_conditions_hold_where_objects_lie():
    around = surroundings(np.array([[5.0, 5.0, 2.0], [-8.0, 0.0, 2.0]]))
    boulders = laid(around, name="boulders", count=8, size_m=3)
    around = surroundings(around.cameras, boulders=boulders)
    near = laid(
        around,
        count=2000,
        where=[
            {"type": "object", "of": "boulders", "min_m": 0.2, "max_m": 1.5},
            {"type": "camera", "max_m": 15},
            {"type": "height", "min_m": 0.0},
        ],
    )
    at = near.positions[:, :2].astype(np.float64)
    away = cKDTree(boulders.positions[:, :2]).query(at)[0] - 1.5
    # Cells are as wide as half of a radius at most: what is between their middles is not told.
    assert away.min() > 0.2 - 0.3
    assert away.max() < 1.5 + 0.3
    cameras = cKDTree(around.cameras[:, :2]).query(at)[0]
    assert cameras.max() < 15.3
    height = around.surface.field.height_at(at[:, 0].copy(), at[:, 1].copy())
    assert (height > -0.2).all()
    assert (height > 0).mean() > 0.94


def test_no_two_circles_overlap_and_gaps_are_kept():
    around = surroundings()
    for gap, radius in ((0.0, 1.0), (0.2, 0.7)):
        apart = {"gap_m": gap, "radius": radius}
        scatter = laid(around, count=1500, size_m=POWER, apart=apart)
        assert scatter.count == 1500
        assert overlaps(scatter, scatter, gap, radius) == 0
    # Without being asked to, some do.
    loose = laid(around, count=1500, size_m=POWER)
    assert overlaps(loose, loose) > 50


def test_circles_keep_apart_from_those_of_earlier_classes():
    around = surroundings()
    pebbles = laid(around, name="pebbles", count=3000, size_m=0.1)
    around = surroundings(pebbles=pebbles)
    apart = {"of": ["pebbles", "rocks"]}
    rocks = laid(around, count=60, size_m={"type": "uniform", "min": 0.05, "max": 0.5}, apart=apart)
    assert overlaps(rocks, pebbles, radius=None) == 0
    assert overlaps(rocks, rocks, radius=None) == 0
    only = laid(around, count=3000, size_m=0.2, apart={"of": ["pebbles"], "radius": 1})
    assert overlaps(only, pebbles) == 0
    assert overlaps(only, only) > 50


@pytest.mark.parametrize("orientation", ["upright", "random", "normal"])
def test_left_out_circles_are_as_wide_as_objects_from_above(orientation):
    # Pillars 20 times as tall as wide: spheres around upright ones would cover 9 times the ground.
    beam = trimesh.creation.box((0.2, 0.2, 4.0))
    beam.apply_translation((0.0, 0.0, 2.0))
    pillar = Prototype(
        "pillar",
        beam.vertices.astype(np.float32),
        beam.faces.astype(np.int32),
        beam.vertex_normals.astype(np.float32),
        np.zeros(len(beam.vertices), np.float32),
        radius=float(np.linalg.norm(beam.vertices, axis=1).max()),
    )
    count = 200 if orientation == "upright" else 12
    drawn = plan(count=count, size_m=1, orientation=orientation, lean_deg=3, apart={})
    drawn = replace(drawn, prototype=np.zeros(count, np.int32))
    pillars = scatter(drawn, [(pillar,)], surroundings(), {})
    assert pillars.count == count
    assert overlaps(pillars, pillars, radius=None) == 0
    if orientation == "upright":
        assert widths(pillars).max() < 0.4
        assert overlaps(pillars, pillars) > 100
    stones = laid(surroundings(pillars=pillars), count=300, apart={"of": ["pillars"]})
    assert overlaps(stones, pillars, radius=None) == 0


def test_more_objects_move_only_those_whose_place_a_larger_one_takes():
    around = surroundings()
    few = laid(around, count=500, size_m=POWER, apart={})
    many = laid(around, count=600, size_m=POWER, apart={})
    moved = (few.positions != many.positions[:500]).any(axis=1)
    assert moved.mean() < 0.1
    # Without distances nothing moves at all.
    few, many = (laid(around, count=n, size_m=POWER) for n in (500, 600))
    assert few.positions.tobytes() == many.positions[:500].tobytes()


def test_places_of_small_ones_do_not_change_those_of_large_ones():
    around = surroundings()
    size = {"type": "choice", "values": [0.05, 2.0], "weights": [9, 1]}
    other = {"type": "choice", "values": [0.5, 2.0], "weights": [9, 1]}
    one, two = (laid(around, count=300, size_m=s, apart={}) for s in (size, other))
    large = one.scales[:, 0] > 1.0
    assert np.array_equal(large, two.scales[:, 0] > 1.0)
    assert np.array_equal(one.positions[large, :2], two.positions[large, :2])


def test_what_finds_no_place_is_an_error_that_says_how_many_fit_or_leaves_gaps():
    around = surroundings()
    with pytest.raises(SceneError, match=r"objects/rocks: only \d+ of 400 found .* cover 221 %"):
        laid(around, count=400, size_m=3, apart={"radius": 1})
    facts: dict = {}
    scatter = laid(around, facts, count=400, size_m=3, apart={"radius": 1}, shortfall="fewer")
    assert overlaps(scatter, scatter) == 0
    # Random sequential adsorption of equal discs jams at 0.547 of the area.
    part = scatter.count * np.pi * 1.5**2 / 1280
    assert 0.45 < part < 0.6
    assert scatter.drawn == 400
    assert facts["asked_for"] == 400
    assert facts["count"] == scatter.count == len(scatter.ids)
    assert (np.diff(scatter.ids) > 0).all()
    assert scatter.ids[-1] <= 400
    alone = laid(around, count=400, size_m=3)
    # An id stands for the same rock, placed or not.
    assert np.array_equal(scatter.variation, alone.variation[scatter.ids - 1])


def test_a_class_larger_than_the_terrain_fits_once():
    around = surroundings()
    assert laid(around, count=1, size_m=500, apart={}, clearance_m=0).count == 1
    with pytest.raises(SceneError, match="only 1 of 2 found"):
        laid(around, count=2, size_m=500, apart={})
    assert laid(around, count=3, size_m=1e4).count == 3
    assert laid(around, count=1000, size_m=1e-4, apart={}).count == 1000
    assert laid(around, count=0, apart={}).count == 0


def winding(corners):
    """How often triangles [n, 3, 3] go around the origin (Van Oosterom and Strackee 1983)."""
    a, b, c = corners.transpose(1, 0, 2)
    la, lb, lc = (np.linalg.norm(v, axis=1) for v in (a, b, c))
    ab, bc, ca = (np.einsum("nk,nk->n", u, v) for u, v in ((a, b), (b, c), (c, a)))
    over = np.einsum("nk,nk->n", a, np.cross(b, c))
    return np.arctan2(over, la * lb * lc + ab * lc + bc * la + ca * lb).sum() / (2 * np.pi)


def gaps(scatter, cameras):
    """From each instance's triangles to the nearest camera; 0 inside."""
    out = np.full(scatter.count, np.inf)
    for n in range(scatter.count):
        made = scatter.prototypes[scatter.prototype[n]]
        turn = np.array(rotation_rows(scatter.orientations[n].astype(float))).reshape(3, 3)
        points = made.points.astype(float) @ turn.T * float(scatter.scales[n, 0])
        corners = (points + scatter.positions[n])[made.faces]
        apart = np.linalg.norm(cameras - scatter.positions[n], axis=1)
        for camera in cameras[apart < scatter.radii()[n] + 5.0]:
            at = trimesh.triangles.closest_point(corners, np.tile(camera, (len(corners), 1)))
            inside = abs(winding(corners - camera)) > 0.5
            away = 0.0 if inside else np.linalg.norm(at - camera, axis=1).min()
            out[n] = min(out[n], away)
    return out


@pytest.mark.parametrize("apart", [None, {}])
def test_no_camera_is_nearer_to_a_rock_than_asked(apart):
    x = np.linspace(-15, 15, 60)
    around = surroundings(np.stack([x, 0.4 * x, np.full(60, 1.2)], axis=1))
    change = {"apart": apart} if apart is not None else {}
    facts: dict = {}
    size = {"type": "uniform", "min": 0.2, "max": 2.0}
    scatter = laid(around, facts, count=500, size_m=size, clearance_m=0.5, **change)
    assert (gaps(scatter, around.cameras) > 0.5).all()
    assert facts["moved_off_cameras"] > 3
    if apart is not None:
        assert overlaps(scatter, scatter, radius=None) == 0
    free = laid(around, count=500, size_m=size, clearance_m=-1e6, **change)
    moved = (free.positions != scatter.positions).any(axis=1)
    gap = gaps(free, around.cameras)
    assert moved[gap <= 0.5].all()
    if apart is None:
        # A 48th of the size is the width of the cubes that are told apart.
        assert not moved[gap > 0.5 + np.sqrt(3) / 48 * 2 * free.radii()].any()
        assert moved.sum() == facts["moved_off_cameras"]
    else:
        # They take places of some smaller ones.
        assert moved.mean() < 0.5


def test_cameras_with_no_way_around_end_in_an_error():
    around = surroundings(np.array([[0.0, 0.0, 1.0]]))
    with pytest.raises(SceneError, match=r"only 0 of 3 found .* have no camera inside"):
        laid(around, count=3, size_m=400)
    assert laid(around, count=3, size_m=400, shortfall="fewer").count == 0


def test_nowhere_to_lie_and_too_many_are_refused():
    around = surroundings()
    with pytest.raises(SceneError, match="nowhere on the terrain"):
        laid(around, count=5, where=[{"type": "height", "min_m": 500}])
    assert laid(around, count=0, where=[{"type": "height", "min_m": 500}]).count == 0
    with pytest.raises(SceneError, match=r"objects/rocks: 1e\+06 per m\^2 .* at most 100,000,000"):
        plan(per_m2=1e6)


def test_upright_objects_lean_by_the_angle_given_toward_every_side():
    around = surroundings()
    scatter = laid(around, count=3000, orientation="upright", lean_deg=30)
    up = np.array([rotation_rows(q.astype(np.float64))[2::3] for q in scatter.orientations])
    assert np.degrees(np.arccos(up[:, 2])) == pytest.approx(30, abs=0.2)
    assert np.abs(up[:, :2].mean(axis=0)).max() < 0.03
    plain = laid(around, count=300, orientation="upright")
    none = laid(around, count=300, orientation="upright", lean_deg=0)
    assert np.array_equal(plain.orientations, none.orientations)


def test_the_report_says_how_well_they_sit():
    facts: dict = {}
    scatter = laid(surroundings(), facts, count=400)
    assert facts["seating_measured"] == 400
    # A float32 step of the height.
    assert facts["seating_error_max_m"] <= np.spacing(np.abs(scatter.positions[:, 2]).max())


def digest() -> str:
    """Of what every kind of density lays under every condition."""
    around = surroundings(np.array([[0.0, 0.0, 1.0]]))
    boulders = laid(around, name="boulders", count=30, size_m=2, apart={})
    around = surroundings(around.cameras, boulders=boulders)
    made = hashlib.sha256()
    for density in (
        {"type": "uniform"}, {"type": "worley", "scale_m": 5}, {"type": "around", "of": "boulders"},
        {"type": "clusters", "parents": 20, "sigma_m": 1},
    ):  # fmt: skip
        for change in (
            {}, {"apart": {}, "shortfall": "fewer"}, {"where": [{"type": "slope", "max_deg": 9}]},
        ):  # fmt: skip
            s = laid(around, count=800, density=density, **change)
            made.update(s.positions.tobytes() + s.orientations.tobytes() + s.ids.tobytes())
    return made.hexdigest()


@pytest.mark.invariant
@pytest.mark.slow
def test_bytes_do_not_depend_on_threads_or_the_cpu_s_extras():
    assert digest_elsewhere("test_scatter_laying") == digest()
