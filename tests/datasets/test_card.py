"""The card says what the dataset is, in Markdown that a parser reads, and how to make it again."""

from __future__ import annotations

import argparse
import hashlib
import json
import re
import shlex
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from tiny_format import contents

from scenec.cli.main import parser
from scenec.datasets import card_tables
from scenec.datasets.export import Choice, export
from scenec.datasets.filters import make_filters
from scenec.datasets.remap import parse_remap
from scenec.datasets.splits import parse_splits
from scenec.testing.made_output import edit, make_output

CFG = '{\n "name": "ä ``` | box",\n "version": 1\n}\n'
FLINT = {
    "file": "rocks/flint.glb",
    "license": "CC-BY-4.0",
    "copyright": ["2020 A. Stone", "2021 B | C"],
    "source": "flint.glb.license beside it",
}


_FENCED = re.compile(r"^(`{3,})\w*\n.*?\n\1$", re.DOTALL | re.MULTILINE)


@pytest.fixture(scope="module")
def output(tmp_path_factory):
    """An output whose manifest knows of a cfg, its inputs and their terms."""
    out = make_output(tmp_path_factory.mktemp("made") / "out", name="ä ``` | box")
    (out / "cfg.json").write_text(CFG, encoding="utf-8")
    manifest = json.loads((out / "manifest.json").read_text(encoding="utf-8"))
    manifest["files"]["cfg.json"] = {"sha256": hashlib.sha256(CFG.encode()).hexdigest()}
    inputs = {"objects/rocks/models/0/file": "a" * 64, "terrain/relief/0/file": "b" * 64}
    licenses = {"objects/rocks/models/0/file": FLINT}
    cfg = {"sha256": "c" * 64, "inputs": inputs, "licenses": licenses}
    edit(out / "manifest.json", files=manifest["files"], seed=7, scenec="9.9",
         libraries={"numpy": "2.0"}, cfg=cfg)  # fmt: skip
    for path in out.glob("batch_*/frames/annotation/*/*.json"):
        sun = {"elevation_deg": 30.0, "azimuth_deg": 100.0, "irradiance": [1, 1, 1]}
        edit(path, backend_version="annotation 1", spp=16, noise_seed=3, sun=sun,
             height_above_surface_m=1.5, estimated_error={"relative_rms": 0.125})  # fmt: skip
    return out


@pytest.fixture(scope="module")
def dataset(output, plugin, tmp_path_factory):
    folder = tmp_path_factory.mktemp("whole") / "ds"
    choice = Choice(
        samples=range(2),
        filters=make_filters(["id<4e9", "depth_mean<=35.123456789"], "ignore"),
        remap=parse_remap({"class": {"rock": "stone"}}),
        splits=parse_splits("train=0.5,val=0.5"),
        split_seed=11,
        level="surface",
        options={"ending": "txt"},
    )
    export(output, "tiny", folder, choice)
    return folder


@pytest.fixture(scope="module")
def card(dataset):
    return (dataset / "README.md").read_text(encoding="utf-8")


def blocks(card: str) -> list[tuple[str, str]]:
    """Language and text of all fenced blocks, as CommonMark ends them."""
    found = re.findall(r"^(`{3,})(\w+)\n(.*?)\n\1$", card, re.DOTALL | re.MULTILINE)
    return [(language, text) for _, language, text in found]


def section(card: str, title: str) -> str:
    return card.split(f"\n## {title}\n")[1].split("\n## ")[0]


def test_the_head_is_yaml_and_has_what_the_format_asks_for(card):
    yaml = pytest.importorskip("yaml")
    head = yaml.safe_load(card.split("---\n")[1])
    assert head["pretty_name"] == "ä ``` | box"
    assert head["configs"] == [{"config_name": "all"}]
    assert head["size_categories"] == ["n<1K"]
    assert "depth-estimation" in head["task_categories"]
    assert "Read `all.json`." in section(card, "How to load it")
    assert "configs" not in section(card, "How to load it")


def test_numbers_are_those_of_the_statistics(card, dataset):
    statistics = json.loads((dataset / "statistics.json").read_text(encoding="utf-8"))
    labels = section(card, "Labels")
    for level in statistics["levels"].values():
        for name, entry in level["labels"].items():
            row = f"| {entry['id']} | {name} | {entry['pixels']:,} | {100 * entry['share']:.3f} % |"
            assert row in labels
    entry = statistics["instances"]["classes"]["/World/Objects/rocks"]
    row = f"| `/World/Objects/rocks` | {entry['seen']:,} | {entry['distinct']:,} |"
    assert row in section(card, "Instances")
    assert "| `train` | 4 | 1 |" in section(card, "Splits")
    assert "relative RMS 0.125 to 0.125" in section(card, "How it was made")


EVIL = [
    "<script>alert(1)</script>", "](javascript:alert(1))", "![x](http://a.b/c.png)", "`</td>` <b>",
    "``` |\n# heading", "=HYPERLINK(1)", "&lt;script&gt;", "\\](x)", "[a]: javascript:alert(1)",
]  # fmt: skip


def test_names_of_others_are_text_in_the_card(tmp_path):
    labels = {"class": dict(enumerate(EVIL, start=1))}
    passes = {
        "label.class": np.arange(1, len(EVIL) + 1, dtype=np.uint32).repeat(4)[None].repeat(8, 0),
        "instance": np.zeros((8, 4 * len(EVIL)), np.uint32),
    }
    out = make_output(
        tmp_path / "out", lambda _: passes, batches=1, cameras=("c",), samples=1, labels=labels,
        name=EVIL[0],
    )  # fmt: skip
    export(out, "webdataset", tmp_path / "set")
    text = _FENCED.sub("", (tmp_path / "set" / "README.md").read_text()).split("\n---\n", 1)[1]
    # Without spans of code, whose content is text whatever it is.
    text = re.sub(r"(?<![`\\])(`+)(?!`).*?(?<!`)\1(?!`)", "", text)
    assert "<script" not in text
    assert "&lt;script&gt;alert" in text
    assert "&amp;lt;script" in text
    assert not re.search(r"(?<!\\)(?:\\\\)*[\[\]]", text)
    assert "\n# heading" not in text


@given(st.text(min_size=1))
def test_code_holds_any_text(text):
    """As CommonMark reads a span: one space off both ends where there are two, and not only."""
    span = card_tables.code(text)
    fence = re.match(r"`+", span)[0]
    inner = span[len(fence) : -len(fence)]
    assert fence not in re.findall(r"`+", inner)
    if inner[0] == inner[-1] == " " and inner.strip(" "):
        inner = inner[1:-1] if "`" in (inner[1], inner[-2]) else inner
    assert inner.split() == text.split() or not text.strip()


def test_every_table_has_one_number_of_columns(card):
    tables = re.findall(r"(?:^\|.*\|\n)+", _FENCED.sub("", card), re.M)
    assert len(tables) > 10
    for table in tables:
        widths = {len(re.findall(r"(?<!\\)\|", line)) for line in table.splitlines()}
        assert len(widths) == 1, table


def test_the_cfg_stands_there_in_full_whatever_is_in_it(card):
    texts = [text for language, text in blocks(card) if language == "json"]
    assert CFG.rstrip("\n") in texts
    assert {"class": {"rock": "stone"}} in [json.loads(t) for t in texts if "rock" in t]


def test_commands_are_ones_that_the_command_line_takes(card):
    (script,) = [text for language, text in blocks(card) if language == "sh"]
    options: list[argparse.Namespace] = []
    for line in script.splitlines():
        words = shlex.split(line)
        assert words[0] == "scenec"
        options.append(parser().parse_args(words[1:]))
    compile_, render, export_, check = options
    assert (compile_.cfg, compile_.seed, compile_.out) == ("cfg.json", 7, "OUT")
    assert (render.backend, render.spp, render.noise_seed) == ("annotation", 16, 3)
    assert render.passes == ("rgb", "label", "instance", "depth")
    assert export_.keep == ["id<4000000000", "depth_mean<=35.123456789"]
    assert (export_.rejected, export_.remap, export_.level) == ("ignore", "remap.json", "surface")
    assert (export_.split, export_.split_seed) == ("train=0.5,val=0.5", 11)
    assert (export_.settings, export_.samples) == (["ending=txt"], range(2))
    assert (check.out, check.against) == ("AGAIN", "DATASET")


def test_terms_of_what_went_in_are_listed_and_unknown_ones_said_to_be(card):
    text = section(card, "Licenses")
    assert (
        "| `/objects/rocks/models/0/file` | `rocks/flint.glb` | CC-BY-4.0 | "
        "2020 A. Stone; 2021 B \\| C | flint.glb.license beside it |" in text
    )
    assert "| `/terrain/relief/0/file` |  | unknown | unknown | nothing says so |" in text


def test_the_digest_is_that_of_the_index(card, dataset):
    lines = (dataset / "frames.csv").read_text(encoding="utf-8").splitlines()[1:]
    fields = [line.split(",") for line in lines]
    text = "".join(f"{field[0]} {field[7]}\n" for field in fields)
    assert hashlib.sha256(text.encode()).hexdigest() in section(card, "Is it whole, is it the same")


def test_a_cfg_that_is_not_the_manifest_s_is_not_shown(output, plugin, tmp_path):
    (output / "cfg.json").write_text(CFG + " ", encoding="utf-8")
    try:
        export(output, "tiny", tmp_path / "ds")
    finally:
        (output / "cfg.json").write_text(CFG, encoding="utf-8")
    text = (tmp_path / "ds/README.md").read_text(encoding="utf-8")
    assert "The cfg itself is not known" in text
    assert CFG.strip() not in text


def test_frames_of_a_mere_stage_have_a_card_too(tmp_path, plugin):
    made = make_output(tmp_path / "made", batches=1, cameras=("a",))
    folder = made / "batch_0000"
    export(folder / "stage.usda", "tiny", tmp_path / "ds")
    text = (tmp_path / "ds/README.md").read_text(encoding="utf-8")
    assert text.count("scenec compile") == 0
    assert "scenec render stage.usda" in text
    assert set(contents(tmp_path / "ds")) >= {"README.md", "SHA256SUMS", "frames.csv"}


def test_bars_are_as_long_as_their_counts_and_what_is_there_shows():
    found: dict[str, Any] = {"edges": [0.0, 1.0, 2.0, 4.0], "counts": [1000, 500, 1], "below": 0}
    lines = card_tables.histogram(found, "m", "pixels").splitlines()[2:]
    bars = [line.split("|")[3].strip() for line in lines]
    assert [len(bar) for bar in bars] == [24, 12, 1]
    assert bars[2] == "▏"
    assert card_tables.bar(0, 0) == ""
