"""Streams: the commands' frames, in order, from whoever makes them, and nothing is left behind."""

from __future__ import annotations

import gc
import itertools
import os
import signal
import subprocess
import sys
import tempfile
import time
from functools import partial

import numpy as np
import psutil
import pytest

import scenec
from scenec.compiler.cfg import builder
from scenec.datasets.pictures import picture
from scenec.schemas.errors import CfgError, FrameError, ScenecError, SceneError
from scenec.testing.small import small_cfg, sparse_cfg, write_cfg


def tiny(**changes):
    cfg = small_cfg(samples=1, outputs=["rgb", "depth", "label", "instance"])
    cfg["objects"]["rocks"] |= {"count": 20, "prototypes": 1, "subdivisions": 1}
    cfg["terrain"]["spacing_m"] = 0.5
    for sensor in cfg["rigs"]["rover"]["sensors"].values():
        sensor["resolution"] = [24, 18]
    return cfg | changes


def digests(frames):
    return [(frame.name, frame.loaded.annotation_digest()) for frame in frames]


@pytest.fixture
def places(tmp_path, monkeypatch):
    """Tells what there is of this process: its descriptors, its children, its temporary files."""
    monkeypatch.setenv("TMPDIR", str(tmp_path))
    monkeypatch.setattr(tempfile, "tempdir", None)
    me = psutil.Process()

    def count():
        gc.collect()
        left = sorted(path.name for path in tmp_path.iterdir())
        return len(os.listdir("/proc/self/fd")), len(me.children(recursive=True)), left

    # What stays for good is there after the first.
    for workers in (0, 2):
        next(scenec.stream(tiny(), backend="annotation", workers=workers))
    return count


@pytest.mark.parametrize(
    ("backend", "workers", "more"),
    [
        ("annotation", 0, {}),
        ("annotation", 2, {}),
        ("pyrender", 1, {}),
        ("mitsuba", 1, {"spp": 2, "noise_seed": 3}),
    ],
)
def test_frames_are_those_of_the_command_to_the_bit(tmp_path, backend, workers, more):
    cfg, options = tiny(batches=2, samples=2), {"backend": backend, **more}
    streamed = [*scenec.stream(cfg, seeds=[5, 7], workers=workers, **options)]
    expected = []
    for seed in (5, 7):
        out = scenec.run(cfg, tmp_path / f"{seed}", seed=seed, workers=0, **options)
        expected += [(seed, view.loaded) for view in out.frames()]
    assert len(expected) >= 8
    for frame, (seed, loaded) in zip(streamed, expected, strict=True):
        assert frame.name == f"{seed}/{loaded.ref.name}"
        assert frame.passes.keys() == loaded.passes.keys()
        for name, array in loaded.passes.items():
            assert frame.passes[name].dtype == array.dtype
            assert frame.passes[name].tobytes() == array.tobytes(), name
        assert frame.record.stage_digest == loaded.sidecar.stage_digest
        assert frame.record.resume_key == loaded.sidecar.resume_key
        assert (frame.rgb is None) == (backend == "annotation")
        if frame.rgb is not None:
            assert (frame.rgb == picture(loaded)).all()
        assert (frame.depth == loaded.passes["depth"]).all()
        assert (frame.labels["class"] == loaded.passes["label.class"]).all()
        assert (frame.instances == loaded.passes["instance"]).all()
        assert all((frame.loaded.table[key] == loaded.table[key]).all() for key in loaded.table)


def test_order_and_bits_depend_on_nobody(tmp_path):
    cfg, asked = tiny(batches=2), {"seeds": [9, 1, 4], "backend": "annotation"}
    found = [digests(scenec.stream(cfg, workers=n, **asked)) for n in (0, 1, 2)]
    names = [name.split("/")[:2] for name, _ in found[0]]
    assert names == [[f"{s}", f"batch_000{b}"] for s in (9, 1, 4) for b in (0, 1)]
    assert len({digest for _, digest in found[0]}) == 6
    assert found[1] == found[0]
    assert found[2] == found[0]


def test_a_stream_goes_on_by_index():
    def numbers(**more):
        frames = scenec.stream(tiny(), backend="annotation", workers=0, **more)
        return [(frame.index, frame.seed) for frame in itertools.islice(frames, 2)]

    assert numbers(start=3) == [(3, 3), (4, 4)]
    assert numbers(seeds=range(10, 20), start=8) == [(8, 18), (9, 19)]
    assert numbers(seeds=iter([5, 6, 7]), start=1) == [(1, 6), (2, 7)]
    assert numbers(seeds=[(2, 50), (4, 70), (6, 90)], start=3) == [(4, 70), (6, 90)]
    assert numbers(seeds=np.array([3]), start=0) == [(0, 3)]


@pytest.mark.parametrize("workers", [0, 2])
def test_leaving_a_stream_leaves_nothing(places, workers):
    before = places()
    frames = scenec.stream(tiny(), backend="annotation", workers=workers)
    assert places() == before
    for _ in frames:
        _, children, left = places()
        assert len(left) == 1 + len(before[2])
        assert children == workers + before[1]
        break
    del frames
    assert places() == before


@pytest.mark.parametrize("workers", [0, 2])
def test_an_error_of_who_takes_frames_leaves_nothing(places, workers):
    before = places()

    def train():
        for frame in scenec.stream(tiny(), backend="annotation", workers=workers):
            raise ZeroDivisionError(frame.name)

    with pytest.raises(ZeroDivisionError, match="0/batch_0000"):
        train()
    assert places() == before


sparse = partial(sparse_cfg, batches=4, samples=1, outputs=["depth"])


@pytest.mark.parametrize("workers", [0, 1])
def test_a_scene_that_cannot_be_built_comes_after_those_before_it(places, workers):
    before, found = places(), []
    with pytest.raises(SceneError, match=r"^scene 0 \(seed 1, batch 2\): "):
        found += scenec.stream(sparse(), seeds=[1], backend="annotation", workers=workers)
    assert places() == before
    frames = scenec.stream(sparse(), seeds=[1, 1], backend="annotation", workers=workers)
    assert [next(frames).loaded.ref.batch for _ in range(2)] == [0, 1]
    with pytest.raises(SceneError):
        next(frames)
    assert places() == before


def test_a_scene_that_cannot_be_built_is_passed_over_or_drawn_again(tmp_path):
    asked = {"backend": "annotation", "workers": 0}
    found = scenec.stream(sparse(), seeds=[1], faults="skip", **asked)
    assert [frame.loaded.ref.batch for frame in found] == [0, 1]
    found = scenec.stream(sparse(), seeds=[1], faults="redraw", **asked)
    out = scenec.run(sparse(), tmp_path / "run", seed=1, faults="redraw", **asked)
    digests_of_run = [view.loaded.annotation_digest() for view in out.frames()]
    assert [digest for _, digest in digests(found)] == digests_of_run
    assert len(digests_of_run) == 4


def test_a_killed_worker_costs_no_frame():
    asked = {"seeds": range(4), "backend": "annotation"}
    frames = scenec.stream(tiny(), workers=1, **asked)
    found = [next(frames)]
    for child in psutil.Process().children():
        child.kill()
    found += frames
    assert digests(found) == digests(scenec.stream(tiny(), workers=0, **asked))


PROGRAM = """
import sys
import scenec
if __name__ == "__main__":
    for frame in scenec.stream(sys.argv[1], backend="annotation", workers=int(sys.argv[2])):
        print(frame.name, flush=True)
        if len(sys.argv) > 3:
            raise ZeroDivisionError
"""


@pytest.mark.parametrize("workers", ["0", "2"])
@pytest.mark.parametrize("interrupted", [True, False])
def test_a_program_that_ends_amid_a_stream_leaves_nothing(tmp_path, workers, interrupted):
    scratch = tmp_path / "scratch"
    scratch.mkdir()
    words = [sys.executable, "-c", PROGRAM, str(write_cfg(tmp_path, tiny())), workers]
    with subprocess.Popen(
        [*words, *([] if interrupted else ["raise"])],
        env=os.environ | {"TMPDIR": str(scratch)},
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
    ) as process:
        assert process.stdout is not None
        assert process.stdout.readline().startswith("0/batch_0000")
        children = psutil.Process(process.pid).children(recursive=True)
        if interrupted:
            process.send_signal(signal.SIGINT)
        _, said = process.communicate()
    assert ("KeyboardInterrupt" if interrupted else "ZeroDivisionError") in said
    assert "Exception ignored" not in said
    assert [path.name for path in scratch.iterdir()] == []
    _, alive = psutil.wait_procs(children)
    assert alive == []


def test_what_is_kept_is_the_commands_output_and_made_once(tmp_path):
    cfg, out = tiny(batches=2), tmp_path / "kept"
    asked = {"seeds": [3, 4], "backend": "annotation", "out": out, "workers": 0}
    first = digests(scenec.stream(cfg, **asked))
    scenec.run(cfg, tmp_path / "run", seed=4, backend="annotation", workers=0)
    ours = sorted(out.glob("seed=4/batch_*/frames/*/*/*.exr"))
    theirs = sorted((tmp_path / "run").glob("batch_*/frames/*/*/*.exr"))
    assert len(ours) == 2
    assert [path.read_bytes() for path in ours] == [path.read_bytes() for path in theirs]
    assert (out / "seed=4/manifest.json").read_bytes() == (
        tmp_path / "run/manifest.json"
    ).read_bytes()
    times = [path.stat().st_mtime_ns for path in ours]
    time.sleep(0.01)
    assert digests(scenec.stream(cfg, **asked)) == first
    assert [path.stat().st_mtime_ns for path in ours] == times


def test_rgb_is_a_picture_unless_radiance_is_asked_for():
    def rgb(form=None):
        asked = {} if form is None else {"color": form}
        return next(scenec.stream(tiny(), workers=0, backend="pyrender", **asked)).rgb

    eight, unit, radiance = rgb(), rgb("srgb"), rgb("radiance")
    assert (eight.dtype, unit.dtype, radiance.dtype) == (np.uint8, np.float32, np.float32)
    assert eight.shape == unit.shape == radiance.shape == (18, 24, 3)
    assert (np.round(unit * 255) == eight).all()
    assert radiance.max() > 1.0 >= unit.max() > 0.0


def test_faults_name_the_argument():
    cfg = tiny()
    cfg["objects"]["rocks"]["count"] = "many"
    with pytest.raises(CfgError, match=r"(?m)^cfg: /objects/rocks/count: "):
        scenec.stream(cfg)
    for options, words in (
        ({"color": "linear"}, "color: 'linear': expected one of srgb8, srgb, radiance"),
        ({"start": -1}, "start: '-1': expected a whole number"),
        ({"passes": "dept"}, 'passes: no pass "dept"'),
        ({"workers": "two"}, "workers: 'two': expected a whole number"),
        ({"seeds": 5}, "seeds: 5: expected"),
    ):
        with pytest.raises(ScenecError, match=f"^{words}"):
            scenec.stream(tiny(), **options)
    for seeds in ([-1], [1.5], [True], [(0, -1)]):
        with pytest.raises(ScenecError, match=r"^seeds: '.*': expected a whole number from 0 to"):
            next(scenec.stream(tiny(), seeds=seeds, backend="annotation", workers=0))


def test_a_pass_that_is_not_there_is_said():
    frame = next(scenec.stream(tiny(), backend="annotation", passes="depth", workers=0))
    assert frame.labels == {}
    with pytest.raises(FrameError, match=r"has no instance, but depth; ask for it: passes="):
        _ = frame.instances


def test_arrays_are_taken_as_colors_and_lists():
    def digest(cfg):
        return next(scenec.stream(cfg, backend="annotation", workers=0)).record.stage_digest

    cfg, color = tiny(), [0.25, 0.5, 0.125]
    cfg["materials"]["sand"]["base_color"] = color
    plain = digest(cfg)
    cfg["materials"]["sand"]["base_color"] = np.array(color)
    cfg["terrain"]["size_m"] = np.array([20, 16])
    cfg["objects"]["rocks"]["count"] = np.int64(20)
    assert digest(cfg) == plain
    parts = builder.Cfg(**{key: value for key, value in cfg.items() if key != "version"})
    assert digest(parts) == plain
