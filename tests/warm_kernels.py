"""Fills an empty folder of kernels before the tests start: ``python tests/warm_kernels.py``.

Two test processes that start without one meet the same kernels in the same order, and each compiles
all of them. Here one process compiles those of the compiler while another compiles those of the
backends; after that both find nearly everything. Where a cache is there, this does nothing.
"""

from __future__ import annotations

import os
import subprocess
import sys
import tempfile
from pathlib import Path

from scenec.schemas.kernels import user_folder

TESTS = Path(__file__).resolve().parent
#: Disjoint: neither needs kernels of the other but a few small ones.
JOBS = {
    "compiler": """
from small import small_cfg, write_cfg
from scenec.compiler.compile import compile_cfg
compile_cfg(write_cfg(folder, small_cfg(samples=1)), seed=1, out=folder / "out")
""",
    "backends": """
from third_party import square_stage
from scenec.backends.run.render import render
stage = square_stage(folder / "square.usda", samples=1)
render(stage, "mitsuba", spp=2, passes=["rgb", "depth", "instance", "face", "normal", "amodal"])
""",
}


def is_cold() -> bool:
    """Whether no kernel has been kept."""
    return not any(user_folder().glob("*"))


def main() -> None:
    """Runs all jobs side by side. What fails here fails in a test, too, which says it better."""
    with tempfile.TemporaryDirectory() as scratch:
        running = []
        for name, job in JOBS.items():
            folder = Path(scratch, name)
            folder.mkdir()
            code = f"from pathlib import Path\nfolder = Path({str(folder)!r})\n{job}"
            paths = os.pathsep.join([str(TESTS), str(TESTS / "backends")])
            environment = {**os.environ, "SCENEC_CACHE": "", "PYTHONPATH": paths}
            running.append(
                subprocess.Popen(
                    [sys.executable, "-c", code],
                    env=environment,
                    stdout=subprocess.DEVNULL,
                    stderr=subprocess.DEVNULL,
                )
            )
        for process in running:
            process.wait()


if __name__ == "__main__":
    if is_cold():
        print("== Compiling the kernels that most tests need", flush=True)
        main()
