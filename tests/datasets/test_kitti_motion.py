"""KITTI's flow and disparity: OpenCV reads the PNGs, the development kit's formulae give values."""

from __future__ import annotations

import json
from pathlib import Path

import cv2
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra import numpy as arrays
from made_frames import LEFT, RIGHT, SIDE, Made, make_out
from numpy.typing import NDArray

from scenec.datasets.export import Choice, export
from scenec.datasets.formats.motion_png import encode_disparity, encode_flow, write_rgb16
from scenec.schemas.errors import OutputError
from scenec.schemas.exr import read_exr, write_exr
from scenec.schemas.files import sha256

BASELINE = RIGHT.offset[0]


def motion(camera: str, depth: NDArray[np.float32]) -> dict[str, NDArray]:
    """Flow of any kind, the pair's true disparity, and codes of what the other picture shows."""
    height, width = depth.shape
    rng = np.random.default_rng(len(camera))
    flow = rng.normal(0, 200, (height, width, 2)).astype(np.float32)
    flow[0] = np.nan
    sign = -1.0 if camera == "rover_right" else 1.0
    with np.errstate(divide="ignore"):
        disparity = (sign * 50.0 * BASELINE / depth).astype(np.float32)
    disparity[:, 0] = np.nan
    codes = rng.integers(0, 4, (height, width)).astype(np.uint32)
    return {"flow": flow, "occlusion": codes, "disparity": disparity,
            "disparity_occlusion": codes[::-1].copy()}  # fmt: skip


@pytest.fixture(scope="module")
def made(tmp_path_factory) -> Made:
    made = make_out(tmp_path_factory.mktemp("out") / "made", (LEFT, RIGHT, SIDE), samples=2)
    for path in sorted(made.out.glob("batch_*/frames/*/*/*.json")):
        told = json.loads(path.read_bytes())
        exr = path.with_suffix(".exr")
        passes = read_exr(exr)
        passes |= motion(told["camera"], passes["depth"])
        write_exr(exr, passes)
        told["exr"] = {"bytes": exr.stat().st_size, "sha256": sha256(exr)}
        told["passes"] = list(passes)
        path.write_text(json.dumps(told), encoding="utf-8")
        made.passes[told["camera"], told["sample"]] = passes
    return made


def devkit_flow(path: Path) -> tuple[NDArray[np.float64], NDArray[np.bool_]]:
    """As ``readme.txt`` of the development kit says; OpenCV has channels in the order b, g, r."""
    channels = cv2.imread(str(path), cv2.IMREAD_UNCHANGED)
    assert channels.dtype == np.uint16
    blue, green, red = channels.transpose(2, 0, 1).astype(np.float64)
    return np.stack([(red - 2**15) / 64, (green - 2**15) / 64], axis=2), blue > 0


def devkit_disparity(path: Path) -> tuple[NDArray[np.float64], NDArray[np.bool_]]:
    steps = cv2.imread(str(path), cv2.IMREAD_UNCHANGED)
    assert steps.dtype == np.uint16
    return steps / 256.0, steps > 0


@pytest.mark.parametrize("how", ["all", "visible"])
def test_flow_and_disparity_come_back_within_half_a_step(made: Made, tmp_path: Path, how: str):
    choice = Choice(options={"flow": how, "disparity": how})
    report = export(made.out, "kitti", tmp_path / "d", choice, workers=1)
    beyond = 0
    for place, camera in (("00", "rover_left"), ("00", "rover_right"), ("01", "rover_side")):
        side = 3 if camera == "rover_right" else 2
        for sample in range(2):
            passes = made.passes[camera, sample]
            folder, name = report.folder / "sequences" / place, f"{sample:06d}.png"
            flow, there = devkit_flow(folder / f"flow_{side}" / name)
            seen = (passes["occlusion"] == 0) | (how == "all")
            known = np.isfinite(passes["flow"]).all(axis=2) & seen
            held = known & (np.abs(passes["flow"]) < 511.99).all(axis=2)
            beyond += int((known & ~held).sum())
            assert (there == held).all()
            assert np.abs(flow - passes["flow"])[held].max() <= 0.5 / 64
            if camera == "rover_side":
                assert not (folder / "disp_2").exists()
                continue
            disparity, there = devkit_disparity(folder / f"disp_{side}" / name)
            seen = (passes["disparity_occlusion"] == 0) | (how == "all")
            assert (there == (np.isfinite(passes["disparity"]) & seen)).all()
            off = np.abs(disparity - np.abs(passes["disparity"]))[there]
            # What is infinitely far away has the least disparity that is one.
            assert off.max() <= 1 / 256
            hit = there & np.isfinite(passes["depth"])
            z = 50.0 * BASELINE / disparity[hit]
            assert np.abs(z / passes["depth"][hit] - 1).max() < 0.5 / 256 / disparity[hit].min()
    assert beyond > 0
    assert report.left_out == {"pixels of flow that KITTI's 16 bits do not hold": beyond}


def test_nothing_of_motion_is_written_unless_it_is_asked_for(made: Made, tmp_path: Path):
    folder = export(made.out, "kitti", tmp_path / "d", workers=1).folder
    assert not [p for p in folder.rglob("*") if p.name.startswith(("flow", "disp"))]


@pytest.mark.parametrize(
    ("option", "lacking"), [({"flow": "all"}, "flow"), ({"disparity": "visible"}, "disparity")]
)
def test_a_pass_that_is_not_there_is_named(tmp_path: Path, option, lacking):
    out = make_out(tmp_path / "made", (LEFT,), samples=1).out
    with pytest.raises(OutputError, match=f"the frames have no pass {lacking}; render with"):
        export(out, "kitti", tmp_path / "d", Choice(options=option), workers=1)


def test_what_is_infinitely_far_away_has_the_least_disparity_and_negative_ones_none():
    coded, lost = encode_disparity(np.array([[-1e-13, 0.0, -0.01, 256.0, np.nan]]))
    assert coded.tolist() == [[1, 1, 0, 0, 0]]
    assert lost == 2


@settings(max_examples=40, deadline=None)
@given(
    arrays.arrays(
        np.float32,
        st.tuples(st.integers(1, 7), st.integers(1, 7), st.just(2)),
        elements=st.one_of(st.floats(width=32), st.floats(-520, 520, width=32)),
    )
)
def test_any_flow_and_disparity_have_the_kits_codes(tmp_path_factory, flow):
    path = tmp_path_factory.mktemp("flow") / "f.png"
    coded, lost = encode_flow(flow)
    write_rgb16(path, coded)
    found, there = devkit_flow(path)
    known = np.isfinite(flow).all(axis=2)
    assert lost == (known & ~there).sum()
    assert (np.abs(found - flow.astype(np.float64))[there] <= 0.5 / 64).all()
    assert not (there & ~known).any()
    far = known & (np.abs(flow) > 512.01).any(axis=2)
    assert not (there & far).any()
    steps, _ = encode_disparity(flow[..., 0])
    kept = steps > 0
    assert (np.abs(steps / 256.0 - flow[..., 0].astype(np.float64))[kept] <= 1.001 / 256).all()
    inside = np.isfinite(flow[..., 0]) & (flow[..., 0] >= 0) & (flow[..., 0] < 255.99)
    assert kept[inside].all()
