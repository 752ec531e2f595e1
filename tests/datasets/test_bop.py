"""BOP as its documented format reads it: JSON, PNG, and projections by the matrices in them."""

from __future__ import annotations

import json
import shutil
from dataclasses import replace

import numpy as np
import pytest
from PIL import Image
from scipy import ndimage
from scipy.spatial.transform import Rotation

from scenec.backends.run.render import render
from scenec.compiler.compile import compile_cfg
from scenec.datasets.export import Choice, export
from scenec.schemas.errors import FrameError, OutputError
from scenec.schemas.instances import BATCH_TABLE, read_table, write_table
from scenec.testing.made_frames import (
    LEFT,
    SIDE,
    THINGS,
    camera_pose,
    lift,
    make_out,
    misprediction,
    off_surface,
    outline,
)
from scenec.testing.small import small_cfg, write_cfg

SCENES = {"000000": LEFT, "000001": SIDE}
BY_NUMBER = {thing.number: thing for thing in THINGS}


class Scene:
    """An independent reader: docs/bop_datasets_format.md, in meters."""

    def __init__(self, path):
        self.path = path
        self.camera, self.gt, self.info = (
            {int(key): value for key, value in json.loads((path / name).read_text()).items()}
            for name in ("scene_camera.json", "scene_gt.json", "scene_gt_info.json")
        )

    def k(self, image):
        """K."""
        return np.array(self.camera[image]["cam_K"]).reshape(3, 3)

    def pose(self, image):
        """Camera to world."""
        w2c = np.eye(4)
        w2c[:3, :3] = np.array(self.camera[image]["cam_R_w2c"]).reshape(3, 3)
        w2c[:3, 3] = np.array(self.camera[image]["cam_t_w2c"]) / 1000.0
        return np.linalg.inv(w2c)

    def depth(self, image):
        """Depth, 0 where there is none."""
        picture = np.asarray(Image.open(self.path / f"depth/{image:06d}.png"))
        assert picture.dtype == np.uint16
        return picture * self.camera[image]["depth_scale"] / 1000.0

    def mask(self, kind, image, index):
        """A mask."""
        picture = np.asarray(Image.open(self.path / f"{kind}/{image:06d}_{index:06d}.png"))
        assert picture.dtype == np.uint8
        assert set(np.unique(picture)) <= {0, 255}
        return picture == 255

    def model_to_camera(self, image, index):
        """Rotation, and translation in millimeters."""
        entry = self.gt[image][index]
        return np.array(entry["cam_R_m2c"]).reshape(3, 3), np.array(entry["cam_t_m2c"])


@pytest.fixture(scope="module")
def made(tmp_path_factory):
    return make_out(tmp_path_factory.mktemp("out") / "made", (LEFT, SIDE), 3)


@pytest.fixture(scope="module")
def dataset(made):
    export(made.out, "bop")
    return made.out / "datasets/bop"


@pytest.fixture(scope="module")
def scenes(dataset):
    return {sensor: Scene(dataset / "all" / name) for name, sensor in SCENES.items()}


def each(scenes):
    """(sensor, scene, image, index, thing) of every instance."""
    for sensor, scene in scenes.items():
        for image, entries in scene.gt.items():
            for index, entry in enumerate(entries):
                yield sensor, scene, image, index, BY_NUMBER[entry["inst_id"]]


def test_points_of_a_model_land_on_its_mask_at_the_depth_of_the_picture(scenes):
    ball = np.random.default_rng(1).normal(size=(4000, 3))
    ball /= np.linalg.norm(ball, axis=1, keepdims=True)
    compared = 0
    for _, scene, image, index, thing in each(scenes):
        turn, shift = scene.model_to_camera(image, index)
        scale = np.array(scene.gt[image][index]["scale"])
        model = ball * thing.half * 1000.0
        points = (scale * model) @ turn.T + shift
        # Outward normals, to keep the side that the camera sees, away from its rim.
        normals = (ball / (scale * thing.half)) @ turn.T
        facing = -(normals * points).sum(1)
        facing /= np.linalg.norm(normals, axis=1) * np.linalg.norm(points, axis=1)
        points = points[facing > 0.5]
        pixels = points @ scene.k(image).T
        uv = np.rint(pixels[:, :2] / pixels[:, 2:]).astype(int)
        mask, depth = scene.mask("mask_visib", image, index), scene.depth(image)
        height, width = mask.shape
        inside = (uv >= 0).all(1) & (uv[:, 0] < width) & (uv[:, 1] < height)
        u, v = uv[inside].T
        whole = scene.mask("mask", image, index)
        # Within half a pixel, where it is rounded to.
        assert ndimage.binary_dilation(whole)[v, u].all()
        shown = mask[v, u]
        gap = np.abs(depth[v, u] * 1000.0 - points[inside, 2])[shown]
        # A pixel is up to 0.15 m wide there; a surface at 60 degrees is 1.7 times as deep.
        assert np.median(gap, axis=0, keepdims=True).max(initial=0.0) < 40.0
        compared += int(shown.sum())
    assert compared > 10_000


def test_depth_under_a_mask_lies_on_the_model_in_its_own_frame(scenes):
    for _, scene, image, index, thing in each(scenes):
        turn, shift = scene.model_to_camera(image, index)
        depth = np.where(scene.mask("mask_visib", image, index), scene.depth(image), 0.0)
        points = lift(depth, scene.k(image), np.eye(4)) * 1000.0
        model = ((points - shift) @ turn) / np.array(scene.gt[image][index]["scale"])
        radius = np.linalg.norm(model / 1000.0 / thing.half, axis=1)
        # Half a millimeter of depth, on a half axis of 12 cm at least.
        assert np.abs(radius - 1.0).max() < 1e-2


def test_poses_are_those_of_the_world_seen_from_the_camera(scenes):
    for sensor, scene, image, index, thing in each(scenes):
        turn, shift = scene.model_to_camera(image, index)
        from_world = np.linalg.inv(camera_pose(sensor, image))
        assert np.abs(turn - from_world[:3, :3] @ thing.rotation).max() < 1e-7
        assert np.abs(shift / 1000.0 - (from_world @ [*thing.position, 1.0])[:3]).max() < 1e-7
        assert abs(np.linalg.det(turn) - 1.0) < 1e-12
        assert Rotation.from_matrix(turn).as_matrix() == pytest.approx(turn, abs=1e-12)


def test_depth_and_pose_of_one_frame_predict_depth_in_another(scenes):
    for sensor, scene in scenes.items():
        depth = scene.depth(1)
        near = np.where(depth < 20.0, depth, 0.0)
        assert off_surface(lift(near, scene.k(1), scene.pose(1))).max() < 1.5 * 0.5e-3
        assert np.abs(scene.pose(1) - camera_pose(sensor, 1)).max() < 1e-12
        b_from_a = np.linalg.inv(scene.pose(2)) @ scene.pose(0)
        k = scene.k(0)
        error, pixels = misprediction(scene.depth(0), scene.depth(2), k, k, b_from_a)
        assert pixels > 100
        assert error < 2e-4
        back = np.linalg.inv(b_from_a)
        assert misprediction(scene.depth(0), scene.depth(2), k, k, back)[0] > 20 * error


def test_masks_and_counts_are_those_of_the_picture(made, scenes):
    for sensor, scene, image, index, thing in each(scenes):
        info = scene.info[image][index]
        visible = made.passes[sensor.name, image]["instance"] == thing.number
        pose = camera_pose(sensor, image)
        whole = outline(thing, sensor, pose)
        assert (scene.mask("mask_visib", image, index) == visible).all()
        assert (scene.mask("mask", image, index) == whole).all()
        assert info["px_count_visib"] == visible.sum()
        # bop_toolkit renders the silhouette on three times the picture.
        assert info["px_count_all"] == outline(thing, sensor, pose, 1).sum()
        assert info["px_count_valid"] == (whole & (scene.depth(image) > 0)).sum()
        assert info["visib_fract"] == info["px_count_visib"] / info["px_count_all"]
        for key, mask in (("bbox_visib", visible), ("bbox_obj", whole)):
            ys, xs = mask.nonzero()
            # As misc.calc_2d_bbox has it.
            assert info[key] == [xs.min(), ys.min(), xs.max() - xs.min(), ys.max() - ys.min()]


def test_every_instance_that_is_seen_is_listed(made, scenes):
    for sensor, scene in scenes.items():
        assert sorted(scene.gt) == [0, 1, 2]
        for image, entries in scene.gt.items():
            seen = set(np.unique(made.passes[sensor.name, image]["instance"]).tolist()) - {0}
            assert {entry["inst_id"] for entry in entries} == seen


def test_objects_are_classes_and_the_rigid_ones_are_told(dataset):
    objects = json.loads((dataset / "objects.json").read_text())
    assert objects == {
        "1": {"class": "/World/Objects/lander", "rigid": True},
        "2": {"class": "/World/Objects/rocks", "rigid": False},
    }
    models = json.loads((dataset / "models/models_info.json").read_text())
    lander = models["1"]
    size = [lander[f"size_{axis}"] for axis in "xyz"]
    assert size == pytest.approx([1800.0, 1200.0, 800.0], rel=1e-6)
    assert lander["diameter"] == pytest.approx(np.linalg.norm(size))
    assert lander["min_y"] == pytest.approx(-600.0)
    # Whatever the size of a rock, its model is the same.
    assert [models["2"][f"size_{a}"] for a in "xyz"] == pytest.approx([2000.0, 1400.0, 1000.0])


def test_a_pattern_that_nothing_matches_is_refused_with_what_there_is(made, tmp_path):
    with pytest.raises(OutputError, match=r"no frame shows anything of .*/landr.*lander"):
        export(made.out, "bop", tmp_path / "d", Choice(options={"objects": "*/landr"}))
    assert not (tmp_path / "d").exists()


def test_only_chosen_objects_are_written(made, tmp_path):
    export(made.out, "bop", tmp_path / "d", Choice(options={"objects": "*/lander"}))
    scene = Scene(tmp_path / "d/all/000000")
    assert [[e["inst_id"] for e in entries] for entries in scene.gt.values()] == [[2]] * 3
    assert json.loads((tmp_path / "d/objects.json").read_text()).keys() == {"1"}
    assert len(list((tmp_path / "d/all/000000/mask_visib").iterdir())) == 3


def test_depth_in_tenths_of_a_millimeter_ends_where_16_bits_do(made, tmp_path):
    export(made.out, "bop", tmp_path / "d", Choice(options={"depth_scale": "0.1"}))
    scene = Scene(tmp_path / "d/all/000000")
    assert scene.camera[0]["depth_scale"] == 0.1
    truth = made.passes["rover_left", 0]["depth"].astype(float)
    near = truth < 6.55
    assert near.any()
    assert np.abs(scene.depth(0)[near] - truth[near]).max() < 0.5001e-4
    assert (scene.depth(0)[truth > 6.56] == 0.0).all()


def test_without_amodal_masks_what_they_say_is_left_out(tmp_path):
    out = make_out(tmp_path / "out", (LEFT,), 1, amodal=False, without=["rgb"]).out
    export(out, "bop")
    scene = Scene(out / "datasets/bop/all/000000")
    assert sorted(path.name for path in scene.path.iterdir() if path.is_dir()) == [
        "depth",
        "mask_visib",
    ]
    keys = {key for info in scene.info[0] for key in info}
    assert keys == {"bbox_visib", "px_count_visib", "truncated"}


def test_frames_without_instances_have_empty_lists(tmp_path):
    out = make_out(tmp_path / "out", (LEFT,), 1, empty=True).out
    export(out, "bop")
    scene = Scene(out / "datasets/bop/all/000000")
    assert scene.gt == scene.info == {0: []}
    assert (scene.depth(0) == 0).all()


def test_the_largest_frame_ids_are_kept(tmp_path):
    out = make_out(tmp_path / "out", (LEFT,), 1, ids={2: 2**32 - 1, 9: 2**31}).out
    export(out, "bop")
    scene = Scene(out / "datasets/bop/all/000000")
    assert [entry["inst_id"] for entry in scene.gt[0]] == [5, 6, 2**31, 2**32 - 1]


def test_a_batch_whose_table_is_gone_is_refused(made, tmp_path):
    out = tmp_path / "out"
    shutil.copytree(made.out, out, ignore=shutil.ignore_patterns("datasets"))
    (out / "batch_0000/frames/instances.npz").unlink()
    with pytest.raises(FrameError, match=r"instances.npz: no such table"):
        export(out, "bop")


@pytest.mark.slow
def test_a_compiled_and_rendered_scene_agrees_with_itself_from_frame_to_frame(tmp_path):
    cfg = small_cfg(samples=2)
    pose = cfg["rigs"]["rover"]["pose"]
    pose["position"] = {"x_m": {"type": "uniform", "min": -2, "max": 2}, "y_m": -5, "height_m": 1.5}
    pose["target"] = {"distance_m": 6, "bearing_deg": 0, "height_m": 0}
    compile_cfg(write_cfg(tmp_path, cfg), seed=1, out=tmp_path / "out")
    render(tmp_path / "out", "reference", passes=("instance", "depth", "amodal"))
    export(tmp_path / "out", "bop")
    scene = Scene(tmp_path / "out/datasets/bop/all/000000")
    b_from_a = np.linalg.inv(scene.pose(1)) @ scene.pose(0)
    k = scene.k(0)
    error, pixels = misprediction(scene.depth(0), scene.depth(1), k, k, b_from_a)
    assert pixels > 1000
    # The ground is rough: inverse depth is not linear between its pixels.
    assert error < 1e-3
    back = np.linalg.inv(b_from_a)
    assert misprediction(scene.depth(0), scene.depth(1), k, k, back)[0] > 20 * error
    for image, infos in scene.info.items():
        for index, info in enumerate(infos):
            whole = scene.mask("mask", image, index)
            visible = scene.mask("mask_visib", image, index)
            assert (whole | ~visible).all()
            assert info["px_count_visib"] <= whole.sum() <= info["px_count_all"]
            assert 0.0 < info["visib_fract"] <= 1.0


def change_sizes(out, scales, boxes):
    """Gives instance 2 of a batch's table other scales and boxes at its samples, as factors."""
    path = out / "batch_0000/frames" / BATCH_TABLE
    table = read_table(path)
    at = np.flatnonzero(table.id == 2)
    changed = replace(
        table,
        moving=at,
        moving_position=np.repeat(table.position[None, at], len(scales), axis=0),
        moving_quaternion=np.repeat(table.quaternion[None, at], len(scales), axis=0),
        moving_shown=np.ones((len(scales), 1), np.bool_),
        moving_scale=table.scale[at] * np.array(scales, np.float32)[:, None],
        moving_box=table.box[at] * np.array(boxes, np.float32)[:, None, None],
    )
    write_table(path, changed)


def test_an_object_whose_parts_move_keeps_its_scale_and_is_not_rigid(tmp_path):
    made = make_out(tmp_path / "out", (LEFT,), 2)
    change_sizes(made.out, [[1.0] * 3] * 2, [[1.0] * 3, [1.0, 1.0, 3.0]])
    export(made.out, "bop", tmp_path / "d")
    poses = json.loads((tmp_path / "d/all/000000/scene_gt.json").read_bytes())
    assert all(one["scale"] == [1.0] * 3 for one in poses["1"] if one["inst_id"] == 2)
    objects = json.loads((tmp_path / "d/objects.json").read_bytes())
    assert objects["1"] == {"class": "/World/Objects/lander", "rigid": False}


def test_an_object_that_grows_has_the_scale_of_each_sample_and_is_not_rigid(tmp_path):
    made = make_out(tmp_path / "out", (LEFT,), 3)
    # The last one is mirrored.
    grown = {1: np.array([1.4, 1.4, 1.4]), 2: np.array([-0.5, 2.0, 1.0])}
    factors = [grown.get(sample, np.ones(3)) for sample in range(3)]
    change_sizes(made.out, factors, np.abs(factors))
    export(made.out, "bop", tmp_path / "d")
    poses = json.loads((tmp_path / "d/all/000000/scene_gt.json").read_bytes())
    for sample in range(3):
        scales = {one["inst_id"]: one["scale"] for one in poses[str(sample)]}
        assert scales[2] == pytest.approx(grown.get(sample, np.ones(3)), rel=1e-5)
        assert scales[6] == pytest.approx([0.9] * 3)
    objects = json.loads((tmp_path / "d/objects.json").read_bytes())
    assert objects["1"] == {"class": "/World/Objects/lander", "rigid": False}
