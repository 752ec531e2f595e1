"""Lidars that feel color: intensities by hand, returns by integrals, losses by their law."""

from __future__ import annotations

import json
from dataclasses import replace
from math import cos, erf, radians, sqrt
from pathlib import Path
from statistics import NormalDist

import laspy
import moving_stages as ms
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from pxr import Sdf, Usd, UsdGeom
from scipy.spatial.transform import Rotation

from scenec.backends.annotation.lidar import scan
from scenec.backends.exact import ExactCaster
from scenec.backends.run.scan import scan_output
from scenec.backends.stage.read import read_stage
from scenec.backends.stage.scene import DEFAULT_SURFACE, Lidar, RenderScene
from scenec.compiler.compile import compile_cfg
from scenec.schemas import stage as names
from scenec.schemas.clouds import LAS_STEP_M
from scenec.schemas.errors import CfgError, StageError
from scenec.schemas.lidar import LidarDetection, LidarFootprint, LidarIntensity
from scenec.schemas.scans import read_scan
from scenec.testing.examples import examples
from scenec.testing.foreign_stages import new_stage
from scenec.testing.small import small_cfg

pytestmark = pytest.mark.usefixtures("workers_here")
BEAM = LidarFootprint(divergence_deg=0.2, rays=401, returns=4)
CALIBRATED = LidarIntensity()


def walls(folder: Path, *planes: tuple, colors: tuple = ()) -> RenderScene:
    """Walls across x, each a table of corners (x, y, z), of colors of their own."""
    stage = new_stage(folder / f"stage{len(list(folder.iterdir()))}.usda", "/World")
    for i, corners in enumerate(planes):
        ms.add_mesh(stage, f"/World/Wall{i}", np.array(corners, float), [[0, 1, 2], [0, 2, 3]], i)
    ms._camera(stage)
    stage.Save()
    scene = read_stage(Path(stage.GetRootLayer().realPath))
    if not colors:
        return scene
    surfaces = tuple(replace(DEFAULT_SURFACE, base_color=color) for color in colors)
    meshes = tuple(replace(mesh, layers=(i,)) for i, mesh in enumerate(scene.meshes))
    return replace(scene, surfaces=surfaces, meshes=meshes)


def wall(x: float, left: float, right: float, turned_deg: float = 0.0) -> np.ndarray:
    """A wall at x from y = left to right, turned about the z axis through (x, 0)."""
    a = radians(turned_deg)
    flat = [(left, -50.0), (right, -50.0), (right, 50.0), (left, 50.0)]
    return np.array([(x - y * np.sin(a), y * cos(a), z) for y, z in flat])


def shot(scene: RenderScene, azimuths_deg=(0.0,), sample: int = 0, **change) -> dict:
    usual = {
        "name": "rig_top",
        "path": "/World/top",
        "to_world": np.eye(4),
        "elevations_deg": np.zeros(1),
        "azimuths_deg": np.array(azimuths_deg, float),
        "range_m": (0.0, 1000.0),
    }
    return scan(scene, ExactCaster(scene), Lidar(**(usual | change)), sample)


@pytest.mark.parametrize("turned", [0.0, 30.0, 60.0, 89.0])
@pytest.mark.parametrize("reach", [0.5, 7.0, 300.0])
@pytest.mark.parametrize(
    ("bands", "reflectance"), [((1, 0, 0), 0.5), ((0.2126, 0.7152, 0.0722), 0.2537), ((0, 0, 1), 0)]
)
def test_intensity_of_a_tilted_plane_is_that_by_hand(tmp_path, turned, reach, bands, reflectance):
    scene = walls(tmp_path, wall(reach, -2e3, 2e3, turned), colors=((0.5, 0.205875, 0.0),))
    calibrated = shot(scene, intensity=LidarIntensity(bands=bands))
    expected = reflectance * cos(radians(turned))
    assert calibrated["intensity"][0, 0] == pytest.approx(expected, rel=1e-3)
    assert calibrated["range_true"][0, 0] == pytest.approx(reach, rel=1e-6)
    received = shot(scene, intensity=LidarIntensity(bands=bands, at_m=10.0))
    assert received["intensity"][0, 0] == pytest.approx(expected * (10 / reach) ** 2, rel=1e-3)


def energies(
    scene: RenderScene, beam: LidarFootprint = BEAM, **change
) -> tuple[np.ndarray, np.ndarray]:
    """Ranges and energies of the returns of one beam along x."""
    made = shot(scene, intensity=LidarIntensity(at_m=1.0), footprint=beam, **change)
    there = np.isfinite(made["range"])
    return made["range_true"][there], made["intensity"][there].astype(float)


@given(st.floats(-0.012, 0.012))
@examples(20)
def test_an_edge_in_the_beam_makes_two_returns_of_the_energies_of_its_integral(
    tmp_path_factory, edge
):
    near, far = wall(10.0, -50.0, edge), wall(13.0, -50.0, 50.0)
    scene = walls(tmp_path_factory.mktemp("edge"), near, far, colors=((0.4,) * 3, (0.8,) * 3))
    reach, energy = energies(scene)
    # The deviation of a Gaussian beam's power is a quarter of its divergence out to 1/e^2.
    deviation = 10.0 * radians(BEAM.divergence_deg) / 4.0
    share = 0.5 * (1.0 + erf(edge / deviation / sqrt(2.0)))
    assert len(reach) == len({round(float(r)) for r in reach}) <= 2
    for at, whole, part in ((10.0, 0.4 / 100.0, share), (13.0, 0.8 / 169.0, 1.0 - share)):
        which = np.abs(reach - at) < 1e-3
        assert energy[which].sum() / whole == pytest.approx(part, abs=0.015)
        assert which.any() == (part > 0.5 / BEAM.rays) or abs(part) < 5 / BEAM.rays


@pytest.mark.parametrize(
    ("rays", "rms", "worst"),
    [(7, 0.077, 0.25), (19, 0.034, 0.13), (37, 0.02, 0.08), (101, 0.01, 0.04)],
)
def test_errors_of_sampled_beams_are_those_of_the_page(tmp_path, rays, rms, worst):
    rng, errors = np.random.default_rng(1), []
    radius, pose = radians(BEAM.divergence_deg) / 2.0, np.eye(4)
    for turn in rng.uniform(0, 2 * np.pi, 12):
        # An edge at any angle to the beam's rays.
        across = np.array([cos(turn), np.sin(turn)])
        corners = wall(10.0, -50.0, 0.0)
        corners[:, 1:] = corners[:, 1:] @ np.array([across, [-across[1], across[0]]])
        scene = walls(tmp_path, corners)
        for off in rng.uniform(-radius, radius, 25):
            pose[1:3, 3] = -10.0 * np.tan(off) * across
            beam = replace(BEAM, rays=rays)
            energy = energies(scene, beam, to_world=pose)[1].sum() / (0.18 / 100.0)
            errors.append(energy - 0.5 * (1.0 + erf(off / (radius / 2.0) / sqrt(2.0))))
    assert sqrt(np.square(errors).mean()) < 1.15 * rms
    assert np.abs(errors).max() < worst


def test_what_is_nearer_together_than_is_separated_is_one_return_at_the_mean(tmp_path):
    scene = walls(tmp_path, wall(10.0, -50, 0.0), wall(10.4, -50, 50), colors=((0.8,) * 3,) * 2)
    (reach,), (energy,) = energies(scene)
    first, second = 0.4 / 10.0**2, 0.4 / 10.4**2
    assert energy == pytest.approx(first + second, rel=0.01)
    assert reach == pytest.approx((10.0 * first + 10.4 * second) / (first + second), abs=0.005)
    assert len(energies(scene, replace(BEAM, separation_m=0.3))[0]) == 2


def test_the_strongest_returns_are_told_nearest_first(tmp_path):
    strips = [wall(x, -50, edge) for x, edge in ((10, -0.005), (12, 0.0), (14, 0.008), (16, 50))]
    scene = walls(tmp_path, *strips, colors=((0.9,) * 3, (0.9,) * 3, (0.9,) * 3, (0.05,) * 3))
    everything, energy = energies(scene)
    np.testing.assert_allclose(everything, [10, 12, 14, 16], atol=1e-3)
    for most in (1, 2, 3):
        told = energies(scene, replace(BEAM, returns=most))[0]
        np.testing.assert_array_equal(told, np.sort(everything[np.argsort(-energy)[:most]]))


@pytest.mark.parametrize("turned", [0.0, 70.0])
@pytest.mark.parametrize("noise", [0.0, 0.15, 0.5])
@pytest.mark.parametrize(("probability", "reflectance"), [(0.5, 0.1), (0.9, 0.1), (0.9, 0.8)])
def test_returns_are_lost_as_the_law_says(tmp_path, turned, noise, probability, reflectance):
    detection = LidarDetection(
        range_m=50.0, reflectance=reflectance, probability=probability, noise=noise
    )
    scene = walls(tmp_path, wall(0.0, -2e3, 2e3, turned), colors=((0.3,) * 3,))
    facing, n = cos(radians(turned)), 4000
    # The range at which half are detected, and some about it.
    half = 50.0 * sqrt((1 + noise * NormalDist().inv_cdf(probability)) * 0.3 * facing / reflectance)
    for reach in (half * f for f in (0.7, 0.9, 0.999, 1.001, 1.15, 2.0)):
        pose = np.eye(4)
        pose[0, 3] = -reach
        made = shot(scene, np.zeros(n), to_world=pose, detection=detection, key=11)
        above = (half / reach) ** 2 - 1.0
        p = NormalDist().cdf(above / noise) if noise else float(above > 0)
        found = np.isfinite(made["range"]).mean()
        assert abs(found - p) <= 5 * sqrt(p * (1 - p) / n) + 1 / n, (reach, found, p)


def test_a_facing_target_of_ten_percent_has_its_probability_at_its_range(tmp_path):
    scene = walls(tmp_path, wall(100.0, -2e3, 2e3), colors=((0.1,) * 3,))
    made = shot(scene, np.zeros(9000), detection=LidarDetection(range_m=100.0, probability=0.9))
    assert np.isfinite(made["range"]).mean() == pytest.approx(0.9, abs=5 * sqrt(0.09 / 9000))


def test_losses_depend_on_key_sample_and_ray_alone(tmp_path):
    scene = walls(tmp_path, wall(100.0, -50, 0.02), wall(120, -99, 99), colors=((0.1,) * 3,) * 2)
    usual = {"detection": LidarDetection(range_m=90.0, noise=0.5), "footprint": BEAM, "key": 4}
    one, again = shot(scene, np.zeros(300), **usual), shot(scene, np.zeros(300), **usual)
    fewer = shot(scene, np.zeros(7), **usual)
    assert all(one[name].tobytes() == again[name].tobytes() for name in one)
    np.testing.assert_array_equal(fewer["range"], one["range"][:, :7])
    there = np.isfinite(one["range"][0])
    # Both returns, the first alone, the second alone, neither.
    assert len({tuple(each) for each in there[:, :2].tolist()}) == 4
    for other in ({"key": 5}, {"sample": 1}):
        assert (shot(scene, np.zeros(300), **(usual | other))["range"] != one["range"]).any()


@pytest.mark.parametrize("beam", [
    LidarFootprint(divergence_deg=0.0, returns=1),
    LidarFootprint(divergence_deg=3.0, rays=1, returns=1),
    LidarFootprint(divergence_deg=0.0, rays=1, separation_m=0.0, returns=1),
])  # fmt: skip
def test_a_beam_without_width_or_of_one_ray_is_a_ray(tmp_path, beam):
    scene = walls(tmp_path, wall(5.0, -9, 9, 20.0), wall(9, -99, 99), colors=((0.5,) * 3,) * 2)
    azimuths = np.linspace(-80, 80, 33)
    plain = shot(scene, azimuths, intensity=CALIBRATED)
    wide = shot(scene, azimuths, intensity=CALIBRATED, footprint=beam)
    for name, values in plain.items():
        np.testing.assert_allclose(wide[name], values, rtol=1e-6, atol=1e-7, err_msg=name)


def test_black_grazed_and_touched_surfaces_and_none(tmp_path):
    scene = walls(tmp_path, wall(5.0, -9, 0), wall(0.0, 50, 90), colors=((0.0,) * 3, (0.5,) * 3))
    sharp = LidarDetection(range_m=1e5, noise=0.0)
    # Black: an answer that holds nothing; nothing to detect.
    for beam in (None, replace(BEAM, returns=1)):
        made = shot(scene, [-30.0], intensity=CALIBRATED, footprint=beam)
        assert made["range"][0, 0] == pytest.approx(5.0 / cos(radians(30)), rel=1e-4)
        assert made["intensity"][0, 0] == 0.0
        assert np.isinf(shot(scene, [-30.0], footprint=beam, detection=sharp)["range"]).all()
        # Nothing at all.
        empty = shot(scene, [180.0], intensity=CALIBRATED, footprint=beam, detection=sharp)
        assert np.isinf(empty["range"]).all()
        assert not empty["intensity"].any()
    # Along the second wall, whose plane holds the lidar: no beam is infinite, none NaN.
    pose = np.eye(4)
    for step in (0.0, 1e-9, 1e-3):
        pose[:3, 3] = (-step, 70.0, 0.0)
        made = shot(
            scene, [0.0, 90.0, 89.9999, -180.0], to_world=pose, footprint=BEAM,
            intensity=LidarIntensity(at_m=1e6),
        )  # fmt: skip
        assert np.isfinite(made["intensity"]).all()
        assert (made["intensity"] >= 0).all()


def with_lidar(**change) -> dict:
    cfg = small_cfg(samples=1)
    rig = next(iter(cfg["rigs"].values()))
    rig["lidars"] = {"top": {"mount": {"position_m": [0, -0.4, 0]}, "beams": 16, "azimuths": 90,
                             "elevation_deg": [5, -30]} | change}  # fmt: skip
    next(iter(rig["sensors"].values()))["outputs"] = ["depth"]
    return cfg


def scanned(folder: Path, cfg: dict, **how) -> Path:
    folder.mkdir()
    (folder / "cfg.json").write_text(json.dumps(cfg))
    compile_cfg(folder / "cfg.json", seed=3, out=folder / "out", batches=range(1))
    return scan_output(folder / "out", **how).scans[0]


FULL = {
    "intensity": {"at_m": 5},
    "footprint": {"divergence_deg": 0.5, "rays": 7, "returns": 3},
    "detection": {"range_m": 30},
}


def test_a_cfg_tells_of_it_and_the_files_have_it(tmp_path):
    stem = scanned(tmp_path / "full", with_lidar(**FULL), clouds=["ply"])
    made = read_scan(stem)
    there = np.isfinite(made.arrays["range"])
    assert there.shape == (16, 90, 3)
    assert made.arrays["points"].shape == (16, 90, 3, 3)
    assert made.sidecar.version == "1.2"
    assert made.sidecar.footprint == LidarFootprint(divergence_deg=0.5, rays=7, returns=3)
    assert made.sidecar.detection == LidarDetection(range_m=30)
    head, _, data = stem.with_suffix(".ply").read_bytes().partition(b"end_header\n")
    kinds = {"float": "<f4", "uint": "<u4"}
    fields = [line.split()[1:] for line in head.decode().splitlines() if "property" in line]
    table = np.frombuffer(data, [(name, kinds[kind]) for kind, name in fields])
    np.testing.assert_array_equal(table["intensity"], made.arrays["intensity"][there])
    np.testing.assert_array_equal(
        table["returns"], there.sum(axis=2)[table["beam"], table["column"]]
    )
    first = table[table["return"] == 1]
    np.testing.assert_array_equal(
        first["range"], made.arrays["range"].min(axis=2)[there.any(axis=2)]
    )


def test_a_stage_has_the_colors_that_a_lidar_feels_and_no_others(tmp_path):
    cfg = with_lidar(**FULL)
    depth = read_scan(scanned(tmp_path / "depth", cfg)).arrays
    rgb = with_lidar(**FULL)
    next(iter(next(iter(rgb["rigs"].values()))["sensors"].values()))["outputs"] = ["rgb", "depth"]
    pictured = read_scan(scanned(tmp_path / "rgb", rgb)).arrays
    np.testing.assert_array_equal(depth["range_true"], pictured["range_true"])
    np.testing.assert_allclose(depth["intensity"], pictured["intensity"], rtol=0.05, atol=1e-3)
    assert len(np.unique(depth["intensity"])) > 100
    stage = scanned(tmp_path / "plain", with_lidar()).parents[2] / "stage.usda"
    assert not any(surface.path for surface in read_stage(stage).surfaces)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"footprint": {}}, "divergence_deg"),
        ({"footprint": {"divergence_deg": 31}}, "at most 30"),
        ({"footprint": {"divergence_deg": 1, "rays": 0}}, "at least 1"),
        ({"detection": {"range_m": 0}}, "more than 0"),
        ({"detection": {"range_m": 9, "probability": 1}}, "less than 1"),
        ({"intensity": {"band": [1, 0, 0]}}, 'did you mean "bands"'),
    ],
)
def test_what_cannot_be_is_a_fault(tmp_path, change, message):
    with pytest.raises(CfgError, match=message):
        scanned(tmp_path / "bad", with_lidar(**change))


@pytest.mark.parametrize(
    ("name", "numbers", "message"),
    [
        (names.ATTR_LIDAR_FOOTPRINT, (0.1, 0, 1, 1), "rays is 0"),
        (names.ATTR_LIDAR_FOOTPRINT, (0.1, 1.5, 1, 1), "rays is 1.5"),
        (names.ATTR_LIDAR_DETECTION, (9, 0, 0.5, 0), "reflectance is 0"),
        (names.ATTR_LIDAR_INTENSITY, (1, 0, 0, -1), "at_m is -1"),
    ],
)
def test_a_stage_that_says_what_cannot_be_is_refused(tmp_path, name, numbers, message):
    path = ms.write_stage(tmp_path / "stage.usda")
    stage = Usd.Stage.Open(str(path))
    prim = UsdGeom.Xform.Define(stage, "/World/odd").GetPrim()
    rays = prim.CreateAttribute(names.ATTR_LIDAR_RAYS, Sdf.ValueTypeNames.Double2Array)
    rays.Set([(0.0, 1.0)])
    prim.CreateAttribute(names.ATTR_LIDAR_AZIMUTHS, Sdf.ValueTypeNames.Int).Set(1)
    prim.CreateAttribute(name, Sdf.ValueTypeNames.Double4).Set(numbers)
    stage.Save()
    with pytest.raises(StageError, match=f"/World/odd: {name}: {message}"):
        read_stage(path)


def test_other_programs_read_the_clouds_of_returns(tmp_path):
    """LAS by laspy in the world, within half a step; PCD by its header; both hold all answers."""
    stem = scanned(tmp_path / "full", with_lidar(**FULL), clouds=["pcd", "las"])
    got = read_scan(stem.with_suffix(".las"))
    there = np.isfinite(got.arrays["range"])
    points = got.arrays["points"][there]
    pose = np.array(got.sidecar.lidar_to_world)
    las = laspy.read(stem.with_suffix(".las"))
    world = points.astype(float) @ pose[:3, :3].T + pose[:3, 3]
    assert np.abs(las.xyz - world).max() < 0.5 * LAS_STEP_M + 1e-9
    intensity = np.clip(got.arrays["intensity"][there], 0, 1)
    assert np.abs(np.asarray(las.intensity) / 65535 - intensity).max() < 1e-5
    level = next(name for name in got.arrays if name.startswith("label."))
    assert (np.asarray(las.classification) == got.arrays[level][there]).all()
    assert (las[level.replace(".", "_")] == got.arrays[level][there]).all()
    assert (las["instance"] == got.arrays["instance"][there]).all()
    number = there.cumsum(axis=2)
    many = np.broadcast_to(number[..., -1:], there.shape)
    assert many.max() > 1
    assert (np.asarray(las.return_number) == number[there]).all()
    assert (np.asarray(las.number_of_returns) == many[there]).all()
    assert (las.gps_time == got.sidecar.time_s).all()

    head, _, data = stem.with_suffix(".pcd").read_bytes().partition(b"DATA binary\n")
    fields = dict(line.split(" ", 1) for line in head.decode().splitlines()[1:])
    kinds = {"F": "<f4", "U": "<u4"}
    names, types = fields["FIELDS"].split(), fields["TYPE"].split()
    table = np.frombuffer(data, [(n, kinds[t]) for n, t in zip(names, types, strict=True)])
    assert len(table) == int(fields["POINTS"]) == len(points)
    assert (np.column_stack([table[axis] for axis in "xyz"]) == points).all()
    place = [float(value) for value in fields["VIEWPOINT"].split()]
    turn = Rotation.from_quat(place[3:], scalar_first=True).as_matrix()
    np.testing.assert_allclose(turn, pose[:3, :3], atol=1e-12)
    np.testing.assert_allclose(place[:3], pose[:3, 3], atol=1e-12)
