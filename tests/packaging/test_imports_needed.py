"""A command imports what its work needs: no renderer to compile, no other renderer to render."""

from __future__ import annotations

import importlib.util
import os
from pathlib import Path

import pytest

from scenec.testing.processes import python, scenec
from scenec.testing.small import small_cfg, write_cfg

#: Packages that only one kind of work needs.
RENDERERS = {"mitsuba", "drjit", "bpy", "pyrender", "OpenGL", "moderngl"}
OTHERS = {"trimesh", "mujoco", "rasterio", "matplotlib", "torch", "h5py", "pyarrow", "rosbags"}
#: Leaves what a process and all below it imported, one file each: Python reads it at its start.
HOOK = """
import atexit, os, sys

def leave():
    names = sorted({name.partition(".")[0] for name in sys.modules})
    whole = sorted(name for name in sys.modules if name.startswith("scenec."))
    with open(os.path.join(os.environ["SEEN_MODULES"], str(os.getpid())), "w") as file:
        file.write("\\n".join([*names, *whole]))

atexit.register(leave)
end = os._exit

def ended(status):
    # Workers leave by it, past what atexit holds.
    leave()
    end(status)

os._exit = ended
"""


def imported(tmp_path: Path, *words: str) -> list[set[str]]:
    """What each Python process of a command had imported in the end."""
    hook, seen = tmp_path / "hook", tmp_path / f"seen_{len(list(tmp_path.iterdir()))}"
    hook.mkdir(exist_ok=True)
    seen.mkdir()
    (hook / "usercustomize.py").write_text(HOOK)
    (hook / "sitecustomize.py").write_text(HOOK)
    environment = os.environ | {"PYTHONPATH": str(hook), "SEEN_MODULES": str(seen)}
    done = scenec(*words, env=environment)
    assert done.returncode == 0, done.stderr
    found = [set(path.read_text().split()) for path in sorted(seen.iterdir())]
    assert any("scenec" in names for names in found)
    return found


@pytest.fixture(scope="module")
def compiled(tmp_path_factory):
    """An output, and what each process that compiled it had imported."""
    folder = tmp_path_factory.mktemp("compiled")
    cfg = small_cfg(samples=1, outputs=["rgb", "depth", "instance"])
    cfg["objects"]["rocks"] |= {"count": 20, "prototypes": 1, "subdivisions": 1}
    cfg["terrain"]["spacing_m"] = 0.5
    words = ["compile", str(write_cfg(folder, cfg)), "--seed", "1", "-o", str(folder / "out")]
    return folder / "out", imported(folder, *words)


#: What a command needs that has anything to compute.
HEAVY = {"numpy", "numba", "scipy", "pxr", "PIL", "OpenEXR", "jsonschema", "referencing"}


def test_help_imports_no_heavy_package(tmp_path):
    for names in imported(tmp_path, "--help"):
        assert not names & (RENDERERS | OTHERS | HEAVY)


@pytest.mark.parametrize("command", ["compile", "run"])
def test_a_command_says_what_it_reads_before_it_imports_what_takes_long(command):
    heavy = "{'numba', 'pxr', 'scipy'}"
    code = f"import sys, scenec.cli.{command}_command; print({heavy} & sys.modules.keys())"
    assert python("-c", code).stdout == "set()\n"


def test_compiling_imports_no_renderer_and_no_backend(compiled, tmp_path):
    out, processes = compiled
    for names in processes:
        assert not names & (RENDERERS | OTHERS)
        assert not {name for name in names if name.startswith("scenec.backends.")} - {
            "scenec.backends"
        }
    # And explaining it neither.
    for question in ([], ["--why", "rocks/1"]):
        for names in imported(tmp_path, "explain", str(out), *question):
            assert not names & (RENDERERS | OTHERS | {"numba", "scipy"})
            assert not {name for name in names if name.startswith("scenec.compiler.")}


def test_rendering_imports_neither_compiler_nor_other_renderers(compiled, tmp_path):
    words = ["render", str(compiled[0]), "--backend", "reference", "--passes", "depth,instance"]
    processes = imported(tmp_path, *words)
    assert any("scenec.backends.run.session" in names for names in processes)
    for names in processes:
        assert not names & (RENDERERS | OTHERS)
        assert not {name for name in names if name.startswith("scenec.compiler.")}


@pytest.mark.slow
@pytest.mark.invariant
@pytest.mark.parametrize(
    ("backend", "own"),
    [("mitsuba", {"mitsuba", "drjit"}), ("cycles", {"bpy"}), ("pyrender", {"pyrender", "OpenGL"})],
)
def test_a_renderer_is_imported_alone(backend, own, compiled, tmp_path):
    # Not imported to be asked: each has to be told of its platform, or its LLVM, before.
    if not all(map(importlib.util.find_spec, own)):
        pytest.skip(f"needs the extra {backend!r}")
    words = ["render", str(compiled[0]), "--passes", "rgb,depth", "--backend", backend]
    processes = imported(tmp_path, *words, "--spp", "2")
    assert any(names & own for names in processes)
    for names in processes:
        assert not names & (RENDERERS - own)
