"""``import scenec`` costs nothing, and gives what the commands call."""

from __future__ import annotations

import subprocess
import sys

import pytest

import scenec

PROGRAM = """
import sys
import scenec
assert scenec.__version__ and "compile" in dir(scenec)
print(*sorted({name.partition(".")[0] for name in sys.modules} - sys.stdlib_module_names))
print(*sorted(name for name in sys.modules if name.startswith("scenec.api")))
"""


def test_importing_scenec_imports_nothing_but_itself():
    done = subprocess.run(
        [sys.executable, "-I", "-c", PROGRAM], capture_output=True, text=True, check=True
    )
    packages, modules = done.stdout.splitlines()
    assert {"numpy", "numba", "pxr", "scipy", "PIL"}.isdisjoint(packages.split())
    assert "scenec" in packages.split()
    assert modules == ""


@pytest.mark.parametrize("name", scenec.__all__)
def test_each_public_name_is_what_its_module_documents(name):
    found = getattr(scenec, name)
    assert found.__module__ == f"scenec.api.{scenec._HOMES[name]}"
    assert found.__doc__
    assert name in dir(scenec)


def test_every_public_name_has_a_home_and_a_type():
    assert sorted(scenec._HOMES) == sorted(scenec.__all__)


def test_what_there_is_not_is_said():
    with pytest.raises(AttributeError, match="'scenec' has no attribute 'rendre'"):
        _ = scenec.rendre
