"""From a millimeter to a thousand kilometers, end to end: same pictures, precision as promised."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from scenec.backends.camera.rays import camera_rays
from scenec.backends.run.session import Session
from scenec.cli.main import main
from scenec.compiler.build import BuildLog, build
from scenec.compiler.cfg.load import load
from scenec.compiler.compile import compile_cfg
from scenec.compiler.draw import draw
from scenec.compiler.mesh.precision import FLOAT32_STEP
from scenec.compiler.terrain.grid import Grid, HeightField
from scenec.testing.small import scaled, small_cfg, write_cfg

PASSES = ("depth", "label", "instance", "face", "normal")


def seen(stage: Path) -> tuple[dict[str, np.ndarray], Any]:
    session = Session.open(stage, "reference")
    camera = session.scene.cameras[0][0]
    return session.render(camera, 0, session.passes(PASSES, camera), 1, 1).arrays, camera


def compiled(folder: Path, cfg: dict) -> tuple[Path, dict]:
    folder.mkdir()
    out = compile_cfg(write_cfg(folder, cfg), seed=3, out=folder / "out").out / "batch_0000"
    return out / "stage.usda", json.loads((out / "report.json").read_text())


def test_a_scene_of_a_millimeter_and_one_of_655_km_are_one_scene_to_the_bit(tmp_path):
    # A power of two scales every float without rounding it: what differs would be a length that
    # the code knows and the cfg does not.
    frames = {}
    for exponent in (0, -14, 15):
        cfg = scaled(small_cfg(samples=1), 2.0**exponent)
        cfg["terrain"]["mesh"] = {"tolerance_px": 0}
        stage, _ = compiled(tmp_path / str(exponent), cfg)
        frames[exponent], _ = seen(stage)
        frames[exponent]["depth"] = frames[exponent]["depth"] * 2.0**-exponent
    assert np.isfinite(frames[0]["depth"]).mean() > 0.3
    assert len(np.unique(frames[0]["instance"])) > 5
    for exponent in (-14, 15):
        for name, array in frames[0].items():
            assert array.tobytes() == frames[exponent][name].tobytes(), (exponent, name)


@pytest.mark.parametrize("extent", [1e-3, 1.0, 1e3, 1e6])
def test_depth_is_that_of_the_float64_relief_within_the_precision_promised(extent, tmp_path):
    cfg = scaled(small_cfg(samples=1), extent / 20)
    cfg["terrain"]["mesh"] = {"tolerance_px": 0}
    stage, report = compiled(tmp_path / "scene", cfg)
    plan = draw(load(tmp_path / "scene" / "small.json"), 3, 0).terrain
    grid = Grid.with_spacing(plan.size_m, plan.spacing_m)
    height = np.zeros(grid.shape)
    for operator in plan.relief:
        height = operator.apply(grid, height)[0]
    frame, camera = seen(stage)
    rays = camera_rays(camera)
    hit = np.isfinite(frame["depth"]).ravel() & (frame["instance"] == 0).ravel()
    assert hit.mean() > 0.3
    at = rays.origins[hit] + frame["depth"].ravel()[hit, None] * rays.directions[hit]
    truth = HeightField(grid, height).height_at(
        np.ascontiguousarray(at[:, 0]), np.ascontiguousarray(at[:, 1])
    )
    normal = frame["normal"].reshape(-1, 3)[hit].astype(np.float64)
    promised = report["precision"]["promised_m"]
    assert promised == pytest.approx(FLOAT32_STEP * extent, rel=0.2)
    # A vertex may be off along all three axes.
    off = np.abs(at[:, 2] - truth)
    slope = np.sqrt((normal[:, :2] ** 2).sum(axis=1)) / np.abs(normal[:, 2])
    assert (off <= promised * (1.0 + slope) + 1e-15 * np.abs(at).max()).all()
    # Along the ray, over the depth: 1e-5 is a hundredth of a pixel here.
    along = np.abs((rays.directions[hit] * normal).sum(axis=1))
    error = off * np.abs(normal[:, 2]) / along / frame["depth"].ravel()[hit]
    assert error.max() < 1e-5


def test_the_precision_reported_is_that_of_the_positions(tmp_path):
    cfg = small_cfg(samples=1)
    _, report = compiled(tmp_path / "a", cfg)
    precision = report["precision"]
    assert precision["promised_m"] == FLOAT32_STEP * precision["extent_m"]
    assert 20 <= precision["extent_m"] < 21
    # No error is larger than what is promised for one tile.
    assert 0 < precision["float32_error_max_m"] <= precision["promised_m"]
    parts = [report["ground"], *report["objects"].values()]
    assert precision["float32_error_max_m"] == max(part["float32_error_max_m"] for part in parts)
    # In pixels: the nearest ground is at most the camera's height off.
    intrinsics = 96 / 2 / np.tan(np.deg2rad(35))
    assert intrinsics / 8 < precision["pixels_per_m_max"] < intrinsics / 1.5 * 1.2
    # Without cameras there are no pixels.
    log = BuildLog()
    build(replace(draw(load(write_cfg(tmp_path, cfg)), 3, 0), rigs=()), log)
    unseen = log.facts["precision"]
    assert unseen["promised_m"] == FLOAT32_STEP * unseen["extent_m"] > 0
    assert unseen["promised_px"] is unseen["float32_error_max_px"] is None


def test_a_camera_too_near_for_float32_is_warned_of(tmp_path, capsys):
    cfg = small_cfg(samples=1)
    cfg["terrain"] |= {"size_m": [1e6, 1e6], "spacing_m": 1e4, "relief": [{"type": "plane"}]}
    path = write_cfg(tmp_path, cfg)
    assert main(["compile", str(path), "--seed", "1", "-o", str(tmp_path / "far")]) == 0
    assert "warning: float32 moves vertices by up to" in capsys.readouterr().err
    cfg["terrain"] |= {"size_m": [100, 100], "spacing_m": 1}
    path = write_cfg(tmp_path, cfg)
    assert main(["compile", str(path), "--seed", "1", "-o", str(tmp_path / "near"), "-v"]) == 0
    said = capsys.readouterr().err
    assert "warning" not in said
    assert "positions in float32: promised 6e-06 m" in said
    assert main(["explain", str(tmp_path / "near")]) == 0
    assert "positions in float32" in capsys.readouterr().out


@pytest.mark.parametrize("seen", ["fov_deg", "intrinsics"])
def test_a_camera_whose_pixels_float32_cannot_resolve_is_refused(seen, tmp_path, capsys):
    cfg = small_cfg(samples=1)
    sensor = cfg["rigs"]["rover"]["sensors"]["front"]
    if seen == "fov_deg":
        sensor["fov_deg"] = 1e-9
    else:
        del sensor["fov_deg"]
        sensor["intrinsics"] = {"fx": 1e9, "fy": 1e9, "cx": 48, "cy": 32}
    path = write_cfg(tmp_path, cfg)
    assert main(["compile", str(path), "--seed", "1", "-o", str(tmp_path / "out")]) == 2
    said = capsys.readouterr().err
    assert "/rigs/rover/sensors/front" in said
    assert "expected at most 0.5" in said
    assert "Traceback" not in said
    assert not (tmp_path / "out" / "batch_0000").exists()


@pytest.mark.parametrize("relief", ["high", "steep"])
def test_a_relief_that_float32_puts_pixels_off_is_refused(relief, tmp_path, capsys):
    cfg = small_cfg(samples=1)
    if relief == "high":
        # At 10^9 m float32 has steps of 64 m: the ground is held around its tiles' middles, objects
        # are not.
        cfg["terrain"]["relief"][0] = {"type": "plane", "height_m": 1e9}
    else:
        # Its tiles are 10^9 m high and 20 m wide.
        cfg["terrain"]["relief"][1]["amplitude_m"] = 1e9
    path = write_cfg(tmp_path, cfg)
    assert main(["compile", str(path), "--seed", "1", "-o", str(tmp_path / "out")]) == 2
    where = {"high": "/rigs/rover/sensors/front: ", "steep": "/terrain/relief: "}[relief]
    assert where in (said := capsys.readouterr().err)
    assert "expected at most" in said
