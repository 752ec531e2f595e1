"""Writes assets/models/*.glb, or says whether the files there are what it makes.

    .venv/bin/python tools/models/make.py [--check | --table] [NAME ...]

Plants and props of scenec's own: nothing is read, every model is made from the numbers in this
folder. Files are the same bytes each time; across machines ``--check`` allows for rounding.
``--table`` prints the rows of assets/models/README.md.
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Callable
from pathlib import Path

import conifer
import grasses
import numpy as np
import props
import woody
from glb import Model, encode, same, triangles

FOLDER = Path(__file__).resolve().parents[2] / "assets" / "models"

MODELS: dict[str, Callable[[], Model]] = {
    "grass_short": grasses.grass_short,
    "grass_tall": grasses.grass_tall,
    "grass_seeding": grasses.grass_seeding,
    "clover": grasses.clover,
    "daisy": grasses.daisy,
    "poppy": grasses.poppy,
    "hazel": woody.hazel,
    "rose": woody.rose,
    "oak": woody.oak,
    "birch": woody.birch,
    "spruce": conifer.spruce,
    "log": woody.log,
    "calibration_board": props.calibration_board,
    "lander": props.lander,
}


def main(arguments: list[str]) -> int:
    """Writes or checks; returns the exit status."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0] if __doc__ else None)
    parser.add_argument(
        "--check", action="store_true", help="write nothing; compare with the files"
    )
    parser.add_argument("--table", action="store_true", help="write nothing; print the page's rows")
    parser.add_argument("names", nargs="*", metavar="NAME", help="models; all when none is named")
    options = parser.parse_args(arguments)
    unknown = [name for name in options.names if name not in MODELS]
    if unknown:
        parser.error(f"no model {unknown[0]!r}: expected one of {', '.join(MODELS)}")
    stale = 0
    for name in options.names or MODELS:
        file = FOLDER / f"{name}.glb"
        model = MODELS[name]()
        if options.table:
            print(_row(name, model))
            continue
        data = encode(model)
        if options.check:
            fresh = file.is_file() and same(file.read_bytes(), data)
            stale += not fresh
            print(f"{name}: {'as made' if fresh else 'differs: run tools/models/make.py'}")
            continue
        FOLDER.mkdir(parents=True, exist_ok=True)
        file.write_bytes(data)
        print(f"{name}: {triangles(model)} triangles, {len(data)} bytes, {', '.join(model.parts)}")
    return 1 if stale else 0


def _row(name: str, model: Model) -> str:
    """What the page says of a model."""
    points = np.concatenate([part.points for part in model.parts.values()])
    size = " × ".join(f"{extent:.2f}" for extent in np.ptp(points, axis=0))
    parts = ", ".join(f"`{key}` ({part.material})" for key, part in model.parts.items())
    what = (MODELS[name].__doc__ or "").splitlines()[0].rstrip(".")
    return f"| `{name}.glb` | {what} | {size} | {parts} | {triangles(model):,} |"


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
