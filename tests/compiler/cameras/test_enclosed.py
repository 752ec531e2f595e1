"""A sensor below the ground, inside of an object or off the terrain is a fault that says where."""

from __future__ import annotations

import re

import numpy as np
import pytest
from shutter_cfgs import cfg as open_cfg

from scenec.compiler.build import BuildLog, build
from scenec.compiler.cameras.enclosed import require_open
from scenec.compiler.cameras.plan import RigPlan
from scenec.compiler.cfg.load import load
from scenec.compiler.draw import draw
from scenec.compiler.scene.ground import Ground, MeshTile
from scenec.compiler.scene.objects import Placed, Prototype, Scatter
from scenec.compiler.scene.rig import Rig, Sensor
from scenec.schemas.errors import SceneError
from scenec.testing import overhangs
from scenec.testing.small import small_cfg, write_cfg

BOX = "".join(f"v {x} {y} {z}\n" for x in (-1, 1) for y in (-1, 1) for z in (0, 2))
SIDES = "f 1 2 4 3\nf 5 7 8 6\nf 1 5 6 2\nf 3 4 8 7\nf 2 6 8 4\n"
FLOOR = "f 1 3 7 5\n"


def plane(x, y):
    return 0.05 * x - 0.02 * y


def on_a_plane(folder, track=((0.0, 0.0, 2.0),), **rig):
    """A tilted plane with one pebble on it, and a rig along a track of places."""
    cfg = small_cfg(samples=len(track), outputs=["depth"])
    cfg["terrain"]["relief"] = cfg["terrain"]["relief"][:1]
    cfg["objects"]["rocks"] |= {"count": 1, "size_m": 0.01}
    rows = [f"{k},{x},{y},{z},1,0,0,0" for k, (x, y, z) in enumerate(track)]
    text = "\n".join(["time_s,x_m,y_m,z_m,qw,qx,qy,qz", *rows])
    (folder / "track.csv").write_text(text, "utf-8")
    pose = {"type": "track", "file": "track.csv"}
    sensors = {"front": {"resolution": [32, 24], "fov_deg": 60}}
    cfg["rigs"] = {"rover": {"pose": pose, "sensors": sensors} | rig}
    return cfg


def built(folder, cfg):
    return build(draw(load(write_cfg(folder, cfg)), 1, 0), BuildLog())


def fault(folder, cfg):
    with pytest.raises(SceneError) as caught:
        built(folder, cfg)
    (line,) = str(caught.value).splitlines()
    return line


def test_a_fault_names_sensor_sample_place_and_the_ground_there(tmp_path):
    x, y = 3.0, -2.0
    line = fault(tmp_path, on_a_plane(tmp_path, [(0, 0, 1.0), (x, y, plane(x, y) - 0.25)]))
    found = re.match(
        r"rigs/rover/sensors/front: sample 1 at \(3, -2, (\S+)\) m is (\S+) m below the ground, "
        r"which is at (\S+) m there",
        line,
    )
    at, deep, ground = map(float, found.groups())
    assert (at, deep, ground) == pytest.approx((plane(x, y) - 0.25, 0.25, plane(x, y)), abs=1e-5)
    assert "allow_below: true" in line


def test_all_samples_are_counted_and_the_first_ones_named(tmp_path):
    line = fault(tmp_path, on_a_plane(tmp_path, [(0, 0, -1.0)] * 12))
    assert re.findall(r"sample (\d+)", line) == ["0", "1", "2"]
    assert "and 9 more like these" in line


def test_who_means_it_says_so(tmp_path):
    places = [(0, 0, -1.0), (40.0, 0, 1.0)]
    assert built(tmp_path, on_a_plane(tmp_path, places, allow_below=True)).samples == 2


def test_a_millimeter_above_the_ground_is_above_it(tmp_path):
    x, y = np.random.default_rng(3).uniform(-0.999, 0.999, (2, 150)) * [[10.0], [8.0]]
    # Places of vertices and of tiles' borders are among them.
    x[:50], y[:50] = np.round(x[:50]), np.round(y[:50])
    over = list(zip(x, y, plane(x, y) + 1e-3, strict=True))
    assert built(tmp_path, on_a_plane(tmp_path, over)).samples == 150
    under = list(zip(x, y, plane(x, y) - 1e-3, strict=True))
    assert "and 147 more like these" in fault(tmp_path, on_a_plane(tmp_path, under))


@pytest.mark.parametrize("low", ["sensors/low", "lidars/low", "sensors/front"])
def test_each_sensor_is_looked_at_where_it_is_mounted(tmp_path, low):
    # The rig looks up: its own axes are the world's.
    mount = {"position_m": [0, 0, -1.5]}
    front = {"resolution": [32, 24], "fov_deg": 60}
    rig = {"sensors": {"front": front}}
    if low == "sensors/low":
        rig["sensors"]["low"] = front | {"mount": mount, "partner": "front"}
    elif low == "lidars/low":
        rig["lidars"] = {"low": {"mount": mount, "beams": 2, "azimuths": 8}}
    else:
        # The other camera of a stereo one is to the right, where the plane is higher than this.
        model = {"type": "stereo", "baseline_m": 4.0}
        front |= {"depth_camera": model, "outputs": ["depth", "depth_measured"]}
    line = fault(tmp_path, on_a_plane(tmp_path, [(5.0, 0.0, 0.3)], **rig))
    assert line.startswith(f"rigs/rover/{low}: sample 0 at ")
    assert line.count("below the ground") == 1


def test_samples_at_which_a_sensor_is_not_triggered_do_not_count(tmp_path):
    front = {"resolution": [32, 24], "fov_deg": 60, "trigger": {"every": 2, "first": 1}}
    places = [(0, 0, -1.0), (0, 0, 1.0), (0, 0, -1.0)]
    assert built(tmp_path, on_a_plane(tmp_path, places, sensors={"front": front})).samples == 3


def test_poses_while_a_shutter_is_open_count(tmp_path):
    cfg = open_cfg({"exposure_s": 0.4, "readout_s": 0.0})
    cfg["terrain"]["relief"] = [{"type": "plane"}]
    cfg["objects"]["rocks"] |= {"count": 1, "size_m": 0.01}
    cfg["samples"] = 1
    # Half way through the exposure it is half a meter above the ground, at its end as far below.
    rows = "0.0,0,0,3,1,0,0,0\n1.0,0,0,-2,1,0,0,0\n"
    (tmp_path / "dive.csv").write_text("time_s,x_m,y_m,z_m,qw,qx,qy,qz\n" + rows, "utf-8")
    cfg["rigs"]["rover"]["pose"] = {
        "type": "track",
        "file": "dive.csv",
        "sampling": {"times_s": [0.5]},
    }
    assert "sample 0 at (0, 0, -0.5) m is 0.5 m below" in fault(tmp_path, cfg)


def test_off_the_terrain_there_has_to_be_land(tmp_path):
    border = "m is off the terrain, which goes from (-10, -8) to (10, 8) m: there is no ground"
    for place in ((-10.5, 0, 1.5), (0, -8.25, 1.5), (10.5, 0, 1.5)):
        cfg = on_a_plane(tmp_path, [place])
        x, y, z = place
        assert f"sample 0 at ({x:g}, {y:g}, {z:g}) {border}" in fault(tmp_path, cfg)
    land = {"reach_m": 50, "blend_m": 1, "relief": [{"type": "plane"}], "material": "sand"}
    cfg["terrain"]["horizon"] = land | {"labels": {"class": "ground"}}
    assert built(tmp_path, cfg).samples == 1
    # Where the land is its own: far from the border, whose heights it begins with.
    below = on_a_plane(tmp_path, [(30.0, 4.0, -0.5), (30.0, 4.0, 0.5)])
    below["terrain"]["horizon"] = cfg["terrain"]["horizon"]
    line = fault(tmp_path, below)
    assert "sample 0 at (30, 4, -0.5) m is 0.5 m below the ground, which is at 0 m there" in line
    assert "more like these" not in line
    beyond = on_a_plane(tmp_path, [(70.0, 4.0, 5.0)])
    beyond["terrain"]["horizon"] = cfg["terrain"]["horizon"]
    assert "off the terrain" in fault(tmp_path, beyond)


def test_under_an_overhang_one_is_above_the_ground(tmp_path):
    overhangs.write(tmp_path / "cliff.obj", *overhangs.shelter())
    under_the_roof, in_the_rock = (0.8, 0.0, 1.2), (0.8, 0.0, 3.4)

    def cfg(place):
        made = on_a_plane(tmp_path, [place])
        made["terrain"] |= {
            "size_m": [19, 19],
            "relief": [{"type": "mesh", "file": "cliff.obj", **overhangs.keys("obj")}],
        }
        return made

    assert built(tmp_path, cfg(under_the_roof)).samples == 1
    assert "below the ground" in fault(tmp_path, cfg(in_the_rock))


def boxed(folder, places, mesh, poses):
    (folder / "box.obj").write_text(mesh, "utf-8")
    cfg = on_a_plane(folder, places)
    cfg["objects"]["box"] = {
        "type": "placed",
        "material": "stone",
        "labels": {"class": "rock"},
        "models": [{"file": "box.obj", "unit_m": 1, "up": "z"}],
        "heights": "world",
        "poses": poses,
    }
    return cfg


def test_inside_of_an_object_is_a_fault_at_that_sample(tmp_path):
    poses = [{"x_m": 4, "y_m": 0, "z_m": 0.5, "scale": 0.5}]
    places = [(4.4, 0.4, 1.4), (4.6, 0.4, 1.4), (4.4, 0.4, 1.6)]
    line = fault(tmp_path, boxed(tmp_path, places, BOX + SIDES + FLOOR, poses))
    assert "sample 0 at (4.4, 0.4, 1.4) m is inside of object 1 of objects/box" in line
    assert "the ground is at 0.212 m there" in line
    assert "sample 1" not in line
    assert "more like these" not in line


def test_an_object_without_a_floor_has_no_inside(tmp_path):
    poses = [{"x_m": 4, "y_m": 0, "z_m": 0.5}]
    cfg = boxed(tmp_path, [(4.4, 0.4, 1.4)], BOX + SIDES, poses)
    assert built(tmp_path, cfg).samples == 1


def test_a_closed_box_whose_faces_are_turned_against_each_other_has_an_inside(tmp_path):
    poses = [{"x_m": 4, "y_m": 0, "z_m": 0.5}]
    mesh = BOX + SIDES + "f 5 7 3 1\n"
    assert "object 1" in fault(tmp_path, boxed(tmp_path, [(4.4, 0.4, 1.4)], mesh, poses))


def still(at):
    """A rig whose camera is at places [n, 3]."""
    to_world = np.tile(np.eye(4), (len(at), 1, 1))
    to_world[:, :3, 3] = at
    sensor = Sensor("eye", (4, 4), (4.0, 4.0, 2.0, 2.0, 0.0), np.eye(4), np.zeros(len(at)), ())
    return RigPlan("r", None, ()), Rig("r", to_world, (sensor,))


def refused(at, objects):
    """Which places are refused among objects over a square of ground far below."""
    corners = np.array([[-50, -50, -50], [50, -50, -50], [50, 50, -50], [-50, 50, -50]])
    faces = np.array([[0, 1, 2], [0, 2, 3]], np.int32)
    none = np.zeros(0, np.float32)
    tile = MeshTile("t", np.zeros(3), corners.astype(np.float32), faces, none, none, none, none)
    ground, out = Ground((), (tile,)), np.zeros(len(at), bool)
    for k, place in enumerate(at):
        plan, rig = still(place[None])
        try:
            require_open((plan,), (rig,), ground, objects, (100.0, 100.0))
        except SceneError:
            out[k] = True
    return out


def torus(n=24, m=16, large=2.0, small=0.7):
    u, v = np.meshgrid(np.arange(n), np.arange(m), indexing="ij")
    a, b = 2 * np.pi * u / n, 2 * np.pi * v / m
    ring = large + small * np.cos(b)
    points = np.stack([ring * np.cos(a), ring * np.sin(a), small * np.sin(b)], -1).reshape(-1, 3)
    corner = [((u + i) % n * m + (v + j) % m).ravel() for i, j in ((0, 0), (1, 0), (1, 1), (0, 1))]
    quads = np.stack(corner, axis=1)
    faces = quads[:, [0, 1, 2, 0, 2, 3]].reshape(-1, 3).astype(np.int32)
    # Split as at creases: each face has corners of its own.
    points = points.astype(np.float32)[faces].reshape(-1, 3)
    faces = np.arange(len(points), dtype=np.int32).reshape(-1, 3)
    none = np.zeros(0, np.float32)
    return Prototype("torus", points, faces, none, none, radius=float(large + small))


def in_torus(local, large=2.0, small=0.7):
    """Signed distance over the tube's radius: of points in the torus's own axes."""
    ring = np.sqrt(local[:, 0] ** 2 + local[:, 1] ** 2) - large
    return np.sqrt(ring**2 + local[:, 2] ** 2) - small


def test_inside_of_a_turned_stretched_instance_is_what_its_formula_says():
    random = np.random.default_rng(5)
    turn = random.normal(size=(2, 4)).astype(np.float16)
    scale = np.array([[1.0, 2.0, 0.5], [0.5, 0.7, 1.5]], np.float32)
    place = np.array([[0, 0, 0], [3.0, 1.0, 0.5]], np.float32)
    whole = dict(name="rings", material="m", labels={}, instances=True, prototypes=(torus(),))
    numbers = dict(prototype=np.zeros(2, np.int32), ids=np.array([1, 2]), drawn=2)
    rings = Scatter(
        **whole,
        **numbers,
        positions=place,
        orientations=turn,
        scales=scale,
        variation=np.zeros(2, np.float32),
    )
    at = random.uniform(-3, 4, (1500, 3)) * [1, 1, 0.5]
    # Onto the lattice that corners have, too, some of them.
    at[::5] = np.round(at[::5])
    distance = []
    for k in range(2):
        x, y, z, w = turn[k].astype(np.float64) / np.linalg.norm(turn[k].astype(np.float64))
        cross = np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]])
        matrix = np.eye(3) + 2 * w * cross + 2 * cross @ cross
        distance.append(in_torus((at - place[k]) @ matrix / scale[k]))
    nearest = np.min(distance, axis=0)
    # The mesh is inside of the torus by up to the sagitta of its facets.
    clear = np.min(np.abs(distance), axis=0) > 0.06
    assert clear.sum() > 1000
    assert (nearest[clear] < 0).sum() > 100
    assert np.array_equal(refused(at[clear], (rings,)), nearest[clear] < 0)


def test_a_moving_object_counts_where_it_is_at_the_sample():
    to_world = np.zeros((1, 2, 3, 4))
    to_world[:, :, :, :3] = np.eye(3)
    to_world[0, 1, :, 3] = [10, 0, 0]
    ring = Placed(
        "ring", "m", {}, True, (torus(),), np.zeros(1, np.int32), np.array([3]), 3, to_world
    )
    ground = Ground((), ())
    for at, samples in (([2, 0, 0], [0]), ([12, 0, 0], [1])):
        plan, rig = still(np.array([at, at], np.float64))
        with pytest.raises(SceneError) as caught:
            require_open((plan,), (rig,), ground, (ring,), (100.0, 100.0))
        told = re.findall(r"sample (\d)[^;]* inside of object 3 of objects/ring", str(caught.value))
        assert list(map(int, told)) == samples
