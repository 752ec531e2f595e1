"""Writes assets/models/*.glb.

    .venv/bin/python lab/models/make.py [--table] [NAME ...]

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
from scenec.lab.models.glb import Card, Model, encode, triangles

FOLDER = Path(__file__).resolve().parents[2] / "assets" / "models"

#: What makes each model, and its suggested label on the level ``class``.
MODELS: dict[str, tuple[Callable[[], Model], str]] = {
    name: (getattr(room, name), label) for room, label, names in (
        (grasses, "grass", "grass_short grass_tall grass_seeding grass_dry grass_fine"),
        (grasses, "fern", "fern"),
        (grasses, "litter", "litter"),
        (grasses, "flower", "clover daisy poppy"),
        (trees, "shrub", "hazel hazel_young"),
        (woody, "shrub", "rose"),
        (conifer, "shrub", "juniper"),
        (trees, "tree", "oak oak_young oak_old birch birch_young birch_old spruce spruce_young "
                        "spruce_old pine pine_old"),
        (woody, "tree", "snag"),
        (woody, "dead_wood", "log"),
        (stones, "stone", "stone_weathered stone_angular stone_rounded stone_slab stone_vesicular"),
        (farm, "wall", "boulder_wall"),
        (farm, "fence", "fence_panel fence_post gate"),
        (farm, "bale", "hay_bale"),
        (farm, "building", "shed"),
        (farm, "bench", "bench"),
        (street, "pallet", "pallet"),
        (street, "drum", "oil_drum"),
        (street, "cone", "traffic_cone"),
        (street, "pole", "delineator street_lamp"),
        (street, "sign", "sign_stop sign_give_way sign_speed_limit"),
        (vehicles, "car", "car"),
        (vehicles, "tractor", "tractor"),
        (person, "person", "person"),
        (vehicles, "rover", "rover"),
        (props, "lander", "lander"),
        (props, "target", "calibration_board"),
        (boards, "target", "apriltag_board sphere_gray sphere_mirror"),
    ) for name in names.split()
}  # fmt: skip


def made(name: str) -> tuple[Model, Card]:
    """A model and what its file says of itself: the first line of its maker's docstring."""
    maker, label = MODELS[name]
    return maker(), Card((maker.__doc__ or "").splitlines()[0].rstrip("."), label)


def main(arguments: list[str]) -> None:
    """Writes the files, or prints their rows."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0] if __doc__ else None)
    parser.add_argument("--table", action="store_true", help="write nothing; print the page's rows")
    parser.add_argument("names", nargs="*", metavar="NAME", help="models; all when none is named")
    options = parser.parse_args(arguments)
    unknown = [name for name in options.names if name not in MODELS]
    if unknown:
        parser.error(f"no model {unknown[0]!r}: expected one of {', '.join(MODELS)}")
    for name in options.names or MODELS:
        model, card = made(name)
        if options.table:
            print(_row(name, model, card))
            continue
        data = encode(model, card)
        (FOLDER / f"{name}.glb").write_bytes(data)
        parts = ", ".join(dict.fromkeys(key for key, _, _ in model.meshes()))
        print(f"{name}: {triangles(model)} triangles, {len(data)} bytes, {parts}")


def _row(name: str, model: Model, card: Card) -> str:
    """What the page says of a model."""
    size = " × ".join(f"{extent:.2f}" for extent in model.size())
    named = {key: part.material for key, part, _ in model.meshes()}
    parts = ", ".join(f"`{key}` ({material})" for key, material in named.items())
    return f"| `{name}.glb` | {card.about} | {size} | {parts} | {triangles(model):,} |"


if __name__ == "__main__":
    main(sys.argv[1:])
