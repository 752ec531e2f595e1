"""Objects dropped by physics: where they rest, what they keep, what is refused."""

from __future__ import annotations

import json
import math
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from scenec.backends.stage.read import read_stage
from scenec.compiler.assets.pose_table import PoseTable, read_poses
from scenec.compiler.build import build_to
from scenec.compiler.cfg.load import load
from scenec.compiler.compile import compile_cfg
from scenec.compiler.draw import draw
from scenec.compiler.geometry.poses import from_quaternion
from scenec.compiler.mesh.build import build_surface
from scenec.compiler.objects.build import build_objects
from scenec.compiler.scene.objects import Prototype
from scenec.compiler.views.needed import Keep
from scenec.schemas.errors import OutputError, ScenecError
from scenec.settle.settle import settle
from scenec.settle.shapes import shape_of
from scenec.settle.world import Options
from scenec.testing.overhangs import shelter, write
from scenec.testing.small import small_cfg, write_cfg

pytest.importorskip("mujoco")

CORNERS = np.array([[i, j, k] for i in (-1, 1) for j in (-1, 1) for k in (-1, 1)], float)
_QUADS = ((0, 1, 3, 2), (4, 6, 7, 5), (0, 4, 5, 1), (2, 3, 7, 6), (0, 2, 6, 4), (1, 5, 7, 3))
#: A top of 1 m by 1 m and four legs: concave as a whole.
TABLE = [
    ((0.0, 0.0, 0.75), (0.5, 0.5, 0.05)),
    *(((x, y, 0.35), (0.05, 0.05, 0.35)) for x in (-0.4, 0.4) for y in (-0.4, 0.4)),
]


def write_boxes(path: Path, boxes: list) -> Path:
    """Boxes by their middles and half sides, as one OBJ."""
    lines, count = [], 0
    for middle, half in boxes:
        points = np.array(middle) + CORNERS * np.array(half)
        lines += ["v " + " ".join(repr(float(v)) for v in p) for p in points]
        lines += ["f " + " ".join(str(i + 1 + count) for i in quad) for quad in _QUADS]
        count += 8
    path.write_text("\n".join(lines) + "\n", encoding="utf-8")
    return path


def cfg_with(
    folder: Path, objects: dict, relief: list | None = None, size: float = 20, spacing: float = 0.2
) -> Path:
    """A cfg with classes of objects; a class without models is of boxes with sides of 1 m."""
    write_boxes(folder / "box.obj", [((0, 0, 0), (0.5, 0.5, 0.5))])
    write_boxes(folder / "table.obj", TABLE)
    cfg = small_cfg(samples=1)
    cfg["labels"] = {"class": {"sky": 1, "ground": 2, "rock": 3}}
    cfg["terrain"] = {
        "size_m": [size, size],
        "spacing_m": spacing,
        "relief": relief or [{"type": "plane"}],
        "ground": [{"material": "sand", "labels": {"class": "ground"}}],
    }
    place = cfg["rigs"]["rover"]["pose"]["position"]
    place["x_m"] = place["y_m"] = 0
    cfg["materials"] = {name: cfg["materials"][name] for name in ("sand", "stone")}
    cfg["light"] = {"sky": {"type": "clear", "resolution": 32, "labels": {"class": "sky"}}}
    for node in objects.values():
        node.setdefault("material", "stone")
        node.setdefault("labels", {"class": "rock"})
        if node["type"] != "rocks":
            node.setdefault("models", [{"file": "box.obj", "unit_m": 1, "up": "z"}])
    cfg["objects"] = objects
    return write_cfg(folder, cfg)


def placed(*poses: dict, **more) -> dict:
    return {"type": "placed", "poses": list(poses), **more}


def dropped(folder: Path, cfg: Path, **options) -> tuple[PoseTable, object]:
    report = settle(
        cfg, seed=1, objects=["b"], out=folder / "poses.csv", options=Options(**options)
    )
    return read_poses(folder / "poses.csv"), report


def corners_of(table: PoseTable, n: int, half: float = 0.5) -> np.ndarray:
    turn = from_quaternion(np.zeros(3), table.quaternion[n])[:3, :3]
    return table.scale[n] * half * CORNERS @ turn.T + table.position_m[n]


def test_a_box_dropped_on_a_plane_rests_upright_with_its_lower_face_on_it(tmp_path):
    cfg = cfg_with(tmp_path, {"b": placed({"x_m": 3.3, "y_m": 1.2, "z_m": 1.0})})
    table, report = dropped(tmp_path, cfg)
    assert np.sort(corners_of(table, 0)[:, 2])[:4] == pytest.approx(np.zeros(4), abs=1e-3)
    # What falls flat stays where it fell, too.
    assert table.position_m[0, :2] == pytest.approx([3.3, 1.2], abs=1e-3)
    assert abs(table.quaternion[0, 0]) == pytest.approx(1.0, abs=1e-6)
    assert (report.unsettled, report.off_terrain, report.objects) == (0, 0, 1)
    assert report.below_ground_m < 1e-3


@pytest.mark.parametrize(("degrees", "stays"), [(20, True), (28, True), (34, False), (40, False)])
def test_a_box_stays_on_a_slope_below_the_angle_of_friction_and_slides_above(
    tmp_path, degrees, stays
):
    # The coefficient 0.6 holds up to 30.96 degrees.
    slope = math.tan(math.radians(degrees))
    write_boxes(tmp_path / "flat.obj", [((0, 0, 0), (0.5, 0.4, 0.1))])
    models = [{"file": "flat.obj", "unit_m": 1, "up": "z"}]
    pose = {"x_m": 4, "y_m": 1.2, "z_m": 0.1, "rotation_deg": [0, -degrees, 0]}
    cfg = cfg_with(
        tmp_path, {"b": placed(pose, models=models)}, [{"type": "plane", "slope": [slope, 0]}]
    )
    table, report = dropped(
        tmp_path, cfg, friction=0.6, drop_m=0.005, max_steps=20000 if stays else 500
    )
    moved = table.position_m[0, 0] - 4
    if stays:
        assert abs(moved) < 0.02
        assert report.unsettled == 0
    else:
        # Downhill, by about half of g (sin - mu cos) times the square of a second or so.
        assert moved < -0.1
        assert abs(table.position_m[0, 1] - 1.2) < 0.2


def test_a_box_beside_a_stone_rests_on_the_fines_about_its_foot(tmp_path):
    # The ramp is all but level where the box is dropped.
    heaped = {"height": 0.2, "reach": 10}
    stone = {"type": "rocks", "count": 1, "size_m": 2, "embed": 0.2, "fillet": heaped}
    box = placed({"x_m": -6, "y_m": -8, "z_m": 0.2, "scale": 0.1})
    cfg = cfg_with(tmp_path, {"stone": stone, "b": box})
    table, report = dropped(tmp_path, cfg)
    assert report.unsettled == 0
    ground = build_to(build_objects, draw(load(cfg), 1, 0))["surface"]
    x, y, z = np.ascontiguousarray(table.position_m[:1].T)
    assert ground.height_at(x, y)[0] > 0.1
    assert z[0] == pytest.approx(ground.height_at(x, y)[0] + 0.05, abs=0.01)


def test_a_table_on_rough_ground_neither_floats_nor_sinks(tmp_path):
    models = [{"file": "table.obj", "unit_m": 1, "up": "z"}]
    rough = [{"type": "plane"}, {"type": "multifractal", "amplitude_m": 0.4, "scale_m": 4}]
    cfg = cfg_with(
        tmp_path, {"b": placed({"x_m": 1, "y_m": -2}, models=models)}, rough, spacing=0.1
    )
    table, report = dropped(tmp_path, cfg, cells=16)
    surface = build_to(build_surface, draw(load(cfg), 1, 0))["surface"]
    turn = from_quaternion(np.zeros(3), table.quaternion[0])[:3, :3]
    boxes = [np.array(m) + CORNERS * np.array(h) for m, h in TABLE]
    feet = []
    for points in boxes:
        at = points @ turn.T + table.position_m[0]
        gap = at[:, 2] - surface.height_at(*np.ascontiguousarray(at[:, :2].T))
        feet.append(gap.min())
    # Every leg is near the ground, none deep in it; the hull of all would stand on humps.
    assert min(feet) == pytest.approx(-report.below_ground_m, abs=1e-6)
    assert -0.02 < min(feet) < 0.005
    assert sum(gap < 0.02 for gap in feet[1:]) >= 3
    assert turn[2, 2] > 0.8
    assert report.hull_gap_m < 0.01


def test_a_batch_that_was_drawn_again_has_the_ground_of_that_attempt(tmp_path):
    rough = [{"type": "plane"}, {"type": "multifractal", "amplitude_m": 4, "scale_m": 8}]
    cfg = cfg_with(tmp_path, {"b": placed({"x_m": 3, "y_m": 2})}, rough)
    settle(cfg, seed=1, objects=["b"], out=tmp_path / "poses.csv", attempt=2)
    corners = corners_of(read_poses(tmp_path / "poses.csv"), 0)
    gaps = []
    for attempt in (0, 2):
        surface = build_to(build_surface, draw(load(cfg), 1, 0, attempt))["surface"]
        gap = corners[:, 2] - surface.height_at(*np.ascontiguousarray(corners[:, :2].T))
        gaps.append(abs(gap.min()))
    assert gaps[1] < 0.1 < gaps[0]
    assert "seed 1 batch 0 attempt 2 " in (tmp_path / "poses.csv").read_text()
    with pytest.raises(ScenecError, match="--attempt -1: expected a whole number from 0"):
        settle(cfg, seed=1, objects=["b"], out=tmp_path / "poses.csv", attempt=-1)


@pytest.mark.slow
def test_nothing_in_a_heap_is_in_anything_else(tmp_path):
    poses = [
        {
            "x_m": 0.05 * (i * 37 % 7), "y_m": 0.05 * (i * 53 % 5), "z_m": 0.4 + 0.5 * i,
            "rotation_deg": [i * 41 % 360, i * 77 % 360, i * 13 % 360],
            "scale": 0.3 + 0.02 * (i % 5),
        }
        for i in range(10)
    ]  # fmt: skip
    cfg = cfg_with(tmp_path, {"b": placed(*poses)})
    table, report = dropped(tmp_path, cfg)
    assert report.unsettled == 0
    assert list(table.id) == list(range(1, 11))
    deepest = 0.0
    for a in range(10):
        for b in range(a):
            deepest = max(deepest, _overlap(corners_of(table, a), corners_of(table, b)))
    assert deepest < 2e-3
    assert min(corners_of(table, n)[:, 2].min() for n in range(10)) > -2e-3


def _overlap(a: np.ndarray, b: np.ndarray) -> float:
    """How deep two boxes, given by their corners, are in each other: separating axes."""

    def axes(corners):
        edges = corners[[4, 2, 1]] - corners[0]
        return edges / np.linalg.norm(edges, axis=1)[:, None]

    u, v = axes(a), axes(b)
    crossed = [np.cross(p, q) for p in u for q in v]
    candidates = [*u, *v, *(c / np.linalg.norm(c) for c in crossed if np.linalg.norm(c) > 1e-6)]
    depth = np.inf
    for axis in candidates:
        p, q = a @ axis, b @ axis
        depth = min(depth, min(p.max() - q.min(), q.max() - p.min()))
    return depth


def test_boxes_one_above_the_other_make_a_stack(tmp_path):
    poses = [{"x_m": 1, "y_m": 1, "z_m": 0.5 + 1.05 * i} for i in range(3)]
    table, report = dropped(tmp_path, cfg_with(tmp_path, {"b": placed(*poses)}), drop_m=0.01)
    assert table.position_m[:, 2] == pytest.approx([0.5, 1.5, 2.5], abs=2e-3)
    assert table.position_m[:, :2] == pytest.approx(np.ones((3, 2)), abs=5e-3)
    assert report.overlap_m < 2e-3


def test_what_begins_inside_of_something_else_is_lifted_out_first(tmp_path):
    # Both at one place, and a table that does not move: on its top there is room for one.
    models = [{"file": "table.obj", "unit_m": 1, "up": "z"}]
    objects = {
        "b": placed({"x_m": 1, "y_m": 1, "scale": 0.3}, {"x_m": 1, "y_m": 1, "scale": 0.3}),
        "stands": placed({"x_m": 1, "y_m": 1}, models=models),
    }
    table, report = dropped(tmp_path, cfg_with(tmp_path, objects), drop_m=0.0)
    heights = np.sort(table.position_m[:, 2])
    assert report.overlap_m < 1e-3
    assert _overlap(corners_of(table, 0), corners_of(table, 1)) < 1e-3
    assert report.unsettled == 0
    assert (heights >= 0.149).all()
    settle(
        tmp_path / "small.json", seed=1, objects=["b"], out=tmp_path / "through.csv", among=[],
        options=Options(drop_m=0.0),
    )  # fmt: skip
    through = read_poses(tmp_path / "through.csv")
    assert through.position_m[:, 2].min() == pytest.approx(0.15, abs=1e-3)


@pytest.mark.slow
def test_a_compile_with_the_table_puts_objects_where_it_says(tmp_path):
    rough = [{"type": "plane"}, {"type": "multifractal", "amplitude_m": 0.4, "scale_m": 4}]
    scattered = {"type": "meshes", "count": 4, "scale": 0.4}
    cfg = cfg_with(tmp_path, {"b": scattered}, rough)
    table, _ = dropped(tmp_path, cfg)
    assert list(table.id) == [1, 2, 3, 4]
    node = json.loads(cfg.read_text())
    node["objects"]["b"] = {
        "type": "placed", "file": "poses.csv", "heights": "world", "material": "stone",
        "labels": {"class": "rock"}, "models": node["objects"]["b"]["models"],
    }  # fmt: skip
    cfg.write_text(json.dumps(node))
    compile_cfg(cfg, seed=1, out=tmp_path / "out", keep=Keep.ALL)
    scene = read_stage(tmp_path / "out/batch_0000/stage.usda")
    for n in range(4):
        row = int(np.flatnonzero(scene.rows.instance_id == n + 1)[0])
        matrix = from_quaternion(table.position_m[n], table.quaternion[n])[:3]
        matrix[:, :3] *= table.scale[n]
        assert scene.rows.to_world[row] == pytest.approx(matrix, abs=1e-9)


def test_the_same_call_gives_the_same_bytes_on_one_machine(tmp_path):
    cfg = cfg_with(tmp_path, {"b": placed({"x_m": 1, "y_m": 1, "rotation_deg": [30, 40, 50]})})
    dropped(tmp_path, cfg)
    first = (tmp_path / "poses.csv").read_bytes()
    dropped(tmp_path, cfg)
    assert (tmp_path / "poses.csv").read_bytes() == first
    assert first.startswith(b"# Made by scenec ")


@pytest.mark.parametrize("size", [1e-2, 1.0, 1e2])
def test_every_size_rests_alike(tmp_path, size):
    pose = {"x_m": 3 * size, "y_m": size, "z_m": size, "scale": size}
    pose["rotation_deg"] = [15, 5, 0]
    cfg = cfg_with(tmp_path, {"b": placed(pose)}, size=20 * size, spacing=0.2 * size)
    table, report = dropped(tmp_path, cfg)
    lowest = np.sort(corners_of(table, 0)[:, 2])[:4]
    assert lowest == pytest.approx(np.zeros(4), abs=1e-3 * size)
    assert report.unsettled == 0


def test_sizes_too_far_apart_are_refused_when_they_can_meet(tmp_path):
    near = [{"x_m": 0, "y_m": 0, "scale": 5}, {"x_m": 1, "y_m": 0, "scale": 0.01}]
    cfg = cfg_with(tmp_path, {"b": placed(*near)})
    with pytest.raises(
        ScenecError, match=r"object 1 is 8\.66 m large and near objects/b: object 2"
    ):
        dropped(tmp_path, cfg)
    assert not (tmp_path / "poses.csv").exists()


def test_falling_from_too_high_is_refused(tmp_path):
    cfg = cfg_with(tmp_path, {"b": placed({"x_m": 0, "y_m": 0, "z_m": 600})})
    with pytest.raises(
        ScenecError, match=r"object 1 would fall 599\.5 m, expected at most 519\.6 m"
    ):
        dropped(tmp_path, cfg)


def test_what_stands_under_a_roof_is_not_put_onto_it(tmp_path):
    write(tmp_path / "cave.obj", *shelter())
    relief = [{"type": "mesh", "file": "cave.obj", "unit_m": 1, "up": "z"}]
    pose = {"x_m": 2.5, "y_m": 0, "z_m": 1, "scale": 0.3}
    cfg = cfg_with(tmp_path, {"b": placed(pose, heights="world")}, relief)
    with pytest.raises(ScenecError, match="object 1 stands under a roof"):
        dropped(tmp_path, cfg)
    cfg = cfg_with(tmp_path, {"b": placed({**pose, "x_m": 7, "z_m": 6}, heights="world")}, relief)
    table, report = dropped(tmp_path, cfg)
    assert report.unsettled == 0
    assert report.below_ground_m < 0.01
    assert table.position_m[0, 2] > 3


@pytest.mark.slow
def test_what_cannot_be_dropped_is_told(tmp_path):
    rocks = {"type": "rocks", "count": 3, "size_m": 0.2}
    (tmp_path / "moving.csv").write_text("time_s,x_m,y_m\n0,0,0\n1,1,1\n", encoding="utf-8")
    objects = {
        "rocks": rocks,
        "none": {"type": "meshes", "count": 0},
        "many": {"type": "meshes", "count": 501, "scale": 0.01},
        "off": placed({"x_m": 99, "y_m": 0}, heights="world"),
        "moves": {"type": "placed", "file": "moving.csv"},
    }
    cfg = cfg_with(tmp_path, objects)
    node = json.loads(cfg.read_text())
    node["samples"] = 2
    cfg.write_text(json.dumps(node))
    out = tmp_path / "p.csv"
    for change, said in (
        ({"objects": ["rock"]}, 'no class of objects is called "rock"; did you mean "rocks"?'),
        ({"objects": ["rocks"]}, 'objects/rocks is of type "rocks", which has no model file'),
        ({"objects": []}, "no class is named"),
        ({"objects": ["none"]}, "no object of it is placed"),
        ({"objects": ["many"]}, "501 objects of many, expected at most 500"),
        ({"objects": ["off"]}, "object 1 at x 99 m, y 0 m is off the terrain"),
        ({"objects": ["moves"]}, "objects/moves moves over time"),
        ({"objects": ["off"], "among": ["rcks"]}, "--among"),
        ({"objects": ["off"], "batch": 1}, "--batch 1: the cfg has batches 0 to 0"),
        ({"objects": ["off"], "options": Options(friction=-1)}, "--friction -1: expected"),
        ({"objects": ["off"], "options": Options(restitution=1)}, "--restitution 1: expected"),
        ({"objects": ["off"], "options": Options(drop_m=math.nan)}, "--drop nan: expected"),
        ({"objects": ["off"], "options": Options(cells=1)}, "--cells 1: expected"),
    ):
        with pytest.raises(ScenecError) as error:
            settle(cfg, seed=1, out=out, **change)
        assert said in str(error.value)
        assert "\n" not in str(error.value)
        assert not out.exists()
    for bad in (tmp_path, tmp_path / "p.txt", cfg / "p.csv"):
        with pytest.raises(OutputError):
            settle(cfg, seed=1, objects=["off"], out=bad)
    assert sorted(p.name for p in tmp_path.iterdir() if p.name.startswith(".")) == []


@pytest.mark.slow
def test_without_the_extra_a_message_names_it(tmp_path):
    cfg = cfg_with(tmp_path, {"b": placed({"x_m": 0, "y_m": 0})})
    blocked = (
        "import sys; sys.modules['mujoco'] = None\n"
        "from scenec.cli.main import main\n"
        "sys.exit(main(sys.argv[1:]))"
    )
    words = ["settle", str(cfg), "--seed", "1", "--objects", "b", "-o", str(tmp_path / "p.csv")]
    done = subprocess.run(
        [sys.executable, "-c", blocked, *words], capture_output=True, text=True, check=False
    )
    assert done.returncode == 2
    assert "pip install 'scenec[physics]'" in done.stderr
    assert "Traceback" not in done.stderr
    assert len(done.stderr.strip().splitlines()) == 1


def test_the_command_answers_scripts(tmp_path, capsys):
    from scenec.cli.main import main

    objects = {"b": placed({"x_m": 0, "y_m": 0}), "c": placed({"x_m": 4, "y_m": 0})}
    words = ["settle", str(cfg_with(tmp_path, objects)), "--seed", "1", "--objects", "b,c"]
    assert main([*words, "-o", str(tmp_path / "p.csv"), "--json"]) == 0
    report = json.loads(capsys.readouterr().out)
    assert report["files"] == {n: str(tmp_path / f"p_{n}.csv") for n in "bc"}
    assert (report["objects"], report["groups"], report["unsettled"]) == (2, 2, 0)
    for name, x in (("b", 0), ("c", 4)):
        table = read_poses(tmp_path / f"p_{name}.csv")
        assert table.position_m[0] == pytest.approx([x, 0, 0.5], abs=1e-3)
    assert main([*words[:-1], "bb", "-o", str(tmp_path / "q.csv")]) == 2
    assert 'did you mean "b"?' in capsys.readouterr().err


def prototype_of(boxes: list) -> Prototype:
    points = np.concatenate([np.array(m) + CORNERS * np.array(h) for m, h in boxes])
    quads = np.concatenate([np.array(_QUADS) + 8 * n for n in range(len(boxes))])
    faces = np.concatenate([quads[:, [0, 1, 2]], quads[:, [0, 2, 3]]]).astype(np.int32)
    shade = np.zeros(len(points), np.float32)
    return Prototype("p", points.astype(np.float32), faces, np.zeros((len(points), 3)), shade)


def test_a_shape_has_a_hull_for_each_connected_piece():
    shape = shape_of(prototype_of(TABLE))
    assert [len(hull) for hull in shape.hulls] == [8] * 5
    assert shape.gap == pytest.approx(0.0, abs=1e-6)
    assert shape.radius == pytest.approx(np.sqrt(0.25 + 0.25 + 0.16), abs=1e-6)
    # As one piece, the hull closes the space between the legs: 0.4 m and more from any of them.
    whole = prototype_of(TABLE[:1])
    bowl = Prototype(
        "bowl", np.array([[1, 1, 1], [-1, 1, 1], [-1, -1, 1], [1, -1, 1], [0, 0, 0]], np.float32),
        np.array([[0, 1, 4], [1, 2, 4], [2, 3, 4], [3, 0, 4]], np.int32), whole.normals,
        whole.variation,
    )  # fmt: skip
    # The farthest point of the lid is its middle: as far from a side, whose angle is 45 degrees.
    assert shape_of(bowl).gap == pytest.approx(np.sqrt(0.5), rel=0.03)


def test_what_is_flat_gets_some_thickness():
    sheet = Prototype(
        "sheet", np.array([[0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0]], np.float32),
        np.array([[0, 1, 2], [0, 2, 3]], np.int32), np.zeros((4, 3)), np.zeros(4, np.float32),
    )  # fmt: skip
    (hull,) = shape_of(sheet).hulls
    assert 1e-3 < np.ptp(hull[:, 2]) < 1e-2
