"""Frames of the adaptive mesh against those of one that is far finer than any pixel."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from scipy import ndimage

from scenec.backends.run.render import render
from scenec.compiler.compile import compile_cfg
from scenec.schemas.frames import read_frame
from scenec.testing.small import small_cfg, write_cfg

pytestmark = pytest.mark.usefixtures("workers_here")


def scene(tolerance_px: float) -> dict:
    cfg = small_cfg(samples=2, objects={}, outputs=["label", "depth"])
    # Detail last: smoothing would end it.
    relief = cfg["terrain"]["relief"]
    cfg["terrain"]["relief"] = [relief[0], relief[2], {**relief[1], "octaves": 8}]
    cfg["materials"]["gravel"]["displacement"] = [
        {"type": "worley", "amplitude_m": -0.02, "scale_m": 0.1}
    ]
    del cfg["materials"]["stone"]
    del cfg["labels"]["class"]["rock"], cfg["labels"]["surface"]["stone"]
    cfg["terrain"]["mesh"] = {"tolerance_px": tolerance_px, "finest_m": 0.002}
    return cfg


def frames(folder: Path, tolerance_px: float) -> list[dict[str, np.ndarray]]:
    folder.mkdir()
    out = folder / "out"
    compile_cfg(write_cfg(folder, scene(tolerance_px)), seed=4, out=out)
    render(out, "reference")
    found = sorted((out / "batch_0000" / "frames").rglob("*.exr"))
    assert len(found) == 2
    return [read_frame(path).passes for path in found]


@pytest.fixture(scope="module")
def pairs(tmp_path_factory):
    folder = tmp_path_factory.mktemp("frames")
    return list(zip(frames(folder / "half", 0.5), frames(folder / "dense", 0.05), strict=True))


def within_a_pixel(shown: np.ndarray, dense: np.ndarray) -> np.ndarray:
    """Pixels whose depth the dense mesh has, too, at most one pixel away."""
    low = ndimage.minimum_filter(dense, 3, mode="nearest")
    high = ndimage.maximum_filter(dense, 3, mode="nearest")
    hair = 1e-6 * np.where(np.isfinite(shown), shown, 0.0)
    inside = (shown >= low - hair) & (shown <= high + hair)
    # At the picture's border a neighbor is missing.
    return inside[1:-1, 1:-1]


@pytest.mark.slow
def test_depth_differs_from_the_dense_meshs_by_less_than_a_pixel(pairs):
    for shown, dense in pairs:
        inside = within_a_pixel(shown["depth"], dense["depth"])
        assert inside.mean() > 0.999
        # The test can tell: two pixels off is seen.
        moved = within_a_pixel(np.roll(shown["depth"], 3, axis=0), dense["depth"])
        assert moved.mean() < 0.9


@pytest.mark.slow
def test_labels_differ_from_the_dense_meshs_at_their_borders_only(pairs):
    for shown, dense in pairs:
        for level in (name for name in shown if name.startswith("label.")):
            wrong = shown[level] != dense[level]
            borders = ndimage.maximum_filter(dense[level], 3) != ndimage.minimum_filter(
                dense[level], 3
            )
            # One pixel on either side of a border.
            assert not (wrong & ~borders).any()
            assert wrong.mean() < 0.02
