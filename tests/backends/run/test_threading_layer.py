"""No kernel makes numba load a threading layer, so that Blender's libraries load beside kernels."""

from __future__ import annotations

import importlib.util
import os
import subprocess
import sys
from pathlib import Path

import pytest

from scenec.backends.run.doctor import diagnose

TESTS = Path(__file__).resolve().parents[2]
#: Debian's and Ubuntu's; OpenCV and ROS bring it.
TBB = "libtbb.so.12"


def has_system_tbb() -> bool:
    """Asked in another process: to look for it is to load it."""
    code = f"import ctypes; ctypes.CDLL({TBB!r})"
    return subprocess.run([sys.executable, "-c", code], capture_output=True).returncode == 0


needs_both = pytest.mark.skipif(
    importlib.util.find_spec("bpy") is None or not has_system_tbb(),
    reason=f"needs Blender, and a {TBB} of the system's",
)

#: An output with a sky of an atmosphere, silhouettes, a lens and a rolling shutter: all kernels.
_ALL_KERNELS = """
import sys
from pathlib import Path
import numba
from scenec.testing.small import small_cfg, write_cfg
from workers_here import here
from scenec.backends.run.render import render
from scenec.compiler.compile import compile_cfg

folder = Path(sys.argv[1])
cfg = small_cfg(samples=1)
cfg["light"]["sky"] = {
    "type": "atmosphere", "planet": "earth", "resolution": 16, "scattering": "multiple",
    "labels": cfg["light"]["sky"]["labels"],
}
compile_cfg(write_cfg(folder, cfg), seed=1, out=folder / "out")
with here():
    render(folder / "out", "reference", passes=["depth", "label", "amodal", "normal"])
try:
    print(numba.threading_layer())
except ValueError:
    print("none")
"""


def run(code: str, *arguments: object) -> str:
    done = subprocess.run(
        [sys.executable, "-c", code, *map(str, arguments)],
        env={**os.environ, "PYTHONPATH": str(TESTS)},
        capture_output=True,
        text=True,
    )
    assert done.returncode == 0, done.stderr
    return done.stdout.strip()


def test_no_kernel_makes_numba_load_a_threading_layer(tmp_path: Path) -> None:
    assert run(_ALL_KERNELS, tmp_path) == "none"


@needs_both
def test_blender_loads_after_kernels_beside_a_tbb_of_the_systems() -> None:
    code = """
import numpy as np
from scenec.backends.cycles.blender import load_bpy
from scenec.compiler.noise.fractal import fbm2_points

fbm2_points(np.uint64(5), np.zeros(10_000), np.zeros(10_000), 7.0, 6, 0.5, 2.1, 0.4)
print(load_bpy().app.version_string)
"""
    assert run(code)


@needs_both
def test_doctor_names_another_tbb_that_is_loaded_already(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("LD_PRELOAD", TBB)
    (found,) = diagnose(("cycles",))
    assert not found.works
    assert TBB in found.message
    assert "load Blender before" in found.message
    assert "pip install" not in found.message
