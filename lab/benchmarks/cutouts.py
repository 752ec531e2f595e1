"""A tree of masked cards beside the same tree as geometry: seconds, memory, agreement.

    python lab/benchmarks/cutouts.py [--cards 20000] [--width 640] [--height 480] [--spp 16]

Each card is a square of two triangles whose picture of opacity leaves a disk; the same leaf as
geometry is a fan of 30 triangles. CPU seconds, each in a process of its own. Alike are pixels in
which both trees show the same leaf, or none; contours run through the others.
"""

from __future__ import annotations

import dataclasses
import tempfile
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from PIL import Image

from scenec.backends.camera.rays import camera_rays
from scenec.backends.exact import ExactCaster
from scenec.backends.registry import open_backend
from scenec.backends.stage.scene import Maps, RenderScene
from scenec.backends.testing.scenes import (
    dome,
    look_at,
    mesh,
    plane,
    rotation,
    scene,
    sun,
    surface,
    with_lights,
)
from scenec.lab.runner import Study, apart, run

SIDES, TEXELS, LEAF_M = 32, 64, 0.12
RENDERERS = ("mitsuba", "cycles", "pyrender")


def tree(folder: Path, cards: int, masked: bool, width: int, height: int) -> RenderScene:
    """A crown of leaves over ground, all leaves in one mesh."""
    rng = np.random.default_rng(1)
    # Even over a ball.
    ways = rng.normal(size=(cards, 3))
    ways *= (rng.uniform(size=(cards, 1)) ** (1 / 3)) / np.linalg.norm(ways, axis=1)[:, None]
    turns = np.stack([rotation(rng) for _ in range(cards)])
    if masked:
        flat, faces = plane(1.0)
    else:
        angle = 2.0 * np.pi * np.arange(SIDES) / SIDES
        flat = np.stack([np.cos(angle), np.sin(angle), 0.0 * angle], axis=1)
        fan = np.arange(1, SIDES - 1)
        faces = np.stack([0 * fan, fan, fan + 1], axis=1)
    own = flat[None] * LEAF_M / 2 @ turns.transpose(0, 2, 1)
    points = (own + 1.5 * ways[:, None] + [0.0, 0.0, 3.0]).reshape(-1, 3)
    every = (faces[None] + len(flat) * np.arange(cards)[:, None, None]).reshape(-1, 3)
    crown, leaf = mesh(points, every, (1,)), surface((0.1, 0.3, 0.05))
    if masked:
        file = folder / "leaf.png"
        y, x = np.mgrid[:TEXELS, :TEXELS] + 0.5 - TEXELS / 2
        alpha = np.clip(0.5 + (TEXELS / 2 - np.hypot(x, y)) / 4, 0.0, 1.0)
        Image.fromarray(np.rint(255 * alpha).astype(np.uint8)).save(file)
        uv = np.tile((flat[faces][..., :2] + 1.0) / 2.0, (cards, 1, 1)).astype(np.float32)
        wrap = ("clamp", "clamp")
        maps = Maps(1.0, projection="uv", opacity=file, opacity_threshold=0.5, opacity_wrap=wrap)
        crown = dataclasses.replace(crown, uv=uv)
        leaf = dataclasses.replace(leaf, maps=maps)
    made = scene(
        [mesh(*plane(20.0)), crown],
        [surface(), leaf],
        cameras=[look_at((0, -6, 3), (0, 0, 3), width, height, 45.0)],
    )
    return with_lights(made, [sun(40.0, 200.0), dome(1.0)])


def cast(cards: int, masked: bool, width: int, height: int) -> NDArray[np.int64]:
    """Which leaf each pixel shows, -1: none; the caster's trees are part of it."""
    with tempfile.TemporaryDirectory() as folder:
        made = tree(Path(folder), cards, masked, width, height)
        row, face, _ = ExactCaster(made).cast(camera_rays(made.cameras[0][0]))
    return np.where(row == 1, face // (2 if masked else SIDES - 2), -1)


def render(
    cards: int, masked: bool, width: int, height: int, name: str, spp: int
) -> NDArray[np.float64]:
    """Mean light of a picture."""
    with tempfile.TemporaryDirectory() as folder:
        made = tree(Path(folder), cards, masked, width, height)
        backend = open_backend(name, "cpu")
        backend.load(made)
        found = backend.radiance(made.cameras[0][0], 0, spp, 1).halves
    return found.mean(axis=(0, 1, 2), dtype=np.float64)


def main(study: Study) -> None:
    """Prints the table."""
    options = study.options
    cards = options.cards // 20 if study.fast else options.cards
    size = (options.width, options.height)
    rows = []
    for name in ("annotation", *RENDERERS):
        found = []
        for masked in (True, False):
            if name == "annotation":
                found.append(apart(cast, cards, masked, *size))
            else:
                found.append(apart(render, cards, masked, *size, name, options.spp))
        one, other = found
        if name == "annotation":
            leaves = (one.value >= 0) | (other.value >= 0)
            alike = f"{100.0 * np.mean((one.value == other.value)[leaves]):.2f} % of leaves' pixels"
        else:
            alike = f"light {100.0 * (one.value.sum() / other.value.sum() - 1.0):+.2f} %"
        rows.append([name, one.cpu_s, other.cpu_s, one.peak_mib, other.peak_mib, alike])
    study.table(
        [f"{cards:,} leaves", "CPU s, cards", "geometry", "MiB, cards", "geometry", "alike"], rows
    )


if __name__ == "__main__":
    run(main, cards=20_000, width=640, height=480, spp=16)
