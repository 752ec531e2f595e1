"""Tables of instances: poses, boxes and pixels against independent answers."""

from __future__ import annotations

import dataclasses
import json
from pathlib import Path

import moving_stages as ms
import numpy as np
import pytest

from scenec.backends.annotation.instances import Instances
from scenec.backends.check.frames import check_frames
from scenec.backends.exact import ExactCaster
from scenec.backends.run.render import render
from scenec.backends.stage.read import read_stage
from scenec.backends.stage.scene import RenderScene
from scenec.schemas.errors import FrameError
from scenec.schemas.exr import read_exr
from scenec.schemas.instances import (
    BATCH_TABLE,
    frame_table_path,
    read_frame_table,
    read_table,
    table_digest,
    write_frame_table,
    write_table,
)
from scenec.schemas.quaternions import quaternions
from scenec.testing import scenes

pytestmark = pytest.mark.usefixtures("workers_here")

PASSES = ("depth", "instance", "label")


@pytest.fixture(scope="module")
def rendered(tmp_path_factory) -> tuple[Path, RenderScene]:
    folder = tmp_path_factory.mktemp("instances")
    stage = ms.write_stage(folder / "m.usda")
    render(stage, "reference", passes=PASSES, folder=folder)
    return folder / "frames", read_stage(stage)


def matrices(quaternion: np.ndarray) -> np.ndarray:
    """Rotation matrices of (x, y, z, w), by rotating the axes: v + 2 q x (q x v + w v)."""
    q, w = quaternion[:, None, :3], quaternion[:, None, 3:]
    v = np.broadcast_to(np.eye(3), (len(quaternion), 3, 3))
    return (v + 2 * np.cross(q, np.cross(q, v) + w * v)).transpose(0, 2, 1)


def test_the_batch_table_holds_every_instance_where_the_stage_puts_it(rendered):
    frames, scene = rendered
    table = read_table(frames)
    assert table.stage_digest == scene.digest
    assert table.id.tolist() == [*range(1, 61), 101, 102, 103]
    assert [table.classes[i] for i in table.class_index[[0, 59, 60]]] == [
        "/World/Objects/pebbles", "/World/Objects/pebbles", "/World/Objects/ball",
    ]  # fmt: skip
    assert table.local_id[-4:].tolist() == [60, 1, 2, 3]
    # Ball and fin differ in their label; pebbles do not.
    assert table.labels[[0, 60], 0].tolist() == [2, 0]
    np.testing.assert_allclose(table.box[60], [[-0.5] * 3, [0.5, 0.5, 1.0]], atol=1e-6)
    assert table.id[table.moving].tolist() == [101, 103]
    assert table.moving_shown.tolist() == [[True, s == 2] for s in range(ms.SAMPLES)]
    for sample in range(ms.SAMPLES):
        position, quaternion = table.pose(sample)
        np.testing.assert_array_equal(position[60], ms.BALL[sample])
        half = np.radians(12.5 * sample)
        np.testing.assert_allclose(quaternion[60], [0, 0, np.sin(half), np.cos(half)], atol=1e-6)


def test_a_frame_lists_what_its_pixels_show(rendered):
    frames, _ = rendered
    for sample in range(ms.SAMPLES):
        stem = frames / "annotation" / "front" / f"{sample:06d}"
        arrays, table = read_exr(stem.with_suffix(".exr")), read_frame_table(stem)
        ids, counts = np.unique(arrays["instance"], return_counts=True)
        assert table["id"].tolist() == ids[ids > 0].tolist()
        assert table["pixels"].tolist() == counts[ids > 0].tolist()
        for i, number in enumerate(table["id"]):
            y, x = np.nonzero(arrays["instance"] == number)
            box = [table[k][i] for k in ("x_min", "y_min", "x_max", "y_max")]
            assert box == [x.min(), y.min(), x.max(), y.max()]
            assert table["truncated"][i] == (
                x.min() == 0 or y.min() == 0 or x.max() == 159 or y.max() == 119
            )
            depth = arrays["depth"][y, x].astype(float)
            np.testing.assert_allclose(table["depth_min"][i], depth.min(), rtol=1e-6)
            np.testing.assert_allclose(table["depth_mean"][i], depth.mean(), rtol=1e-6)
            np.testing.assert_allclose(table["depth_max"][i], depth.max(), rtol=1e-6)
        assert set(table["label.class"]) == {"", "pebble"}
        assert table["truncated"].any()
        assert not table["truncated"].all()


def test_boxes_by_the_pose_in_the_camera_hold_the_pixels_and_no_more(rendered):
    """Corners by the camera-frame pose project around the pixels; tightly for the whole ball."""
    frames, _ = rendered
    for sample in range(ms.SAMPLES):
        stem = frames / "annotation" / "front" / f"{sample:06d}"
        table, sidecar = read_frame_table(stem), json.loads(stem.with_suffix(".json").read_text())
        k = np.array(sidecar["intrinsics"])
        size, middle = (
            np.stack([table[f"{name}_{a}"] for a in "xyz"], axis=1) for name in ("size", "box")
        )
        signs = np.array([[x, y, z] for x in (-1, 1) for y in (-1, 1) for z in (-1, 1)])
        corners = middle[:, None] + 0.5 * size[:, None] * signs
        turn = matrices(np.stack([table[f"cam_q{a}"] for a in "xyzw"], axis=1))
        place = np.stack([table[f"cam_{a}"] for a in "xyz"], axis=1)
        seen = place[:, None] + (corners[:, :, None, :] * turn[:, None]).sum(axis=3)
        ahead = (seen[:, :, 2] > 0.1).all(axis=1)
        u, v = ((seen @ k.T)[..., i] / seen[..., 2] for i in (0, 1))
        assert ahead.sum() > 20
        for i in np.flatnonzero(ahead):
            assert u[i].min() <= table["x_min"][i] + 0.5
            assert u[i].max() >= table["x_max"][i] + 0.5
            assert v[i].min() <= table["y_min"][i] + 0.5
            assert v[i].max() >= table["y_max"][i] + 0.5
        ball = table["id"].tolist().index(101)
        wide = u[ball].max() - u[ball].min()
        assert wide < 2.0 * (table["x_max"][ball] - table["x_min"][ball] + 1)


def test_poses_of_any_matrix_put_its_mesh_into_its_box():
    """Turned, stretched, mirrored, sheared and flat: R q + t of the box holds all vertices."""
    rng = np.random.default_rng(2)
    ball, faces = scenes.icosphere(1)
    rows = []
    for i in range(60):
        linear = scenes.rotation(rng) @ np.diag(rng.uniform(0.1, 3.0, 3))
        kind = i % 6
        linear = {
            0: linear,
            1: linear @ np.diag([-1.0, 1, 1]),
            2: linear @ np.array([[1.0, 0.7, -0.2], [0, 1, 0.5], [0, 0, 1]]),
            3: linear @ np.diag([1.0, 1, 0]),
            4: linear @ np.diag([0.0, 1, 1]),
            5: linear @ np.diag([0.0, 0, 1]),
        }[kind]
        rows.append((0, scenes.affine(linear, rng.normal(size=3) * 10)))
    scene = scenes.scene([scenes.mesh(ball, faces)], rows)
    scene = dataclasses.replace(scene, instance_paths={"/World/A": 0})
    table = Instances(scene).table()
    turn = matrices(table.quaternion.astype(float))
    for i, (_, matrix) in enumerate(rows):
        world = scene.meshes[0].points.astype(float) @ matrix[:, :3].T + matrix[:, 3]
        inside = (world - table.position[i]) @ turn[i]
        slack = 1e-5 * (1.0 + np.abs(inside).max())
        assert (inside >= table.box[i, 0] - slack).all()
        assert (inside <= table.box[i, 1] + slack).all()
        if i % 6 < 2:
            # No shear: the box is the tight one, and scale and turn give the matrix back.
            np.testing.assert_allclose(inside.min(axis=0), table.box[i, 0], atol=slack)
            np.testing.assert_allclose(
                turn[i] * table.scale[i], matrix[:, :3], atol=1e-5, rtol=1e-5
            )
            assert (table.scale[i, 0] < 0) == (i % 6 == 1)


def test_quaternions_of_half_turns_and_of_none():
    half = [np.diag(d).astype(float) for d in ([1, -1, -1], [-1, 1, -1], [-1, -1, 1], [1, 1, 1])]
    np.testing.assert_array_equal(np.abs(quaternions(np.array(half))), np.eye(4))


def test_several_backends_write_the_same_tables(rendered, tmp_path):
    frames, scene = rendered
    render(scene.source, "mitsuba", passes=("rgb", *PASSES), spp=1, folder=tmp_path)
    assert (tmp_path / "frames" / BATCH_TABLE).read_bytes() == (frames / BATCH_TABLE).read_bytes()
    for sample in range(ms.SAMPLES):
        name = f"front/{sample:06d}.instances.csv"
        own = (tmp_path / "frames" / "mitsuba" / name).read_bytes()
        assert own == (frames / "annotation" / name).read_bytes()


def test_a_lost_table_is_made_again_and_nothing_else(rendered, tmp_path):
    _, scene = rendered
    ask = {"passes": ("instance",), "samples": [0, 1], "folder": tmp_path}
    assert render(scene.source, "reference", **ask).rendered == 2
    stem = tmp_path / "frames" / "annotation" / "front" / "000001"
    frame_table_path(stem).unlink()
    (tmp_path / "frames" / BATCH_TABLE).unlink()
    report = render(scene.source, "reference", **ask)
    assert (report.rendered, report.skipped) == (1, 1)
    assert frame_table_path(stem).is_file()
    assert (tmp_path / "frames" / BATCH_TABLE).is_file()
    # Without the pass there is no table, and none of an earlier frame.
    one = {"samples": [1], "folder": tmp_path, "replace": True}
    render(scene.source, "reference", passes=("depth",), **one)
    assert not frame_table_path(stem).exists()


def test_check_holds_tables_against_frames(rendered, tmp_path):
    _, scene = rendered
    folder = tmp_path / "batch"
    render(scene.source, "reference", passes=PASSES, samples=[0], folder=folder)
    assert list(check_frames(folder, scene.digest)) == []
    stem = folder / "frames" / "annotation" / "front" / "000000"
    path = frame_table_path(stem)
    table, whole = read_frame_table(stem), path.read_bytes()

    def found() -> list[str]:
        return [finding.message for finding in check_frames(folder, scene.digest)]

    path.write_bytes(whole[:-20])
    assert "truncated, damaged or changed" in found()[0]
    path.unlink()
    assert "no such table" in found()[0]
    for name, fault in (
        ("pixels", "other values of pixels"),
        ("x_max", "other values of x_max"),
        ("depth_min", "other values of depth_min"),
        ("depth_max", "other values of depth_max"),
        ("amodal_bounded", "pixels <= amodal <= amodal_full does not hold"),
        ("cam_z", "not those in the world"),
    ):
        wrong = {k: v.copy() for k, v in table.items()}
        wrong[name][3] += 1
        write_frame_table(path, wrong)
        sidecar = json.loads(stem.with_suffix(".json").read_text())
        sidecar["instance_table"]["sha256"] = _sha256(path)
        stem.with_suffix(".json").write_text(json.dumps(sidecar))
        assert any(fault in message for message in found()), name
    (folder / "frames" / BATCH_TABLE).write_bytes(b"PK")
    assert any("no table of instances" in message for message in found())
    write_table(
        folder / "frames" / BATCH_TABLE,
        dataclasses.replace(Instances(scene).table(), stage_digest="other"),
    )
    assert any("is of another stage" in message for message in found())


def _sha256(path: Path) -> str:
    import hashlib

    return hashlib.sha256(path.read_bytes()).hexdigest()


def test_text_with_commas_and_quotes_comes_back(tmp_path):
    columns = {
        "id": np.array([1, 2], np.uint32),
        "class": np.array(['a,"b"', "plain"]),
        "label.x": np.array(["", "two\nlines"]),
        "depth_min": np.array([0.1, 2.5e-7]),
    }
    write_frame_table(tmp_path / "t.instances.csv", columns)
    again = read_frame_table(tmp_path / "t.instances.csv")
    for name, values in columns.items():
        assert again[name].tolist() == values.tolist()


def test_a_table_of_a_batch_with_a_broken_header_is_refused(rendered, tmp_path):
    frames, _ = rendered
    whole = (frames / BATCH_TABLE).read_bytes()
    place = whole.index(b"'descr'")
    for at in range(place, place + 60):
        broken = bytearray(whole)
        broken[at] ^= 5
        (tmp_path / BATCH_TABLE).write_bytes(broken)
        with pytest.raises(FrameError, match="no table of instances, or a damaged one"):
            read_table(tmp_path)
        assert table_digest(tmp_path / BATCH_TABLE) in (None, table_digest(frames / BATCH_TABLE))


@pytest.mark.parametrize("content", [b"", b"id\nx\n", b"id,pixels\n1\n", b"\xff\xfe\x00"])
def test_what_is_no_table_is_said_to_be_none(tmp_path, content):
    path = tmp_path / "t.instances.csv"
    path.write_bytes(content)
    with pytest.raises(FrameError, match="no table of instances"):
        read_frame_table(path)
    (tmp_path / BATCH_TABLE).write_bytes(content)
    with pytest.raises(FrameError, match="no table of instances"):
        read_table(tmp_path)


@pytest.mark.parametrize(
    ("name", "change"),
    [
        ("scale", lambda scale: scale[:, :2]),
        ("position", lambda position: position[1:]),
        ("id", lambda ids: ids[:, None]),
        ("moving", lambda moving: np.array([10**6])),
    ],
)
def test_a_table_whose_arrays_do_not_fit_is_refused(rendered, tmp_path, name, change):
    with np.load(rendered[0] / BATCH_TABLE) as stored:
        arrays = {key: stored[key] for key in stored.files}
    arrays[name] = change(arrays[name])
    np.savez(tmp_path / BATCH_TABLE, **arrays)
    with pytest.raises(FrameError, match=r"has shape|names an instance"):
        read_table(tmp_path)


def test_a_frame_without_instances_has_an_empty_table(tmp_path):
    scene = scenes.scene([scenes.mesh(np.eye(3), [[0, 1, 2]])], [(0, scenes.affine())], [0])
    made = Instances(scene)
    row, t = np.array([0, -1], np.int32), np.array([1.0, np.inf])
    geometry = ExactCaster(scene).geometry
    seen = made.seen(row, t, scenes.camera(2, 1), 0, geometry, masks=True)
    assert seen.amodal is not None
    assert len(seen.amodal.ids) == 0
    write_frame_table(tmp_path / "e.instances.csv", seen.table)
    assert {len(v) for v in read_frame_table(tmp_path / "e.instances.csv").values()} == {0}
    write_table(tmp_path / BATCH_TABLE, made.table())
    assert len(read_table(tmp_path).id) == 0
