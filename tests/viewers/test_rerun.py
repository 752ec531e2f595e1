"""Recordings for Rerun, checked by Rerun's own tool; skipped without the extra ``rerun``."""

from __future__ import annotations

import io
import re
import subprocess
import sys

import numpy as np
import pytest
from PIL import Image
from sensor_frames import add_sensor, on_disk

from scenec.datasets.recording import log_frames
from scenec.schemas.errors import FrameError, OutputError
from scenec.testing import made_output

pytestmark = pytest.mark.slow


def tool(*words: str) -> str:
    """What ``rerun rrd ...`` prints."""
    command = [sys.executable, "-m", "rerun", "rrd", *words]
    done = subprocess.run(command, capture_output=True, text=True, check=True)
    return done.stdout + done.stderr


def test_a_recording_holds_every_pass_of_every_camera(tmp_path):
    pytest.importorskip("rerun")
    out = made_output.make_output(tmp_path / "out")
    report = log_frames(out, save=tmp_path / "all.rrd")
    assert report.frames == 8
    assert "1 file verified without error" in tool("verify", str(tmp_path / "all.rrd"))
    told = tool("print", str(tmp_path / "all.rrd"))
    entities = set(re.findall(r"/batch_\d+/[\w/]+", told))
    for batch in ("batch_0000", "batch_0001"):
        for camera in ("rover_left", "rover_right"):
            base = f"/{batch}/{camera}"
            parts = ("", "/rgb", "/depth", "/label/class", "/label/surface", "/instance",
                     "/instance/boxes")  # fmt: skip
            assert {f"{base}{part}" for part in parts} <= entities


def test_the_pictures_are_the_sensors_to_the_bit(tmp_path):
    pytest.importorskip("rerun")
    from rerun.chunk import RrdReader

    out = made_output.make_output(tmp_path / "out", batches=1)
    add_sensor(out)
    log_frames(out, save=tmp_path / "all.rrd")
    found: dict[tuple[str, int], bytes] = {}
    for chunk in RrdReader(tmp_path / "all.rrd").stream():
        columns = chunk.to_record_batch().to_pydict()
        blobs = next((columns[c] for c in columns if c.endswith((":blob", "Image:buffer"))), ())
        for row, blob in enumerate(blobs):
            (content,) = blob
            found[chunk.entity_path, columns["sample"][row]] = bytes(content)
    for camera in ("rover_left", "rover_right"):
        for sample in range(2):
            wanted = on_disk(out, camera, sample)
            base = f"/batch_0000/{camera}"
            for name, kind in (("rgb", "picture"), ("clean", "clean")):
                picture = Image.open(io.BytesIO(found[f"{base}/{name}", sample]))
                assert np.array_equal(np.asarray(picture), wanted[kind])
            raw = np.frombuffer(found[f"{base}/raw", sample], np.uint16)
            assert np.array_equal(raw.reshape(wanted["raw"].shape), wanted["raw"])


def test_labels_beyond_16_bits_and_faulty_frames_are_errors(tmp_path):
    pytest.importorskip("rerun")
    labels = {"class": {1: "sky", 2: "ground", 70_000: "rock"}, "surface": {}}
    out = made_output.make_output(tmp_path / "large", labels=labels)
    with pytest.raises(OutputError, match="label id 70000: Rerun's class ids have 16 bits"):
        log_frames(out, save=tmp_path / "large.rrd")
    assert not (tmp_path / "large.rrd").exists()
    out = made_output.make_output(tmp_path / "out", batches=1)
    broken = out / "batch_0000" / "frames" / "annotation" / "rover_left" / "000001.exr"
    broken.write_bytes(b"")
    told: list[str] = []
    report = log_frames(out, save=tmp_path / "some.rrd", warn=told.append)
    assert (report.frames, report.faults, len(told)) == (3, 1, 1)
    with pytest.raises(FrameError, match="000001"):
        log_frames(out, save=tmp_path / "none.rrd", faults="stop")
    assert not (tmp_path / "none.rrd").exists()
    for path in out.rglob("*.exr"):
        path.write_bytes(b"")
    with pytest.raises(FrameError, match=r"not one of 4 frames can be read; the first: .*000000"):
        log_frames(out, save=tmp_path / "none.rrd")
    assert not (tmp_path / "none.rrd").exists()


def test_without_rerun_one_line_says_what_to_install(tmp_path, monkeypatch):
    monkeypatch.setitem(sys.modules, "rerun", None)
    out = made_output.make_output(tmp_path / "out")
    with pytest.raises(OutputError, match=r"pip install 'scenec\[rerun\]'"):
        log_frames(out, save=tmp_path / "all.rrd")
