"""``scenec --help`` imports nothing heavy: that is what lets it answer at once."""

from __future__ import annotations

import subprocess
import sys

HEAVY = ("numpy", "numba", "scipy", "pxr", "mitsuba", "drjit", "PIL", "OpenEXR", "jsonschema")
PROGRAM = """
import sys
from scenec.cli.main import main
try:
    main(["--help"])
except SystemExit as stop:
    assert not stop.code, stop.code
print("\\nLOADED", *sorted({name.partition(".")[0] for name in sys.modules}))
"""


def test_help_imports_no_heavy_package():
    done = subprocess.run(
        [sys.executable, "-c", PROGRAM], capture_output=True, text=True, check=False
    )
    assert done.returncode == 0, done.stderr
    assert "usage: scenec" in done.stdout.lower()
    loaded = set(done.stdout.split("\nLOADED")[1].split())
    assert "scenec" in loaded
    assert loaded.isdisjoint({*HEAVY, "bpy", "matplotlib", "rasterio", "referencing", "trimesh"})
