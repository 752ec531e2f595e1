"""Focus in cfgs: what is drawn, what stands in the stage and is read back, what is refused."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from pxr import Sdf, Usd, UsdGeom

from scenec.backends.stage.read import read_stage
from scenec.backends.stage.scene import Camera
from scenec.compiler.cfg.load import load
from scenec.compiler.compile import compile_cfg
from scenec.compiler.draw import draw
from scenec.compiler.scene.rig import Focus, Rig, Sensor
from scenec.compiler.views.frustum import in_view, views_of_all
from scenec.schemas.errors import CfgError, SceneError, StageError
from scenec.testing.small import small_cfg, write_cfg

FREE = {"distance_m": 2.5, "f_number": 2.0, "focal_length_mm": 25.0}


def cfg_with(**sensor: Any) -> dict[str, Any]:
    """The small cfg with one sensor of these keys."""
    cfg = small_cfg()
    given = {"resolution": [96, 64], "fov_deg": 70, **sensor}
    cfg["rigs"]["rover"]["sensors"] = {"front": given}
    return cfg


def drawn(folder: Path, **sensor: Any) -> Focus | None:
    plan = draw(load(write_cfg(folder, cfg_with(**sensor))), 1, 0)
    return plan.rigs[0].sensors[0].sensor.focus


def faults_of(folder: Path, **sensor: Any) -> str:
    with pytest.raises(CfgError) as error:
        load(write_cfg(folder, cfg_with(**sensor)))
    return str(error.value)


def compiled(folder: Path, **sensor: Any) -> tuple[Path, tuple[Camera, ...]]:
    """The stage of an almost empty scene, and its camera at each sample."""
    cfg = cfg_with(**sensor)
    cfg["objects"]["rocks"]["count"] = 3
    cfg["terrain"]["relief"] = [{"type": "plane"}]
    compile_cfg(write_cfg(folder, cfg), seed=3, out=folder / "out", batches=range(1))
    stage = folder / "out" / "batch_0000" / "stage.usda"
    return stage, tuple(cameras[0] for cameras in read_stage(stage).cameras)


def test_a_sensor_without_focus_has_none_and_says_nothing_of_it(tmp_path: Path) -> None:
    assert drawn(tmp_path) is None
    stage, cameras = compiled(tmp_path)
    assert all(camera.focus is None for camera in cameras)
    layer = Sdf.Layer.FindOrOpen(str(stage.parent / "cameras.usdc"))
    assert "fStop" not in layer.ExportToString()


def test_without_imaging_the_aperture_is_focal_length_over_twice_the_f_number(
    tmp_path: Path,
) -> None:
    focus = drawn(tmp_path, focus=FREE)
    assert focus.radius_m(0) == pytest.approx(0.025 / 4.0, rel=1e-15)
    assert focus.distance_m.tolist() == [2.5] * 3


def test_with_imaging_f_number_and_size_of_pixels_are_its_own(tmp_path: Path) -> None:
    focus = drawn(
        tmp_path, focus={"distance_m": 3}, imaging={"f_number": 2.8, "pixel_um": 5.0}, fov_deg=90
    )
    # 96 pixels of 5 um that see 90 degrees: 0.24 mm.
    assert focus.focal_length_m == pytest.approx(48 * 5e-6, rel=1e-12)
    assert focus.f_number.tolist() == [2.8] * 3


def test_distance_and_f_number_can_be_drawn_for_each_sample(tmp_path: Path) -> None:
    spread = {"type": "log_uniform", "min": 1.0, "max": 8.0}
    focus = drawn(tmp_path, focus={**FREE, "distance_m": spread, "f_number": spread})
    assert len(set(focus.distance_m.tolist())) == 3
    assert len(set(focus.f_number.tolist())) == 3
    assert set(focus.distance_m.tolist()).isdisjoint(focus.f_number.tolist())


def test_the_stage_has_usds_own_numbers_of_the_lens(tmp_path: Path) -> None:
    """Focal length and apertures of the lens's own size: other renderers blur by them."""
    stage, cameras = compiled(tmp_path, focus=FREE)
    opened = Usd.Stage.Open(str(stage))
    prim = next(p for p in opened.Traverse() if p.IsA(UsdGeom.Camera))
    camera = UsdGeom.Camera(prim).GetCamera(Usd.TimeCode(0))
    # Tenths of a meter.
    assert camera.focalLength == pytest.approx(0.25, rel=1e-6)
    assert camera.fStop == pytest.approx(2.0, rel=1e-6)
    assert camera.focusDistance == pytest.approx(2.5, rel=1e-6)
    # Gf's own field of view is still that of the intrinsics.
    fov = camera.GetFieldOfView(camera.FOVHorizontal)
    assert fov == pytest.approx(70.0, abs=1e-4)
    for read in cameras:
        assert read.focus.distance_m == pytest.approx(2.5, rel=1e-6)
        assert read.focus.aperture_radius_m == pytest.approx(0.025 / 4.0, rel=1e-6)


def test_drawn_focus_comes_back_at_each_sample(tmp_path: Path) -> None:
    spread = {"type": "uniform", "min": 1.0, "max": 8.0}
    _, cameras = compiled(tmp_path, focus={**FREE, "distance_m": spread})
    distances = [camera.focus.distance_m for camera in cameras if camera.focus is not None]
    focus = draw(load(tmp_path / "small.json"), 3, 0).rigs[0].sensors[0].sensor.focus
    assert distances == pytest.approx(focus.distance_m.tolist(), rel=1e-6)


def test_a_sensor_without_pictures_has_no_aperture_in_the_stage(tmp_path: Path) -> None:
    _, cameras = compiled(tmp_path, focus=FREE, outputs=["depth"])
    assert cameras[0].focus is None


@pytest.mark.parametrize(
    ("sensor", "message"),
    [
        ({"focus": {"distance_m": 2, "focal_length_mm": 5}}, "expected the key f_number"),
        ({"focus": {"distance_m": 2, "f_number": 5}}, "expected the key focal_length_mm"),
        ({"focus": FREE, "imaging": {}}, "imaging/f_number says it already"),
        ({"focus": FREE, "imaging": {}}, "imaging/pixel_um says it already"),
        ({"focus": FREE, "lens": {"type": "kannala_brandt"}}, "take focus or lens away"),
    ],
)
def test_what_does_not_go_together_is_one_clear_fault(
    tmp_path: Path, sensor: dict[str, Any], message: str
) -> None:
    assert message in faults_of(tmp_path, **sensor)


def test_nothing_is_in_focus_nearer_than_the_focal_length(tmp_path: Path) -> None:
    with pytest.raises(SceneError, match=r"focus/distance_m: 0.02 m is not beyond .* 25 mm"):
        drawn(tmp_path, focus={**FREE, "distance_m": 0.02})


def foreign(folder: Path, f_stop: float, distance: float, meters: float) -> Path:
    """A stage of nothing but a camera."""
    stage = Usd.Stage.CreateInMemory()
    UsdGeom.SetStageMetersPerUnit(stage, meters)
    UsdGeom.SetStageUpAxis(stage, UsdGeom.Tokens.z)
    camera = UsdGeom.Camera.Define(stage, "/cam")
    camera.CreateFStopAttr(f_stop)
    camera.CreateFocusDistanceAttr(distance)
    path = folder / "foreign.usda"
    stage.GetRootLayer().Export(str(path))
    return path


def test_a_foreign_stages_aperture_is_in_tenths_of_its_units(tmp_path: Path) -> None:
    """Centimeters: the default focal length of 50 is 50 mm."""
    focus = read_stage(foreign(tmp_path, 4.0, 300.0, 0.01)).cameras[0][0].focus
    assert focus.distance_m == pytest.approx(3.0, rel=1e-6)
    assert focus.aperture_radius_m == pytest.approx(0.05 / 8.0, rel=1e-6)


@pytest.mark.parametrize(("f_stop", "distance"), [(0.0, 300.0), (4.0, 0.0)])
def test_usds_zero_is_no_depth_of_field(tmp_path: Path, f_stop: float, distance: float) -> None:
    assert read_stage(foreign(tmp_path, f_stop, distance, 0.01)).cameras[0][0].focus is None


def test_an_impossible_aperture_of_a_foreign_stage_is_one_clear_error(tmp_path: Path) -> None:
    path = foreign(tmp_path, -4.0, 3.0, 1.0)
    with pytest.raises(StageError, match="fStop is -4"):
        read_stage(path)


def test_a_foreign_stages_aperture_behind_a_bent_lens_is_one_clear_error(tmp_path: Path) -> None:
    path = foreign(tmp_path, 4.0, 3.0, 1.0)
    stage = Usd.Stage.Open(str(path))
    prim = stage.GetPrimAtPath("/cam")
    prim.CreateAttribute("scenec:lens:model", Sdf.ValueTypeNames.Token).Set("equirectangular")
    stage.GetRootLayer().Save()
    with pytest.raises(StageError, match="set fStop to 0"):
        read_stage(path)


def test_pruning_keeps_what_only_the_aperture_sees() -> None:
    """Balls whose pinhole picture lies outside, but whose blur reaches in, count as in view."""
    rng = np.random.default_rng(5)
    focus = Focus(np.array([2.0]), np.array([1.0]), 0.6)
    intrinsics = (80.0, 85.0, 30.0, 26.0, 3.0)
    sensor = Sensor("s", (64, 48), intrinsics, np.eye(4), np.zeros(1), ("rgb",), focus=focus)
    views = views_of_all((Rig("r", np.eye(4)[None], (sensor,)),))
    assert len(views.eye) == 5
    fx, fy, cx, cy, skew = intrinsics
    seen_by_rim_alone = 0
    for _ in range(400):
        z, angle = float(rng.uniform(0.6, 30.0)), rng.uniform(0.0, 2.0 * np.pi)
        dx, dy = 0.3 * np.array([np.cos(angle), np.sin(angle)])
        # A pixel of the picture that this point of the aperture sees, and a point that shows there:
        # its own projection, with the plane in focus, 2 m away, kept.
        u, v = rng.uniform(0.0, 64.0), rng.uniform(0.0, 48.0)
        y = (v - cy - fy * dy / 2.0) * z / fy
        x = ((u - cx - (fx * dx + skew * dy) / 2.0) * z - skew * y) / fx
        point = np.array([x + dx, y + dy, z])
        found = [in_view(views, i, *point, 0.0) for i in range(5)]
        assert any(found)
        seen_by_rim_alone += not found[0]
    assert seen_by_rim_alone > 10
