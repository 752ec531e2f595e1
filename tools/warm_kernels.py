"""Compiles kernels before they are asked for: ``python tools/warm_kernels.py [--all]``.

Two processes, one for the compiler and one for annotation, do small work that needs the kernels
which nearly every scene needs; ``--all`` goes on with all cfgs that ship, as ``make wheel`` does.
What is compiled is kept in ``scenec.schemas.kernels.user_folder()``. Where that holds kernels of
this very text already, nothing is done. A failure is none of a user's: what is missing is compiled
when it is called.
"""

from __future__ import annotations

import hashlib
import json
import subprocess
import sys
import tempfile
from importlib.metadata import version
from pathlib import Path
from typing import Any

from scenec.schemas.kernels import user_folder

ROOT = Path(__file__).resolve().parents[1]
CONFIGS = ROOT / "configs"
_COMPILE = """
import sys
from scenec.compiler.compile import compile_cfg
compile_cfg(sys.argv[1], seed=1, out=sys.argv[2])
"""
_RENDER = """
import sys
from scenec.backends.run.render import render
passes = sys.argv[3].split(",")
report = render(sys.argv[1], sys.argv[2], spp=2 if "rgb" in passes else None, passes=passes)
sys.exit(not report.rendered)
"""
#: A ground that is not convex, two stones, a camera and a sun: all that annotation tells apart.
_STAGE = """#usda 1.0
(
    defaultPrim = "World"
    endTimeCode = 0
    metersPerUnit = 1
    startTimeCode = 0
    upAxis = "Z"
)
def Xform "World"
{
    def Mesh "Ground"
    {
        int[] faceVertexCounts = [5]
        int[] faceVertexIndices = [0, 1, 2, 3, 4]
        point3f[] points = [(-9, -9, 0), (9, -9, 0), (9, 9, 0), (0, 2, 0), (-9, 9, 0)]
        uniform token subdivisionScheme = "none"
    }
    def PointInstancer "Stones"
    {
        int64[] ids = [1, 2]
        quath[] orientations = [(1, 0, 0, 0), (0, 0, 1, 0)]
        point3f[] positions = [(0, 0, 0.5), (1, 1, 0.5)]
        rel prototypes = </World/Stones/Stone>
        int[] protoIndices = [0, 0]
        float3[] scales = [(1, 1, 1), (2, 2, 2)]
        def Mesh "Stone"
        {
            int[] faceVertexCounts = [3, 3, 3, 3]
            int[] faceVertexIndices = [0, 2, 1, 0, 1, 3, 1, 2, 3, 2, 0, 3]
            point3f[] points = [(0, 0, 0), (1, 0, 0), (0, 1, 0), (0, 0, 1)]
            uniform token subdivisionScheme = "none"
        }
    }
    def Camera "Camera"
    {
        float focalLength = 0.36
        float horizontalAperture = 0.36
        float verticalAperture = 0.27
        double3 xformOp:translate = (0, 0, 8)
        uniform token[] xformOpOrder = ["xformOp:translate"]
    }
    def DistantLight "Sun"
    {
        float inputs:intensity = 10
    }
}
"""


def small_cfg() -> dict[str, Any]:
    """The demo without its elevation model and most of its rocks."""
    cfg: dict[str, Any] = json.loads((CONFIGS / "jacksboro.json").read_text(encoding="utf-8"))
    cfg["samples"] = 2
    cfg["terrain"]["size_m"] = [60, 60]
    cfg["terrain"]["relief"] = [
        {"type": "plane"}, *(o for o in cfg["terrain"]["relief"] if o["type"] != "dem")
    ]  # fmt: skip
    for objects in cfg.get("objects", {}).values():
        if "count" in objects:
            objects["count"] = 300
    return cfg


def digest() -> str:
    """Of all source files and of what compiles them."""
    found = hashlib.sha256(f"{sys.version} {version('numba')} {version('numpy')}".encode())
    for layer in ("schemas", "compiler", "backends"):
        for file in sorted((ROOT / layer).rglob("*.py")):
            source = file.read_bytes()
            if b"@kernel" in source or b"@inlined" in source:
                found.update(source)
    return found.hexdigest()[:16]


def started(code: str, *arguments: object) -> subprocess.Popen[bytes]:
    """A process that runs a program."""
    words = [sys.executable, "-c", code, *map(str, arguments)]
    return subprocess.Popen(words, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)


def main() -> None:
    """Runs the jobs, two at a time."""
    everything = "--all" in sys.argv[1:]
    stamp = user_folder() / f".warm-{digest()}{'-all' * everything}"
    if stamp.exists():
        return
    with tempfile.TemporaryDirectory() as scratch:
        place = Path(scratch)
        cfg, stage = place / "cfg.json", place / "stage.usda"
        cfg.write_text(json.dumps(small_cfg()), encoding="utf-8")
        stage.write_text(_STAGE, encoding="utf-8")
        jobs = [
            started(_RENDER, stage, "annotation", "label,instance,depth"),
            started(_COMPILE, cfg, place / "out"),
        ]
        statuses = [job.wait() for job in jobs]
        for file in sorted(CONFIGS.glob("*.json")) if everything else ():
            out = place / file.stem
            statuses.append(started(_COMPILE, file, out).wait())
            passes = "label,instance,depth,normal,amodal"
            statuses.append(started(_RENDER, out, "annotation", passes).wait())
            statuses += [started(_RENDER, out, b, "rgb").wait() for b in ("mitsuba", "pyrender")]
    if not any(statuses):
        stamp.parent.mkdir(parents=True, exist_ok=True)
        stamp.touch()


if __name__ == "__main__":
    main()
