"""What ``scenec explain`` prints is what reports hold, the most effective first."""

from __future__ import annotations

import json
import re
import shutil
from collections.abc import Iterator
from itertools import pairwise
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from scenec.api.explain.data import read_batches
from scenec.api.explain.left_out import (
    LeftOut,
    Rates,
    left_out_of,
    left_out_text,
    parts_of,
    rates_of,
    size,
)
from scenec.api.explain.passes import passes_text, rows_of, wrapped
from scenec.api.explain.stage import read_contents
from scenec.backends.run.render import render
from scenec.cli.main import main
from scenec.compiler.compile import compile_cfg
from scenec.schemas.codec import decode
from scenec.schemas.errors import OutputError
from scenec.schemas.report import BatchReport
from scenec.testing.processes import output_of
from scenec.testing.small import small_cfg, write_cfg

pytestmark = pytest.mark.usefixtures("workers_here")

NUMBER = re.compile(r"(?<![\w.])-?\d[\d,]*(?:\.\d+)?(?:e[+-]?\d+)?(?![\w])")


@pytest.fixture(scope="module")
def output(tmp_path_factory):
    folder = tmp_path_factory.mktemp("explained")
    cfg = small_cfg(samples=2, outputs=["label", "instance", "depth"])
    cfg["terrain"] |= {"size_m": [60, 60], "spacing_m": 1.0}
    cfg["terrain"]["relief"][1]["amplitude_m"] = 3
    cfg["terrain"]["ground"][1]["where"] = [{"type": "slope", "min_deg": 3}]
    out = folder / "out"
    compile_cfg(write_cfg(folder, cfg), seed=3, out=out)
    render(out, "reference")
    return out


def numbers_in(value: Any) -> list[float]:
    """All numbers of a JSON document, however deep."""
    if isinstance(value, bool) or value is None:
        return []
    if isinstance(value, (int, float)):
        return [float(value)]
    if isinstance(value, dict):
        return [n for one in value.values() for n in numbers_in(one)]
    return [n for one in value for n in numbers_in(one)] if isinstance(value, list) else []


def as_report(value: Any) -> BatchReport:
    return decode(value, BatchReport, OutputError, "report.json")


def said(capsys: pytest.CaptureFixture[str], *words: str) -> str:
    assert main(["explain", *words]) == 0
    return capsys.readouterr().out


def test_every_number_of_the_table_stands_in_the_report(output, capsys):
    batch = read_batches(output)[0]
    rows = rows_of(batch.report, batch.seconds)
    known = numbers_in(json.loads((batch.folder / "report.json").read_text()))
    known += [100.0 * n for n in known]
    for row in rows:
        for text in NUMBER.findall(row.text):
            value = float(text.replace(",", ""))
            # To half of the last digit that is printed.
            digits, _, power = text.replace(",", "").partition("e")
            half = 0.5000001 * 10.0 ** (int(power or 0) - len(digits.partition(".")[2]))
            close = [n for n in known if abs(n - value) <= half]
            assert close, f"{text} of {row} is not in the report"
    assert {row.name: row.seconds for row in rows if row.seconds is not None} == {
        "relief, all steps": batch.seconds["relief"],
        "ground layers, all": batch.seconds["cover"],
        "ground mesh": batch.seconds["ground"],
        **{
            {"prune": "pruning", "surfaces": "materials, all"}.get(
                name, name.replace("objects/", "objects: ")
            ): value
            for name, value in batch.seconds.items()
            if name not in ("relief", "cover", "ground")
        },
    }


def test_every_error_of_the_report_is_printed(output):
    batch = read_batches(output)[0]
    printed = " ".join(row.text for row in rows_of(batch.report, batch.seconds))
    values = [float(text.replace(",", "")) for text in NUMBER.findall(printed)]

    def errors(node: Any, path: str = "") -> list[tuple[str, float]]:
        if isinstance(node, dict):
            return [e for key, one in node.items() for e in errors(one, f"{path}/{key}")]
        if isinstance(node, list):
            return [e for one in node for e in errors(one, path)]
        named = re.search(r"error.*_(px|m)$|change_(rms|max)_m$|snap_max_m$", path)
        return [(path, float(node))] if named and node is not None else []

    found = [
        (path, value)
        for path, value in errors(json.loads((batch.folder / "report.json").read_text()))
        # Stands in another unit beside, or belongs to one level of detail (--why).
        if not re.search(
            r"levels|lod_error_max_m|height_error_(max|rms)_m|surface_error_found_m", path
        )
        and not path.endswith(("surface_error_99_9_px", "seating_error_max_m"))
    ]
    assert len(found) > 8
    for path, value in found:
        assert any(abs(n - value) <= 0.051 * abs(value) + 1e-12 for n in values), path


def test_what_is_printed_fits_a_hundred_columns_and_begins_with_what_is_kept(output, capsys):
    text = said(capsys, str(output))
    lines = text.splitlines()
    assert max(map(len, lines)) <= 100
    data = json.loads(said(capsys, str(output), "--json"))["batches"]["batch_0000"]
    kept = data["kept"]
    match = re.fullmatch(
        r"batch_0000: kept ([\d,]+) of ([\d,]+) instances, ([\d,]+) of ([\d,]+) triangles, "
        r"(\S+ \S+) of (\S+ \S+)",
        lines[0],
    )
    assert match is not None
    numbers = [int(part.replace(",", "")) for part in match.groups()[:4]]
    assert numbers == [kept[n][k] for n in ("instances", "triangles") for k in ("kept", "of")]
    assert list(match.groups()[4:]) == [size(kept["bytes"][k]) for k in ("kept", "of")]
    # Two labels' worth of order: kept, left out, passes, frames.
    places = [text.index(part) for part in ("kept", "left out, most", "pass  ", "frames of")]
    assert places == sorted(places)


def test_kept_and_left_out_add_up_to_what_was_drawn(output, capsys):
    report = json.loads((output / "batch_0000" / "report.json").read_text())
    contents = read_contents(output / "batch_0000" / "stage.usda")
    data = json.loads(said(capsys, str(output), "--json"))["batches"]["batch_0000"]
    gone = sum(one["instances"] for one in data["left_out"])
    assert data["kept"]["instances"] == {"kept": contents.instances, "of": 300}
    assert contents.instances + gone == 300
    assert gone > 0
    whole = data["kept"]["triangles"]["of"]
    assert whole == contents.triangles + sum(one["triangles"] for one in data["left_out"])
    assert data["kept"]["bytes"]["kept"] == report["bytes"]


def test_left_out_is_listed_most_effective_first_with_seconds_of_this_output(output, capsys):
    text = said(capsys, str(output))
    batch = read_batches(output)[0]
    contents = read_contents(batch.stage)
    rates = rates_of(batch, contents)
    assert rates.emit_s == batch.seconds["emit"]
    assert rates.load_s == batch.frames[0].seconds["load"]
    left = left_out_of(batch.report, rates)
    assert [one.seconds for one in left] == sorted((one.seconds for one in left), reverse=True)
    for one in left:
        share = rates.emit_s / batch.report.bytes * one.bytes
        share += rates.load_s / contents.triangles * one.triangles
        assert one.seconds == pytest.approx(share)
    # Each line's numbers are its entry's, in this order.
    block = text[text.index("left out, most") : text.index("* estimated")]
    flat = " ".join(block.split())
    place = 0
    for one in left:
        numbers = [f"{n:,}" for n in (one.instances, one.triangles) if n]
        numbers += [size(one.bytes)] if one.bytes else []
        first = one.what.split()[0]
        place = flat.index(first, place)
        for number in numbers:
            assert number in flat[place:]
    assert "estimated" in text


def test_without_frames_seconds_are_not_made_up(output, tmp_path, capsys):
    bare = tmp_path / "out"
    shutil.copytree(output, bare, ignore=shutil.ignore_patterns("frames"))
    text = said(capsys, str(bare))
    assert "nothing was rendered" in text
    assert "seconds*" not in text
    data = json.loads(said(capsys, str(bare), "--json"))["batches"]["batch_0000"]
    assert {one["seconds"] for one in data["left_out"]} == {None}


entries = st.lists(
    st.fixed_dictionaries(
        {
            "what": st.sampled_from(["objects/a: 3", "materials/b", "terrain: 2 tiles"]),
            "why": st.just("because"),
            "instances": st.integers(0, 10**6),
            "triangles": st.integers(0, 10**9),
            "bytes": st.integers(0, 10**12),
        }
    ),
    max_size=12,
)


# Where the machine has other work, drawing is slow.
@given(entries, st.floats(1e-3, 1e3), st.integers(1, 10**9), st.floats(1e-3, 1e3),
       st.integers(1, 10**9))  # fmt: skip
def test_any_list_is_ranked_by_what_it_spares(found, emit_s, written, load_s, triangles):
    report = as_report({**RICH, "left_out": found, **NO_MORE})
    timed = left_out_of(report, Rates(emit_s, written, load_s, triangles, "x"))
    costs = [emit_s / written * one.bytes + load_s / triangles * one.triangles for one in timed]
    assert all(a >= b * (1.0 - 1e-12) for a, b in pairwise(costs))
    weights = [one.bytes + 36 * one.triangles for one in left_out_of(report)]
    assert weights == sorted(weights, reverse=True)
    assert sorted((one.what, one.bytes) for one in timed) == sorted(
        (one["what"], one["bytes"]) for one in found
    )


def test_entries_of_older_reports_have_no_numbers(capsys):
    report = {**RICH, "left_out": [{"what": "a", "why": "b"}], **NO_MORE}
    assert left_out_of(as_report(report)) == [LeftOut("a", "b")]


@given(st.text("ab 0123456789.,%mpx", max_size=200), st.integers(24, 80))
def test_numbers_and_units_stay_together(text, width):
    lines = wrapped(text, width)
    assert " ".join(" ".join(lines).split()) == " ".join(text.split())


@pytest.mark.parametrize(
    ("number", "text"),
    [(0, "0 B"), (999, "999 B"), (1000, "0.977 KiB"), (2**20, "1 MiB"), (3 * 2**30, "3 GiB")],
)
def test_bytes_are_said_as_people_say_them(number, text):
    assert size(number) == text


def test_a_batch_can_be_chosen_and_one_that_is_not_there_is_said(output, capsys):
    assert said(capsys, str(output), "--batch", "0").startswith("batch_0000")
    assert "batch 7" in output_of(capsys, ["explain", str(output), "--batch", "7"], 2).err
    with pytest.raises(SystemExit):
        main(["explain", str(output), "--batch", "-1"])


RICH = {
    "relief": [
        {"type": "smooth", "change_rms_m": 0.01, "change_max_m": 0.2},
        {"type": "thermal", "steps": 12, "change_max_m": 0.3, "steep_left": 0.004},
    ],
    "cover": [],
    "ground": {
        "faces": 10, "float32_error_max_m": 1e-7, "cuts": [],
        "mesh": {
            "tolerance_px": 0.5, "budget_bound": True, "tolerance_reached_px": 0.75,
            "height_error_max_px": 0.74, "triangles": 8, "triangles_of_grid": 20,
        },
    },
    "objects": {
        "logs": {
            "count": 9, "asked_for": 12, "triangles": 90, "triangles_finest": 900, "lod_px": 0.5,
            "lod_error_max_px": 0.7, "float32_error_max_m": 2e-8,
            "left_out": ["log.glb: its animation"],
        },
    },
    "object_budget": {"max_triangles": 100, "error_factor": 1.4},
    "sky": {
        "sky_0000.exr": {"optical_depth_550nm": {"dust": 0.6}, "resolution_error": 0.036},
        "set_to_zero": {"dawn.exr": {"negative_fraction": 0.002}},
    },
    "surfaces": {
        "sand": {
            "kind": "Sand", "bytes": 12,
            "displacement": {"octaves_m": [0.1, 0.05], "amplitudes_m": [0.01, 0.005]},
            "normals_beside_mesh": {"slope_rms": 0.3, "slope_rms_kept": 0.2},
            "pictures": {
                "base_color": {
                    "texels": [1024, 512], "texels_per_pixel": 4.4, "texels_kept": [256, 128],
                    "rms_error": 0.0021, "bytes_saved": 4321,
                },
            },
        },
    },
    "prune": {"light": {"min_view_factor": 0.0001, "everywhere": False}}, "bytes": 1,
}  # fmt: skip


#: Parts of ``RICH`` in which nothing is left out.
NO_MORE = {"ground": RICH["ground"] | {"mesh": None}, "objects": {}, "surfaces": {}}


@pytest.mark.parametrize(
    "words",
    [
        "change rms 0.01 m, change max 0.2 m", "steep left 0.004", "0.75 px within max_triangles",
        "9 instances placed of 12 asked for", "0.7 px worst, 0.5 px asked",
        "errors up to 1.4 times lod_px", "resolution error up to 3.6 % rms",
        "0.2 % below 0 set to 0", "octaves 0.1 0.05 m, amplitudes 0.01 0.005 m",
        "slope rms 0.3, slope rms kept 0.2",
        "1024 × 512 texels, 4.4 a pixel; kept 256 × 128, rms error 0.0021",
        "no shadow on what is seen, and fills less than 0.01 % of a hemisphere there",
    ],
)  # fmt: skip
def test_every_kind_of_approximation_shows_its_error(words):
    rows = rows_of(as_report(RICH), {"relief": 1.5, "prune": 0.25})
    assert any(words in row.text for row in rows), [row.text for row in rows]
    assert {row.name: row.seconds for row in rows}["pruning"] == 0.25


def test_approximations_are_among_what_was_left_out():
    found = {one.what: (one.triangles, one.bytes) for one in left_out_of(as_report(RICH))}
    assert found == {
        "terrain: triangles of the grid": (12, 0),
        "objects/logs: finer levels of detail": (810, 0),
        "materials/sand: texels of base color": (0, 4321),
        "log.glb: its animation": (0, 0),
    }


def others(value: Any) -> Iterator[tuple[str, Any]]:
    """A JSON value with one part at a time that is of another kind, or missing; with its place."""
    for other in ("x", -1, None, [1], {"a": "b"}):
        yield "", other
    if isinstance(value, dict):
        for key, part in value.items():
            place = "/" + key.replace("/", "~1")
            yield place, {name: one for name, one in value.items() if name != key}
            yield from ((f"{place}{at}", {**value, key: one}) for at, one in others(part))
    elif isinstance(value, list):
        for i, part in enumerate(value):
            yield from (
                (f"/{i}{at}", [*value[:i], one, *value[i + 1 :]]) for at, one in others(part)
            )


def test_a_report_of_another_shape_is_refused_with_the_place_or_it_does_not_matter(
    output, tmp_path
):
    out = tmp_path / "out"
    shutil.copytree(output, out)
    batch = read_batches(out)[0]
    contents = read_contents(batch.stage)
    refused = []
    for file in (
        out / "batch_0000" / "report.json",
        out / "timings.json",
    ):
        text = file.read_text()
        for at, other in others(json.loads(text)):
            file.write_text(json.dumps(other))
            try:
                one = read_batches(out)[0]
            except OutputError as error:
                refused.append((at, str(error).removeprefix(f"{file}: is no report of scenec: ")))
                continue
            rates = rates_of(one, contents)
            left = left_out_of(one.report, rates)
            assert parts_of(one.report, contents, left).text
            assert left_out_text(left, rates, 100)
            assert passes_text(rows_of(one.report, one.seconds), 100)
        file.write_text(text)
    assert len(refused) > 300
    for at, told in refused:
        place = told.partition(": ")[0].rstrip("/")
        assert at.startswith(place) or place.startswith(at), (at, told)
