"""Annotation of a 640 x 480 frame of the 30,000-rock scene: seconds, by what is asked for.

    python studies/benchmarks/frame.py [CFG]

Everything is loaded; what is timed is what each further frame costs, whichever renderer draws it.
"""

from __future__ import annotations

import os
import statistics
import sys
import tempfile
from pathlib import Path

from scenec.backends.run.session import Session
from scenec.compiler.compile import compile_cfg

ROOT = Path(__file__).resolve().parents[2]
REPEAT = 4
PASSES = ("label", "instance", "depth", "range", "normal", "position", "face")


def main() -> None:
    """Prints the table."""
    cfg = Path(sys.argv[1]) if len(sys.argv) > 1 else ROOT / "configs" / "jacksboro.json"
    with tempfile.TemporaryDirectory() as folder:
        out = compile_cfg(cfg, seed=1, out=Path(folder) / "out").out
        print(f"{cfg.name}, {os.cpu_count()} cores, {REPEAT} rounds over all samples")
        print(f"{'passes':40}{'median':>8}{'worst':>8}")
        for passes in (("depth",), ("label", "instance", "depth"), (*PASSES, "amodal")):
            measure(out / "batch_0000" / "stage.usda", passes)


def measure(stage: Path, wanted: tuple[str, ...]) -> None:
    """Prints one row: seconds of all frames but those of the first round, which compiles."""
    session = Session.open(stage, "annotation")
    passes = session.passes(wanted, session.scene.cameras[0][0])
    rows: list[float] = []
    for turn in range(REPEAT + 1):
        for sample, cameras in enumerate(session.scene.cameras):
            _, details = session.render(cameras[0], sample, passes, 0, 0)
            if turn:
                steps = details["seconds"]
                rows.append(steps["annotate"] + steps.get("instances", 0.0))
    print(f"{','.join(wanted):40}{statistics.median(rows):8.3f}{max(rows):8.3f}")


if __name__ == "__main__":
    main()
