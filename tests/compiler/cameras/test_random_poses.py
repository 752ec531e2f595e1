"""Random poses keep every limit, say which one they cannot keep, and depend on nothing else."""

from __future__ import annotations

import re
from dataclasses import replace

import numpy as np
import pytest
from elsewhere import COMPILE, printed_elsewhere
from test_compile import hashes
from test_motions import around, balls, hills

from scenec.compiler.build import BuildLog, build
from scenec.compiler.cameras.paths.looks import LookDirection, LookPoint, PoseLimits
from scenec.compiler.cameras.paths.orbit import ObjectAim
from scenec.compiler.cameras.paths.random_pose import RandomPose
from scenec.compiler.cameras.paths.rays import hits, span_of
from scenec.compiler.cfg.load import load
from scenec.compiler.compile import compile_cfg
from scenec.compiler.distributions.numbers import Distribution
from scenec.compiler.draw import draw
from scenec.schemas.errors import SceneError
from scenec.testing.small import small_cfg, write_cfg

FREE = PoseLimits()
KEYS = (
    "height_m", "roll_deg", "look/bearing_deg", "look/pitch_deg", "look/x_m", "look/y_m",
    "look/height_m", "place0", "place1", "object",
)  # fmt: skip


def uniform(low, high) -> Distribution:
    return Distribution("uniform", "sample", False, low, high)


def direction(pitch_deg=None) -> LookDirection:
    pitch = uniform(-90.0, 90.0) if pitch_deg is None else pitch_deg
    return LookDirection(bearing_deg=uniform(0.0, 360.0), pitch_deg=pitch)


def drawn(look=None, polygon=((-20, -10), (20, 10)), limits=FREE, **keys) -> RandomPose:
    base = {"height_m": uniform(0.5, 5.0), "roll_deg": 0.0} | keys
    return RandomPose(
        region_m=polygon, look=look or direction(), limits=limits, tries=500,
        keys={name: 77 + i for i, name in enumerate(KEYS)}, **base,
    )  # fmt: skip


ROCKS = ObjectAim(object="rocks", pick_u=0.0)


def limited(**limits) -> PoseLimits:
    """Limits by what they are of: the least and the largest."""
    ends = {f"{end}_{of}": v for of, p in limits.items() if isinstance(p, tuple)
            for end, v in zip(("min", "max"), p, strict=True)}  # fmt: skip
    return PoseLimits(**ends, **{of: v for of, v in limits.items() if not isinstance(v, tuple)})


def test_positions_are_uniform_over_a_box_and_over_a_polygon():
    at = drawn().built(around(samples=1000)).to_world[:, :3, 3]
    for axis, half in ((0, 20), (1, 10)):
        counts = np.histogram(at[:, axis], 10, (-half, half))[0]
        assert ((counts - 100) ** 2 / 100).sum() < 30
    # A concave one: an L of three equal squares.
    corners = ((0, 0), (10, 0), (10, 5), (5, 5), (5, 10), (0, 10))
    at = drawn(polygon=corners).built(around(samples=900)).to_world[:, :2, 3]
    assert ((at[:, 0] < 5) | (at[:, 1] < 5)).all()
    squares = [((at[:, 0] < 5) & (at[:, 1] < 5)), at[:, 0] >= 5, at[:, 1] >= 5]
    assert ((np.array([s.sum() for s in squares]) - 300) ** 2 / 300).sum() < 14
    assert (at >= 0).all()
    assert (at <= 10).all()


def test_heights_are_above_the_ground_and_views_as_drawn():
    built = drawn(direction(-90.0), height_m=1.25, roll_deg=30.0).built(around(hills))
    at = built.to_world[:, :3, 3]
    assert np.allclose(at[:, 2] - around(hills).ground(at[:, :2]), 1.25, rtol=0, atol=1e-12)
    assert np.allclose(built.to_world[:, :3, 2], [0, 0, -1], atol=1e-15)
    assert built.facts == {"tries": 50, "rejected": {}}


@pytest.mark.parametrize("height", [0.01, 1e5])
def test_a_centimeter_and_100_km_above_the_ground_are_heights_like_others(height):
    limits = limited(elevation_deg=(-90.0, -89.9), distance_m=(0.9 * height, 1.1 * height))
    poses = drawn(direction(-90.0), height_m=height, limits=limits)
    at = poses.built(around(hills, 5)).to_world[:, :3, 3]
    assert np.allclose(at[:, 2] - around(hills).ground(at[:, :2]), height, rtol=1e-12)
    # From 100 km a terrain of 60 m is less than a pixel: all that is seen is sky.
    seeing = replace(poses, limits=replace(limits, max_sky=0.9))
    if height < 1.0:
        seeing.built(around(hills, 5))
    else:
        with pytest.raises(SceneError, match=r"500 with a share of sky above 0\.9 \(max_sky\)"):
            seeing.built(around(hills, 5))


def test_every_limit_is_kept():
    limits = limited(
        clearance_m=0.3, distance_m=(3.0, 12.0), elevation_deg=(-40.0, -10.0),
        incidence_deg=(20.0, 75.0), max_sky=0.25,
    )  # fmt: skip
    rocks = balls((2, 3, 0, 0.5), (-6, 1, 0, 1.0), (8, -4, 0, 0.3))
    ground = around(hills, 30, bodies={"rocks": rocks})
    built = drawn(ROCKS, limits=limits).built(ground)
    assert len(built.facts["rejected"]) >= 4
    for pose in built.to_world:
        eye, forward = pose[:3, 3], pose[:3, 2]
        away = np.linalg.norm(rocks.middle - eye, axis=1)
        assert (away >= rocks.radius + 0.3).all()
        # It looks at the middle of one of them.
        to = (rocks.middle - eye) / away[:, None]
        seen = (to @ forward).argmax()
        assert to[seen] @ forward == pytest.approx(1.0, abs=1e-12)
        assert 3.0 <= away[seen] <= 12.0
        assert -40.0 <= np.degrees(np.arcsin(forward[2])) <= -10.0
        reach = hits(ground.surface.field, span_of(ground.surface.field), eye, forward[None])[0]
        x, y = (eye + reach * forward)[:2]
        east = 0.2 * np.cos(0.4 * x) * np.cos(0.3 * y)
        slope = np.array([east, -0.15 * np.sin(0.4 * x) * np.sin(0.3 * y)])
        normal = np.append(-slope, 1.0) / np.sqrt(1 + slope @ slope)
        assert 19.0 <= np.degrees(np.arccos(-normal @ forward)) <= 76.0


def test_rays_find_a_plane_where_it_is_and_the_sky_where_there_is_none():
    field = around(lambda x, y: 0.1 * x).surface.field
    rng = np.random.default_rng(0)
    way = rng.normal(size=(500, 3))
    way /= np.linalg.norm(way, axis=1)[:, None]
    eye = np.array([1.0, 2.0, 4.0])
    normal = np.array([-0.1, 0, 1])
    with np.errstate(divide="ignore"):
        exact = -(eye @ normal) / (way @ normal)
    at = eye + exact[:, None] * way
    on = (exact > 0) & (np.abs(at[:, 0]) < 30) & (np.abs(at[:, 1]) < 20)
    found = hits(field, span_of(field), eye, way)
    assert np.array_equal(np.isfinite(found), on)
    assert np.allclose(found[on], exact[on], rtol=1e-9)
    # Straight down from far, straight up, and from below the ground.
    down = hits(field, span_of(field), np.array([0.0, 0, 1e5]), np.array([[0.0, 0, -1], [0, 0, 1]]))
    assert down[0] == pytest.approx(1e5)
    assert down[1] == np.inf


@pytest.mark.parametrize(
    ("change", "part"),
    [
        ({"height_m": -1.0}, "500 below the ground"),
        ({"limits": limited(distance_m=(100.0, None))}, "with a distance not above 100 m"),
        ({"limits": limited(elevation_deg=(91.0, None))}, "with a view not above 91 degrees"),
        (
            {"limits": limited(max_sky=0.1), "look": direction(60.0)},
            "500 with a share of sky above 0.1",
        ),
        ({"limits": limited(incidence_deg=(None, 1.0)), "look": direction(45.0)}, "looking past"),
        ({"polygon": ((0, 0), (1, 1), (2, 2))}, "region_m has an area of 0 m²"),
        ({"polygon": ((0, 0), (100, 1))}, "the region reaches (100, 1) m"),
    ],
)
def test_limits_that_cannot_be_kept_are_named_with_how_many_tries_each_rejected(change, part):
    middle = LookPoint(x_m=0.0, y_m=0.0)
    with pytest.raises(SceneError) as caught:
        drawn(**({"look": middle} if "limits" in change else {}) | change).built(around(samples=2))
    assert part in str(caught.value)
    assert "rigs/r/pose" in str(caught.value)


def test_a_region_inside_of_an_object_has_no_poses():
    inside = drawn(polygon=((-1, -1), (1, 1)), limits=limited(clearance_m=0.1))
    with pytest.raises(SceneError, match=r"500 inside of an object or nearer than 0\.1 m to it"):
        inside.built(around(samples=1, bodies={"rocks": balls((0, 0, 0, 9))}))
    none = balls((0, 0, 0, 1)).only(np.array([False]))
    with pytest.raises(SceneError, match="no object of the class rocks"):
        drawn(ROCKS).built(around(bodies={"rocks": none}))


def test_the_share_of_sky_is_that_of_the_picture():
    # A level view of a plain: five of nine rows of rays, the one in the middle being level.
    wide = around(size=(4000.0, 4000.0), samples=1, spacing=20.0)
    level = drawn(direction(0.0), height_m=2.0, limits=limited(max_sky=0.56))
    level.built(wide)
    with pytest.raises(SceneError, match=r"share of sky above 0\.55"):
        drawn(direction(0.0), height_m=2.0, limits=limited(max_sky=0.55)).built(wide)


# Whole cfgs --------------------------------------------------------------------------------------

POSES = {
    "random": {
        "type": "random",
        "region_m": [[-8, -6], [8, -6], [8, 6], [-8, 6]],
        "height_m": {"type": "uniform", "min": 0.4, "max": 3},
        "look": {"type": "object", "object": "rocks"},
        "roll_deg": {"type": "normal", "mean": 0, "std": 3},
        "limits": {"max_sky": 0.4, "min_distance_m": 1, "max_distance_m": 6, "clearance_m": 0.1},
    },
    "orbit": {
        "type": "orbit",
        "center": {"type": "object", "object": "rocks"},
        "radius_m": {"type": "uniform", "min": 2, "max": 3},
        "height_m": 1,
    },
    "lawn_mower": {
        "type": "lawn_mower", "along_m": 9, "across_m": 6, "height_m": 4,
        "bearing_deg": {"type": "uniform", "min": 0, "max": 360},
    },
    "rover": {"type": "rover", "goals": 3, "sampling": {"rate_hz": 0.1}},
    "mav": {"type": "mav", "height_m": 2, "goals": 4, "tilt": True},
    "descent": {
        "type": "descent", "entry_height_m": {"type": "uniform", "min": 20, "max": 60},
        "drift_m_s": 0.2,
    },
}  # fmt: skip


def moving(samples=3, **poses):
    cfg = small_cfg(samples=samples, outputs=["label", "depth"])
    cfg["terrain"]["spacing_m"] = 0.4
    cfg["objects"]["rocks"]["count"] = 60
    rig = cfg["rigs"].pop("rover")
    for name, pose in poses.items():
        sensors = {f"eye_{name}": dict(rig["sensors"]["front"])}
        cfg["rigs"][name] = {"pose": pose, "sensors": sensors}
    return cfg


def rigs_of(folder, cfg, seed=5):
    scene = build(draw(load(write_cfg(folder, cfg)), seed, 0), BuildLog())
    return {rig.name: rig.to_world for rig in scene.rigs}


def test_another_rig_changes_no_other_rig_s_draws(tmp_path):
    few = {name: POSES[name] for name in ("mav", "descent", "lawn_mower")}
    before = rigs_of(tmp_path, moving(**few))
    after = rigs_of(tmp_path, moving(random=POSES["random"], **few))
    for name in few:
        assert np.array_equal(before[name], after[name])
    other = rigs_of(tmp_path, moving(**few), seed=6)
    assert all(not np.array_equal(before[name], other[name]) for name in few)


def test_more_samples_begin_with_the_same_random_poses(tmp_path):
    pose = POSES["random"] | {"look": {"type": "direction", "pitch_deg": -30}}
    three, five = (rigs_of(tmp_path, moving(n, random=pose))["random"] for n in (3, 5))
    assert np.array_equal(five[:3], three)


def test_what_was_looked_at_is_there_once_all_objects_are_laid(tmp_path):
    cfg = moving(4, random=POSES["random"], orbit=POSES["orbit"])
    scene = build(draw(load(write_cfg(tmp_path, cfg)), 5, 0), BuildLog())
    middles, radii = scene.objects[0].balls()
    for rig in scene.rigs:
        for pose in rig.to_world:
            away = np.linalg.norm(middles - pose[:3, 3], axis=1)
            assert (away >= radii).all()
            to = (middles - pose[:3, 3]) / away[:, None]
            # Positions are stored in float32.
            assert np.linalg.norm(to - pose[:3, 2], axis=1).min() < 1e-6


@pytest.mark.invariant
@pytest.mark.slow
def test_all_motions_have_the_same_bytes_in_all_circumstances_at_once(tmp_path):
    cfg = moving(2, **POSES)
    path = write_cfg(tmp_path, cfg)
    compile_cfg(path, seed=11, out=tmp_path / "here")
    printed_elsewhere(COMPILE, path, tmp_path / "there")
    ours, theirs = hashes(tmp_path / "here"), hashes(tmp_path / "there")
    assert ours == theirs
    assert any(re.search("cameras", file) for file in ours)
