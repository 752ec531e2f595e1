"""Statistics are what NumPy counts, in any order of frames, and bounded."""

from __future__ import annotations

import json
from dataclasses import replace
from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from scenec.datasets import bins
from scenec.datasets.filters import make_filters
from scenec.datasets.idset import IdSet, packed
from scenec.datasets.source import LoadedFrame, Source
from scenec.datasets.statistics import Statistics, measure
from scenec.schemas.records import SunRecord
from scenec.testing.examples import examples
from scenec.testing.made_output import LABELS, make_output, some_passes

LARGEST = 2**32 - 1


@pytest.fixture(scope="module")
def frames(tmp_path_factory):
    source = Source(make_output(tmp_path_factory.mktemp("made") / "out"))
    return [source.load(ref) for ref in source.frames]


@pytest.fixture(scope="module")
def measured(frames):
    return [measure(frame) for frame in frames]


def one_frame(folder: Path, passes: dict, **more) -> LoadedFrame:
    out = make_output(folder / "out", lambda _: passes, batches=1, cameras=("a",), samples=1)
    source = Source(out)
    frame = source.load(source.frames[0])
    return replace(frame, sidecar=replace(frame.sidecar, **more))


def summed(parts: list[dict]) -> Statistics:
    total = Statistics()
    for part in parts:
        total.add(part)
    return total


def test_pixels_shares_and_frames_of_labels_are_what_numpy_counts(frames, measured):
    found = summed(measured).as_json()["levels"]
    for level, names in LABELS.items():
        pictures = np.stack([frame.passes[f"label.{level}"] for frame in frames])
        for number, name in names.items():
            of = pictures == number
            entry = found[level]["labels"][name]
            assert entry["id"] == number
            assert entry["pixels"] == of.sum()
            assert entry["share"] == of.sum() / of.size
            assert entry["frames"] == of.any(axis=(1, 2)).sum()
        assert found[level]["pixels"] == pictures.size


@examples(40)
@given(
    order=st.permutations(range(8)),
    cuts=st.lists(st.integers(0, 8), max_size=3),
    data=st.data(),
)
def test_any_order_and_grouping_of_frames_gives_the_same_bits(measured, order, cuts, data):
    edges = [0, *sorted(cuts), 8]
    groups = [[measured[i] for i in order[a:b]] for a, b in pairwise(edges)]
    states = [json.loads(json.dumps(summed(group).state())) for group in groups]
    total = summed(data.draw(st.permutations(states)))
    expected = summed(measured)
    assert json.dumps(total.state()) == json.dumps(expected.state())
    assert json.dumps(total.as_json()) == json.dumps(expected.as_json())


def test_instances_are_counted_once_a_frame_and_distinct_ones_once_a_batch(frames, measured):
    found = summed(measured).as_json()["instances"]
    per_batch: dict[str, set[int]] = {}
    for frame in frames:
        per_batch.setdefault(frame.ref.batch_name, set()).update(frame.table["id"].tolist())
    assert found["seen"] == sum(len(frame.table["id"]) for frame in frames)
    assert found["distinct"] == sum(map(len, per_batch.values())) < found["seen"]
    (entry,) = found["classes"].values()
    areas = np.concatenate([frame.table["pixels"] for frame in frames])
    assert sum(entry["area"]["counts"]) == len(areas) == entry["seen"]
    expected, _ = np.histogram(areas, entry["area"]["edges"])
    # NumPy's last bin holds its last edge, too: no value of these is there.
    assert entry["area"]["counts"] == expected.tolist()
    assert sum(found["per_frame"]["counts"]) == len(frames)


def test_a_closed_batch_counts_the_same_and_takes_no_more_room(measured):
    total = summed(measured)
    before = json.dumps(total.as_json())
    total.close("batch_0000")
    total.close("batch_0001")
    assert json.dumps(total.as_json()) == before
    assert total.state()["seen"] == {}
    again = Statistics()
    again.merge(json.loads(json.dumps(total.state())))
    assert json.dumps(again.as_json()) == before


def test_occlusion_and_truncation_are_of_whole_pixels(tmp_path):
    pixels = np.array([10, 9, 5, 1, 1, 3])
    amodal = np.array([10, 10, 10, 10, 1000, 10])
    # 0, 0.1, 0.5, 0.9, 0.999 and 0.7 hidden: 1 - 9 / 10 in floats would fall below 0.1.
    found = bins.share_table(bins.share_counts(pixels, amodal))
    assert found["zero"] == 1
    assert found["counts"] == [0, 1, 0, 0, 0, 1, 0, 1, 0, 2]
    frame = one_frame(tmp_path, some_passes(3))
    json_ = summed([measure(frame)]).as_json()["instances"]["all"]
    assert sum(json_["occlusion"]["counts"]) == len(frame.table["id"])
    for column in ("amodal", "amodal_full"):
        del frame.table[column]
    older = summed([measure(frame)]).as_json()["instances"]["all"]
    assert "occlusion" not in older
    assert "truncation" not in older


def test_ignored_instances_are_counted_apart(tmp_path):
    frame = one_frame(tmp_path, some_passes(0))
    make_filters(["id<100"], "ignore").apply(frame)
    found = summed([measure(frame)]).as_json()["instances"]
    kept = int((frame.table["id"] < 100).sum())
    assert (found["seen"], found["ignored"]) == (kept, len(frame.table["id"]) - kept)


@examples(60)
@given(
    arrays(
        np.float32,
        st.tuples(st.integers(1, 9), st.integers(1, 9)),
        elements=st.floats(width=32) | st.sampled_from([float(edge) for edge in bins._EDGES]),
    )
)
def test_lengths_of_a_picture_fall_in_the_bins_that_comparing_puts_them_in(picture):
    finite = picture[np.isfinite(picture)].astype(np.float64)
    found = bins.length_counts(picture)
    assert found.counts == bins.LENGTH.counts(finite)
    assert found.infinite == np.isposinf(picture).sum()
    if len(finite):
        assert (found.low, found.high) == (finite.min(), finite.max())
    else:
        assert found.low > found.high


def test_minus_infinity_is_in_no_bin():
    found = bins.length_counts(np.array([[0.0, -np.inf, 0.0]], np.float32))
    assert (found.counts, found.infinite, found.low) == ({"0": 2}, 0, 0.0)


def test_a_value_on_an_edge_is_in_the_bin_above_it_in_float32_too():
    for number, edge in enumerate(bins.LENGTH.edges, 1):
        at = np.float32(edge)
        at = at if float(at) >= edge else np.nextafter(at, np.float32(np.inf))
        under = np.nextafter(at, np.float32(0))
        assert bins.length_counts(np.array([[at]])).counts == {str(number): 1}
        assert bins.length_counts(np.array([[under]])).counts == {str(number - 1): 1}


@examples(60)
@given(
    arrays(np.uint32, (7, 5), elements=st.sampled_from([0, 1, 2, 65536, LARGEST - 1, LARGEST])),
    st.sets(st.sampled_from([1, 2, 65536, LARGEST])),
)
def test_pixels_of_ids_are_what_numpy_counts(picture, keys):
    wanted = np.array(sorted(keys), np.uint32)
    counts, none, other = bins.id_counts(picture, wanted)
    assert counts.tolist() == [int((picture == key).sum()) for key in wanted]
    assert none == (picture == 0).sum()
    assert none + other + counts.sum() == picture.size


@examples(60)
@given(st.lists(st.sets(st.integers(0, LARGEST) | st.integers(0, 70_000)), max_size=4))
def test_a_set_of_ids_is_a_set(parts):
    found, texts = IdSet(), IdSet()
    for part in parts:
        found.add(np.array(list(part), np.uint32))
        texts.add_text(packed(np.array(sorted(part), np.uint32)))
    expected = set().union(*parts)
    assert len(found) == len(expected)
    assert found.ids().tolist() == sorted(expected)
    assert texts.text() == found.text()


@pytest.mark.parametrize("text", ["", "x", "AAAA", "é"])
def test_what_is_no_set_of_ids_is_refused(text):
    with pytest.raises(ValueError, match="no set of ids"):
        IdSet().add_text(text)


def test_a_set_of_dense_ids_takes_a_bit_an_id_in_a_state():
    found = IdSet()
    found.add(np.arange(1, 1_000_001))
    assert len(found) == 1_000_000
    assert len(found.text()) < 20_000


def pose(right, down, forward):
    matrix = np.eye(4)
    matrix[:3, 0], matrix[:3, 1], matrix[:3, 2] = right, down, forward
    return matrix.tolist()


def turned(heading: float, pitch: float, roll: float):
    """A camera by its angles, degrees: turned right, tipped up, rolled clockwise, in this order."""
    h, p, r = np.radians([heading, pitch, roll])
    forward = np.array([np.sin(h) * np.cos(p), np.cos(h) * np.cos(p), np.sin(p)])
    level = np.array([np.cos(h), -np.sin(h), 0.0])
    up = np.cross(level, forward)
    right = np.cos(r) * level - np.sin(r) * up
    return pose(right, np.cross(forward, right), forward)


def posed(frame: LoadedFrame, camera_to_world) -> LoadedFrame:
    told = replace(frame.sidecar, camera_to_world=camera_to_world)
    return LoadedFrame(frame.ref, {}, told, {}, {})


@examples(60)
@given(st.integers(0, 359), st.integers(-89, 89), st.integers(-180, 179))
def test_heading_pitch_and_roll_are_those_the_camera_was_turned_by(frames, heading, pitch, roll):
    frame = posed(frames[0], turned(heading, pitch, roll))
    view = measure(frame)["counts"]["view"]
    assert view["heading"] == {str(heading // 15 + 1): 1}
    assert view["pitch"] == {str((pitch + 90) // 10 + 1): 1}
    assert view["roll"] == {str((roll + 180) // 10 + 1): 1}


def test_a_camera_that_looks_straight_down_has_no_heading(frames):
    frame = posed(frames[0], pose((1, 0, 0), (0, -1, 0), (0, 0, -1)))
    view = measure(frame)["counts"]["view"]
    assert view == {"pitch": {"1": 1}}
    frame = posed(frames[0], pose((1, 0, 0), (0, 1, 0), (0, 0, 1)))
    assert measure(frame)["counts"]["view"] == {"pitch": {"18": 1}}


def test_suns_are_counted_by_where_they_stand(frames):
    total = Statistics()
    suns = [(90.0, 0.0), (12.0, 359.9999999), (12.0, 45.0), (-3.0, 200.0), None]
    for sun in suns:
        record = sun and SunRecord(
            elevation_deg=sun[0], azimuth_deg=sun[1], irradiance=(1.0, 2.0, 3.0)
        )
        told = replace(frames[0].sidecar, sun=record)
        total.add(measure(LoadedFrame(frames[0].ref, {}, told, {}, {})))
    found = total.as_json()["sun"]
    assert found["without"] == 1
    assert found["elevation_deg"] == [-3.0, 90.0]
    assert {row: [i for i, n in enumerate(c) if n] for row, c in found["frames"].items()} == {
        "8": [6],
        "10": [0, 1],
        "17": [0],
    }


def test_frames_without_passes_tables_or_names_are_measured_all_the_same(tmp_path):
    nothing = {
        "label.class": np.zeros((1, 1), np.uint32),
        "instance": np.zeros((1, 1), np.uint32),
        "depth": np.full((1, 1), np.inf, np.float32),
    }
    found = summed([measure(one_frame(tmp_path / "a", nothing))]).as_json()
    assert found["levels"]["class"]["unlabeled"] == 1
    assert found["depth"]["nothing"] == 1
    assert found["depth"]["range_m"] is None
    assert found["instances"]["seen"] == found["instances"]["distinct"] == 0
    strange = {"label.class": np.full((1, 1), LARGEST, np.uint32)}
    frame = one_frame(tmp_path / "b", {"label.class": np.zeros((1, 1), np.uint32)})
    frame.passes |= strange
    found = summed([measure(frame)]).as_json()
    assert found["levels"]["class"]["unknown"] == 1
    assert "instances" not in found
    assert "depth" not in found


def test_statistics_of_nothing_are_written_too():
    assert Statistics().as_json()["frames"] == 0
    json.dumps(Statistics().state())
