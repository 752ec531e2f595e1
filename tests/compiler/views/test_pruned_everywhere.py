"""Where single objects show in the light, however far away they stand, none is left out."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from test_panoramas import sky_with

from scenec.compiler.compile import compile_cfg
from scenec.compiler.light.panorama import ImageSky
from scenec.compiler.materials.mirrors import any_mirror
from scenec.compiler.materials.values import gray_picture
from scenec.compiler.scene.material import Material, MaterialMaps
from scenec.schemas.exr import write_rgb
from scenec.testing.small import small_cfg, write_cfg

_DULL = Material((0.4, 0.3, 0.2), 0.9, 0.04, 0.0)


@pytest.mark.parametrize(
    ("change", "mirror"),
    [
        ({}, False),
        ({"metallic": 1.0, "specular": 0.0, "roughness": 0.22}, True),
        ({"metallic": 1.0, "specular": 0.0, "roughness": 0.23}, False),
        ({"metallic": 1.0, "roughness": 0.3, "roughness_variation": -0.4}, True),
        ({"roughness": 0.13}, True),
        ({"roughness": 0.14}, False),
        ({"roughness": 0.01, "specular": 0.0}, False),
    ],
)
def test_a_mirror_is_what_sends_on_far_more_one_way_than_a_dull_surface(change, mirror):
    assert any_mirror([_DULL, replace(_DULL, **change)]) == mirror


@pytest.mark.parametrize(("smooth", "mirror"), [(0.005, False), (0.02, True)])
def test_a_picture_of_roughness_counts_by_its_smoothest_texels(smooth, mirror):
    plane = np.full(10_000, 0.9, np.float32)
    plane[: int(smooth * plane.size)] = 0.05
    maps = MaterialMaps(1.0, {"roughness": gray_picture(plane.reshape(100, 100))}, "opengl")
    assert any_mirror([replace(_DULL, roughness=0.05, maps=maps)]) == mirror


def _panorama(path: Path, radiance: float, extract: bool) -> bool:
    write_rgb(path, sky_with((40.0, 35.0), 3.0, radiance))
    sun = "extract" if extract else "keep"
    plan = ImageSky(files=(path,), strength=np.ones(1), rotation_deg=np.zeros(1), sun=sun)
    sky, _, _ = plan.build(None, 1)
    return sky.sharp


def test_a_sun_that_stays_in_the_skys_picture_is_sharp(tmp_path):
    path = tmp_path / "sky.exr"
    assert _panorama(path, 1e4, extract=False)
    assert not _panorama(path, 1e4, extract=True)
    assert not _panorama(path, 10.0, extract=False)


@pytest.mark.slow
def test_nothing_is_left_out_beside_a_mirror(tmp_path):
    cfg = small_cfg(samples=1, batches=1)
    kept = []
    for number, roughness in enumerate((0.9, 0.1)):
        cfg["materials"]["sand"] |= {"metallic": 1, "roughness": roughness}
        folder = tmp_path / str(number)
        folder.mkdir()
        compile_cfg(write_cfg(folder, cfg), seed=5, out=folder / "out")
        report = json.loads((folder / "out/batch_0000/report.json").read_text())
        counts = report["prune"]["objects"]["rocks"]
        kept.append(sum(n for why, n in counts.items() if why in ("seen", "shadow", "light")))
        assert report["prune"]["light"]["everywhere"] == (number == 1)
    assert 0 < kept[0] < kept[1] == 300
