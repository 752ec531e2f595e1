"""A wheel built from the checkout is whole, and works outside it with its package data."""

from __future__ import annotations

import os
import shutil
import sys
import sysconfig
import tarfile
import zipfile
from pathlib import Path

import pytest

from scenec.testing.processes import ran

ROOT = Path(__file__).resolve().parents[2]
LAYERS = ("schemas", "compiler", "backends", "datasets", "quality", "settle", "importers", "api",
          "cli")  # fmt: skip
#: Folders that come whole.
DATA = ("assets", "configs")
#: What stays in the checkout.
KEPT = ("testing", "lab")
#: What the source distribution and the build need of the checkout.
SOURCES = (*LAYERS, *DATA, *KEPT, "src", "pyproject.toml", "README.md", "LICENSE")
PROGRAM = """
import json, sys
from importlib.resources import files
import scenec.schemas.errors as errors
schema = json.loads((files("scenec.schemas") / "cfg.schema.json").read_text())
assert schema["$schema"].endswith("2020-12/schema"), schema["$schema"]
import scenec.backends.contract, scenec.compiler.scene.scene
from scenec.compiler.cfg.load import load
from scenec.compiler.cfg.resources import find_file
assert load(find_file("package:configs/mars_yard.json", None)).files
assert find_file("package:assets/models/oak.glb", None).is_file()
print(errors.__file__)
"""

#: Types of what is made when it is asked for.
STUB = "compiler/cfg/builder.pyi"

#: A kernel's answer, and whether it was read.
KERNEL = """
from scenec.schemas import kernels
from scenec.compiler.arithmetic.elementary import exp
loaded = []
load = kernels._FileCache.load_overload
kernels._FileCache.load_overload = lambda *given: loaded.append(load(*given)) or loaded[-1]
print(float(exp(0.3)).hex(), all(loaded))
"""

pytestmark = [pytest.mark.slow, pytest.mark.invariant]


def run(*command: str | Path, cwd: Path, **environment: str) -> str:
    done = ran(*command, cwd=cwd, env={**os.environ, **environment})
    assert done.returncode == 0, done.stdout + done.stderr
    return done.stdout


@pytest.fixture(scope="module")
def built(tmp_path_factory):
    """A wheel and an sdist, built from a copy so that no build/ stays in the checkout."""
    copy = tmp_path_factory.mktemp("checkout")
    for name in SOURCES:
        source = ROOT / name
        if source.is_dir():
            ignored = shutil.ignore_patterns("__pycache__", "*.egg-info")
            shutil.copytree(source, copy / name, symlinks=True, ignore=ignored)
        else:
            shutil.copy2(source, copy / name)
    compiled = run(sys.executable, "-c", KERNEL, cwd=copy, NUMBA_CACHE_DIR=str(copy / "kept"))
    assert compiled.endswith("False\n")
    (copy / "kept" / "scenec").rename(copy / "schemas" / "compiled")
    # As `make wheel` writes it.
    (copy / STUB).write_text("def read(path: str) -> object: ...\n")
    run(sys.executable, "-m", "build", "--no-isolation", "--wheel", "--sdist", cwd=copy)
    return copy / "dist"


def modules() -> set[str]:
    """Every file that a wheel must hold, as its name inside the wheel."""
    names = {f"scenec/{path.name}" for path in (ROOT / "src" / "scenec").glob("*.py")}
    for layer in LAYERS:
        for path in (ROOT / layer).rglob("*"):
            shipped = path.suffix in (".py", ".json", ".vert", ".frag", ".html", ".css", ".js")
            name = str(path.relative_to(ROOT))
            if shipped and "__pycache__" not in path.parts:
                names.add(f"scenec/{name}")
    data = (path for folder in DATA for path in (ROOT / folder).rglob("*") if path.is_file())
    return names | {f"scenec/{path.relative_to(ROOT)}" for path in data}


def test_the_wheel_holds_every_module_and_schema_and_nothing_else(built):
    (wheel,) = built.glob("*.whl")
    with zipfile.ZipFile(wheel) as archive:
        names = {name for name in archive.namelist() if ".dist-info/" not in name}
        metadata = {name.partition(".dist-info/")[2] for name in archive.namelist()}
    compiled = {name for name in names if "/compiled/" in name}
    assert names - compiled == modules() | {f"scenec/{STUB}"}
    assert len(compiled) == 1
    assert "scenec/schemas/cfg.schema.json" in names
    assert {"METADATA", "entry_points.txt", "licenses/LICENSE"} <= metadata


def test_the_source_distribution_holds_every_module_and_schema(built):
    (sdist,) = built.glob("*.tar.gz")
    with tarfile.open(sdist) as archive:
        names = {member.name.split("/", 1)[-1] for member in archive.getmembers()}
    assert {f"src/{name}" for name in modules()} <= names


def test_the_installed_wheel_works_outside_the_checkout(built, tmp_path):
    (wheel,) = built.glob("*.whl")
    venv = tmp_path / "venv"
    run(sys.executable, "-m", "venv", "--without-pip", venv, cwd=tmp_path)
    site = next((venv / "lib").glob("python3*")) / "site-packages"
    install = ["-m", "pip", "--python", str(venv / "bin" / "python"), "install"]
    options = ["--quiet", "--no-deps", "--no-index"]
    run(sys.executable, *install, *options, wheel, cwd=tmp_path)
    # The plain path, not site.addsitedir: the .pth files of the running environment, the editable
    # install of scenec among them, are not followed.
    (site / "dependencies.pth").write_text(sysconfig.get_path("purelib") + "\n")

    isolated = {"PYTHONPATH": "", "NUMBA_CACHE_DIR": str(tmp_path / "numba")}
    where = run(venv / "bin" / "python", "-c", PROGRAM, cwd=tmp_path, **isolated)
    assert Path(where.strip()).is_relative_to(site)
    # A kernel that the wheel brings is read where nothing can be written.
    isolated["NUMBA_CACHE_DIR"] = "/dev/null/kernels"
    here = run(sys.executable, "-c", KERNEL, cwd=tmp_path, **isolated)
    there = run(venv / "bin" / "python", "-c", KERNEL, cwd=tmp_path, **isolated)
    assert (here.split()[0], there.split()[1]) == (there.split()[0], "True")
    usage = run(venv / "bin" / "scenec", "--help", cwd=tmp_path, **isolated)
    assert "usage: scenec" in usage.lower()
    assert "render" in usage
