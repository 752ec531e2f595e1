"""Pruned stages: what stays is what it was, what went is said, other keeps are other outputs."""

from __future__ import annotations

import json
from dataclasses import replace

import numpy as np
import pytest
from pxr import Usd, UsdGeom

from scenec.compiler.compile import compile_cfg
from scenec.compiler.views.needed import Keep
from scenec.schemas.errors import OutputError
from scenec.schemas.left_out import LEFT_OUT, Reason, read_left_out
from scenec.schemas.manifest import read_manifest, stage_digest
from scenec.testing.small import small_cfg, write_cfg


def _cfg() -> dict:
    cfg = small_cfg(samples=1, batches=1)
    cfg["rigs"]["rover"]["sensors"]["front"]["outputs"] = ["label", "instance"]
    return cfg


@pytest.fixture(scope="module")
def outputs(tmp_path_factory):
    folder = tmp_path_factory.mktemp("pruned")
    file = write_cfg(folder, _cfg())
    for keep in (Keep.SEEN, Keep.UNPRUNED):
        compile_cfg(file, seed=5, out=folder / keep, keep=keep)
    return folder


def _arrays(batch) -> dict[int, tuple]:
    """Of each local id: what its instance is."""
    stage = Usd.Stage.Open(str(batch / "stage.usda"))
    rocks = UsdGeom.PointInstancer(stage.GetPrimAtPath("/World/Objects/rocks"))
    targets = rocks.GetPrototypesRel().GetTargets()
    names = [targets[i].name for i in rocks.GetProtoIndicesAttr().Get()]
    rows = zip(
        names,
        np.array(rocks.GetPositionsAttr().Get()).tolist(),
        np.array(rocks.GetScalesAttr().Get()).tolist(),
        [str(q) for q in rocks.GetOrientationsAttr().Get()],
        strict=True,
    )
    return dict(zip(rocks.GetIdsAttr().Get(), rows, strict=True))


def test_what_stays_is_as_it_was_and_the_rest_has_a_reason(outputs):
    pruned, whole = (_arrays(outputs / keep / "batch_0000") for keep in ("seen", "unpruned"))
    assert 0 < len(pruned) < len(whole) == 300
    assert all(whole[local] == one for local, one in pruned.items())
    record = read_left_out(outputs / "seen" / "batch_0000")
    for local in range(1, 301):
        reason = record.classes["rocks"].of(local)
        assert reason.kept == (local in pruned)
        assert reason in (Reason.SEEN, Reason.OUT_OF_VIEW, Reason.BEHIND_GROUND)
    assert read_left_out(outputs / "unpruned" / "batch_0000") is None


def test_the_report_adds_up_and_the_record_is_no_part_of_the_stage(outputs):
    report = json.loads((outputs / "seen" / "batch_0000" / "report.json").read_text())
    gone = [e for e in report["left_out"] if e["pass"] == "prune" and e["instances"]]
    kept = len(_arrays(outputs / "seen" / "batch_0000"))
    assert sum(entry["instances"] for entry in gone) == 300 - kept
    assert all(entry["triangles"] > 0 and entry["bytes"] > 0 for entry in gone)
    manifest = read_manifest(outputs / "seen")
    before = stage_digest(manifest, "batch_0000")
    files = {path: one for path, one in manifest.files.items() if not path.endswith(LEFT_OUT)}
    assert len(files) == len(manifest.files) - 1
    manifest = replace(manifest, files=files)
    assert stage_digest(manifest, "batch_0000") == before
    assert manifest.keep == "seen"


def test_an_output_of_another_keep_is_another_output(tmp_path):
    cfg = _cfg() | {"batches": 2}
    file = write_cfg(tmp_path, cfg)
    compile_cfg(file, seed=5, out=tmp_path / "out")
    with pytest.raises(OutputError, match="keep"):
        compile_cfg(file, seed=5, out=tmp_path / "out", batches=range(1), keep=Keep.UNPRUNED)
