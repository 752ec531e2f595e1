"""What the README shows works as it stands."""

from __future__ import annotations

import re
from pathlib import Path

import pytest

from scenec.compiler.cfg.load import load
from scenec.compiler.compile import compile_cfg

ROOT = Path(__file__).resolve().parents[2]
README = (ROOT / "README.md").read_text(encoding="utf-8")


@pytest.mark.parametrize(
    "coarse", [pytest.param(False, id="as it is", marks=pytest.mark.slow), True]
)
def test_the_cfg_that_is_explained_line_by_line_is_valid(coarse, tmp_path):
    (block,) = re.findall(r"```jsonc\n(.*?)```", README, re.DOTALL)
    path = tmp_path / "first.jsonc"
    path.write_text(block, encoding="utf-8")
    assert load(path).cfg["name"] == "first"
    fewer = [f"materials.{name}.maps.procedural.resolution=256" for name in ("sand", "basalt")]
    fewer += ["terrain.spacing_m=0.6", "objects.rocks.count=300", "light.sky.resolution=32"]
    spec = load(path, fewer if coarse else [])
    assert compile_cfg(spec, seed=1, out=tmp_path / "out", batches=range(1)).batches == (0,)


def test_every_file_that_it_links_is_there():
    for target in re.findall(r"\]\(([^)#]+)\)", README):
        assert (ROOT / target).exists(), target


def test_every_command_that_it_names_exists():
    from scenec.cli.main import parser

    known = set(parser()._subparsers._group_actions[0].choices)
    for line in re.findall(r"^    scenec (\w+)", README, re.MULTILINE):
        assert line in known


@pytest.mark.parametrize("path", sorted((ROOT / "configs").glob("*.json")), ids=lambda p: p.stem)
def test_every_cfg_that_ships_is_valid(path):
    assert load(path).cfg["name"] == path.stem
