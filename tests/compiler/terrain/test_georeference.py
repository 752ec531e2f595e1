"""Where on a planet a DEM lies: recorded on the stage, and no number of the scene depends on it."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from pxr import Usd

from scenec.backends.check.stage import check_stage
from scenec.backends.model.collect import coarse_model
from scenec.backends.run.session import Session
from scenec.backends.stage.read import read_stage
from scenec.compiler.build import BuildLog, build
from scenec.compiler.cfg.load import load
from scenec.compiler.compile import compile_cfg
from scenec.compiler.draw import draw
from scenec.compiler.emit.batch import write_batch
from scenec.compiler.scene.scene import DemOrigin
from scenec.datasets.models.gltf import write_gltf
from scenec.schemas import stage as names
from scenec.schemas.codec import decode
from scenec.schemas.errors import CfgError, SceneError, StageError
from scenec.schemas.georeference import Georeference
from scenec.schemas.glb import decode_glb
from scenec.schemas.manifest import read_manifest
from scenec.testing.small import small_cfg, write_cfg

rasterio = pytest.importorskip("rasterio")

PASSES = ("depth", "range", "label", "instance", "face", "normal", "position")
BOARD = {"file": "board.obj", "unit_m": 1, "up": "z"}
HEIGHTS = np.random.default_rng(1).normal(size=(30, 40)).cumsum(axis=0).astype(np.float32)


def compiled(folder: Path, origin: tuple[float, float] | None, **keys) -> Path:
    """A scene on a DEM with everything else in it, too."""
    folder.mkdir()
    place = {} if origin is None else {"crs": "EPSG:32617"}
    corner = (0.0, 0.0) if origin is None else origin
    if origin is None:
        np.save(folder / "dem.npy", HEIGHTS)
    else:
        with rasterio.open(
            folder / "dem.tif", "w", driver="GTiff", width=40, height=30, count=1,
            dtype="float32", transform=rasterio.transform.from_origin(*corner, 1.0, 1.0), **place,
        ) as file:  # fmt: skip
            file.write(HEIGHTS, 1)
    cfg = small_cfg(samples=2)
    cfg["terrain"]["relief"][0] = {
        "type": "dem", "file": "dem.npy" if origin is None else "dem.tif", "pixel_m": 1,
        "center": [0.4, 0.6], "height_scale": 0.3, **keys,
    }  # fmt: skip
    compile_cfg(write_cfg(folder, cfg), seed=5, out=folder / "out")
    return folder / "out" / "batch_0000"


def frames(batch: Path) -> list[dict[str, np.ndarray]]:
    session = Session.open(batch / "stage.usda", "reference")
    found = []
    for sample in range(2):
        camera = session.scene.cameras[sample][0]
        passes = [name for name in session.passes(PASSES, camera) if name != "rgb"]
        found.append(session.render(camera, sample, passes, 1, 1).arrays)
    return found


def test_frames_of_a_scene_moved_by_ten_thousand_kilometers_keep_their_bits(tmp_path):
    near = compiled(tmp_path / "near", (300.0, 500.0))
    far = compiled(tmp_path / "far", (1e7 + 0.3, -1e7))
    none = compiled(tmp_path / "none", None)
    first = frames(near)
    assert np.isfinite(first[0]["depth"]).mean() > 0.3
    assert len(np.unique(first[0]["instance"])) > 5
    for other in (far, none):
        layers = {path.relative_to(other) for path in other.rglob("*.usd*")}
        assert layers == {path.relative_to(near) for path in near.rglob("*.usd*")}
        for name in layers - {Path("stage.usda")}:
            assert (near / name).read_bytes() == (other / name).read_bytes(), name
        for a, b in zip(first, frames(other), strict=True):
            assert a.keys() == b.keys()
            for name in a:
                assert a[name].tobytes() == b[name].tobytes(), name


def test_the_place_of_the_origin_stands_on_the_root_and_in_the_report(tmp_path):
    batch = compiled(tmp_path / "far", (1e7, -1e7 + 0.125), height_offset_m=2.5)
    stage = Usd.Stage.Open(str(batch / "stage.usda"))
    root = stage.GetDefaultPrim()
    assert root.GetAttribute(names.ATTR_GEOREFERENCE_CRS).Get() == "EPSG:32617"
    # 0.4 of 40 columns to the east, and 0.4 of 30 rows south of the first corner.
    center = tuple(root.GetAttribute(names.ATTR_GEOREFERENCE_CENTER).Get())
    assert center == (1e7 + 16.0, -1e7 + 0.125 - 12.0)
    assert root.GetAttribute(names.ATTR_GEOREFERENCE_HEIGHT_OFFSET).Get() == 2.5
    step = json.loads((batch / "report.json").read_text())["relief"][0]
    assert tuple(step["georeference"]["center"]) == center
    assert check_stage(batch / "stage.usda") == []


def test_the_height_offset_gives_back_the_heights_of_the_file(tmp_path):
    # Without an offset the mean is put at 0; what was added for that is what the stage says.
    batch = compiled(tmp_path / "scene", (5.0, 5.0), height_scale=1.0, height_offset_m=None)
    stage = Usd.Stage.Open(str(batch / "stage.usda"))
    root = stage.GetDefaultPrim()
    offset = root.GetAttribute(names.ATTR_GEOREFERENCE_HEIGHT_OFFSET).Get()
    # Rows 10 to 26 from the south, columns 6 to 26: what lies under the terrain of 20 m x 16 m.
    under = HEIGHTS[::-1][10:26, 6:26]
    assert -offset == pytest.approx(float(under.mean()), abs=0.1 * float(under.std()))


def test_tracks_and_objects_by_latitude_lie_where_the_manifest_s_plane_puts_them(tmp_path):
    batch = compiled(tmp_path / "scene", (500_000.0, 4_000_000.0))
    place = read_manifest(tmp_path / "scene" / "out").batches[0].georeference
    assert place == read_stage(batch / "stage.usda").georeference
    assert place.body == "Earth"
    assert place.latitude_deg == pytest.approx(36.14, abs=0.01)
    x, y = np.array([3.0, -7.0, 1.5]), np.array([-2.0, 4.0, 0.0])
    there = list(zip(*place.latitude_longitude(x, y), strict=True))
    cfg = small_cfg(samples=2)
    cfg["terrain"]["relief"][0] = {"type": "dem", "file": "dem.tif", "center": [0.4, 0.6]}
    lines = [f"{i},{p},{q},3,1,0,0,0\n" for i, (p, q) in enumerate(there[:2])]
    (tmp_path / "scene" / "track.csv").write_text(
        "time_s,latitude_deg,longitude_deg,z_m,qw,qx,qy,qz\n" + "".join(lines)
    )
    cfg["rigs"]["rover"]["pose"] = {"type": "track", "file": "track.csv"}
    (tmp_path / "scene" / "board.obj").write_text("v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 3\n")
    (tmp_path / "scene" / "poses.csv").write_text(
        "latitude_deg,longitude_deg\n{},{}\n".format(*there[1])
    )
    own = {"type": "placed", "models": [BOARD], "material": "stone"}
    pose = dict(zip(("latitude_deg", "longitude_deg"), there[2], strict=True))
    cfg["objects"] |= {"one": {**own, "poses": [{"x_m": 5, "y_m": 5}, pose]},
                       "file": {**own, "file": "poses.csv"}}  # fmt: skip
    plan = draw(load(write_cfg(tmp_path / "scene", cfg)), 1, 0)
    assert plan.rigs[0].pose.to_world[:, :2, 3] == pytest.approx(np.stack([x, y], 1)[:2], abs=1e-6)
    one, file = (drawn.keys for drawn in plan.objects[1:])
    assert one[0].position_m[0] == pytest.approx([5, 5, 0])
    assert one[1].position_m[0] == pytest.approx([x[2], y[2], 0], abs=1e-6)
    assert file[0].position_m[0] == pytest.approx([x[1], y[1], 0], abs=1e-6)


def test_latitudes_without_a_place_are_refused(tmp_path):
    np.save(tmp_path / "dem.npy", HEIGHTS)
    (tmp_path / "board.obj").write_text("v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 3\n")
    pose = {"latitude_deg": 1, "longitude_deg": 2}
    cfg = small_cfg()
    cfg["objects"]["one"] = {"type": "placed", "models": [BOARD],
                             "material": "stone", "poses": [pose]}  # fmt: skip
    for poses, relief, said in (
        (
            [pose],
            {"type": "plane"},
            "latitude_deg: the terrain lies nowhere on a body: expected x_m",
        ),
        ([{**pose, "x_m": 1}], None, "x_m and latitude_deg both say where the object is"),
        ([{"longitude_deg": 2}], None, "expected either the key x_m or the key latitude_deg"),
        ([{"x_m": 1, "longitude_deg": 2}], None, "expected latitude_deg and longitude_deg, or x_m"),
    ):
        cfg["objects"]["one"]["poses"] = poses
        cfg["terrain"]["relief"][0] = relief or {"type": "dem", "file": "dem.npy", "pixel_m": 1}
        with pytest.raises(CfgError, match=said):
            load(write_cfg(tmp_path, cfg))
    cfg["objects"]["one"]["poses"] = [pose]
    with pytest.raises(SceneError, match="objects/one/poses/0: latitude_deg and longitude_deg"):
        draw(load(write_cfg(tmp_path, cfg)), 1, 0)


@pytest.mark.parametrize(
    "place",
    [
        Georeference("Moon", 1_737_400.0, 1_737_400.0, -89.5, 40.25),
        Georeference("", 3.4e6, 3.3e6, 90.0, 0.0, (0.8, -0.6, 0.6, 0.8), "EPSG:32617",
                     (1.0, 0.1, 2e6, -0.1, 1.0, -3e6), 0.25),
    ],
)  # fmt: skip
def test_the_place_comes_back_from_the_stage_and_goes_into_models(place, tmp_path):
    scene = build(draw(load(write_cfg(tmp_path)), 1, 0), BuildLog())
    origin = DemOrigin(place.crs, (1.0, 2.0), 0.0, place)
    write_batch(tmp_path / "batch", replace(scene, georeference=origin))
    read = read_stage(tmp_path / "batch" / "stage.usda")
    assert read.georeference == place
    model = coarse_model(read, "b", ground_faces=500, object_faces=500, instances=10)
    write_gltf(model, tmp_path / "b.glb")
    extras = decode_glb((tmp_path / "b.glb").read_bytes())[0]["nodes"][0]["extras"]
    assert decode(extras["georeference"], Georeference, StageError, "extras") == place


@pytest.mark.parametrize(
    ("name", "value", "said"),
    [
        ("semiMajor", -1.0, "expected radii above 0"),
        ("latitude", 91.0, "the latitude 91"),
        ("eastNorth", [1.0], "holds 1 numbers, expected 4"),
    ],
)
def test_a_place_that_is_none_is_an_error(name, value, said, tmp_path):
    scene = build(draw(load(write_cfg(tmp_path)), 1, 0), BuildLog())
    place = Georeference("Moon", 1e6, 1e6, 1.0, 2.0, (0.0, 1.0, -1.0, 0.0))
    write_batch(tmp_path / "batch", replace(scene, georeference=DemOrigin("", (0, 0), 0.0, place)))
    stage = Usd.Stage.Open(str(tmp_path / "batch" / "stage.usda"))
    stage.GetDefaultPrim().GetAttribute(f"scenec:georeference:{name}").Set(value)
    stage.Save()
    with pytest.raises(StageError, match=said):
        read_stage(tmp_path / "batch" / "stage.usda")


def test_without_a_place_there_is_nothing(tmp_path):
    batch = compiled(tmp_path / "scene", None)
    stage = Usd.Stage.Open(str(batch / "stage.usda"))
    root = stage.GetDefaultPrim()
    assert not [name for name in root.GetPropertyNames() if "georeference" in name]
