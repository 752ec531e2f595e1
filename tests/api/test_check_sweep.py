"""``scenec check`` of a whole sweep: findings of each point, by its folder."""

from __future__ import annotations

import shutil

import pytest

import scenec
from scenec.schemas.errors import ScenecError
from scenec.testing.small import small_cfg


def test_a_sweep_is_checked_point_by_point(tmp_path):
    cfg = small_cfg(samples=1, outputs=["depth"])
    out = tmp_path / "sweep"
    scenec.sweep(cfg, out, seeds=[1, 2], backend="annotation", workers=0)
    assert scenec.check(out).sound
    one, other = sorted(path.name for path in out.iterdir() if path.is_dir())
    (exr,) = (out / one).rglob("000000.exr")
    exr.write_bytes(b"")
    shutil.rmtree(out / other)
    report = scenec.check(out)
    assert not report.sound
    where = {finding.where for finding in report.findings if finding.severity == "error"}
    assert any(place.startswith(f"{one}: ") and "000000" in place for place in where)
    assert other in where
    with pytest.raises(ScenecError, match=r"give .*exact one of its points"):
        scenec.check(out, exact=True)
    (out / "sweep.json").write_text("{}")
    with pytest.raises(ScenecError, match=r"sweep\.json"):
        scenec.check(out)
