"""Shades: the albedo's variation is its noise and what the conditions of the ground add."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from scenec.compiler.build import BuildLog, build
from scenec.compiler.cfg.load import load
from scenec.compiler.draw import draw
from scenec.compiler.scene.ground import Ground
from scenec.testing.small import small_cfg, write_cfg


def ground(folder: Path, shades: list[dict] | None, slope: float = 0.0) -> Ground:
    cfg = small_cfg()
    cfg["terrain"]["relief"] = [{"type": "plane", "slope": [slope, 0.0]}]
    cfg["terrain"]["mesh"] = {"tolerance_px": 0}
    if shades is not None:
        cfg["terrain"]["shades"] = shades
    return build(draw(load(write_cfg(folder, cfg)), 5, 0), BuildLog()).ground


def varied(of: Ground) -> np.ndarray:
    return np.concatenate([tile.variation for tile in of.tiles])


def test_steep_ground_is_darker_by_what_the_shade_says_and_level_ground_is_as_it_was(tmp_path):
    slopes = {"type": "slope", "min_deg": 20, "softness_deg": 10, "over_m": 0}
    steep = [{"by": -0.6, "where": [slopes]}]
    for slope, part in ((0.0, 0.0), (np.tan(np.deg2rad(20.0)), 0.5), (1.0, 1.0)):
        noise, found = (varied(ground(tmp_path, s, slope)) for s in (None, steep))
        assert np.allclose(found, np.clip(noise - 0.6 * part, -1.0, 1.0), rtol=0, atol=1e-6)


def test_shades_add_up_and_stay_within_bounds(tmp_path):
    east = {"by": 2.0, "where": [{"type": "point", "x_m": 10, "y_m": 0, "max_m": 9}]}
    disk = {"by": -0.25, "where": [{"type": "point", "x_m": 0, "y_m": 0, "max_m": 5}]}
    both = ground(tmp_path, [east, disk])
    noise = varied(ground(tmp_path, None))
    x, y, _ = np.concatenate([tile.points + tile.translate for tile in both.tiles]).T
    added = 2.0 * (np.hypot(x - 10.0, y) <= 9.0) - 0.25 * (np.hypot(x, y) <= 5.0)
    # Vertices that labels cut in lie between samples on both sides of a bound.
    sharp = np.abs(np.hypot(x - 10.0, y) - 9.0) + 0.0 > 0.3
    sharp &= np.abs(np.hypot(x, y) - 5.0) > 0.3
    assert np.allclose(varied(both)[sharp], np.clip(noise + added, -1, 1)[sharp], atol=1e-6)
    assert np.abs(varied(both)).max() == 1.0


def test_shades_move_neither_points_nor_labels(tmp_path):
    steep = [{"by": 1.5, "where": [{"type": "noise", "scale_m": 4, "min": 0}]}]
    for bare, shaded in zip(
        ground(tmp_path, None).tiles, ground(tmp_path, steep).tiles, strict=True
    ):
        for key in ("points", "faces", "normals", "layer", "weights"):
            assert np.array_equal(getattr(bare, key), getattr(shaded, key)), key
