"""The page of ``scenec view``: what is in it, how large it gets, what it does about faults."""

from __future__ import annotations

import base64
import io
import json
import math
import re
import shutil
import subprocess
import tracemalloc
import zlib
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra import numpy as arrays
from PIL import Image

from scenec.backends.run.executors import make_executor
from scenec.datasets.view import layers as stored
from scenec.datasets.view.fitting import steps
from scenec.datasets.view.ground import Ground, ground_text
from scenec.datasets.view.layers import Fineness, taken
from scenec.datasets.view.page import write_view
from scenec.schemas.errors import FrameError, OutputError
from scenec.schemas.frames import frame_stem, read_frame
from scenec.schemas.picture import develop
from scenec.testing import made_output
from scenec.testing.examples import examples
from scenec.testing.processes import output_of

ELEMENT = re.compile(rb'<template id="(\w+)">(.*?)</template>', re.DOTALL)


def elements(page: Path) -> dict[str, bytes]:
    return {name.decode(): text for name, text in ELEMENT.findall(page.read_bytes())}


def index_of(page: Path) -> dict:
    return json.loads(elements(page)["index"])


def rows_of(page: Path) -> list[dict]:
    index = index_of(page)
    return [dict(zip(index["columns"], row, strict=True)) for row in index["frames"]]


def unpacked(text: bytes) -> tuple[dict, dict[str, bytes]]:
    """A frame's element: its facts, and the bytes of each layer."""
    head, *lines = text.split(b"\n")
    facts = json.loads(head)
    names = [layer["name"] for layer in facts["layers"]]
    return facts, dict(zip(names, map(base64.b64decode, lines), strict=True))


def read_ids(data: bytes, facts: dict, shape: tuple[int, int]) -> np.ndarray:
    raw = zlib.decompress(data)
    ids = np.frombuffer(raw[: 4 * facts["count"]], "<u4")
    return ids[np.frombuffer(raw[4 * facts["count"] :], f"<u{facts['bytes']}")].reshape(shape)


def read_steps(data: bytes, facts: dict, shape: tuple[int, int]) -> np.ndarray:
    """Written out pixel by pixel from the module's docstring, as a browser does it."""
    raw = zlib.decompress(data)
    height, width = shape
    codes = np.zeros((height + 1, width + 1), int)
    for i in range(height * width):
        y, x = divmod(i, width)
        folded = raw[i] + 256 * raw[height * width + i]
        rest = folded // 2 if folded % 2 == 0 else -(folded + 1) // 2
        plane = codes[y + 1, x] + codes[y, x + 1] - codes[y, x]
        codes[y + 1, x + 1] = (rest + plane) % 65536
    values = np.empty(shape)
    near, far, top = facts["near"], facts["far"], facts["top"]
    for place in np.ndindex(shape):
        code = codes[place[0] + 1, place[1] + 1]
        part = (code - 1) / (top - 2)
        value = near + part * (far - near) if facts.get("even") else near * (far / near) ** part
        values[place] = math.inf if code == 0 else math.nan if code == top else value
    return values


def test_ids_come_back_exactly_and_depth_within_the_stated_error(output, tmp_path):
    write_view(output, tmp_path / "view.html")
    texts, index = elements(tmp_path / "view.html"), index_of(tmp_path / "view.html")
    for number, row in enumerate(rows_of(tmp_path / "view.html")):
        _, batch, camera, sample = row["at"]
        frame = read_frame(
            frame_stem(
                output / index["batches"][batch], "annotation", index["cameras"][camera], sample
            )
        )
        facts, data = unpacked(texts[f"f{number}"])
        of = {layer["name"]: layer for layer in facts["layers"]}
        shape = frame.passes["depth"].shape
        for name in ("label.class", "label.surface", "instance"):
            assert (read_ids(data[name], of[name], shape) == frame.passes[name]).all()
        depth, hit = frame.passes["depth"].astype(float), np.isfinite(frame.passes["depth"])
        found = read_steps(data["depth"], of["depth"], shape)
        assert (np.isinf(found) == ~hit).all()
        worst = np.abs(found[hit] / depth[hit] - 1).max()
        assert worst <= index["stored"]["depth_error"]
        assert index["stored"]["depth_error"] < 1e-4
        assert facts["K"] == np.ravel(frame.sidecar.intrinsics)[:6].tolist()
        assert np.allclose(facts["pose"], np.ravel(frame.sidecar.camera_to_world)[:12])


def test_the_picture_is_the_developed_one_to_jpegs_error(tmp_path):
    smooth = np.linspace(0.1, 1.5, 64 * 48 * 3).reshape(48, 64, 3).astype(np.float32)
    out = made_output.make_output(
        tmp_path / "out", lambda _: {"rgb": smooth}, batches=1, cameras=("a",), samples=1
    )
    write_view(out, tmp_path / "view.html")
    _, data = unpacked(elements(tmp_path / "view.html")["f0"])
    picture = np.asarray(Image.open(io.BytesIO(data["rgb"]))).astype(int)
    difference = picture - develop(smooth, made_output.EXPOSURE_EV)
    assert np.abs(difference).max() <= 6


@examples(60)
@given(
    arrays.arrays(
        np.float32,
        arrays.array_shapes(min_dims=2, max_dims=2, max_side=9),
        elements=st.one_of(
            st.floats(2**-10, 2**20, width=32), st.just(math.inf), st.just(math.nan)
        ),
    ),
    st.sampled_from([12, 16]),
)
def test_any_depth_comes_back_within_its_stated_error(depth, bits):
    layer = stored.store_depth("depth", depth, bits)
    found = read_steps(layer.data, layer.facts, depth.shape)
    assert (np.isnan(found) == np.isnan(depth)).all()
    assert (np.isposinf(found) == np.isposinf(depth)).all()
    hit = np.isfinite(depth)
    bound = stored.depth_error(layer.facts) * (1 + 1e-6) + 1e-12
    assert (np.abs(found[hit] / depth[hit].astype(float) - 1) <= bound).all()


@examples(60)
@given(
    arrays.arrays(
        np.uint32,
        arrays.array_shapes(min_dims=2, max_dims=2, max_side=20),
        elements=st.one_of(st.integers(0, 3), st.integers(0, 2**32 - 1)),
    )
)
def test_any_ids_come_back(ids):
    layer, found = stored.store_ids("instance", ids)
    assert (read_ids(layer.data, layer.facts, ids.shape) == ids).all()
    assert (found == np.unique(ids)).all()


def test_more_ids_than_a_byte_or_two_can_tell_come_back():
    for count in (256, 257, 65536, 65537):
        ids = (np.arange(count, dtype=np.uint32) * 3)[None]
        layer, _ = stored.store_ids("instance", ids)
        assert (read_ids(layer.data, layer.facts, ids.shape) == ids).all()


def test_normals_are_off_by_less_than_stated():
    rng = np.random.default_rng(1)
    normal = rng.normal(size=(200, 300, 3))
    normal[0, :6] = [[1, 0, 0], [-1, 0, 0], [0, 1, 0], [0, -1, 0], [0, 0, 1], [0, 0, -1]]
    normal /= np.linalg.norm(normal, axis=2, keepdims=True)
    normal[1, 0] = 0.0
    raw = np.frombuffer(zlib.decompress(stored.store_normal(normal).data), np.uint8)
    codes = np.cumsum(raw.reshape(2, 200, 300), axis=2, dtype=np.uint8).astype(float)
    none = (codes == 0).all(axis=0)
    assert none[1, 0]
    assert none.sum() == 1
    x, y = (codes - 1) / 127 - 1
    z = 1 - np.abs(x) - np.abs(y)
    fold = np.maximum(-z, 0)
    x, y = x - np.where(x >= 0, fold, -fold), y - np.where(y >= 0, fold, -fold)
    found = np.stack([x, y, z], axis=2)
    found /= np.linalg.norm(found, axis=2, keepdims=True)
    angle = np.degrees(np.arccos(np.clip((found * normal).sum(axis=2), -1, 1)))[~none]
    assert angle.max() < stored.NORMAL_ERROR_DEG
    assert angle.max() > 0.5 * stored.NORMAL_ERROR_DEG


def test_a_reduced_picture_holds_pixels_of_the_frame_and_blends_none():
    for full, kept in ((640, 320), (641, 100), (7, 7), (5, 1)):
        places = taken(full, kept)
        assert (np.diff(places) >= 1).all()
        assert places[0] >= 0
        assert places[-1] < full
        centers = (np.arange(kept) + 0.5) * full / kept
        assert np.abs(places + 0.5 - centers).max() <= 0.5
    ids = np.arange(30 * 40, dtype=np.uint32).reshape(30, 40)
    small = stored.thinned(ids, (13, 10))
    assert small.shape == (10, 13)
    assert np.isin(small, ids).all()


def noisy(width: int, height: int):
    def passes(number: int):
        return made_output.some_passes(number, width, height)

    return passes


def test_the_page_keeps_its_budget_and_says_what_it_cost(tmp_path):
    out = made_output.make_output(tmp_path / "out", noisy(160, 120), samples=3)
    full = write_view(out, tmp_path / "full.html")
    assert full.reduced == 0
    sizes = []
    for budget in (0.6, 0.3):
        report = write_view(out, tmp_path / "view.html", budget_mb=budget)
        assert report.bytes == (tmp_path / "view.html").stat().st_size <= budget * 1e6
        stated = index_of(tmp_path / "view.html")["stored"]
        assert stated["side"] == report.fineness.side
        assert stated["reduced"] == report.reduced
        sizes.append(report.fineness.side or 160)
    assert sizes == sorted(sizes, reverse=True)
    assert sizes[-1] < 160
    with pytest.raises(OutputError, match=r"--budget-mb 0\.15: too small .* give 1 or more"):
        write_view(out, tmp_path / "view.html", budget_mb=0.15)


def test_a_picture_that_is_wider_than_a_jpeg_may_be_is_stored_thinner():
    size = Fineness().size(70_000, 2)
    assert size == Fineness(side=80_000).size(70_000, 2) == (65_500, 1)
    assert Fineness().size(3, 65_500) == (3, 65_500)
    layer = stored.store_picture("rgb", np.full((2, 70_000, 3), 80, np.uint8), size, 88)
    with Image.open(io.BytesIO(layer.data)) as image:
        assert image.size == size
        assert abs(int(np.asarray(image)[0, -1, 0]) - 80) < 3


def script(name: str) -> str:
    return (Path(stored.__file__).parent / f"browser/{name}.js").read_text(encoding="utf-8")


def test_what_there_may_be_as_many_of_as_frames_is_no_list_of_arguments():
    lists = r"Math\.(max|min)\([^;]*\.\.\.(frames|values|xs|ys|path|list)\b"
    for path in sorted((Path(stored.__file__).parent / "browser").glob("*.js")):
        assert not re.search(lists, script(path.stem)), path.name


@pytest.mark.skipif(shutil.which("node") is None, reason="no node")
def test_extremes_of_more_numbers_than_a_function_takes_are_found():
    lines = re.findall(r"^const (?:highest|lowest) = .*$", script("base"), re.M)
    many = "const many = Array.from({ length: 200000 }, (_, i) => (i * 7919) % 200009);"
    code = [*lines, many, "console.log(highest(many), lowest(many), highest([], 1));"]
    told = subprocess.run(["node", "-e", "\n".join(code)], capture_output=True, check=True)
    many = [i * 7919 % 200_009 for i in range(200_000)]
    assert told.stdout.split() == [b"%d" % max(many), b"0", b"1"]


def test_finer_steps_come_before_coarser_ones():
    found = steps(640)
    assert found[0] == Fineness()
    sides = [fineness.side or 640 for fineness in found]
    assert sides == sorted(sides, reverse=True)
    assert min(sides) >= 48
    assert [f.depth_bits for f in found] == [16, 12] * (len(found) // 2)


def test_the_same_output_gives_the_same_bytes_whatever_the_number_of_processes(tmp_path):
    out = made_output.make_output(tmp_path / "out", samples=3)
    pages = []
    for number, workers in enumerate((0, 0, 2)):
        with make_executor(workers) as executor:
            write_view(out, tmp_path / f"{number}.html", executor=executor)
        pages.append((tmp_path / f"{number}.html").read_bytes())
    assert pages[0] == pages[1] == pages[2]
    assert str(tmp_path).encode() not in pages[0]


def test_the_page_asks_for_nothing_from_elsewhere(output, tmp_path):
    write_view(output, tmp_path / "view.html")
    page = (tmp_path / "view.html").read_text(encoding="utf-8")
    assert "default-src 'none'" in page
    addresses = set(re.findall(r"\w+://[^\"' )]+", page))
    assert addresses <= {"http://www.w3.org/2000/svg"}
    assert not re.search(r"<(link|img|iframe|script)[^>]+(src|href)=\"(?!data:)", page)
    assert "%TITLE%" not in page
    assert "/* script */" not in page


def test_names_cannot_break_out_of_the_page(tmp_path):
    evil = "</template><script>alert(1)</script>&lt;"
    labels = {"class": {1: evil, 2: "<b>&", 3: "石"}, "surface": made_output.LABELS["surface"]}
    out = made_output.make_output(tmp_path / "a <b> & c", labels=labels)
    write_view(out, tmp_path / "view.html")
    page = (tmp_path / "view.html").read_bytes()
    assert b"alert(1)" in page
    assert evil.encode() not in page
    assert b"<title>a &lt;b&gt; &amp; c" in page
    (level,) = [e for e in index_of(tmp_path / "view.html")["levels"] if e["name"] == "class"]
    assert [name for _, name, _ in level["classes"]] == ["no label", evil, "<b>&", "石"]


def test_faulty_frames_are_named_and_never_shown(tmp_path):
    out = made_output.make_output(tmp_path / "out", batches=1, cameras=("front",), samples=5)
    folder = out / "batch_0000" / "frames" / "annotation" / "front"
    damaged = folder / "000001.exr"
    damaged.write_bytes(damaged.read_bytes()[:-20])
    (folder / "000002.json").write_text("{", encoding="utf-8")
    made_output.edit(folder / "000003.json", stage_digest="0" * 64)
    (folder / "000004.json").unlink()
    told: list[str] = []
    report = write_view(out, tmp_path / "view.html", warn=told.append)
    assert report.frames == 1
    assert [kind for _, kind, _ in report.faults] == ["damaged", "damaged", "foreign"]
    assert report.missing == 1
    assert len(told) == 3
    assert [name in line for name, line in zip(("000001", "000002", "000003"), told, strict=True)]
    rows = rows_of(tmp_path / "view.html")
    assert [row["fault"][0] if row["fault"] else None for row in rows] == [
        None, "damaged", "damaged", "foreign",
    ]  # fmt: skip
    assert not any(str(tmp_path) in row["fault"][1] for row in rows[1:])
    assert set(elements(tmp_path / "view.html")) == {"f0", "index"}
    assert index_of(tmp_path / "view.html")["missing"] == ["annotation: batch_0000/front/000004"]
    with pytest.raises(FrameError, match="000001"):
        write_view(out, tmp_path / "other.html", faults="stop")
    assert not (tmp_path / "other.html").exists()


def test_a_page_of_nothing_but_damaged_frames_is_none(tmp_path, capsys):
    out = made_output.make_output(tmp_path / "out", batches=1, cameras=("front",), samples=2)
    for path in out.glob("batch_*/frames/*/*/*.exr"):
        path.write_bytes(path.read_bytes()[:-20])
    with pytest.raises(FrameError, match=r"not one of 2 frames can be read; the first: .*000000"):
        write_view(out, tmp_path / "view.html")
    assert not (tmp_path / "view.html").exists()
    for command in (["view"], ["export", "--format", "webdataset", "--faults", "skip"], ["sheet"]):
        assert "000000" in output_of(capsys, [*command, str(out)], 2).err
    assert not [*out.glob("*.html"), *out.glob("*.png")]


def test_an_output_without_frames_says_what_to_do(tmp_path):
    out = made_output.make_output(tmp_path / "out")
    for folder in out.glob("batch_*/frames"):
        shutil.rmtree(folder)
    with pytest.raises(FrameError, match="render first"):
        write_view(out, tmp_path / "view.html")
    with pytest.raises(OutputError, match="manifest"):
        write_view(tmp_path, tmp_path / "view.html")


def test_all_backends_are_shown_and_one_can_be_asked_for(tmp_path):
    out = made_output.make_output(tmp_path / "out", batches=1)
    frames = out / "batch_0000" / "frames"
    shutil.copytree(frames / "annotation", frames / "another")
    assert write_view(out, tmp_path / "view.html").frames == 8
    assert index_of(tmp_path / "view.html")["backends"] == ["another", "annotation"]
    assert write_view(out, tmp_path / "view.html", backends=["another"]).frames == 4


def test_frames_of_one_pixel_without_instances_or_hits_are_shown(tmp_path):
    kinds = [
        {"depth": np.array([[np.inf]], np.float32)},
        {"depth": np.array([[2.5]], np.float32)},
        {"label.class": np.array([[0]], np.uint32), "instance": np.zeros((1, 1), np.uint32)},
        {"normal": np.zeros((1, 1, 3), np.float32), "instance": np.array([[2**32 - 1]], np.uint32)},
    ]
    out = made_output.make_output(
        tmp_path / "out", kinds.__getitem__, batches=1, cameras=("a",), samples=4
    )
    assert write_view(out, tmp_path / "view.html").frames == 4
    texts = elements(tmp_path / "view.html")
    facts, data = unpacked(texts["f1"])
    assert read_steps(data["depth"], facts["layers"][0], (1, 1))[0, 0] == pytest.approx(2.5)
    facts, data = unpacked(texts["f0"])
    assert np.isinf(read_steps(data["depth"], facts["layers"][0], (1, 1))[0, 0])
    facts, data = unpacked(texts["f3"])
    layer = facts["layers"][[e["name"] for e in facts["layers"]].index("instance")]
    assert read_ids(data["instance"], layer, (1, 1))[0, 0] == 2**32 - 1


def test_statistics_count_all_pixels_and_instances_of_the_frames(tmp_path):
    out = made_output.make_output(tmp_path / "out", noisy(48, 36))
    write_view(out, tmp_path / "view.html")
    wanted: dict[int, int] = {}
    instances = 0
    for path in sorted(out.glob("batch_*/frames/*/*/*.exr")):
        passes = read_frame(path).passes
        for number in np.unique(passes["label.class"]).tolist():
            found = int((passes["label.class"] == number).sum())
            wanted[number] = wanted.get(number, 0) + found
        instances += len(np.unique(passes["instance"][passes["instance"] > 0]))
    got: dict[int, int] = {}
    seen = 0
    for *_, tally in index_of(tmp_path / "view.html")["tallies"]:
        for number, count in tally["pixels"]["class"]:
            got[number] = got.get(number, 0) + count
        seen += sum(count for _, count in tally["instances"])
        assert sum(n for _, n in tally["sizes"]) == sum(n for _, n in tally["hidden"])
    assert got == wanted
    assert seen == instances


def test_the_ground_comes_back_within_its_steps():
    y, x = np.mgrid[0:30, 0:40]
    heights = 0.1 * x - 0.3 * y - 50.0
    heights[3, 4] = np.nan
    text = ground_text(Ground((-4.0, 2.0), (0.5, 0.25), heights), 64)
    head, line = text.split(b"\n")
    facts = json.loads(head)
    found = facts["low"] + read_steps(base64.b64decode(line), facts, heights.shape)
    assert np.isinf(found[3, 4])
    hit = np.isfinite(heights)
    assert np.abs(found - heights)[hit].max() <= np.ptp(heights[hit]) / 2 / 65533 * 1.001
    coarse = json.loads(ground_text(Ground((0, 0), (1, 1), heights), 20).split(b"\n")[0])
    assert coarse["size"] == [20, 15]
    assert coarse["step"] == [2, 2]


def calm(width: int, height: int):
    """Frames as large as real ones compress: even depth and light, the usual blocks."""

    def passes(number: int):
        found = made_output.some_passes(number, width, height)
        y, x = np.mgrid[0:height, 0:width].astype(np.float32)
        found["rgb"] = np.stack([x / width, y / height, np.full_like(x, 0.5)], axis=2)
        hit = np.isfinite(found["depth"])
        found["depth"] = np.where(hit, 300 - y - 0.1 * x, found["depth"]).astype(np.float32)
        return found

    return passes


@pytest.fixture
def many(tmp_path):
    """560 frames of two cameras: EXR and tables are links to those of sample 0, poses are not."""
    out = made_output.make_output(tmp_path / "many", calm(160, 120), batches=4, samples=1)
    batches = json.loads((out / "manifest.json").read_bytes())["batches"]
    made_output.edit(out / "manifest.json", batches=[b | {"samples": 70} for b in batches])
    for first in sorted(out.glob("batch_*/frames/annotation/*/000000.json")):
        sidecar = json.loads(first.read_bytes())
        for sample in range(1, 70):
            stem = first.with_name(f"{sample:06d}")
            for ending in (".exr", ".png", ".instances.csv"):
                stem.with_suffix(ending).hardlink_to(first.with_suffix(ending))
            pose = made_output.pose_of(sidecar["camera"], sample).tolist()
            told = {**sidecar, "sample": sample, "camera_to_world": pose}
            stem.with_suffix(".json").write_text(json.dumps(told))
    return out


@pytest.mark.slow
def test_memory_does_not_grow_with_the_frames_but_for_their_index(many, tmp_path):
    peaks = []
    # The first one warms caches up.
    for samples in (2, 10, 70):
        out = tmp_path / f"{samples}"
        shutil.copytree(many, out, copy_function=lambda a, b: Path(b).hardlink_to(a))
        for path in out.glob("batch_*/frames/*/*/*.json"):
            if int(path.stem) >= samples:
                path.unlink()
        tracemalloc.start()
        report = write_view(out, tmp_path / "view.html")
        peaks.append((report.frames, tracemalloc.get_traced_memory()[1]))
        tracemalloc.stop()
    _, (few, less), (more, most) = peaks
    # A frame in memory has half a megabyte.
    assert (most - less) / (more - few) < 6_000
