"""The models in assets/models: sound files, as their page says, as their generator makes them."""

from __future__ import annotations

import json
import re
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from scenec.backends.run.render import render
from scenec.cli.main import main
from scenec.compiler.assets.library import shipped, snippet
from scenec.compiler.assets.model import read_model
from scenec.compiler.compile import compile_cfg
from scenec.lab.models import glb, make
from scenec.schemas.frames import read_frame
from scenec.testing.small import small_cfg

ROOT = Path(__file__).resolve().parents[2]
FOLDER = ROOT / "assets" / "models"
#: Most triangles of one file, by its label; of all others, THING.
BUDGETS = {
    "grass": 300, "litter": 300, "flower": 600, "fern": 650, "shrub": 18_000, "tree": 110_000,
    "stone": 5120,
}  # fmt: skip
THING = 25000
#: Parts that are surfaces without an inside: leaves, straws, foils on plates, cells of a pattern.
OPEN = {
    "apriltag_board": {"black", "white"},
    "calibration_board": {"pattern"},
    "hay_bale": {"straw_pale", "straw_shade"},
    "sign_stop": {"white", "red"},
    "sign_give_way": {"white", "red"},
    "sign_speed_limit": {"white", "red", "digits"},
}
#: Parts whose faces share the normals of what they stand on.
LOOSE = {"needles", "bright_needles", "shoots", "straw_pale", "straw_shade"}
#: Things that were made of open pieces on purpose: what they hide is not modeled.
SHELLS = {"lander", "log", "snag"}
PLANTS = {"grass", "litter", "flower", "fern", "shrub", "tree"}
NAMES = sorted(file.stem for file in FOLDER.glob("*.glb"))
CARDS = shipped()
#: Row of the page's table: name, what it is, size, parts (with materials), triangles.
ROW = re.compile(
    r"^\| `(\w+)\.glb` \| .* \| ([\d.]+) × ([\d.]+) × ([\d.]+) \| (.*) \| ([\d,]+) \|$", re.M
)


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


def test_each_file_has_a_row_and_a_maker_and_all_together_stay_small() -> None:
    assert sorted(make.MODELS) == sorted(rows()) == NAMES
    assert sum(card.bytes for card in CARDS.values()) < 6_000_000


@pytest.mark.parametrize("name", NAMES)
def test_a_model_is_sound_and_as_its_page_says(name: str) -> None:
    size, parts, count = rows()[name]
    model = read_model(FOLDER / f"{name}.glb")
    assert CARDS[name].materials == parts
    assert count == CARDS[name].triangles == len(model.faces)
    assert count <= BUDGETS.get(CARDS[name].label, THING)
    for mesh in loaded(name).geometry.values():
        assert np.isfinite(mesh.vertices).all()
        assert mesh.area_faces.min() > (1e-6 if CARDS[name].label in PLANTS else 0.0)
        assert np.array_equal(np.unique(mesh.faces), np.arange(len(mesh.vertices)))
    low, high = model.points.min(axis=0), model.points.max(axis=0)
    assert high - low == pytest.approx(size, abs=0.006)
    # It stands on the ground, or its foot reaches a little below; the origin is under it.
    assert (-0.03 if CARDS[name].label in PLANTS else -0.001) < low[2] <= 0.001
    assert (low[:2] < 0.0).all()
    assert (high[:2] > 0.0).all()


@pytest.mark.parametrize("name", NAMES)
def test_normals_are_unit_vectors_on_one_side_of_their_faces(name: str) -> None:
    document, values, _ = glb.decode((FOLDER / f"{name}.glb").read_bytes())
    for mesh in document["meshes"]:
        (primitive,) = mesh["primitives"]
        points = values[primitive["attributes"]["POSITION"]].astype(np.float64)
        stored = values[primitive["attributes"]["NORMAL"]]
        normals = stored[:, :3] / float(np.iinfo(stored.dtype).max)
        faces = values[primitive["indices"]].reshape(-1, 3)
        assert np.abs(np.sqrt((normals**2).sum(axis=1)) - 1.0).max() < 0.01
        a, b, c = (points[faces[:, k]] for k in range(3))
        outside = np.cross(b - a, c - a)
        facing = (outside * normals[faces].sum(axis=1)).sum(axis=1) > 0.0
        # Needles and straws stand out on all sides, and share the normals of the outer one.
        if mesh["name"] not in LOOSE:
            assert facing.mean() > 0.99, mesh["name"]


@pytest.mark.parametrize(
    "name", [n for n in NAMES if CARDS[n].label not in PLANTS and n not in SHELLS]
)
def test_a_thing_is_closed_and_its_faces_look_outward(name: str) -> None:
    model = read_model(FOLDER / f"{name}.glb")
    inside = [part[1:] not in OPEN.get(name, ()) for part in model.parts]
    faces = model.faces[np.array(inside)[model.part_of_face]].astype(np.int64)
    # Every edge is walked as often forth as back: the surface has no border, whichever parts
    # share it, and solids may touch.
    forth = np.concatenate([faces[:, [k, (k + 1) % 3]] for k in range(3)])
    count = len(model.points)
    walked = np.unique(forth @ [count, 1], return_counts=True)
    back = np.unique(forth[:, ::-1] @ [count, 1], return_counts=True)
    assert all(np.array_equal(a, b) for a, b in zip(walked, back, strict=True))
    a, b, c = (model.points[faces[:, k]] for k in range(3))
    volumes = (a * np.cross(b, c)).sum(axis=1) / 6.0
    assert volumes.sum() > 0.0
    trimesh = pytest.importorskip("trimesh")
    pieces = trimesh.graph.connected_component_labels(
        np.concatenate([faces[:, :2], faces[:, 1:]]), node_count=count
    )
    assert np.bincount(pieces[faces[:, 0]], volumes).min() > -1e-12


@pytest.mark.parametrize("name", NAMES)
def test_the_reader_finds_what_the_list_says(name: str) -> None:
    card = CARDS[name]
    model = read_model(FOLDER / f"{name}.glb")
    assert np.ptp(model.points, axis=0) == pytest.approx(card.size_m, abs=2e-3)
    assert np.bincount(model.part_of_face).tolist() == list(card.parts.values())
    assert (model.degenerate, model.notes) == (0, ())
    assert list(model.parts) == [f"/{part}" for part in card.parts]
    assert {m.name for m in model.materials} == set(card.materials.values())
    assert card.license == "CC0-1.0"


@pytest.mark.parametrize(
    "name",
    [pytest.param(n, marks=pytest.mark.slow if CARDS[n].triangles > 9000 else ()) for n in NAMES],
)
def test_a_file_is_what_its_generator_makes(name: str) -> None:
    assert glb.same((FOLDER / f"{name}.glb").read_bytes(), glb.encode(*make.made(name)))


@pytest.mark.parametrize("name", ["fence_panel", "stone_slab", "sign_stop"])
def test_a_model_made_twice_has_the_same_bytes(name: str) -> None:
    assert glb.encode(*make.made(name)) == glb.encode(*make.made(name))


def test_a_moved_point_is_not_the_same_model() -> None:
    model, card = make.made("clover")
    before = glb.encode(model, card)
    model.parts["leaves"].points[5, 0] += 0.001
    assert not glb.same(before, glb.encode(model, card))


def test_the_board_has_squares_of_a_tenth_of_a_meter() -> None:
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


def test_opencv_reads_the_six_tags_of_the_board() -> None:
    cv2 = pytest.importorskip("cv2")
    model = read_model(FOLDER / "apriltag_board.glb")
    black = model.faces[model.part_of_face == model.parts.index("/black")]
    pixels_per_m, width, height = 500.0, 600, 450
    picture = np.full((height, width), 255, np.uint8)
    for x, _, z in model.points[black].reshape(-1, 3, 3).mean(axis=1):
        # Of a cell's two triangles either middle lies in it.
        column, row = np.floor((x + 0.54) / 0.03), np.floor((1.2 - z) / 0.03)
        left, top = (
            round((0.06 + 0.03 * column) * pixels_per_m),
            round((0.06 + 0.03 * row) * pixels_per_m),
        )
        picture[top : top + 15, left : left + 15] = 0
    family = cv2.aruco.getPredefinedDictionary(cv2.aruco.DICT_APRILTAG_36h11)
    corners, ids, _ = cv2.aruco.ArucoDetector(family).detectMarkers(picture)
    assert sorted(ids.ravel().tolist()) == [0, 1, 2, 3, 4, 5]
    for corner, number in zip(corners, ids.ravel().tolist(), strict=True):
        row, column = divmod(number, 3)
        middle = corner[0].mean(axis=0) / pixels_per_m - 0.06
        assert middle == pytest.approx([0.21 + 0.33 * column, 0.21 + 0.33 * row], abs=0.004)


def test_assets_lists_all_and_shows_one(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["assets"]) == 0
    listed = capsys.readouterr().out
    assert all(f"\n{name} " in listed for name in NAMES)
    assert main(["assets", "--json"]) == 0
    assert [row["name"] for row in json.loads(capsys.readouterr().out)] == NAMES
    assert main(["assets", "car", "--json"]) == 0
    car = json.loads(capsys.readouterr().out)
    assert car["cfg"]["objects"]["car"]["parts"]["windows"] == {"labels": {"part": "windows"}}
    assert car["size_m"] == pytest.approx([2.14, 4.33, 1.48], abs=0.005)
    assert main(["assets", "tracktor"]) == 2
    assert capsys.readouterr().err == ("scenec: no asset 'tracktor'; did you mean \"tractor\"?\n")


@pytest.mark.slow
def test_a_cfg_with_all_of_them_compiles_and_every_label_is_annotated(tmp_path: Path) -> None:
    cfg = small_cfg(samples=1)
    labels: dict[str, dict[str, int]] = {"class": {"sky": 1, "ground": 2}, "part": {}}
    cfg["objects"], across = {}, 7
    for number, card in enumerate(CARDS.values()):
        lines = snippet(card, CARDS)
        for level, names in lines["labels"].items():
            labels[level] |= names
        (entry,) = lines["objects"].values()
        entry["type"] = "placed"
        entry.pop("count", None)
        entry.pop("embed", None)
        row, column = divmod(number, across)
        place = {"x_m": 12.0 * (column - 3), "y_m": 12.0 * (row - 3)}
        # Grass of 0.2 m and a tree of 10 m are seen as large as each other.
        entry["poses"] = [place | {"scale": 8.0 / max(card.size_m)}]
        cfg["objects"][card.name] = entry
    cfg["labels"] = labels
    cfg["terrain"] |= {"size_m": [100, 100], "spacing_m": 2, "relief": [{"type": "plane"}]}
    cfg["terrain"]["ground"] = [{"material": "sand", "labels": {"class": "ground"}}]
    cfg["materials"] = {"sand": cfg["materials"]["sand"]}
    cfg["light"]["sky"]["labels"] = {"class": "sky"}
    cfg["rigs"] = {
        f"row_{row}": {
            "pose": {
                "type": "random_target",
                "position": {"x_m": 0, "y_m": 12.0 * (row - 3) - 14, "height_m": 16},
                "target": {"distance_m": 14, "bearing_deg": 0, "height_m": 2},
            },
            "sensors": {"eye": {"resolution": [1280, 160], "fov_deg": 138}},
        }
        for row in range(8)
    }
    cfg["outputs"] = ["label", "instance"]
    path = tmp_path / "cfg.json"
    path.write_text(json.dumps(cfg), encoding="utf-8")
    compile_cfg(path, seed=1, out=tmp_path / "out")
    report = render(tmp_path / "out", "reference", passes=("label", "instance"))
    assert not report.failed
    frames = [read_frame(frame) for frame in report.frames]
    seen = {
        level: set(np.unique([frame.passes[f"label.{level}"] for frame in frames]).tolist())
        for level in labels
    }
    assert set(labels["class"].values()) <= seen["class"] | {labels["class"]["sky"]}
    # From above, some are too small, and some hidden below or inside of the others.
    hidden = {n for n, number in labels["part"].items() if number not in seen["part"]}
    assert hidden <= {
        *("inside", "filling", "belly", "lamp"),
        *("nails", "staples", "hinges", "bungs", "lenses"),
    }
    assert len(np.unique([frame.passes["instance"] for frame in frames])) == len(NAMES) + 1
