"""Maps of an output: read by GDAL and the json module, resumed after kills, verified."""

from __future__ import annotations

import csv
import json
import math
import os
import signal
import subprocess
import sys

import numpy as np
import pytest
from killed import contents, killed_at_each_call
from PIL import Image

from scenec.api.maps import map_options
from scenec.backends.annotation.instances import Instances
from scenec.backends.stage.ground import rasterize
from scenec.backends.stage.read import read_stage
from scenec.cli.main import main
from scenec.datasets.maps.rasters import write_layers
from scenec.datasets.maps.tables import write_table
from scenec.schemas import site_map
from scenec.schemas.errors import OutputError
from scenec.schemas.georeference import Georeference
from scenec.schemas.site_map import LAYERS, MapGrid
from scenec.schemas.vehicle import TRAVERSABILITY
from scenec.testing.small import small_cfg, write_cfg

rasterio = pytest.importorskip("rasterio")

#: A reference system of the Moon, in meters.
MOON = (
    'PROJCS["Moon",GEOGCS["Moon",DATUM["Moon",SPHEROID["Moon",1737400,0]],PRIMEM["0",0],'
    'UNIT["degree",0.0174532925199433]],PROJECTION["Polar_Stereographic"],'
    'PARAMETER["latitude_of_origin",-90],PARAMETER["central_meridian",0],'
    'PARAMETER["scale_factor",1],PARAMETER["false_easting",0],PARAMETER["false_northing",0],'
    'UNIT["metre",1]]'
)


@pytest.fixture(scope="module")
def out(tmp_path_factory):
    folder = tmp_path_factory.mktemp("maps")
    cfg = write_cfg(folder, small_cfg(samples=2, batches=2))
    assert main(["compile", str(cfg), "-o", str(folder / "out"), "--keep", "all"]) == 0
    return folder / "out"


@pytest.fixture(scope="module")
def maps(out):
    assert main(["export", str(out), "--format", "map", "--set", "sun_rays=3"]) == 0
    return out / "datasets" / "map"


@pytest.mark.parametrize(("settings", "slope_deg"), [((), 17.0), (("--set", "slope_deg=9"), 9.0)])
def test_traversability_is_for_the_vehicle_that_the_cfg_names(
    settings, slope_deg, tmp_path, capsys
):
    cfg = small_cfg(samples=1)
    sensor = next(iter(cfg["rigs"]["rover"]["sensors"].values()))
    sensor["vehicle"] = {"wheel_base_m": 2.8, "slope_deg": 17}
    path = write_cfg(tmp_path, cfg)
    assert main(["compile", str(path), "-o", str(tmp_path / "out")]) == 0
    layers = ["--set", "layers=height,tilt,traversability", *settings]
    assert main(["export", str(tmp_path / "out"), "--format", "map", *layers]) == 0
    assert f"slopes of {slope_deg:g}°" in capsys.readouterr().err
    folder = tmp_path / "out/datasets/map"
    batch = json.loads((folder / "export.json").read_text())["batches"]["batch_0000"]
    assert batch["vehicle"]["slope_deg"] == slope_deg
    # Cells follow its wheelbase, and what is steeper than it drives is a hazard.
    assert batch["grid"]["cell_m"] == pytest.approx(0.2)
    with rasterio.open(folder / "batch_0000/tilt.tif") as tilt:
        steep = tilt.read(1) > slope_deg
    with rasterio.open(folder / "batch_0000/traversability.tif") as classes:
        assert (classes.read(1)[steep] == TRAVERSABILITY.index("hazard")).all()


def test_each_batch_has_its_layers_tables_and_a_picture(maps, out):
    said = json.loads((maps / "export.json").read_text())
    assert sorted(said["batches"]) == ["batch_0000", "batch_0001"]
    scene = read_stage(out / "batch_0001" / "stage.usda")
    batch = said["batches"]["batch_0001"]
    assert batch["stage_digest"] == scene.digest
    expected = [name for name in LAYERS if name != "label"]
    levels = [f"label_{level}" for level in scene.levels]
    assert sorted(batch["layers"]) == sorted(expected + levels)
    assert batch["rows"]["objects"] == len(Instances(scene).ids)
    names = sorted(path.name for path in (maps / "batch_0001").iterdir())
    tables = [f"{name}.{end}" for name in ("objects", "paths") for end in ("csv", "geojson")]
    assert names == sorted([f"{name}.tif" for name in expected + levels] + tables + ["map.png"])
    picture = np.asarray(Image.open(maps / "batch_0001" / "map.png"))
    # Each class of ground that the map has is in the picture of them, shaded or not.
    assert len(np.unique(picture.reshape(-1, 3), axis=0)) > 1000


def test_gdal_reads_layers_north_up_where_the_stage_has_them(maps, out):
    scene = read_stage(out / "batch_0000" / "stage.usda")
    ground = np.flatnonzero(scene.rows.instance_id == 0)
    with rasterio.open(maps / "batch_0000" / "height.tif") as file:
        heights, transform = file.read(1), file.transform
        assert file.crs is None
        assert math.isnan(file.nodata)
        assert file.units == ("m",)
        assert file.descriptions[0].startswith("height: ")
        step = file.res
    assert step == (pytest.approx(0.1), pytest.approx(0.1))
    west, north = transform @ (0, 0)
    # The ground alone, by another way: triangles over the middles of cells.
    mesh = np.full(heights.shape, -np.inf)
    for row in ground.tolist():
        of, matrix = scene.meshes[scene.rows.mesh[row]], scene.rows.to_world[row]
        points = of.points.astype(float) @ matrix[:, :3].T + matrix[:, 3]
        low = np.array([west, north - heights.shape[0] * step[1]])
        owner = np.empty(mesh.shape, np.int32)
        rasterize(points, of.faces, low, np.array(step), mesh, owner)
    mesh = mesh[::-1]
    with rasterio.open(maps / "batch_0000" / "instance.tif") as file:
        bare = file.read(1) == 0
    assert 0.8 < bare.mean() < 1.0
    np.testing.assert_allclose(heights[bare], mesh[bare], atol=1e-6)
    assert (heights[~bare] >= mesh[~bare] - 1e-6).all()


def test_labels_and_classes_are_whole_numbers_that_export_json_names(maps):
    said = json.loads((maps / "export.json").read_text())["batches"]["batch_0000"]
    for level, names in said["labels"].items():
        with rasterio.open(maps / "batch_0000" / f"label_{level}.tif") as file:
            ids = file.read(1)
        assert ids.dtype == np.uint32
        assert {str(number) for number in np.unique(ids)} <= set(names)
    with rasterio.open(maps / "batch_0000" / "traversability.tif") as file:
        classes = file.read(1)
    assert classes.dtype == np.uint8
    assert set(np.unique(classes)) == {0, 1, 2, 3}
    # A disc of 1.4 m does not fit at the border.
    assert (classes[:6] == 0).all()
    assert (classes[:, :6] == 0).all()
    with rasterio.open(maps / "batch_0000" / "sun.tif") as file:
        assert set(np.unique(np.round(3 * file.read(1)))) == {0, 1, 2, 3}


def test_tables_are_the_same_as_csv_and_geojson(maps, out):
    with (maps / "batch_0000" / "objects.csv").open() as file:
        rows = list(csv.DictReader(file))
    features = json.loads((maps / "batch_0000" / "objects.geojson").read_text())["features"]
    table = Instances(read_stage(out / "batch_0000" / "stage.usda")).table()
    assert len(rows) == len(features) == len(table.id)
    for number, (row, feature) in enumerate(zip(rows, features, strict=True)):
        assert int(row["instance"]) == table.id[number]
        place = feature["geometry"]["coordinates"]
        assert place == [float(row[name]) for name in ("x_m", "y_m", "z_m")]
        away = table.position[number] - place
        assert np.abs(away).max() < float(row["size_m"])
        assert feature["properties"]["class"] == row["class"]
        # What lies on a slope may stand above the ground under its middle.
        above = float(row["above_ground_m"]) / float(row["height_m"])
        assert float(row["burial"]) == pytest.approx(max(0.0, 1.0 - above), abs=1e-3)
    (path,) = json.loads((maps / "batch_0000" / "paths.geojson").read_text())["features"]
    assert path["geometry"]["type"] == "LineString"
    assert len(path["geometry"]["coordinates"]) == len(path["properties"]["time_s"]) == 2


def test_a_place_moves_rasters_and_tables_alike(tmp_path):
    place = Georeference(
        "Moon", 1737400.0, 1737400.0, -89.7, 144.5, crs=MOON, east_north=(0.0, -1.0, 1.0, 0.0),
        to_crs=(0.0, -1.0, 5000.0, 1.0, 0.0, -7000.0),
    )  # fmt: skip
    grid = MapGrid(-2.0, 1.0, 0.5, 8, 4)
    np.savez(tmp_path / "tile.npz", height=np.arange(32, dtype=np.float32).reshape(4, 8))
    write_layers(tmp_path, grid, ("height",), place, lambda _: tmp_path / "tile.npz", 480)
    with rasterio.open(tmp_path / "height.tif") as file:
        # x = 0.25, y = -0.25 is in row 2, column 4.
        assert next(iter(file.sample([(5000.25, -6999.75)]))) == 20
        assert file.crs.to_dict()["proj"] == "stere"
    table = {"camera": ["a"], "time_s": np.zeros(1), "x_m": np.array([0.25]),
             "y_m": np.array([-0.25]), "z_m": np.array([np.nan])}  # fmt: skip
    write_table(tmp_path, "paths", table, place)
    said = json.loads((tmp_path / "paths.geojson").read_text())
    assert said["crs"]["properties"]["name"] == MOON
    assert said["features"][0]["geometry"] == {"type": "Point", "coordinates": [5000.25, -6999.75]}


def test_gdal_takes_a_map_of_a_plane_on_a_body_to_the_latitudes_of_its_tables(tmp_path):
    from rasterio.warp import transform

    place = Georeference("Mars", 3396190.0, 3376200.0, 18.4, 77.5)
    grid = MapGrid(-50.0, 40.0, 10.0, 10, 8)
    np.savez(tmp_path / "tile.npz", height=np.zeros((8, 10), np.float32))
    write_layers(tmp_path, grid, ("height",), place, lambda _: tmp_path / "tile.npz", 480)
    table = {"id": np.arange(2), "x_m": np.array([0.0, 33.0]), "y_m": np.array([0.0, -25.0]),
             "z_m": np.zeros(2)}  # fmt: skip
    write_table(tmp_path, "objects", table, place)
    with (tmp_path / "objects.csv").open() as file:
        rows = list(csv.DictReader(file))
    with rasterio.open(tmp_path / "height.tif") as file:
        plane = file.crs
        assert next(iter(file.sample([(33.0, -25.0)]))) == 0.0
    lonlat = "+proj=longlat +a=3396190 +b=3376200 +no_defs"
    longitude, latitude = transform(plane, lonlat, table["x_m"], table["y_m"])
    np.testing.assert_allclose([float(r["latitude_deg"]) for r in rows], latitude, atol=2e-9)
    np.testing.assert_allclose([float(r["longitude_deg"]) for r in rows], longitude, atol=2e-9)
    assert latitude[0] == pytest.approx(18.4)


def test_maps_that_are_there_are_not_made_again_and_others_are_not_replaced(maps, out, capsys):
    before = contents(maps)
    ask = ["export", str(out), "--format", "map", "--set", "sun_rays=3"]
    assert main(ask) == 0
    assert "there already" in capsys.readouterr().err
    assert main([*ask, "--set", "slope_deg=20"]) == 2
    assert "holds other maps" in capsys.readouterr().err
    assert contents(maps) == before


def test_check_finds_what_was_changed_removed_or_added(maps, tmp_path, capsys):
    copy = tmp_path / "map"
    for path, data in contents(maps).items():
        (copy / path).parent.mkdir(parents=True, exist_ok=True)
        (copy / path).write_bytes(data)
    assert main(["check", str(copy)]) == 0
    (copy / "batch_0000" / "slope.tif").unlink()
    (copy / "batch_0001" / "objects.csv").write_text("none\n")
    data = bytearray((copy / "batch_0001" / "height.tif").read_bytes())
    data[-9] ^= 1
    (copy / "batch_0001" / "height.tif").write_bytes(data)
    (copy / "batch_0001" / "mine.txt").write_text("")
    capsys.readouterr()
    assert main(["check", str(copy)]) == 1
    said = capsys.readouterr().out
    for line in (
        "batch_0000/slope.tif: is missing",
        "batch_0001/objects.csv: has 5 bytes",
        "batch_0001/height.tif: was changed",
        "batch_0001/mine.txt: is no part of it",
    ):
        assert line in said
    assert "4 errors" in said


FEW = ("--set", "layers=height,tilt,instance", "--set", "cell_m=0.2", "--batches", "0:1")


def test_workers_make_the_same_bytes(out, tmp_path):
    for workers in ("0", "2"):
        ask = ["export", str(out), "--format", "map", "-o", str(tmp_path / workers), *FEW]
        assert main([*ask, "--workers", workers]) == 0
    assert contents(tmp_path / "0") == contents(tmp_path / "2")


def test_a_killed_export_goes_on_and_ends_with_the_same_bytes(out, tmp_path, monkeypatch):
    monkeypatch.setattr(site_map, "TILE", 64)
    ask = ["export", str(out), "--format", "map", *FEW]
    assert main([*ask, "-o", str(tmp_path / "whole")]) == 0
    whole, folder = contents(tmp_path / "whole"), tmp_path / "killed"

    def act() -> None:
        assert main([*ask, "-o", str(folder)]) == 0

    # Each goes on where the last one was killed.
    killed = list(killed_at_each_call(act))
    assert len(killed) > 20
    assert contents(folder) == whole
    assert [path.name for path in tmp_path.iterdir() if path.name.endswith(".partial")] == []


def test_tiles_that_are_there_are_not_cast_again(out, tmp_path):
    folder = tmp_path / "map"
    code = f"""
import os, signal
import scenec.datasets.maps.rasters as rasters
import scenec.api.maps as maps
maps.write_layers = lambda *a, **k: os.kill(os.getpid(), signal.SIGKILL)
from scenec.cli.main import main
main(["export", {str(out)!r}, "--format", "map", "-o", {str(folder)!r}, *{FEW!r}])
"""
    killed = subprocess.run([sys.executable, "-c", code], capture_output=True, check=False)
    assert killed.returncode in (-signal.SIGKILL, 2, 1)
    (tile,) = (tmp_path / ".map.partial").rglob("*.npz")
    with np.load(tile) as arrays:
        changed = {name: arrays[name] + 1 for name in arrays}
    with tile.open("wb") as file:
        np.savez(file, **changed)
    assert main(["export", str(out), "--format", "map", "-o", str(folder), *FEW]) == 0
    with rasterio.open(folder / "batch_0000" / "height.tif") as file:
        np.testing.assert_array_equal(file.read(1), changed["height"])
    assert not os.path.exists(tmp_path / ".map.partial")


@pytest.mark.parametrize(
    ("settings", "message"),
    [
        (["cell=1"], r"--set 'cell=1': expected NAME=VALUE of cell_m, .*did you mean .cell_m"),
        (["cell_m"], "expected NAME=VALUE"),
        (["cell_m=x"], "--set 'cell_m=x': expected a number"),
        (["cell_m=-1", "layers=height"], "cell_m=-1: expected a number above 0"),
        (["sample=1.5"], "expected a whole number"),
        (["area_m=1,2,3"], "expected WEST,SOUTH,EAST,NORTH"),
        (["layers=heigth"], "no layer 'heigth'.*height"),
        (["sun_rays=0"], "sun_rays=0: expected a number from 1"),
        (["wheel_base_m=0.1"], "wheel_m|wheel_base_m|cell_m"),
        (["slope_deg=100"], "slope_deg=100: expected"),
    ],
)
def test_options_that_make_no_sense_are_refused(settings, message):
    if settings == ["wheel_base_m=0.1"]:
        # Cells follow the wheelbase: nothing is wrong with a small vehicle.
        assert map_options(settings).cell == pytest.approx(0.1 / 14)
        return
    with pytest.raises(OutputError, match=message):
        map_options(settings)


@pytest.mark.parametrize(
    ("more", "message"),
    [
        (["--set", "sample=2"], "sample=2: .* has the samples 0 to 1"),
        (["--cameras", "rover_front"], "--cameras chooses among frames, and map holds stages"),
        (["--batches", "7:9"], "no such batches"),
        (["--set", "area_m=0,0,1e9,1e9"], "cells of 0.1 m: at most"),
    ],
)
def test_what_cannot_be_mapped_is_said_in_one_line(more, message, out, tmp_path, capsys):
    import re

    assert main(["export", str(out), "--format", "map", "-o", str(tmp_path / "m"), *more]) == 2
    said = capsys.readouterr().err
    assert re.search(message, said), said
    assert "Traceback" not in said
    assert not (tmp_path / "m").exists()


def test_what_was_pruned_is_said_before_the_work(tmp_path, capsys):
    out = str(tmp_path / "out")
    cfg = small_cfg(samples=1)
    assert main(["compile", str(write_cfg(tmp_path, cfg)), "-o", out]) == 0
    capsys.readouterr()
    sparse = ["--set", "layers=height", "--set", "cell_m=1"]
    assert main(["export", out, "--format", "map", *sparse]) == 0
    said = capsys.readouterr().err.splitlines()
    (at,) = (i for i, line in enumerate(said) if line.startswith("warning: objects and ground"))
    assert at < next(i for i, line in enumerate(said) if line.startswith("mapped"))


def test_a_folder_of_somebody_is_left_alone(out, tmp_path, capsys):
    (tmp_path / "mine").write_text("mine")
    assert main(["export", str(out), "--format", "map", "-o", str(tmp_path)]) == 2
    assert "holds no maps of scenec" in capsys.readouterr().err
    assert contents(tmp_path) == {"mine": b"mine"}


def test_the_list_of_formats_has_its_options(capsys):
    assert main(["export", "--list", "--json"]) == 0
    listed = json.loads(capsys.readouterr().out)["map"]["options"]
    assert listed["wheel_base_m"]["default"] == "1.4"
    assert set(listed) >= {"cell_m", "area_m", "sample", "slope_deg"}


def test_craters_in_the_table_are_as_deep_as_the_map_shows(tmp_path):
    """Of those that no other reaches: the mean of the outline above the center, in height.tif."""
    craters = {
        "type": "craters", "min_diameter_m": 2, "max_diameter_m": 5, "density_per_m2": 0.06,
        "degradation": 0.3, "irregularity": 0,
    }  # fmt: skip
    cfg = small_cfg(samples=1, batches=1)
    relief = [{"type": "plane", "slope": [0, 0]}, craters]
    cfg["objects"]["rocks"]["count"] = 1
    cfg["terrain"] |= {
        "size_m": [60, 60],
        "spacing_m": 0.1,
        "relief": relief,
        "mesh": {"tolerance_px": 0},
    }
    folder = tmp_path / "out"
    assert main(["compile", str(write_cfg(tmp_path, cfg)), "-o", str(folder), "--keep", "all"]) == 0
    ask = ["export", str(folder), "--format", "map", "--set", "cell_m=0.05"]
    assert main([*ask, "--set", "layers=height"]) == 0
    maps = folder / "datasets" / "map" / "batch_0000"
    with (maps / "craters.csv").open() as file:
        rows = [{name: float(value) for name, value in row.items()} for row in csv.DictReader(file)]
    features = json.loads((maps / "craters.geojson").read_text())["features"]
    assert len(features) == len(rows) > 20
    assert [row["age"] for row in rows] == sorted((row["age"] for row in rows), reverse=True)
    every = read_stage(folder / "batch_0000" / "stage.usda").craters
    with rasterio.open(maps / "height.tif") as file:
        heights = file.read(1)
        step, west, north = file.res[0], *(file.transform @ (0, 0))
    seen = 0
    turn = np.arange(120) * np.pi / 60
    for row, feature in zip(rows, features, strict=True):
        assert feature["geometry"]["coordinates"] == [row["x_m"], row["y_m"], row["z_m"]]
        radius = 0.5 * row["diameter_m"]
        away = np.hypot(every.x_m - row["x_m"], every.y_m - row["y_m"])
        alone = (away < radius * 1.2 + 2.5 * every.diameter_m).sum() == 1
        if not alone or max(abs(row["x_m"]), abs(row["y_m"])) > 26.0:
            continue
        seen += 1
        x = row["x_m"] + np.append(radius * np.cos(turn), 0.0)
        y = row["y_m"] + np.append(radius * np.sin(turn), 0.0)
        at = heights[((north - y) / step).astype(int), ((x - west) / step).astype(int)]
        assert row["z_m"] == pytest.approx(at[-1], abs=0.02)
        # Cells are half a spacing, and the mesh cuts the crest.
        assert row["depth_m"] == pytest.approx(at[:-1].mean() - at[-1], rel=0.05, abs=0.01)
    assert seen >= 2
