"""Lenses in cfgs: what is written into the stage, what is refused, and that other cfgs stay."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from scenec.compiler.cfg.load import load
from scenec.compiler.draw import draw
from scenec.compiler.geometry import lenses
from scenec.schemas.errors import CfgError, SceneError
from scenec.schemas.lens import Lens, radial
from scenec.testing.small import small_cfg, write_cfg


def cfg_with(**sensor: Any) -> dict[str, Any]:
    """The small cfg with one sensor of these keys."""
    cfg = small_cfg()
    cfg["rigs"]["rover"]["sensors"] = {"front": {"resolution": [640, 480], **sensor}}
    return cfg


def faults_of(folder: Path, **sensor: Any) -> str:
    """What a cfg with such a sensor is refused for."""
    with pytest.raises(CfgError) as error:
        load(write_cfg(folder, cfg_with(**sensor)))
    return str(error.value)


def drawn(folder: Path, seed: int = 1, **sensor: Any) -> Any:
    """The plan of such a sensor."""
    plan = draw(load(write_cfg(folder, cfg_with(**sensor))), seed, 0)
    return plan.rigs[0].sensors[0].sensor


def test_a_fold_within_the_picture_is_a_fault_that_names_its_radius(tmp_path: Path) -> None:
    """With k1 = -0.5 it lies at 1 / sqrt(1.5) = 0.8165, 39.23 degrees."""
    text = faults_of(
        tmp_path, intrinsics={"fx": 300, "fy": 300, "cx": 320, "cy": 240},
        lens={"type": "brown_conrady", "k1": -0.5},
    )  # fmt: skip
    assert "/rigs/rover/sensors/front/lens" in text
    assert "a radius of 0.8165 (39.23 degrees from the axis)" in text
    assert "corners lie at a radius of 1.333" in text


def test_a_fisheye_may_fold_beyond_its_image_circle_only(tmp_path: Path) -> None:
    """max_angle_deg before the fold makes it sound."""
    lens = {"type": "kannala_brandt", "k1": -0.2}
    given = {"fx": 150, "fy": 150, "cx": 320, "cy": 240}
    text = faults_of(tmp_path, intrinsics=given, lens=lens)
    assert "73.97 degrees from the axis" in text
    assert "max_angle_deg" in text
    sensor = drawn(tmp_path, intrinsics=given, lens={**lens, "max_angle_deg": 70})
    assert sensor.lens.max_angle == pytest.approx(math.radians(70), rel=1e-15)


def test_a_drawn_lens_that_folds_ends_in_one_message(tmp_path: Path) -> None:
    """Whatever of its law was sound: it is looked at once it is drawn."""
    law = {"type": "uniform", "min": -0.6, "max": -0.5}
    with pytest.raises(SceneError, match="rigs/rover/sensors/front/lens: the distortion folds"):
        drawn(tmp_path, fov_deg=110, lens={"type": "brown_conrady", "k1": law})


def test_a_lens_can_be_drawn_once_a_batch(tmp_path: Path) -> None:
    """From its own stream: other numbers of the sensor are as they are without the law."""
    law = {"type": "uniform", "min": -0.1, "max": 0.1}
    mount = {"position_m": [{"type": "uniform", "min": 0, "max": 1}, 0, 0]}
    one = drawn(tmp_path, fov_deg=60, lens={"type": "brown_conrady", "k1": law}, mount=mount)
    other = drawn(tmp_path, 2, fov_deg=60, lens={"type": "brown_conrady", "k1": law}, mount=mount)
    plain = drawn(tmp_path, fov_deg=60, mount=mount)
    assert one.lens.coefficients[0] != other.lens.coefficients[0]
    assert np.array_equal(one.to_rig, plain.to_rig)
    focal = 320.0 / radial(one.lens, math.tan(math.radians(30)))
    assert one.intrinsics[0] == pytest.approx(focal, rel=1e-12)


def test_a_panorama_is_the_whole_sphere_unless_told(tmp_path: Path) -> None:
    """Pixels per radian, of square pixels with a field of view."""
    whole = drawn(tmp_path, lens={"type": "equirectangular"})
    assert whole.intrinsics[:2] == pytest.approx((640 / (2 * math.pi), 480 / math.pi), rel=1e-15)
    part = drawn(tmp_path, fov_deg=180, lens={"type": "equirectangular"})
    assert part.intrinsics[:2] == pytest.approx((640 / math.pi,) * 2, rel=1e-15)


def test_a_survey_overlaps_by_what_the_lens_sees(tmp_path: Path) -> None:
    """Width of a strip over the height: of a fisheye of 120 degrees, 2 tan 60."""
    lens = Lens("kannala_brandt", (0.0,) * 4)
    intrinsics = lenses.lens_intrinsics(lens, (640, 480), 120.0)
    assert not isinstance(intrinsics, str)
    assert lenses.strip_width(lens, intrinsics, 640) == pytest.approx(2 * math.sqrt(3), rel=1e-12)
    wide = lenses.lens_intrinsics(lens, (640, 480), 200.0)
    assert not isinstance(wide, str)
    assert lenses.strip_width(lens, wide, 640) is None
