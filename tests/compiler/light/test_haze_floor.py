"""Where haze begins does not depend on what was left out of the stage."""

from __future__ import annotations

from pathlib import Path

import pytest
from pxr import Usd, UsdGeom

from scenec.backends.stage.read import read_stage
from scenec.compiler.compile import compile_cfg
from scenec.compiler.views.needed import Keep
from scenec.schemas import stage as names
from scenec.testing.small import small_cfg, write_cfg


@pytest.fixture(scope="module")
def stages(tmp_path_factory: pytest.TempPathFactory) -> dict[Keep, Path]:
    """Even ground with large rocks sunk into it: the lowest point is a rock's, and out of view."""
    folder = tmp_path_factory.mktemp("floor")
    cfg = small_cfg(samples=1, batches=1, outputs=["rgb"])
    cfg["terrain"] |= {"size_m": [240, 240], "spacing_m": 4.0}
    cfg["terrain"]["relief"] = [{"type": "plane", "slope": [0, 0]}]
    cfg["objects"]["rocks"] |= {"count": 60}
    cfg["light"]["haze"] = {"visibility_m": 200, "scale_height_m": 5}
    cfg["rigs"]["rover"]["sensors"]["front"] |= {"resolution": [24, 16], "fov_deg": 30}
    file = write_cfg(folder, cfg)
    found = {}
    for keep in (Keep.SEEN, Keep.UNPRUNED):
        compile_cfg(file, seed=2, out=folder / keep, keep=keep)
        found[keep] = folder / keep / "batch_0000" / "stage.usda"
    return found


def lowest(path: Path) -> float:
    """Of all geometry, by USD's own boxes."""
    stage = Usd.Stage.Open(str(path))
    cache = UsdGeom.BBoxCache(Usd.TimeCode(0), [UsdGeom.Tokens.default_, UsdGeom.Tokens.render])
    box = cache.ComputeWorldBound(stage.GetPrimAtPath(names.ROOT)).ComputeAlignedRange()
    return float(box.GetMin()[2])


def test_the_floor_of_haze_is_the_same_with_and_without_pruning(stages: dict[Keep, Path]) -> None:
    floors = []
    for path in stages.values():
        stage = Usd.Stage.Open(str(path))
        sky = stage.GetPrimAtPath(names.SKY_PRIM)
        floors.append(sky.GetAttribute(names.ATTR_HAZE_FLOOR).Get())
        haze = read_stage(path).haze[0]
        assert haze.floor_m == floors[-1]
    assert floors[0] == floors[1]
    # It is below all there was, and what stayed would have said something else.
    assert floors[0] <= lowest(stages[Keep.UNPRUNED]) < lowest(stages[Keep.SEEN])
