"""Measured pages name the command that makes them anew, and are not old."""

from __future__ import annotations

import re

import pytest
from blocks import ROOT

from scenec.testing.processes import ran

PAGES = {path.name: path.read_text(encoding="utf-8") for path in (ROOT / "docs").glob("*.md")}
#: Minor versions that figures may be of: the newest and two before it.
RECENT = list(
    dict.fromkeys(re.findall(r"^## \[(\d+\.\d+)\.", (ROOT / "CHANGELOG.md").read_text(), re.M))
)[:3]


def scripts() -> list[str]:
    """What ``make measured`` runs, below ``lab``."""
    done = ran(
        "make", "--no-print-directory", "--eval", "list: ; @echo $(MEASURED)", "list", cwd=ROOT
    )
    assert done.returncode == 0, done.stderr
    return done.stdout.split()


@pytest.mark.parametrize("script", scripts())
def test_a_measured_page_names_its_command_and_a_recent_version(script):
    source = (ROOT / "lab" / f"{script}.py").read_text(encoding="utf-8")
    (page,) = re.findall(r'page="(\w+)"', source)
    mark = f"by_{script.rpartition('/')[2]}"
    stamps = re.findall(f"<!--{mark}-->(.*?)<!--/{mark}-->", PAGES[f"{page}.md"])
    made = [re.match(rf"`python lab/{script}\.py`: scenec (\d+\.\d+)", stamp) for stamp in stamps]
    versions = [one[1] for one in made if one]
    assert versions, (page, stamps)
    assert set(versions) <= set(RECENT), (page, stamps)


@pytest.mark.parametrize("page", PAGES)
def test_figures_are_of_a_recent_version_or_of_a_machine_with_a_gpu(page):
    for line in PAGES[page].splitlines():
        for version in re.findall(r"\bscenec (\d+\.\d+)\b", line):
            assert version in RECENT or "GPU" in line or "NVIDIA" in line, line


@pytest.mark.parametrize("page", PAGES)
def test_every_script_and_test_that_a_page_names_is_there(page):
    for path in re.findall(r"\b(?:lab|tests|tools|configs)/[\w/]+\.\w+\b", PAGES[page]):
        assert (ROOT / path).exists(), path
