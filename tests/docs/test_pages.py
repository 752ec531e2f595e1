"""What holds for the README, for the pages of docs/, and for the website that is made of them."""

from __future__ import annotations

import json
import re
import subprocess
import sys

import pytest
from blocks import ROOT, blocks

from scenec.compiler.cfg.load import load
from scenec.compiler.compile import compile_cfg

README = (ROOT / "README.md").read_text(encoding="utf-8")
PAGES = sorted([ROOT / "README.md", ROOT / "CONTRIBUTING.md", *(ROOT / "docs").glob("*.md")])


def test_the_readme_has_at_most_100_lines():
    assert len(README.splitlines()) <= 100


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.name)
def test_every_file_that_a_page_links_or_shows_is_there(page):
    text = re.sub(r"^```.*?^```$", "", page.read_text(encoding="utf-8"), flags=re.M | re.S)
    for target in re.findall(r"\]\(([^)#\s]+)[^)]*\)", text):
        assert "://" in target or (page.parent / target).exists(), target


def test_every_command_that_pages_name_exists():
    from scenec.cli.main import parser

    known = set(parser()._subparsers._group_actions[0].choices)
    for page in PAGES:
        text = page.read_text(encoding="utf-8")
        code = "\n".join(re.findall(r"^```sh\n.*?^```$", text, re.M | re.S))
        said = re.findall(r"(?:`|^    )scenec ([a-z]+)", text, re.M)
        for command in said + re.findall(r"^(?:\S+/)?scenec ([a-z]+)", code, re.M):
            assert command in known, (page.name, command)


def test_the_website_builds_without_a_warning(tmp_path):
    command = [sys.executable, "-m", "sphinx", "--quiet", "--fail-on-warning", "--keep-going"]
    folders = [str(ROOT / "docs"), str(tmp_path / "site")]
    done = subprocess.run([*command, *folders], capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    commands = (tmp_path / "site" / "commands.html").read_text(encoding="utf-8")
    assert "usage: scenec render" in commands
    assert "compile_cfg" in (tmp_path / "site" / "api.html").read_text(encoding="utf-8")


@pytest.mark.parametrize(
    "coarse", [pytest.param(False, id="as it is", marks=pytest.mark.slow), True]
)
def test_the_cfg_that_is_explained_line_by_line_is_valid(coarse, tmp_path):
    (block,) = blocks("docs/cfg_tour.md")
    path = tmp_path / "first.json"
    path.write_text(block.text, encoding="utf-8")
    spec = load(path)
    assert spec.cfg["name"] == "first"
    if coarse:
        cfg = json.loads(spec.text)
        cfg["terrain"]["spacing_m"] *= 4
        cfg["objects"]["rocks"]["count"] //= 16
        cfg["light"]["sky"]["resolution"] = 32
        for name in ("sand", "basalt"):
            cfg["materials"][name]["maps"]["procedural"]["resolution"] = 256
        path.write_text(json.dumps(cfg), encoding="utf-8")
    assert compile_cfg(path, seed=1, out=tmp_path / "out", batches=range(1)).batches == (0,)
