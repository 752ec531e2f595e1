"""Sky that is seen below the horizon: it can have a label of its own, or it is said."""

from __future__ import annotations

from dataclasses import asdict
from pathlib import Path

import numpy as np
import pytest

from scenec.backends.camera import tiles
from scenec.backends.check.frames import check_frames
from scenec.backends.run.render import render
from scenec.backends.stage.read import read_stage
from scenec.compiler.cfg.load import load
from scenec.compiler.compile import compile_cfg
from scenec.schemas.errors import CfgError
from scenec.schemas.frames import read_frame
from scenec.schemas.stage import ATTR_SKY_LABEL_BELOW
from scenec.testing.small import small_cfg, write_cfg

pytestmark = pytest.mark.usefixtures("workers_here")

SKY, FAR = 1, 9


def cfg(**sky):
    """A small terrain whose border cameras look over."""
    made = small_cfg(samples=2, outputs=["label", "depth"])
    made["labels"]["class"] |= {"far": FAR} if sky else {}
    made["light"]["sky"] |= sky
    return made


def output(folder: Path, **sky) -> Path:
    compile_cfg(write_cfg(folder, cfg(**sky)), seed=1, out=folder / "out")
    return folder / "out"


@pytest.fixture(scope="module")
def plain(tmp_path_factory) -> Path:
    return output(tmp_path_factory.mktemp("plain"))


@pytest.fixture(scope="module")
def named(tmp_path_factory) -> Path:
    return output(tmp_path_factory.mktemp("named"), labels_below={"class": "far"})


def frames(out: Path):
    """(labels by level, where no surface is seen, where rays go down) of each frame."""
    report = render(out, "annotation")
    found = []
    for stem in report.frames:
        frame = read_frame(stem.with_suffix(".json"))
        k, pose = np.array(frame.sidecar.intrinsics), np.array(frame.sidecar.camera_to_world)
        height, width = frame.passes["depth"].shape
        u, v = np.meshgrid(np.arange(width) + 0.5, np.arange(height) + 0.5)
        x, y = (u - k[0, 2]) / k[0, 0], (v - k[1, 2]) / k[1, 1]
        up = pose[2, 0] * x + pose[2, 1] * y + pose[2, 2]
        found.append((frame, np.isinf(frame.passes["depth"]), up < 0.0))
    return found, report.warnings


def test_the_ground_of_the_skys_picture_has_the_label_that_it_is_given(named: Path) -> None:
    found, warnings = frames(named)
    for frame, sky, down in found:
        labels = frame.passes["label.class"]
        assert (sky & down).any()
        assert (labels[sky & down] == FAR).all()
        assert (labels[sky & ~down] == SKY).all()
        assert not np.isin(labels[~sky], (SKY, FAR)).any()
        # A level that is left out has the sky's.
        assert (frame.passes["label.surface"][sky] == 7).all()
    # That level is still to be said.
    assert len([line for line in warnings if "below the horizon" in line]) == 1


def test_labels_below_on_every_level_leave_nothing_to_say(tmp_path: Path) -> None:
    out = output(tmp_path, labels_below={"class": "far", "surface": "sand"})
    found, warnings = frames(out)
    assert not [line for line in warnings if "below the horizon" in line]
    assert all(frame.sidecar.sky.below_horizon == 0 for frame, _, _ in found)


def test_without_it_the_sky_has_one_label_and_its_share_below_is_said(plain: Path) -> None:
    found, warnings = frames(plain)
    skies, below = 0, 0
    for frame, sky, down in found:
        assert (frame.passes["label.class"][sky] == SKY).all()
        counts = {"pixels": sky.sum(), "below_horizon": (sky & down).sum()}
        assert asdict(frame.sidecar.sky) == counts
        skies, below = skies + sky.sum(), below + (sky & down).sum()
    (line,) = [line for line in warnings if "below the horizon" in line]
    assert line.startswith("batch_0000/rover_front: ")
    assert f"{100 * below / skies:.0f} % of the sky in its 2 frames" in line
    assert "labels_below" in line
    (finding,) = [f for f in check_frames(plain / "batch_0000", None) if f.check == "sky"]
    assert finding.severity == "warning"
    assert finding.message in line
    text = (plain / "batch_0000/sky.usdc").read_bytes()
    assert ATTR_SKY_LABEL_BELOW.format(level="").encode() not in text


def test_a_horizon_leaves_no_sky_below(tmp_path: Path) -> None:
    made = cfg()
    # Hills that rise from the border on: what they stand on does not count.
    relief = [{"type": "plane"}, {"type": "multifractal", "amplitude_m": 150, "scale_m": 900}]
    relief[1] |= {"variant": "ridged", "mask": [{"type": "point", "x_m": 0, "y_m": 0}]}
    relief[1]["mask"][0] |= {"min_m": 500, "softness_m": 900}
    land = {"reach_m": 3000, "relief": relief, "material": "sand"}
    made["terrain"]["horizon"] = land | {"labels": {"class": "ground", "surface": "sand"}}
    compile_cfg(write_cfg(tmp_path, made), seed=1, out=tmp_path / "out")
    found, warnings = frames(tmp_path / "out")
    assert not [line for line in warnings if "below the horizon" in line]
    for _, sky, down in found:
        assert (sky & down).sum() <= 0.01 * sky.sum()


def test_pictures_in_bands_count_the_same(plain: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    from scenec.backends.annotation.annotate import annotate
    from scenec.backends.exact.caster import ExactCaster

    scene = read_stage(plain / "batch_0000/stage.usda")
    camera, caster = scene.cameras[0][0], ExactCaster(scene)
    whole = annotate(scene, caster, camera, ["label"], 0).sky
    monkeypatch.setattr(tiles, "PIXELS", 96 * 7)
    assert len(tiles.bands(camera)) > 1
    assert annotate(scene, caster, camera, ["label"], 0).sky == whole


def test_its_labels_are_checked_as_others_are(tmp_path: Path) -> None:
    made = cfg(labels_below={"class": "fra"})
    with pytest.raises(CfgError) as caught:
        load(write_cfg(tmp_path, made))
    assert (
        '/light/sky/labels_below/class: no label "fra" on the level "class"; did you mean "far"'
        in (str(caught.value))
    )
    # What is not given is not part of the cfg's digest.
    assert "labels_below" not in load(write_cfg(tmp_path, cfg())).cfg["light"]["sky"]
