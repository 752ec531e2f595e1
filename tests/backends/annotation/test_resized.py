"""Tables of instances that change their size: scales and boxes are those of each sample."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from pxr import Gf, UsdGeom

from scenec.backends.annotation.instances import Instances
from scenec.backends.run.render import render
from scenec.backends.stage.read import read_stage
from scenec.schemas import instances
from scenec.schemas.instances import read_frame_table, read_table, write_table
from scenec.testing.foreign_stages import label, written

pytestmark = pytest.mark.usefixtures("workers_here")

SAMPLES = 4
#: Of a cube of edge 1 at each sample: grown along x, mirrored at the last.
SCALES = np.array([[1.0, 1.0, 2.0], [1.2, 1.0, 2.0], [1.4, 1.0, 2.0], [-1.6, 1.0, 2.0]])


def growing(stage):
    """A cube that grows and turns, one that only turns, and an eye above both."""
    for name, scales in (("grows", SCALES), ("turns", np.full((SAMPLES, 3), 0.5))):
        cube = UsdGeom.Cube.Define(stage, f"/Root/{name}")
        cube.CreateSizeAttr(1.0)
        label(cube.GetPrim(), name)
        move, turn, scale = cube.AddTranslateOp(), cube.AddRotateZOp(), cube.AddScaleOp()
        move.Set((-2.0 if name == "grows" else 2.0, 0, 0))
        for sample, value in enumerate(scales):
            turn.Set(20.0 * sample, sample)
            scale.Set(Gf.Vec3f(*value.tolist()), sample)
    UsdGeom.Camera.Define(stage, "/Root/eye").AddTranslateOp().Set((0, 0, 12))


def test_scales_and_boxes_are_those_of_each_sample(tmp_path):
    path = written(tmp_path, growing, samples=SAMPLES)
    render(path, "reference", passes=("depth", "instance"), folder=tmp_path)
    table = read_table(tmp_path / "frames")
    for sample, expected in enumerate(SCALES):
        scale, box = table.size(sample)
        np.testing.assert_allclose(scale[0], expected, rtol=1e-6)
        half = 0.5 * np.abs(expected)
        np.testing.assert_allclose(box[0], [-half, half], rtol=1e-6)
        np.testing.assert_allclose(scale[1], [0.5] * 3, rtol=1e-6)
        stem = tmp_path / "frames" / "annotation" / "eye" / f"{sample:06d}"
        frame = read_frame_table(stem)
        sizes = np.stack([frame[f"size_{axis}"] for axis in "xyz"], axis=1)
        np.testing.assert_allclose(sizes, [np.abs(expected), [0.5] * 3], rtol=1e-6)


def test_a_table_of_a_version_without_sizes_is_read_and_made_anew(tmp_path, monkeypatch):
    path = written(tmp_path, growing, samples=SAMPLES)
    monkeypatch.setattr(instances, "TABLE_VERSION", 1)
    old = replace(Instances(read_stage(path)).table(), moving_scale=None, moving_box=None)
    write_table(tmp_path / "frames" / instances.BATCH_TABLE, old)
    monkeypatch.undo()
    assert read_table(tmp_path / "frames").moving_scale is None
    render(path, "reference", passes=("depth", "instance"), folder=tmp_path)
    assert read_table(tmp_path / "frames").moving_scale is not None


def test_a_table_of_what_keeps_its_size_has_no_sizes_by_sample(tmp_path):
    def build(stage):
        growing(stage)
        stage.RemovePrim("/Root/grows")

    scene = read_stage(written(tmp_path, build, samples=SAMPLES))
    table = Instances(scene).table()
    assert table.moving.tolist() == [0]
    assert table.moving_scale is None
    write_table(tmp_path / "instances.npz", table)
    with np.load(tmp_path / "instances.npz") as arrays:
        assert "moving_scale" not in arrays
    np.testing.assert_array_equal(read_table(tmp_path).size(3)[0], table.scale)


def test_a_box_holds_the_parts_where_they_are_at_each_sample(tmp_path):
    """A lid slides along x on a base, both of edge 1, doubled; at the last sample it is hidden."""

    def build(stage):
        whole = UsdGeom.Xform.Define(stage, "/Root/chest")
        whole.AddRotateZOp().Set(90.0)
        whole.AddScaleOp().Set(Gf.Vec3f(2.0))
        label(whole.GetPrim(), "chest")
        UsdGeom.Cube.Define(stage, "/Root/chest/base").CreateSizeAttr(1.0)
        lid = UsdGeom.Cube.Define(stage, "/Root/chest/lid")
        lid.CreateSizeAttr(1.0)
        move = lid.AddTranslateOp()
        for sample in range(SAMPLES):
            move.Set((float(sample), 0, 1), sample)
        lid.CreateVisibilityAttr().Set("inherited", 0)
        lid.GetVisibilityAttr().Set("invisible", SAMPLES - 1)

    table = Instances(read_stage(written(tmp_path, build, samples=SAMPLES))).table()
    for sample in range(SAMPLES - 1):
        expected = [[-1, -1, -1], [1 + 2 * sample, 1, 3]]
        np.testing.assert_allclose(table.size(sample)[1], [expected], atol=1e-6)
    np.testing.assert_allclose(table.size(SAMPLES - 1)[1], [[[-1] * 3, [1] * 3]], atol=1e-6)
