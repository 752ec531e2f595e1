"""KITTI's flow and disparity: OpenCV reads the PNGs, the development kit's formulae give values."""

from __future__ import annotations

import csv
import json
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra import numpy as arrays
from numpy.typing import NDArray

from scenec.backends.run.facts import FrameResult, describe_frame
from scenec.backends.run.writer import write_frame
from scenec.backends.stage.scene import Camera, Lighting, RenderScene, Rows
from scenec.datasets.export import Choice, ExportReport, export
from scenec.datasets.formats.motion_png import encode_disparity, encode_flow, write_rgb16
from scenec.datasets.verify import verify
from scenec.schemas.errors import OutputError
from scenec.schemas.exr import read_exr, write_exr
from scenec.schemas.files import sha256
from scenec.schemas.frames import FrameKey
from scenec.schemas.records import RendererFacts
from scenec.testing.examples import examples
from scenec.testing.made_frames import LEFT, RIGHT, SIDE, Made, Sensor, make_out
from scenec.testing.made_output import edit

BASELINE = RIGHT.offset[0]
ASTRAY = "pictures of flow that does not lead to the next picture here: written without any"


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
def made(tmp_path_factory):
    made = make_out(tmp_path_factory.mktemp("out") / "made", (LEFT, RIGHT, SIDE), samples=2)
    return moving(made)


def moving(made: Made, without: Mapping[str, Sequence[str]] | None = None, **more: Any) -> Made:
    """The same with motion; cameras without some passes, and more in all sidecars."""
    for path in sorted(made.out.glob("batch_*/frames/*/*/*.json")):
        told = json.loads(path.read_bytes())
        exr = path.with_suffix(".exr")
        passes = read_exr(exr)
        passes |= motion(told["camera"], passes["depth"])
        for name in (without or {}).get(told["camera"], ()):
            del passes[name]
        write_exr(exr, passes)
        told["exr"] = {"bytes": exr.stat().st_size, "sha256": sha256(exr)}
        told["passes"] = list(passes)
        path.write_text(json.dumps(told | more), encoding="utf-8")
        made.passes[told["camera"], told["sample"]] = passes
    return made


def partners(out: Path, **names: str) -> None:
    """Has sidecars of cameras say to which other one their disparity goes."""
    for camera, partner in names.items():
        for path in sorted(out.glob(f"batch_*/frames/*/{camera}/*.json")):
            edit(path, partner=partner)


def small(name: str, x: float = 0.0) -> Sensor:
    return Sensor(f"rover_{name}", f"/World/Rigs/rover/{name}", (x, 0.0, 0.0), 0.0, (16, 12), 12.0)


def exported(out: Path, folder: Path, faults: str = "stop", **options: str) -> ExportReport:
    return export(out, "kitti", folder, Choice(options=options, faults=faults))


def pairs(dataset: Path) -> list[tuple[str, str]]:
    with (dataset / "sequences.csv").open(encoding="utf-8", newline="") as file:
        return [(line["left"], line["right"]) for line in csv.DictReader(file)]


def with_flow(dataset: Path, folder: str = "flow_2") -> dict[str, bool]:
    """Whether any pixel of each picture of flow has any, in the order that readers zip them in."""
    files = sorted((dataset / "sequences/00" / folder).glob("*.png"))
    return {file.stem: bool(devkit_flow(file)[1].any()) for file in files}


def test_a_sidecar_names_the_camera_that_disparity_goes_to(tmp_path):
    k = np.array([[2.0, 0, 2], [0, 2, 1], [0, 0, 1]])
    left, right = (Camera(f"rig_{n}", f"/World/Rigs/rig/{n}", 4, 2, k, np.eye(4)) for n in "ab")
    left = replace(left, partner=right.path)
    none = np.zeros(0, np.uint32)
    rows = Rows(none.astype(np.int32), np.zeros((0, 3, 4)), none, none.astype(np.float32))
    scene = RenderScene(
        Path("stage.usda"), "0" * 64, 1, (), rows, (), (), {}, {}, ((left, right),),
        (Lighting((), ()),), np.zeros((2, 3)),
    )  # fmt: skip
    key = FrameKey("0" * 64, ("depth",), 0, 0, "reference", "0")
    depth = {"depth": np.ones((2, 4), np.float32)}
    told = []
    for camera in (left, right, replace(left, partner="/World/Gone")):
        record = describe_frame(scene, camera, 0, RendererFacts("r", "0", "cpu", None, None))
        write_frame(tmp_path / "f", FrameResult(depth, record), key, scene, camera)
        told.append(json.loads((tmp_path / "f.json").read_bytes()).get("partner", "absent"))
    assert told == ["rig_b", "absent", None]


def test_the_pair_is_that_of_the_partner_and_not_of_the_nearest(tmp_path):
    made = moving(make_out(tmp_path / "out", (small("a"), small("b", 0.1), small("c", 0.25)), 1))
    partners(made.out, rover_a="rover_c", rover_c="rover_a", rover_b="rover_a")
    folder = exported(made.out, tmp_path / "d", disparity="all").folder
    assert pairs(folder) == [("rover_a", "rover_c"), ("rover_b", "")]
    found, there = devkit_disparity(folder / "sequences/00/disp_2/000000.png")
    wanted = made.passes["rover_a", 0]["disparity"]
    assert there.sum() > 100
    assert np.abs(found - wanted)[there].max() <= 1 / 256


def test_disparity_to_another_camera_than_the_pairs_is_refused(tmp_path):
    made = moving(make_out(tmp_path / "out", (small("a"), small("b", 0.1), small("c", 0.25)), 1))
    partners(made.out, rover_a="rover_c")
    choice = Choice(cameras=["rover_a", "rover_b"], options={"disparity": "all"})
    with pytest.raises(OutputError, match="disparity goes to rover_c, and format kitti has it bes"):
        export(made.out, "kitti", tmp_path / "d", choice)


def test_a_pair_by_geometry_of_frames_that_name_no_partner_is_said_once(tmp_path):
    cameras = (small("a"), small("b", 0.1), small("x", 9.0), small("y", 9.3))
    made = moving(make_out(tmp_path / "out", cameras, 2))

    def told(name: str) -> list[str]:
        said: list[str] = []
        export(made.out, "kitti", tmp_path / name, Choice(), say=said.append)
        return said

    (line,) = told("before")
    assert line.startswith("warning: rover_a and rover_b (and 1 more pairs) are a pair by where")
    # Without disparity there is nothing that a pair could get wrong.
    moving(made, dict.fromkeys((s.name for s in cameras[2:]), ("disparity",)))
    (line,) = told("one")
    assert line.startswith("warning: rover_a and rover_b are a pair by where")
    partners(made.out, rover_a="rover_b")
    assert told("after") == []


@pytest.mark.parametrize("has", ["left", "right"])
def test_of_a_pair_one_camera_alone_may_have_disparity(tmp_path, has):
    made = make_out(tmp_path / "out", (small("left"), small("right", 0.25)), 1)
    lacks = {"left": "rover_right", "right": "rover_left"}[has]
    moving(made, {lacks: ("disparity", "disparity_occlusion")})
    partners(made.out, **{f"rover_{has}": lacks})
    report = exported(made.out, tmp_path / "d", disparity="visible")
    folders = sorted(path.name for path in (report.folder / "sequences/00").glob("disp_*"))
    assert folders == [{"left": "disp_2", "right": "disp_3"}[has]]
    told = {"left pictures of pairs without the pass disparity": 1} if has == "right" else {}
    assert report.left_out == told


def test_flow_to_a_sample_that_is_not_the_next_picture_is_no_flow(tmp_path):
    made = moving(make_out(tmp_path / "out", (small("a"), small("b", 0.25)), 4))
    folder = made.out / "batch_0000/frames/mitsuba"
    (folder / "rover_b/000001.json").unlink()
    report = exported(made.out, tmp_path / "d", "skip", flow="all")
    # Samples 0, 2, 3 of both.
    for side in ("flow_2", "flow_3"):
        found = with_flow(report.folder, side)
        assert found == {"000000": False, "000001": True, "000002": False}
    assert report.left_out[ASTRAY] == 4
    flow, there = devkit_flow(report.folder / "sequences/00/flow_2/000001.png")
    assert np.abs(flow - made.passes["rover_a", 2]["flow"])[there].max() <= 0.5 / 64


def test_flow_of_a_camera_that_is_triggered_less_often_leads_to_its_next_picture(tmp_path):
    made = moving(make_out(tmp_path / "out", (small("a"),), 5), trigger=[2, 0])
    for sample in (1, 3):
        (made.out / f"batch_0000/frames/mitsuba/rover_a/{sample:06d}.json").unlink()
    found = with_flow(exported(made.out, tmp_path / "d", flow="all").folder)
    assert found == {"000000": True, "000001": True, "000002": False}


def test_flow_to_a_damaged_picture_is_no_flow(tmp_path):
    made = moving(make_out(tmp_path / "out", (small("a"), small("b", 0.25)), 4))
    (made.out / "batch_0000/frames/mitsuba/rover_b/000002.exr").write_bytes(b"damaged")
    report = exported(made.out, tmp_path / "d", "skip", flow="all")
    for side in ("flow_2", "flow_3"):
        found = with_flow(report.folder, side)
        assert found == {"000000": True, "000001": False, "000003": False}
    assert report.left_out[ASTRAY] == 4
    assert verify(report.folder) == []


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
def test_flow_and_disparity_come_back_within_half_a_step(made, tmp_path, how):
    choice = Choice(options={"flow": how, "disparity": how})
    report = export(made.out, "kitti", tmp_path / "d", choice)
    beyond = 0
    for place, camera in (("00", "rover_left"), ("00", "rover_right"), ("01", "rover_side")):
        side = 3 if camera == "rover_right" else 2
        for sample in range(2):
            passes = made.passes[camera, sample]
            folder, name = report.folder / "sequences" / place, f"{sample:06d}.png"
            flow, there = devkit_flow(folder / f"flow_{side}" / name)
            seen = (passes["occlusion"] == 0) | (how == "all")
            # No picture follows the second one.
            known = np.isfinite(passes["flow"]).all(axis=2) & seen & (sample == 0)
            held = known & (np.abs(passes["flow"]) < 511.99).all(axis=2)
            beyond += int((known & ~held).sum())
            assert (there == held).all()
            assert np.abs(flow - passes["flow"])[held].max(initial=0.0) <= 0.5 / 64
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
    assert report.left_out == {"pixels of flow that KITTI's 16 bits do not hold": beyond, ASTRAY: 3}


def test_depth_gray_and_motion_are_written_if_they_are_asked_for_alone(made, tmp_path):
    folder = export(made.out, "kitti", tmp_path / "d").folder
    folders = {path.name for path in (folder / "sequences/00").iterdir() if path.is_dir()}
    assert folders == {"image_2", "image_3"}


def test_what_is_infinitely_far_away_has_the_least_disparity_and_negative_ones_none():
    coded, lost = encode_disparity(np.array([[-1e-13, 0.0, -0.01, 256.0, np.nan]]))
    assert coded.tolist() == [[1, 1, 0, 0, 0]]
    assert lost == 2


@examples(40)
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
