"""What a sensor took is the picture of a frame wherever one is shown or handed on."""

from __future__ import annotations

import io
import json
from pathlib import Path
from typing import Any

import h5py
import numpy as np
import pyarrow.parquet as pq
import pytest
import webdataset
from PIL import Image
from rosbags.rosbag2 import Reader
from rosbags.typesys import Stores, get_typestore
from sensor_frames import add_sensor, on_disk

from scenec.datasets import pictures
from scenec.datasets.export import Choice, export
from scenec.datasets.source import Source
from scenec.datasets.torch_dataset import FrameDataset
from scenec.datasets.view.page import write_view
from scenec.schemas.errors import FrameError
from scenec.schemas.frames import beside_path, read_frame
from scenec.testing.made_output import exported, make_output, small_ids, some_passes

CAMERAS = ("rover_left", "rover_right")


@pytest.fixture(scope="module")
def out(tmp_path_factory):
    out = make_output(tmp_path_factory.mktemp("sensor") / "out", small_ids, batches=1)
    add_sensor(out)
    return out


def places(out: Path) -> list[dict[str, Any]]:
    return [on_disk(out, ref.camera, ref.sample) for ref in Source(out).frames]


def test_hdf5_has_the_picture_beside_radiance_and_what_lies_beside_it(out, tmp_path):
    with h5py.File(exported(out, "hdf5", tmp_path / "d") / "all_12x8.h5") as file:
        for number, wanted in enumerate(places(out)):
            assert np.array_equal(file["rgb"][number], some_passes(number)["rgb"])
            for kind, pixels in wanted.items():
                assert np.array_equal(file[kind][number], pixels)
                assert file[kind].dtype == pixels.dtype
        assert file["raw"].dtype == np.uint16
        assert "sensor took" in file["picture"].attrs["convention"]
        assert "mosaic" in file["raw"].attrs["convention"]
    with h5py.File(exported(out, "hdf5", tmp_path / "e", rgb="srgb8") / "all_12x8.h5") as file:
        assert "picture" not in file
        assert np.array_equal(file["rgb8"][1], places(out)[1]["picture"])


def test_cameras_that_hold_different_things_have_hdf5_files_of_their_own(tmp_path):
    out = make_output(tmp_path / "out", batches=1)
    add_sensor(out, ["rover_right"], ["clean"])
    folder = exported(out, "hdf5", tmp_path / "d")
    names = sorted(path.name for path in folder.glob("*.h5"))
    assert names == ["all_rover_left_12x8.h5", "all_rover_right_12x8.h5"]
    with h5py.File(folder / names[0]) as file:
        assert "picture" not in file
    with h5py.File(folder / names[1]) as file:
        assert np.array_equal(file["clean"][1], on_disk(out, "rover_right", 1)["clean"])
        assert "raw" not in file


def test_every_pass_has_a_convention_in_hdf5(tmp_path):
    shapes = {"flow": 2, "flow_backward": 2, "scene_flow": 3}
    extra = {name: np.full((8, 12, c), np.nan, np.float32) for name, c in shapes.items()}
    extra |= {name: np.ones((8, 12), np.float32) for name in ("disparity", "depth_measured")}
    codes = ("occlusion", "occlusion_backward", "disparity_occlusion")
    extra |= {name: np.full((8, 12), 3, np.uint32) for name in codes}
    extra |= {"range": np.ones((8, 12), np.float32), "face": np.zeros((8, 12), np.uint32)}
    # The sky has none.
    extra["face"][:2] = 0xFFFFFFFF
    out = make_output(tmp_path / "out", lambda n: some_passes(n) | extra, batches=1)
    with h5py.File(exported(out, "hdf5", tmp_path / "d") / "all_12x8.h5") as file:
        for name, array in extra.items():
            assert np.array_equal(file[name][0], array, equal_nan=array.dtype.kind == "f")
            assert file[name].attrs["convention"]


def test_webdataset_has_the_pictures(out, tmp_path):
    folder = exported(out, "webdataset", tmp_path / "d")
    shards = sorted(map(str, folder.glob("*.tar")))
    found = list(webdataset.WebDataset(shards, shardshuffle=False).decode("rgb8"))
    for sample, wanted in zip(found, places(out), strict=True):
        assert np.array_equal(sample["rgb.png"], wanted["picture"])
        assert np.array_equal(sample["clean.png"], wanted["clean"])
        assert np.array_equal(sample["raw.npy"], wanted["raw"])


def test_parquet_has_the_pictures_and_null_where_a_camera_has_none(tmp_path):
    out = make_output(tmp_path / "out", batches=1)
    add_sensor(out, ["rover_left"])
    folder = exported(out, "parquet", tmp_path / "d")
    (file,) = folder.glob("data/*.parquet")
    for row, wanted in zip(pq.read_table(file).to_pylist(), places(out), strict=True):
        named = {"image": "picture", "image_clean": "clean", "image_raw": "raw"}
        for column, kind in named.items():
            if kind not in wanted:
                assert row[column] is None
                continue
            picture = np.asarray(Image.open(io.BytesIO(row[column]["bytes"])))
            assert np.array_equal(picture, wanted[kind])
            assert picture.dtype == wanted[kind].dtype
    assert "image_clean" not in pq.read_table(_plain(tmp_path)).column_names


def _plain(folder: Path) -> Path:
    out = make_output(folder / "plain", batches=1)
    (file,) = exported(out, "parquet", folder / "plain_d").glob("data/*.parquet")
    return file


def test_a_ros_bag_has_the_pictures(out, tmp_path):
    bag = exported(out, "rosbag2", tmp_path / "d", times="samples") / "all/batch_0000"
    store = get_typestore(Stores.ROS2_JAZZY)
    found: dict[str, list[Any]] = {}
    with Reader(bag) as reader:
        for connection, _, data in reader.messages():
            if connection.msgtype == "sensor_msgs/msg/Image":
                message = store.deserialize_cdr(data, connection.msgtype)
                found.setdefault(connection.topic, []).append(message)
    topics = {"image_raw": ("picture", "rgb8"), "clean/image_raw": ("clean", "rgb8"),
              "mosaic/image_raw": ("raw", "bayer_grbg16")}  # fmt: skip
    for camera in CAMERAS:
        for topic, (kind, encoding) in topics.items():
            for sample, message in enumerate(found[f"/{camera}/{topic}"]):
                wanted = on_disk(out, camera, sample)[kind]
                assert message.encoding == encoding
                pixels = np.frombuffer(message.data.tobytes(), wanted.dtype).reshape(wanted.shape)
                assert np.array_equal(pixels, wanted)


@pytest.mark.parametrize(
    ("form", "pattern"),
    [
        ("oaisys", "batch_0001/{camera}/{two:04d}{camera}_rgb_00.png"),
        ("coco", "images/all/batch_0000_{camera}_{sample:06d}.png"),
        ("panoptic", "images/all/batch_0000_{camera}_{sample:06d}.png"),
        ("cityscapes", "leftImg8bit/all/*/*_{index:06d}_{sample:06d}_leftImg8bit.png"),
        ("tum", "all/batch_0000_{camera}/rgb/{half:.6f}.png"),
        ("kitti", "sequences/0{index}/image_2/{sample:06d}.png"),
    ],
)
def test_trees_of_pictures_have_the_sensors_and_count_what_they_leave_out(
    out, tmp_path, form, pattern
):
    report = export(out, form, tmp_path / "d")
    for index, camera in enumerate(CAMERAS):
        for sample in range(2):
            names = {"camera": camera, "index": index, "sample": sample, "two": sample + 2}
            (file,) = report.folder.glob(pattern.format(half=0.5 * sample, **names))
            wanted = on_disk(out, camera, sample)["picture"]
            assert np.array_equal(np.asarray(Image.open(file)), wanted)
    told = json.loads((report.folder / "export.json").read_bytes())["left_out"]
    for kind in ("clean", "raw"):
        assert told[f"{kind} pictures beside a sensor's, which format {form} does not hold"] == 4


def test_training_samples_have_the_sensors_picture(out):
    frames = FrameDataset(out, ("rgb",), rgb="srgb", as_numpy=True)
    for number, wanted in enumerate(places(out)):
        picture = np.moveaxis(frames[number]["rgb"], 0, -1)
        assert np.array_equal(np.rint(255.0 * picture), wanted["picture"])


def test_frames_of_rgb_alone_are_shown_and_exported(tmp_path):
    rgb = np.ones((6, 8, 3), np.float32)
    out = make_output(tmp_path / "out", lambda _: {"rgb": rgb}, batches=1, cameras=("a",))
    assert write_view(out, tmp_path / "view.html", faults="stop").frames == 2
    folder = exported(out, "kitti", tmp_path / "d")
    picture = np.asarray(Image.open(folder / "sequences/00/image_2/000001.png"))
    assert np.array_equal(picture, on_disk(out, "a", 1)["picture"])


@pytest.mark.parametrize(
    ("form", "ending", "content", "said"),
    [
        ("hdf5", "raw.png", b"other", "raw.png: truncated, damaged or changed"),
        ("webdataset", "clean.png", None, "clean.png: missing, though its sidecar names it"),
        ("tum", "png", b"no picture", "png: not a picture, or a damaged one"),
        ("kitti", "png", "cut", "png: not a picture, or a damaged one"),
        ("coco", "png", "turned", "png: is 8 x 12 pixels, unlike its EXR"),
    ],
)
def test_frames_with_damaged_pictures_are_faults_that_can_be_skipped(
    tmp_path, form, ending, content, said
):
    out = make_output(tmp_path / "out", small_ids, batches=1, cameras=("a",), samples=3)
    add_sensor(out)
    path = next(out.glob(f"batch_0000/frames/*/a/000001.{ending}"))
    if content == "cut":
        whole = path.read_bytes()
        content = whole[: len(whole) // 2]
    elif content == "turned":
        content = _png(np.zeros((12, 8, 3), np.uint8))
    path.unlink()
    if content is not None:
        path.write_bytes(content)
    with pytest.raises(FrameError, match=said):
        export(out, form, tmp_path / "d")
    report = export(out, form, tmp_path / "d", Choice(faults="skip"))
    assert report.frames == 2
    assert [(fault.name, fault.kind) for fault in report.faults] == [
        ("batch_0000/a/000001", "damaged")
    ]


def _png(pixels: np.ndarray) -> bytes:
    store = io.BytesIO()
    Image.fromarray(pixels).save(store, "PNG")
    return store.getvalue()


def test_what_a_format_does_not_read_need_not_be_there(tmp_path):
    out = make_output(tmp_path / "out", small_ids, batches=1, cameras=("a",))
    add_sensor(out)
    next(out.glob("batch_0000/frames/*/a/000001.raw.png")).unlink()
    assert export(out, "tum", tmp_path / "d").frames == 2


def test_a_picture_that_is_gone_or_another_is_an_error_and_never_made_up(tmp_path):
    out = make_output(tmp_path / "out", batches=1, cameras=("a",), samples=2)
    add_sensor(out)
    source = Source(out)
    stem = source.frames[0].stem
    frame, bare = source.load(source.frames[0]), read_frame(stem)
    beside_path(stem, "clean").write_bytes(beside_path(stem, "raw").read_bytes())
    beside_path(stem, "raw").unlink()
    for seen in (frame, bare):
        with pytest.raises(FrameError, match=r"000000\.clean\.png: truncated, damaged or changed"):
            pictures.beside(seen, "clean")
        with pytest.raises(FrameError, match=r"000000\.raw\.png: missing"):
            pictures.beside(seen, "raw")
    stem.with_suffix(".png").write_bytes(b"no picture")
    with pytest.raises(FrameError, match=r"000000\.png: not a picture"):
        pictures.picture(frame)
    stem.with_suffix(".png").unlink()
    with pytest.raises(FrameError, match=r"000000\.png: missing"):
        pictures.picture(bare)
    with pytest.raises(FrameError, match="render it again"):
        source.load(source.frames[0])
