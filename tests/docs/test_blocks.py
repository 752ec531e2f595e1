"""Whatever README, tutorial and recipes show works as it stands."""

from __future__ import annotations

import json
import re

import pytest
from blocks import ROOT, blocks, run_all, sections

TUTORIAL, RECIPES = "docs/tutorial.md", "docs/recipes.md"
OTHERS = (
    "docs/light.md",
    "docs/objects.md",
    "docs/writing.md",
    "docs/python.md",
    "docs/evaluate.md",
    "docs/commands.md",
)
PAGES = ("README.md", TUTORIAL, RECIPES, *OTHERS)

README = (ROOT / "README.md").read_text(encoding="utf-8")
FIRST_OUT = "out/first"
ENVIRONMENT = "it makes the environment that the tests run in"
#: Every block of these pages that is not run, by what it begins with, and why.
NOT_RUN = {
    "make demo": ENVIRONMENT,
    "git clone YOUR-COPY-OF-SCENEC scenec && cd scenec": ENVIRONMENT,
    "scenec evaluate detections.json --against dataset": "no network has predicted anything here",
    "import torch": "PyTorch takes gigabytes and is not among what scenec installs",
}


def first_cfg():
    """The block of the tutorial that other pages build on."""
    return [block for block in blocks(TUTORIAL) if block.file == "first.json"]


def test_what_is_not_run_is_listed_with_its_reason():
    found = [block for page in PAGES for block in blocks(page) if block.why_not]
    begins = {re.split("[#\n]", block.text)[0].strip(): block.why_not for block in found}
    assert begins == NOT_RUN


def test_what_looks_like_a_command_is_in_a_block_that_is_run():
    for page in PAGES:
        text = (ROOT / page).read_text(encoding="utf-8")
        assert not re.findall(r"^(?:    |\$ )scenec .*$", text, re.M), page


def test_the_cfg_of_the_readme_runs_as_the_readme_says(tmp_path):
    run_all(blocks("README.md"), tmp_path)
    from scenec.cli.main import main

    cfg = str(tmp_path / "first.json")
    assert f"scenec run first.json --seed 1 -o {FIRST_OUT} " in README
    # What `make demo` leaves.
    (tmp_path / "out/jacksboro/batch_0000").mkdir(parents=True)
    out = tmp_path / FIRST_OUT
    assert main(["run", cfg, "--seed", "1", "-o", str(out), "--spp", "4", "--samples", "0:1"]) == 0
    for name in ("png", "exr", "json", "instances.csv"):
        assert (out / f"batch_0000/frames/mitsuba/rover_front/000000.{name}").is_file()


def test_there_is_one_first_cfg():
    (readme,) = [block for block in blocks("README.md") if block.file == "first.json"]
    assert [json.loads(block.text) for block in first_cfg()] == [json.loads(readme.text)]


def test_the_tutorial_runs_from_its_first_block_to_its_last(tmp_path):
    run_all(blocks(TUTORIAL), tmp_path)


@pytest.mark.parametrize("recipe", sections(RECIPES))
def test_each_recipe_runs_in_a_folder_of_its_own(recipe, tmp_path):
    run_all([*first_cfg(), *blocks(RECIPES, sections(RECIPES)[recipe])], tmp_path)


@pytest.mark.parametrize("page", OTHERS)
def test_the_blocks_of_other_pages_run(page, tmp_path):
    run_all([*first_cfg(), *blocks(page)], tmp_path)
