"""What `scenec init` and `scenec schema` write can be used as it is."""

from __future__ import annotations

import json
import os
from pathlib import Path

import pytest
from jsonschema import Draft202012Validator

from scenec.backends.run.render import render
from scenec.cli.main import main
from scenec.compiler.cfg import json_positions
from scenec.compiler.cfg.load import load
from scenec.compiler.compile import compile_cfg
from scenec.compiler.kinds import schema
from scenec.schemas.errors import OutputError
from scenec.schemas.files import atomic, check_output
from scenec.testing.processes import output_of

ROOT = Path(__file__).resolve().parents[2]
TEMPLATES = sorted((ROOT / "configs" / "templates").glob("*.jsonc"))
NOT_PLAIN = r"cannot be written: it is (no plain file|a folder)"
CFGS = [*TEMPLATES, *sorted((ROOT / "configs").glob("*.json"))]


@pytest.mark.usefixtures("workers_here")
@pytest.mark.parametrize("template", TEMPLATES, ids=lambda path: path.stem)
def test_a_template_is_short_says_what_it_is_and_compiles_anywhere(template, tmp_path, capsys):
    file = tmp_path / "mine.jsonc"
    assert f"scenec run {file}" in output_of(capsys, ["init", template.stem, "-o", str(file)]).out
    text = file.read_text()
    assert text == template.read_text()
    assert text.startswith("// ")
    assert text.count("\n") <= 50
    coarse = {
        "samples": 1,
        "terrain.size_m": [20, 20],
        "terrain.spacing_m": 1,
        **{f"objects.{name}.count": 5 for name in load(file).cfg["objects"]},
    }
    spec = load(file, [f"{path}={json.dumps(value)}" for path, value in coarse.items()])
    assert spec.cfg["name"] == template.stem
    assert spec.warnings == ()
    # Models that it names come with scenec, wherever that is.
    assert all(f.reference.startswith("package:assets/") for f in spec.files.values())
    compile_cfg(spec, seed=1, out=tmp_path / "out")
    assert (tmp_path / "out" / "batch_0000" / "stage.usda").is_file()
    # No camera sees the ground of the sky's picture.
    assert render(tmp_path / "out", "annotation", passes=["label"]).warnings == []


def test_templates_are_listed_and_misspelled_ones_told(capsys):
    about = json.loads(output_of(capsys, ["init", "--json"]).out)
    assert {"forest", "meadow", "mars", "moon", "desert"} <= set(about)
    assert output_of(capsys, ["init"]).out.count("\n") == len(about)
    assert 'did you mean "forest"?' in output_of(capsys, ["init", "forrest"], 2).err


def test_init_replaces_nothing_and_writes_to_standard_output(tmp_path, capsys, monkeypatch):
    monkeypatch.chdir(tmp_path)
    assert main(["init", "moon"]) == 0
    (tmp_path / "moon.jsonc").write_text("mine")
    assert "moon.jsonc: is there already" in output_of(capsys, ["init", "moon"], 2).err
    assert (tmp_path / "moon.jsonc").read_text() == "mine"
    assert output_of(capsys, ["init", "moon", "-o", "-"]).out.startswith("// The Moon")


def test_init_leaves_links_pipes_and_devices_alone(tmp_path, capsys):
    link, pipe = tmp_path / "link", tmp_path / "pipe"
    link.symlink_to(tmp_path / "nowhere")
    os.mkfifo(pipe)
    for file in (link, pipe, Path(os.devnull)):
        assert (
            f"{file}: is there already"
            in output_of(capsys, ["init", "moon", "-o", str(file)], 2).err
        )
    assert link.is_symlink()
    assert not (tmp_path / "nowhere").exists()
    assert pipe.is_fifo()
    assert Path(os.devnull).is_char_device()


def test_nothing_takes_the_place_of_a_pipe_or_a_folder(tmp_path):
    pipe, folder, link = tmp_path / "pipe", tmp_path / "folder", tmp_path / "link"
    os.mkfifo(pipe)
    folder.mkdir()
    link.symlink_to(pipe)
    for file in (pipe, folder, link):
        with pytest.raises(OutputError, match=NOT_PLAIN):
            check_output(file)
        with (
            pytest.raises(OutputError, match=NOT_PLAIN),
            atomic(file) as new,
        ):
            new.write_text("text")
    assert pipe.is_fifo()
    assert sorted(path.name for path in tmp_path.iterdir()) == ["folder", "link", "pipe"]


def schema_of(capsys, *words: str) -> Draft202012Validator:
    schema = json.loads(output_of(capsys, ["schema", *words]).out)
    Draft202012Validator.check_schema(schema)
    # Self-contained: a reference leads nowhere else.
    text = json.dumps(schema)
    assert text.count('"$ref": "') == text.count('"$ref": "#/$defs/')
    return Draft202012Validator(schema)


@pytest.mark.parametrize("path", CFGS, ids=lambda path: path.stem)
def test_the_schema_in_one_piece_takes_what_ships(path, capsys):
    judge = schema_of(capsys)
    cfg = json_positions.parse(path.read_bytes()).value
    assert judge.is_valid(cfg)
    del cfg["terrain"]["spacing_m"]
    assert not judge.is_valid(cfg)
    cfg["terrain"]["spacing_m"] = -1
    assert not judge.is_valid(cfg)


def test_the_schema_in_one_piece_knows_kinds_of_other_packages(capsys, monkeypatch):
    cfg = json_positions.parse(TEMPLATES[0].read_bytes()).value
    cfg["terrain"]["relief"].append({"type": "farmland", "furrow_m": 1})
    assert not schema_of(capsys).is_valid(cfg)
    offered = {"scenec.relief": ("farmland",)}
    monkeypatch.setattr(schema, "names_of", lambda group: offered.get(group, ()))
    assert schema_of(capsys).is_valid(cfg)


def test_the_schema_of_cfgs_that_extend_requires_nothing_and_knows_all_keys(capsys, tmp_path):
    judge = schema_of(capsys, "--partial")
    assert judge.is_valid({"extends": "base.json", "terrain": {"spacing_m": 0.1}})
    assert not judge.is_valid({"extends": "base.json", "terrain": {"spacin_m": 0.1}})
    assert main(["schema", "-o", str(tmp_path / "s.json")]) == 0
    assert json.loads((tmp_path / "s.json").read_text())["$ref"] == "#/$defs/cfg"
