"""Writes assets/models/*.glb, or says whether the files there are what it makes.

    .venv/bin/python lab/models/make.py [--check | --table] [NAME ...]

Plants, stones and things of scenec's own: nothing is read, every model is made from the numbers in
this folder, stones by the compiler. Files are the same bytes each time; across machines ``--check``
allows for rounding. ``--table`` prints the rows of assets/models/README.md.
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Callable
from pathlib import Path

from scenec.lab.models import (
    boards,
    conifer,
    farm,
    grasses,
    person,
    props,
    stones,
    street,
    trees,
    vehicles,
    woody,
)
from scenec.lab.models.glb import Card, Model, encode, same, triangles

FOLDER = Path(__file__).resolve().parents[2] / "assets" / "models"

#: What makes each model, and its suggested label on the level ``class``.
MODELS: dict[str, tuple[Callable[[], Model], str]] = {
    "grass_short": (grasses.grass_short, "grass"),
    "grass_tall": (grasses.grass_tall, "grass"),
    "grass_seeding": (grasses.grass_seeding, "grass"),
    "grass_dry": (grasses.grass_dry, "grass"),
    "grass_fine": (grasses.grass_fine, "grass"),
    "fern": (grasses.fern, "fern"),
    "litter": (grasses.litter, "litter"),
    "clover": (grasses.clover, "flower"),
    "daisy": (grasses.daisy, "flower"),
    "poppy": (grasses.poppy, "flower"),
    "hazel": (trees.hazel, "shrub"),
    "hazel_young": (trees.hazel_young, "shrub"),
    "rose": (woody.rose, "shrub"),
    "juniper": (conifer.juniper, "shrub"),
    "oak": (trees.oak, "tree"),
    "oak_young": (trees.oak_young, "tree"),
    "oak_old": (trees.oak_old, "tree"),
    "birch": (trees.birch, "tree"),
    "birch_young": (trees.birch_young, "tree"),
    "birch_old": (trees.birch_old, "tree"),
    "spruce": (trees.spruce, "tree"),
    "spruce_young": (trees.spruce_young, "tree"),
    "spruce_old": (trees.spruce_old, "tree"),
    "pine": (trees.pine, "tree"),
    "pine_old": (trees.pine_old, "tree"),
    "snag": (woody.snag, "tree"),
    "log": (woody.log, "dead_wood"),
    "stone_weathered": (stones.stone_weathered, "stone"),
    "stone_angular": (stones.stone_angular, "stone"),
    "stone_rounded": (stones.stone_rounded, "stone"),
    "stone_slab": (stones.stone_slab, "stone"),
    "stone_vesicular": (stones.stone_vesicular, "stone"),
    "boulder_wall": (farm.boulder_wall, "wall"),
    "fence_panel": (farm.fence_panel, "fence"),
    "fence_post": (farm.fence_post, "fence"),
    "gate": (farm.gate, "fence"),
    "hay_bale": (farm.hay_bale, "bale"),
    "shed": (farm.shed, "building"),
    "bench": (farm.bench, "bench"),
    "pallet": (street.pallet, "pallet"),
    "oil_drum": (street.oil_drum, "drum"),
    "traffic_cone": (street.traffic_cone, "cone"),
    "delineator": (street.delineator, "pole"),
    "street_lamp": (street.street_lamp, "pole"),
    "sign_stop": (street.sign_stop, "sign"),
    "sign_give_way": (street.sign_give_way, "sign"),
    "sign_speed_limit": (street.sign_speed_limit, "sign"),
    "car": (vehicles.car, "car"),
    "tractor": (vehicles.tractor, "tractor"),
    "person": (person.person, "person"),
    "rover": (vehicles.rover, "rover"),
    "lander": (props.lander, "lander"),
    "calibration_board": (props.calibration_board, "target"),
    "apriltag_board": (boards.apriltag_board, "target"),
    "sphere_gray": (boards.sphere_gray, "target"),
    "sphere_mirror": (boards.sphere_mirror, "target"),
}


def made(name: str) -> tuple[Model, Card]:
    """A model and what its file says of itself: the first line of its maker's docstring."""
    maker, label = MODELS[name]
    return maker(), Card((maker.__doc__ or "").splitlines()[0].rstrip("."), label)


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
        model, card = made(name)
        if options.table:
            print(_row(name, model, card))
            continue
        data = encode(model, card)
        if options.check:
            fresh = file.is_file() and same(file.read_bytes(), data)
            stale += not fresh
            print(f"{name}: {'as made' if fresh else 'differs: run lab/models/make.py'}")
            continue
        FOLDER.mkdir(parents=True, exist_ok=True)
        file.write_bytes(data)
        parts = ", ".join(dict.fromkeys(key for key, _, _ in model.meshes()))
        print(f"{name}: {triangles(model)} triangles, {len(data)} bytes, {parts}")
    return 1 if stale else 0


def _row(name: str, model: Model, card: Card) -> str:
    """What the page says of a model."""
    size = " × ".join(f"{extent:.2f}" for extent in model.size())
    named = {key: part.material for key, part, _ in model.meshes()}
    parts = ", ".join(f"`{key}` ({material})" for key, material in named.items())
    return f"| `{name}.glb` | {card.about} | {size} | {parts} | {triangles(model):,} |"


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
