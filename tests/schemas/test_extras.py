"""What is said of extras whose wheels are not there for every Python."""

from __future__ import annotations

import sys
import tomllib
from pathlib import Path

import pytest
from packaging.markers import default_environment
from packaging.requirements import Requirement

from scenec.schemas.extras import PYTHONS, install

PROJECT = tomllib.loads((Path(__file__).parents[2] / "pyproject.toml").read_text())["project"]
#: Those that scenec works with.
ALL = ((3, 12), (3, 13), (3, 14))


def served(extra: str) -> tuple[tuple[int, int], ...]:
    """Pythons on which all that an extra names is installed, by the markers of its packages."""
    needs = [Requirement(text) for text in PROJECT["optional-dependencies"][extra]]

    def has_all(version: tuple[int, int]) -> bool:
        name = f"{version[0]}.{version[1]}"
        where = {
            **default_environment(),
            "python_version": name,
            "python_full_version": f"{name}.1",
        }
        return all(need.marker is None or need.marker.evaluate(where) for need in needs)

    return tuple(version for version in ALL if has_all(version))


def test_pythons_of_extras_are_those_of_pyproject():
    found = {extra: served(extra) for extra in PROJECT["optional-dependencies"]}
    assert {extra: pythons for extra, pythons in found.items() if pythons != ALL} == PYTHONS


@pytest.mark.parametrize(
    ("here", "text"),
    [
        ((3, 13, 0), "pip install 'scenec[cycles]'"),
        ((3, 12, 9), "pip install 'scenec[cycles]', with Python 3.13 (there is no wheel for 3.12)"),
    ],
)
def test_a_python_that_an_extra_has_no_wheel_for_is_named(here, text, monkeypatch):
    monkeypatch.setattr(sys, "version_info", here)
    assert install("cycles") == text


def test_what_works_with_every_python_says_nothing_of_it(monkeypatch):
    monkeypatch.setattr(sys, "version_info", (3, 14, 0))
    assert install("mitsuba") == "pip install 'scenec[mitsuba]'"
