"""Facts about finished annotation, from the cfg to the pixel."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from pxr import Gf, Usd, UsdGeom

from scenec.backends.camera.rays import camera_rays
from scenec.backends.check.witness import Witness
from scenec.backends.exact import ExactCaster
from scenec.backends.registry import open_backend
from scenec.backends.run.session import Session
from scenec.backends.stage.read import read_stage
from scenec.compiler.build import BuildLog, build
from scenec.compiler.cfg.load import load
from scenec.compiler.compile import compile_cfg
from scenec.compiler.draw import draw
from scenec.compiler.mesh.merge import label_index
from scenec.testing.foreign_stages import polygons
from scenec.testing.small import small_cfg, write_cfg

pytestmark = pytest.mark.usefixtures("workers_here")

PASSES = ("depth", "label", "instance", "normal", "position", "face")


def compiled(folder: Path, cfg: dict, seed: int) -> Path:
    compile_cfg(write_cfg(folder, cfg), seed=seed, out=folder / "out", replace=True)
    return folder / "out" / "batch_0000" / "stage.usda"


def annotation(session: Session, sample: int) -> dict[str, np.ndarray]:
    camera = session.scene.cameras[sample][0]
    return session.render(camera, sample, session.passes(PASSES, camera), 0, 0).arrays


def drawn_cfg(seed: int) -> dict:
    """A cfg whose terrain, rocks and cameras differ much from seed to seed."""
    rng = np.random.default_rng(seed)
    cfg = small_cfg(samples=1)
    cfg["terrain"]["size_m"] = [float(rng.uniform(16, 60))] * 2
    cfg["terrain"]["spacing_m"] = float(rng.uniform(0.1, 0.6))
    cfg["terrain"]["relief"][1]["amplitude_m"] = float(rng.uniform(0.0, 2.5))
    rocks = cfg["objects"]["rocks"]
    rocks["count"] = int(10 ** rng.uniform(0, 4))
    rocks["subdivisions"] = int(rng.integers(1, 4))
    rocks["size_m"] = {"type": "log_uniform", "min": 0.01, "max": float(rng.uniform(0.1, 3.0))}
    rocks["orientation"] = ("random", "upright", "normal")[seed % 3]
    position = cfg["rigs"]["rover"]["pose"]["position"]
    # Grazing views from 20 cm and steep ones from 10 m.
    position["height_m"] = float(10 ** rng.uniform(-0.7, 1.0))
    cfg["rigs"]["rover"]["pose"]["target"]["distance_m"] = float(rng.uniform(1, 12))
    cfg["rigs"]["rover"]["pose"]["roll_deg"] = float(rng.uniform(-40, 40))
    cfg["rigs"]["rover"]["sensors"]["front"] = {
        "resolution": [320, 240],
        "intrinsics": {"fx": 260, "fy": 240, "cx": 150.5, "cy": 127.2, "skew": float(seed % 2)},
    }
    return cfg


@pytest.mark.parametrize(
    "seed", [*range(3), *(pytest.param(n, marks=pytest.mark.slow) for n in range(3, 10))]
)
def test_mitsuba_sees_what_is_annotated_on_every_pixel(seed, tmp_path):
    scene = read_stage(compiled(tmp_path, drawn_cfg(seed), seed))
    backend, rays = open_backend("mitsuba"), camera_rays(scene.cameras[0][0])
    backend.load(scene)
    witness = Witness()
    witness.add(ExactCaster(scene), rays, backend.witness(rays, 0))
    assert (witness.pixels, witness.beyond) == (320 * 240, 0)


def test_labels_are_those_of_the_merge_function_at_the_hit_points(tmp_path):
    cfg = small_cfg(samples=4)
    del cfg["terrain"]["ground"][2], cfg["materials"]["mud"], cfg["labels"]["surface"]["mud"]
    stage = compiled(tmp_path, cfg, 3)
    spec = load(tmp_path / "small.json")
    plan = draw(spec, 3, 0)
    log = BuildLog()
    build(plan, log)
    (merge,) = plan.terrain.merges
    bound = log.facts["ground"]["cuts"][0]["side_error_bound"]
    session = Session.open(stage, "mitsuba")
    ids = cfg["labels"]["surface"]
    ground, wrong = 0, 0
    for sample in range(4):
        found = annotation(session, sample)
        on_ground = (found["label.class"] == cfg["labels"]["class"]["ground"]).ravel()
        x, y, _ = found["position"].reshape(-1, 3)[on_ground].T
        side = merge.side(np.ascontiguousarray(x), np.ascontiguousarray(y))
        expected = np.where(label_index([side]) == 1, ids["gravel"], ids["sand"])
        differs = found["label.surface"].ravel()[on_ground] != expected
        assert np.abs(side[differs]).max(initial=0.0) <= bound
        ground += on_ground.sum()
        wrong += differs.sum()
    assert ground > 5000
    assert wrong < 0.01 * ground


def test_an_instance_keeps_its_id_over_a_batch(tmp_path):
    cfg = small_cfg(samples=6)
    cfg["objects"]["rocks"] |= {"count": 60, "size_m": {"type": "uniform", "min": 0.3, "max": 0.9}}
    stage = compiled(tmp_path, cfg, 8)
    opened = Usd.Stage.Open(str(stage))
    instancer = UsdGeom.PointInstancer(opened.GetPrimAtPath("/World/Objects/rocks"))
    center = np.array(instancer.GetPositionsAttr().Get(), np.float64)
    radius = 0.5 * np.array(instancer.GetScalesAttr().Get(), np.float64)[:, 0]
    session = Session.open(stage, "mitsuba")
    seen: dict[int, set[int]] = {}
    for sample in range(6):
        found = annotation(session, sample)
        rock = found["label.class"] == cfg["labels"]["class"]["rock"]
        assert ((found["instance"] > 0) == rock).all()
        for number in np.unique(found["instance"][rock]).tolist():
            hits = found["position"][found["instance"] == number]
            distance = np.linalg.norm(hits - center[number - 1], axis=1)
            # Whatever the camera, the pixels of an id lie on that very rock.
            assert distance.max() <= radius[number - 1] * (1 + 1e-6)
            seen.setdefault(number, set()).add(sample)
    assert sum(len(samples) > 1 for samples in seen.values()) >= 5


def test_a_class_without_ids_resolves_to_none_and_moves_no_others(tmp_path):
    cfg = small_cfg(samples=1)
    more = cfg["objects"]["rocks"] | {"count": 50}
    cfg["objects"] = {"first": cfg["objects"]["rocks"], "second": more}
    with_ids = annotation(Session.open(compiled(tmp_path, cfg, 2), "reference"), 0)
    cfg["objects"]["first"]["instances"] = False
    without = annotation(Session.open(compiled(tmp_path, cfg, 2), "reference"), 0)
    first = (with_ids["instance"] > 0) & (with_ids["instance"] <= 300)
    assert first.any()
    assert (without["instance"][first] == 0).all()
    assert (without["instance"][~first] == with_ids["instance"][~first]).all()


def plane_stage(path: Path) -> Path:
    """Z = y / 4 with vertices that float32 holds exactly, seen from 8 m above."""
    stage = Usd.Stage.CreateNew(str(path))
    UsdGeom.SetStageUpAxis(stage, UsdGeom.Tokens.z)
    UsdGeom.SetStageMetersPerUnit(stage, 1.0)
    mesh = polygons(
        stage,
        "/plane",
        [(-64, -64, -16), (64, -64, -16), (64, 64, 16), (-64, 64, 16)],
        [4],
        [0, 1, 2, 3],
    )
    camera = UsdGeom.Camera.Define(stage, "/camera")
    camera.AddTransformOp().Set(Gf.Matrix4d(1.0).SetTranslate(Gf.Vec3d(0, 0, 8)))
    camera.CreateFocalLengthAttr(0.5)
    camera.CreateHorizontalApertureAttr(0.5)
    camera.CreateVerticalApertureAttr(0.375)
    stage.SetDefaultPrim(mesh.GetPrim())
    stage.Save()
    return path


@pytest.mark.parametrize("backend", ["reference", "mitsuba"])
def test_depth_of_an_inclined_plane_is_exact_in_memory_and_on_disk(backend, tmp_path):
    from scenec.backends.run.render import render
    from scenec.schemas.frames import read_frame

    stage = plane_stage(tmp_path / "plane.usda")
    session = Session.open(stage, backend)
    camera = session.scene.cameras[0][0]
    assert (camera.width, camera.height) == (640, 480)
    # Looking down, the ray through (u, v) is (x, y, -1) * t from (0, 0, 8): z = y/4 at
    # 8 - t = y t / 4.
    v = (np.arange(480) + 0.5 - camera.intrinsics[1, 2]) / camera.intrinsics[1, 1]
    expected = np.repeat(8.0 / (1.0 - v[:, None] / 4.0), 640, axis=1)
    found = annotation(session, 0)
    assert np.abs(found["depth"] / expected - 1.0).max() <= 1e-12
    report = render(stage, backend, passes=["depth"])
    on_disk = read_frame(report.frames[0]).passes["depth"].astype(np.float64)
    assert np.abs(on_disk / expected - 1.0).max() <= 1e-7


def test_light_that_float32_cannot_hold_is_left_out_and_counted(tmp_path):
    cfg = small_cfg(samples=1)
    # Cliffs of kilometers around the camera: slivers whose barycentrics overflow.
    cfg["terrain"]["relief"][1]["amplitude_m"] = 1e6
    cfg["rigs"]["rover"]["allow_below"] = True
    session = Session.open(compiled(tmp_path, cfg, 3), "mitsuba")
    camera = session.scene.cameras[0][0]
    result = session.render(camera, 0, ("rgb",), 8, 0)
    arrays, record = result.arrays, result.record
    assert np.isfinite(arrays["rgb"]).all()
    assert arrays["rgb"].min() >= 0.0
    assert record.samples_dropped > 0
    ordinary = Session.open(compiled(tmp_path, small_cfg(samples=1), 3), "mitsuba")
    assert (
        ordinary.render(ordinary.scene.cameras[0][0], 0, ("rgb",), 8, 0).record.samples_dropped == 0
    )
