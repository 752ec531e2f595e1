"""What is drawn once a batch, once a sample, and taken from files, ends up where it should."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from scenec.compiler.build import BuildLog, build
from scenec.compiler.cfg.load import load
from scenec.compiler.draw import draw
from scenec.compiler.geometry.poses import from_quaternion
from scenec.compiler.light.latlong import read_picture
from scenec.compiler.plan import Plan
from scenec.schemas.errors import SceneError
from scenec.schemas.exr import write_rgb
from scenec.testing.extras import needs
from scenec.testing.small import small_cfg, write_cfg

BPY_SKY = "package:bpy/*/datafiles/studiolights/world/{}.exr"


def planned(folder: Path, cfg: dict, seed: int = 1, batch: int = 0) -> Plan:
    return draw(load(write_cfg(folder, cfg)), seed, batch)


def test_light_and_camera_are_drawn_each_sample_terrain_once_a_batch(tmp_path):
    plan = planned(tmp_path, small_cfg())
    assert len(set(plan.light.sun.elevation_deg.tolist())) == 3
    assert len({tuple(xy) for xy in plan.rigs[0].pose.xy.tolist()}) == 3
    assert isinstance(plan.terrain.relief[1].amplitude_m, float)


def test_per_batch_holds_a_light_still_over_the_samples_of_a_batch(tmp_path):
    cfg = small_cfg(batches=2)
    cfg["light"]["sun"]["elevation_deg"]["per"] = "batch"
    first, second = (planned(tmp_path, cfg, batch=b).light.sun.elevation_deg for b in range(2))
    assert len(set(first.tolist())) == 1
    assert first[0] != second[0]


def test_sizes_are_drawn_for_each_rock(tmp_path):
    (rocks,) = planned(tmp_path, small_cfg()).objects
    assert len(set(rocks.scale.tolist())) == 300
    assert 0.05 <= rocks.scale.min() < 0.1
    assert 0.5 < rocks.scale.max() <= 0.7
    assert np.allclose(np.linalg.norm(rocks.orientations, axis=1), 1.0)
    assert set(rocks.prototype.tolist()) == {0, 1, 2, 3}


def test_random_turns_favor_no_direction(tmp_path):
    cfg = small_cfg()
    cfg["objects"]["rocks"]["count"] = 20_000
    (rocks,) = planned(tmp_path, cfg).objects
    x, y, z, w = rocks.orientations.T
    # Images of the z axis under uniform rotations: mean 0, each coordinate uniform in [-1, 1].
    up = np.stack([2 * (x * z + y * w), 2 * (y * z - x * w), 1 - 2 * (x * x + y * y)], axis=1)
    assert np.abs(up.mean(axis=0)).max() < 0.02
    assert np.allclose((up**2).mean(axis=0), 1 / 3, atol=0.01)


def test_a_drawn_count_is_met(tmp_path):
    cfg = small_cfg()
    cfg["objects"]["rocks"]["count"] = {"type": "uniform", "min": 10, "max": 20}
    counts = {planned(tmp_path, cfg, seed).objects[0].count.exact for seed in range(40)}
    assert counts <= set(range(10, 21))
    assert len(counts) > 5


def track_cfg(folder: Path, convention: str) -> dict:
    rng = np.random.default_rng(0)
    q = rng.normal(size=(4, 4))
    q /= np.linalg.norm(q, axis=1)[:, None]
    rows = np.column_stack([np.arange(4) * 0.5 + 10, rng.uniform(-5, 5, (4, 3)), q])
    header = "time_s,x_m,y_m,z_m,qw,qx,qy,qz"
    np.savetxt(folder / "track.csv", rows, "%.17g", ",", header=header, comments="")
    cfg = small_cfg()
    cfg["rigs"]["rover"]["pose"] = {"type": "track", "file": "track.csv", "convention": convention}
    cfg["rigs"]["rover"]["allow_below"] = True
    return cfg


def test_a_track_s_poses_and_times_are_those_of_the_file(tmp_path):
    cfg = track_cfg(tmp_path, "opencv")
    rows = np.loadtxt(tmp_path / "track.csv", delimiter=",", skiprows=1)
    plan = planned(tmp_path, cfg)
    scene = build(plan, BuildLog())
    assert scene.times.tolist() == [10.0, 10.5, 11.0]
    for i in range(3):
        expected = from_quaternion(rows[i, 1:4], rows[i, 4:])
        assert np.allclose(scene.rigs[0].to_world[i], expected, atol=1e-14)


def image_cfg(files: list[str], **sky) -> dict:
    cfg = small_cfg(samples=5)
    labels = {"class": "sky", "surface": "sky"}
    cfg["light"] = {"sun": None, "sky": {"type": "image", "files": files, "labels": labels} | sky}
    return cfg


def sky_of(folder: Path, cfg: dict, batch: int = 0):
    log = BuildLog()
    return build(planned(folder, cfg, batch=batch), log).sky, log


def test_pictures_are_taken_in_turn_over_samples_and_batches(tmp_path):
    for name in ("a", "b", "c"):
        write_rgb(tmp_path / f"{name}.exr", np.full((4, 8, 3), 2.0, np.float32))
    cfg = image_cfg(["a.exr", "b.exr", "c.exr"]) | {"batches": 2}
    assert sky_of(tmp_path, cfg)[0].texture == ("a.exr", "b.exr", "c.exr", "a.exr", "b.exr")
    assert sky_of(tmp_path, cfg, 1)[0].texture == ("c.exr", "a.exr", "b.exr", "c.exr", "a.exr")
    random = sky_of(tmp_path, image_cfg(["a.exr", "b.exr", "c.exr"], pick="random"))[0].texture
    assert set(random) <= {"a.exr", "b.exr", "c.exr"}


def test_pictures_of_one_name_from_two_folders_stay_apart(tmp_path):
    for folder in ("one", "two"):
        (tmp_path / folder).mkdir()
        write_rgb(tmp_path / folder / "sky.exr", np.full((4, 8, 3), 1.0, np.float32))
    sky, _ = sky_of(tmp_path, image_cfg(["one/sky.exr", "two/sky.exr"]))
    assert sky.texture[:2] == ("sky.exr", "sky_2.exr")


def test_negative_radiance_of_a_picture_becomes_zero_and_is_reported(tmp_path):
    picture = np.full((4, 8, 3), 1.0, np.float32)
    picture[0, 0, 0] = -0.5
    write_rgb(tmp_path / "a.exr", picture)
    sky, log = sky_of(tmp_path, image_cfg(["a.exr"]))
    assert sky.pictures["a.exr"].min() == 0.0
    report = log.facts["sky"]["set_to_zero"]["a.exr"]
    assert report["lowest_radiance"] == -0.5
    assert report["negative_fraction"] == pytest.approx(1 / 96)


def test_a_picture_that_is_not_finite_is_refused(tmp_path):
    picture = np.full((4, 8, 3), np.inf, np.float32)
    write_rgb(tmp_path / "a.exr", picture)
    with pytest.raises(SceneError, match=r"a\.exr.*infinite"):
        sky_of(tmp_path, image_cfg(["a.exr"]))


@needs("cycles", "bpy")
def test_real_panoramas_are_found_in_an_installed_package(tmp_path):
    spec = load(write_cfg(tmp_path, image_cfg([BPY_SKY.format(n) for n in ("forest", "city")])))
    sky = build(draw(spec, 1, 0), BuildLog()).sky
    assert sky.texture[:2] == ("forest.exr", "city.exr")
    assert read_picture(spec.files["light/sky/files/1"].path).shape == (512, 1024, 3)
    # City holds no negative radiance: the very file goes into the stage.
    assert isinstance(sky.pictures["city.exr"], Path)
