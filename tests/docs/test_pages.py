"""What holds for the README, for the pages of docs/, and for the website that is made of them."""

from __future__ import annotations

import re
import subprocess
import sys

import pytest
from blocks import ROOT

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
