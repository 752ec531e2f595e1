"""What levels of detail change in frames: silhouettes by a pixel, nothing else."""

from __future__ import annotations

import numpy as np
import pytest

from scenec.backends.run.render import render
from scenec.compiler.compile import compile_cfg
from scenec.compiler.kinds.table import ROCKS
from scenec.schemas.frames import Frame, read_frame
from scenec.testing.small import small_cfg, write_cfg

pytestmark = pytest.mark.usefixtures("workers_here")

_WIDTH = 240
_FOV_DEG = 70


@pytest.fixture(scope="module")
def frames(tmp_path_factory) -> dict[float, Frame]:
    """The same view at three tolerances, and at the finest level."""
    out = {}
    for lod_px in (0.0, 0.5, 3.0):
        folder = tmp_path_factory.mktemp(f"lod_{lod_px}")
        cfg = small_cfg(samples=1, outputs=["label", "instance", "depth"])
        rocks = cfg["objects"].pop("rocks") | {"subdivisions": 4, "count": 80, "lod_px": lod_px}
        for family in ROCKS:
            cfg["objects"][family] = rocks | {"family": family}
        cfg["rigs"]["rover"]["sensors"]["front"] |= {"resolution": [_WIDTH, 180]}
        compile_cfg(write_cfg(folder, cfg), seed=3, out=folder / "out")
        report = render(folder / "out", "reference")
        out[lod_px] = read_frame(report.frames[0])
    return out


def beyond(one: np.ndarray, other: np.ndarray, reach: int) -> np.ndarray:
    """Pixels whose value does not occur within ``reach`` pixels in the other picture."""
    padded = np.pad(other, reach, mode="edge")
    span = range(2 * reach + 1)
    rows, columns = one.shape
    return ~np.any([padded[j : j + rows, i : i + columns] == one for j in span for i in span], 0)


@pytest.mark.parametrize("lod_px", [0.5, 3.0])
@pytest.mark.parametrize("name", ["instance", "label.class", "label.surface"])
def test_ids_and_labels_change_within_the_tolerance_of_silhouettes_only(frames, lod_px, name):
    finest, coarse = frames[0.0].passes[name], frames[lod_px].passes[name]
    reach = int(np.ceil(lod_px))
    # Where a rock leaves the ground at a small angle, their line of contact moves farther than they
    # do; and what is no larger than the tolerance may come and go.
    allowed = 3e-4 * finest.size * (1.0 + lod_px)
    assert (finest != coarse).any()
    assert (finest != coarse).mean() < 0.004 * (1.0 + 2.0 * lod_px)
    assert beyond(finest, coarse, reach).sum() <= allowed
    assert beyond(coarse, finest, reach).sum() <= allowed


def test_depth_keeps_to_the_tolerance_but_where_a_face_is_seen_along_itself(frames):
    finest, coarse = frames[0.0].passes, frames[0.5].passes
    same = (finest["instance"] == coarse["instance"]) & (finest["instance"] > 0)
    assert same.sum() > 1000
    focal = 0.5 * _WIDTH / np.tan(np.deg2rad(0.5 * _FOV_DEG))
    pixels = np.abs(finest["depth"][same] / coarse["depth"][same] - 1.0) * focal
    assert np.median(pixels) < 0.2
    assert np.quantile(pixels, 0.98) < 0.5
    ground = (finest["instance"] == 0) & (coarse["instance"] == 0)
    assert np.array_equal(finest["depth"][ground], coarse["depth"][ground])
