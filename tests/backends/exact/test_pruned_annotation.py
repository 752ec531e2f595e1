"""What pruning leaves out shows in no pixel: annotation bit by bit, pictures within noise."""

from __future__ import annotations

import numpy as np
import pytest

from scenec.backends.stage.read import read_stage
from scenec.compiler.views.needed import Keep
from scenec.schemas.left_out import read_left_out
from scenec.testing.pruned_scenes import (
    annotation,
    compiled,
    difference,
    drawn_cfg,
    everything,
    odd_cfg,
)


def _same(folder, cfg, annotation=annotation) -> int:
    """Asserts equal annotation; how many instances and tiles were left out."""
    batches = {keep: compiled(folder, cfg, keep) for keep in (Keep.SEEN, Keep.UNPRUNED)}
    pairs = zip(annotation(batches[Keep.SEEN]), annotation(batches[Keep.UNPRUNED]), strict=True)
    for (name, pruned), (other, whole) in pairs:
        assert name == other
        assert pruned.keys() == whole.keys()
        for key, values in whole.items():
            assert np.array_equal(pruned[key], values, equal_nan=values.dtype.kind == "f"), (
                f"{name}: {key} differs"
            )
    record = read_left_out(batches[Keep.SEEN])
    if record is None:
        return 0
    gone = sum(
        n for one in record.classes.values() for why, n in one.counts().items() if not why.kept
    )
    return gone + len(record.tiles)


@pytest.mark.invariant
@pytest.mark.slow
def test_annotation_of_pruned_stages_is_that_of_whole_ones_bit_by_bit(tmp_path):
    gone = [_same(folder, drawn_cfg(seed, folder)) for seed, folder in _folders(tmp_path, 6)]
    # Not because nothing was left out.
    assert sum(n > 100 for n in gone) >= 4


def _folders(root, count):
    for seed in range(count):
        folder = root / str(seed)
        folder.mkdir()
        yield seed, folder


@pytest.mark.invariant
@pytest.mark.slow
def test_with_color_annotation_is_the_same_too(tmp_path):
    gone = [
        _same(folder, drawn_cfg(seed, folder, ("rgb", "label", "instance")))
        for seed, folder in _folders(tmp_path, 3)
    ]
    assert any(n > 0 for n in gone)


@pytest.mark.invariant
@pytest.mark.slow
def test_lenses_lidars_depth_cameras_flow_and_lamps_find_all_there_is_for_them(tmp_path):
    gone = [
        _same(folder, odd_cfg(seed, folder, outputs), everything)
        for (seed, folder), outputs in zip(
            _folders(tmp_path, 4),
            (("label",), ("instance",), ("rgb", "label"), ("label", "instance")),
            strict=True,
        )
    ]
    assert sum(gone) > 50


def test_keeping_everything_keeps_everything(tmp_path):
    drawn = drawn_cfg(2, tmp_path)
    read = [
        read_stage(compiled(tmp_path, drawn, keep) / "stage.usda")
        for keep in (Keep.ALL, Keep.UNPRUNED)
    ]
    # 400 pebbles, 8 boulders, 6 logs.
    assert [len(np.unique(scene.rows.instance_id)) - 1 for scene in read] == [414, 414]


@pytest.mark.slow
def test_pictures_of_pruned_stages_differ_by_less_than_noise(tmp_path):
    for _, folder in _folders(tmp_path, 4):
        cfg = drawn_cfg(int(folder.name) + 20, folder, ("rgb",))
        batches = {keep: compiled(folder, cfg, keep) for keep in (Keep.SEEN, Keep.UNPRUNED)}
        found = difference(batches[Keep.SEEN], batches[Keep.UNPRUNED], 256)
        assert found.paired < found.noise
        assert abs(found.mean) < 2e-3


@pytest.mark.slow
def test_leaving_out_what_casts_shadows_would_be_noticed(tmp_path):
    """The comparison can fail: without anything that no camera sees, pictures differ more."""
    worst = 0.0
    for seed, folder in _folders(tmp_path, 6):
        cfg = drawn_cfg(seed + 20, folder, ("rgb", "instance"))
        whole = compiled(folder, cfg, Keep.UNPRUNED)
        blind = compiled(folder, drawn_cfg(seed + 20, folder, ("instance",)), Keep.SEEN)
        bare = folder / "bare"
        _without(whole, bare, read_left_out(blind))
        found = difference(bare, whole, 64)
        worst = max(worst, found.paired / found.noise)
    assert worst > 1.0


def _without(whole, bare, record):
    """A copy of a stage in which all that no camera sees is invisible."""
    import shutil

    from pxr import Usd, UsdGeom

    shutil.copytree(whole, bare)
    stage = Usd.Stage.Open(str(bare / "stage.usda"))
    for prim in stage.Traverse():
        if prim.IsA(UsdGeom.PointInstancer):
            one = record.classes[prim.GetName()]
            gone = [
                int(number)
                for why in one.counts()
                if not why.kept
                for number in one.where(why).tolist()
            ]
            UsdGeom.PointInstancer(prim).CreateInvisibleIdsAttr(gone)
    stage.GetRootLayer().Save()
