"""Annotation of a 640 x 480 frame of the 30,000-rock scene: seconds of each step, per backend.

    python benchmarks/bench_frame.py [CFG]

Everything is loaded; what is timed is what each further frame costs: visibility by the renderer,
resolving it exactly, and all annotation the cfg asks for. The last column says how many pixels of a
frame the renderer itself had wrong.
"""

from __future__ import annotations

import os
import statistics
import sys
import tempfile
from pathlib import Path

from scenec.backends.session import Session
from scenec.compiler.compile import compile_cfg

ROOT = Path(__file__).resolve().parent.parent
REPEAT = 4


def main() -> None:
    """Prints the table."""
    cfg = Path(sys.argv[1]) if len(sys.argv) > 1 else ROOT / "configs" / "jacksboro.json"
    with tempfile.TemporaryDirectory() as folder:
        out = compile_cfg(cfg, seed=1, out=Path(folder) / "out").out
        print(f"{cfg.name}, {os.cpu_count()} cores, {REPEAT} rounds over all samples")
        print(
            f"{'backend':12}{'visibility':>12}{'resolve':>10}{'both':>8}{'worst':>8}{'changed':>9}"
        )
        for backend in ("mitsuba", "reference"):
            measure(out / "batch_0000" / "stage.usda", backend)


def measure(stage: Path, backend: str) -> None:
    """Prints one row: medians over all frames but the first round, which compiles."""
    session = Session.open(stage, backend)
    passes = session.passes(("label", "instance", "depth"), session.scene.cameras[0][0])
    rows: list[tuple[float, float]] = []
    changed = 0
    for turn in range(REPEAT + 1):
        for sample, cameras in enumerate(session.scene.cameras):
            _, details = session.render(cameras[0], sample, passes, 0, 0)
            if turn:
                seconds = details["seconds"]
                rows.append((seconds.get("visibility", 0.0), seconds["resolve"]))
                changed += details["resolver"]["changed"]
    visibility, resolve = (statistics.median(column) for column in zip(*rows, strict=True))
    worst = max(map(sum, rows))
    print(
        f"{backend:12}{visibility:12.3f}{resolve:10.3f}{visibility + resolve:8.3f}{worst:8.3f}"
        f"{changed / REPEAT / len(session.scene.cameras):9.1f}"
    )


if __name__ == "__main__":
    main()
