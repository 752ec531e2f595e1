"""Frames on disk are what was in memory, bit for bit, or an error that names the file."""

from __future__ import annotations

import dataclasses
import json
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray

from scenec.backends.run.facts import FrameResult, describe_frame
from scenec.backends.run.writer import write_frame
from scenec.backends.testing import scenes as ms
from scenec.schemas.errors import FrameError
from scenec.schemas.exr import read_exr, write_exr
from scenec.schemas.frames import FrameKey, frame_stem, is_done, read_frame
from scenec.schemas.records import ErrorEstimate, RendererFacts

H, W = 24, 32
KEY = FrameKey("d" * 64, ("rgb", "label.class", "instance", "depth"), 64, 0, "mitsuba", "m 1")


def arrays() -> dict[str, NDArray]:
    rng = np.random.default_rng(0)
    depth = rng.uniform(0.1, 1e4, (H, W))
    depth[:5] = np.inf
    position = rng.normal(size=(H, W, 3))
    position[:5] = np.nan
    ids = rng.integers(0, 2**32, (H, W), dtype=np.uint32)
    ids[0, :4] = [0, 2**24 + 1, 2**31, 2**32 - 1]
    return {
        "rgb": rng.uniform(0, 1e4, (H, W, 3)).astype(np.float32),
        "label.class": ids,
        "instance": ids[::-1].copy(),
        "depth": depth,
        "range": depth * 1.5,
        "normal": rng.normal(size=(H, W, 3)),
        "position": position,
        "face": ids.T.reshape(H, W).copy(),
    }


def written(tmp_path: Path, error: ErrorEstimate | None = None) -> Path:
    camera = ms.look_at((0, 0, 1), (5, 0, 0), W, H)
    scene = ms.scene([ms.mesh(*ms.plane())], cameras=[camera])
    stem = frame_stem(tmp_path, "mitsuba", "rig_cam", 3)
    wanted = {name: arrays()[name] for name in KEY.passes}
    renderer = RendererFacts("mitsuba", "m 1", "cpu", None, None)
    record = dataclasses.replace(describe_frame(scene, camera, 0, renderer), estimated_error=error)
    write_frame(stem, FrameResult(wanted, record), KEY, scene, camera)
    return stem


def test_every_pass_comes_back_bit_for_bit(tmp_path: Path):
    path = tmp_path / "f.exr"
    write_exr(path, arrays())
    back = read_exr(path)
    assert list(back) == list(arrays())
    for name, array in arrays().items():
        expected = array if array.dtype == np.uint32 else array.astype(np.float32)
        assert back[name].dtype == expected.dtype
        assert back[name].tobytes() == expected.tobytes()


def test_channels_have_the_names_of_the_convention(tmp_path: Path):
    import OpenEXR

    write_exr(tmp_path / "f.exr", arrays())
    file = OpenEXR.File(str(tmp_path / "f.exr"), separate_channels=True)
    channels = {part.name(): set(part.channels) for part in file.parts}
    assert channels["rgb"] == {"R", "G", "B"}
    assert channels["depth"] == {"Z"}
    assert channels["label.class"] == {"label.class.id"}
    assert channels["instance"] == {"instance.id"}
    assert channels["range"] == {"range.Z"}


def test_a_frame_cut_short_anywhere_is_refused_by_name(tmp_path: Path):
    path = tmp_path / "f.exr"
    write_exr(path, arrays())
    whole = path.read_bytes()
    for length in [0, 3, 40, *range(100, len(whole), 1499), len(whole) - 1]:
        path.write_bytes(whole[:length])
        with pytest.raises(FrameError, match=r"f\.exr"):
            read_exr(path)


def test_a_foreign_exr_and_a_missing_one_are_refused(tmp_path: Path):
    import OpenEXR

    header = {"type": OpenEXR.scanlineimage, "compression": OpenEXR.ZIP_COMPRESSION}
    part = OpenEXR.Part(header, {"Q": np.ones((2, 2), np.float32)}, name="beauty")
    OpenEXR.File([part]).write(str(tmp_path / "foreign.exr"))
    with pytest.raises(FrameError, match="not a frame of scenec"):
        read_exr(tmp_path / "foreign.exr")
    with pytest.raises(FrameError, match="no such frame"):
        read_exr(tmp_path / "none.exr")
    with pytest.raises(FrameError, match="unknown pass"):
        write_exr(tmp_path / "f.exr", {"beauty": np.ones((2, 2))})


def test_one_flipped_bit_anywhere_is_seen(tmp_path: Path):
    # OpenEXR has no checksum and returns altered pixels in silence; the sidecar has one.
    stem = written(tmp_path)
    exr = stem.with_suffix(".exr")
    whole = exr.read_bytes()
    for position in np.random.default_rng(1).integers(0, len(whole), 25):
        broken = bytearray(whole)
        broken[position] ^= 1
        exr.write_bytes(broken)
        with pytest.raises(FrameError, match="checksum"):
            read_frame(stem)


def test_a_frame_is_found_by_any_of_its_files(tmp_path: Path):
    stem = written(tmp_path)
    for path in (stem, *(stem.with_suffix(s) for s in (".exr", ".json", ".png"))):
        frame = read_frame(path, ["depth"])
        assert set(frame.passes) == set(KEY.passes)
    with pytest.raises(FrameError, match=r"has no normal .*--passes"):
        read_frame(stem, ["normal"])


def test_the_sidecar_says_what_a_user_needs_in_strict_json(tmp_path: Path):
    stem = written(tmp_path, ErrorEstimate(float("inf")))

    def refuse(name: str) -> None:
        raise AssertionError(f"{name} is not JSON")

    sidecar = json.loads(stem.with_suffix(".json").read_text(), parse_constant=refuse)
    camera = ms.look_at((0, 0, 1), (5, 0, 0), W, H)
    np.testing.assert_array_equal(sidecar["intrinsics"], camera.intrinsics)
    np.testing.assert_array_equal(sidecar["camera_to_world"], camera.camera_to_world)
    assert sidecar["resolution"] == [W, H]
    assert sidecar["labels"] == {"class": {"1": "sky", "2": "ground"}}
    assert (sidecar["backend"], sidecar["spp"], sidecar["noise_seed"]) == ("mitsuba", 64, 0)
    assert sidecar["stage_digest"] == KEY.stage_digest
    assert sidecar["resume_key"] == KEY.digest()
    assert sidecar["estimated_error"]["relative_rms"] is None
    assert not any(str(tmp_path) in str(value) for value in sidecar.values())


@pytest.mark.parametrize(
    ("field", "value"),
    [
        ("stage_digest", "e" * 64),
        ("passes", (*KEY.passes, "position")),
        ("spp", 65),
        ("noise_seed", 1),
        ("backend", "reference"),
        ("backend_version", "m 2"),
        ("denoise", True),
        ("half", True),
    ],
)
def test_a_frame_is_done_only_for_the_very_key_it_was_made_with(tmp_path: Path, field, value):
    stem = written(tmp_path)
    assert is_done(stem, KEY)
    assert not is_done(stem, dataclasses.replace(KEY, **{field: value}))


@pytest.mark.parametrize("suffix", [".exr", ".json", ".png"])
def test_a_frame_with_a_file_missing_or_cut_is_not_done(tmp_path: Path, suffix):
    stem = written(tmp_path)
    path = stem.with_suffix(suffix)
    if suffix != ".png":
        path.write_bytes(path.read_bytes()[:-5])
        assert not is_done(stem, KEY)
    path.unlink()
    assert not is_done(stem, KEY)
