"""The models in assets/models: sound files, as their page says, as their generator makes them."""

from __future__ import annotations

import importlib
import re
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest

ROOT = Path(__file__).resolve().parents[2]
FOLDER = ROOT / "assets" / "models"
#: Most triangles of one file, by what it is.
BUDGETS = {"grass": 300, "herb": 600, "shrub": 6000, "tree": 20000, "prop": 3000}
KINDS = {
    "grass_short": "grass", "grass_tall": "grass", "grass_seeding": "grass",
    "clover": "herb", "daisy": "herb", "poppy": "herb",
    "hazel": "shrub", "rose": "shrub", "oak": "tree", "birch": "tree", "spruce": "tree",
    "log": "prop", "calibration_board": "prop", "lander": "prop",
}  # fmt: skip
#: Row of the page's table: name, what it is, size, parts (with materials), triangles.
ROW = re.compile(
    r"^\| `(\w+)\.glb` \| .* \| ([\d.]+) × ([\d.]+) × ([\d.]+) \| (.*) \| ([\d,]+) \|$", re.M
)


@pytest.fixture(scope="module")
def tools() -> Any:
    """The modules ``make`` and ``glb`` of tools/models."""
    sys.path.insert(0, str(ROOT / "tools" / "models"))
    try:
        return importlib.import_module("make"), importlib.import_module("glb")
    finally:
        sys.path.pop(0)


def loaded(name: str) -> Any:
    trimesh = pytest.importorskip("trimesh")
    return trimesh.load_scene(FOLDER / f"{name}.glb", process=False)


def rows() -> dict[str, tuple[Any, ...]]:
    """The page's table: sizes, parts with their materials, triangles."""
    text = (FOLDER / "README.md").read_text()
    out = {}
    for name, x, y, z, parts, count in ROW.findall(text):
        named = dict(re.findall(r"`(\w+)` \((\w+)\)", parts))
        out[name] = ((float(x), float(y), float(z)), named, int(count.replace(",", "")))
    return out


def test_each_file_has_a_row_and_a_kind_and_all_together_stay_small() -> None:
    names = sorted(file.stem for file in FOLDER.glob("*.glb"))
    assert names == sorted(KINDS) == sorted(rows())
    assert sum(file.stat().st_size for file in FOLDER.glob("*.glb")) < 3_000_000


@pytest.mark.parametrize("name", KINDS)
def test_a_model_is_sound_and_as_its_page_says(name: str) -> None:
    size, parts, count = rows()[name]
    scene = loaded(name)
    assert {key: mesh.visual.material.name for key, mesh in scene.geometry.items()} == parts
    assert count == sum(len(mesh.faces) for mesh in scene.geometry.values())
    assert count <= BUDGETS[KINDS[name]]
    for mesh in scene.geometry.values():
        assert np.isfinite(mesh.vertices).all()
        assert mesh.area_faces.min() > 1e-6
        assert np.array_equal(np.unique(mesh.faces), np.arange(len(mesh.vertices)))
    low, high = scene.bounds
    # The file's axes are x right, y up, z to the front; the page's are width, depth, height.
    assert (high - low)[[0, 2, 1]] == pytest.approx(size, abs=0.006)
    # It stands on the ground, or its foot reaches a little below; the origin is under it.
    assert -0.03 < low[1] <= 0.001
    assert (low[[0, 2]] < 0.0).all()
    assert (high[[0, 2]] > 0.0).all()


@pytest.mark.parametrize("name", KINDS)
def test_normals_are_unit_vectors_on_one_side_of_their_faces(name: str, tools: Any) -> None:
    _, glb = tools
    document, values, _ = glb.decode((FOLDER / f"{name}.glb").read_bytes())
    for mesh in document["meshes"]:
        (primitive,) = mesh["primitives"]
        points = values[primitive["attributes"]["POSITION"]].astype(np.float64)
        normals = values[primitive["attributes"]["NORMAL"]][:, :3] / 127.0
        faces = values[primitive["indices"]].reshape(-1, 3)
        assert np.abs(np.sqrt((normals**2).sum(axis=1)) - 1.0).max() < 0.01
        a, b, c = (points[faces[:, k]] for k in range(3))
        outside = np.cross(b - a, c - a)
        facing = (outside * normals[faces].sum(axis=1)).sum(axis=1) > 0.0
        # Needles stand out from the twig on all sides, and share the normals of its upper side.
        if mesh["name"] not in ("needles", "shoots"):
            assert facing.mean() > 0.99, mesh["name"]


@pytest.mark.parametrize(
    "name",
    [pytest.param(n, marks=pytest.mark.slow if k == "tree" else ()) for n, k in KINDS.items()],
)
def test_a_file_is_what_its_generator_makes(name: str, tools: Any) -> None:
    make, glb = tools
    assert list(make.MODELS) == list(KINDS)
    assert glb.same((FOLDER / f"{name}.glb").read_bytes(), glb.encode(make.MODELS[name]()))


def test_a_moved_point_is_not_the_same_model(tools: Any) -> None:
    make, glb = tools
    model = make.MODELS["clover"]()
    before = glb.encode(model)
    model.parts["leaves"].points[5, 0] += 0.001
    assert not glb.same(before, glb.encode(model))


def test_the_board_has_squares_of_a_tenth_of_a_meter(tools: Any) -> None:
    _, glb = tools
    document, values, (picture,) = glb.decode((FOLDER / "calibration_board.glb").read_bytes())
    mesh = next(m for m in document["meshes"] if m["name"] == "pattern")
    attributes = mesh["primitives"][0]["attributes"]
    points, uv = values[attributes["POSITION"]], values[attributes["TEXCOORD_0"]]
    # Meters per picture: all of it lies on the board once, upright, seen from the front.
    assert np.ptp(points, axis=0) == pytest.approx([1.2, 0.9, 0.0])
    assert uv[:, 0] == pytest.approx((points[:, 0] + 0.6) / 1.2)
    assert 1.0 - uv[:, 1] == pytest.approx((points[:, 1] - 0.45) / 0.9)
    dark = picture[:, :, 0] < 128
    height, width = dark.shape
    assert (height, width) == (720, 960)
    x, y = np.meshgrid(
        (np.arange(width) + 0.5) * 1.2 / width, (np.arange(height) + 0.5) * 0.9 / height
    )
    column, row = np.floor(x / 0.1).astype(int) - 1, np.floor(y / 0.1).astype(int) - 1
    inside = (column >= 0) & (column < 10) & (row >= 0) & (row < 7)
    assert np.array_equal(dark, inside & ((column + row) % 2 == 0))
