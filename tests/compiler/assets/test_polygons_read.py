"""Concave and broken polygons in every format of meshes."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
from pxr import Gf, Sdf, Usd, UsdGeom, UsdShade

from scenec.cli.main import main
from scenec.compiler.assets.model import read_model
from scenec.compiler.assets.parse import parse_model
from scenec.compiler.compile import compile_cfg
from scenec.testing.outlines import CROSSES, EMPTY, C

#: A square, a C that opens to the right and begins where a fan from its first corner is wrong.
SQUARE = [(2, 0), (3, 0), (3, 1), (2, 1)]
POLYGONS = [SQUARE, [*C[1:], C[0]]]
BOW = [(4, 0), (6, 2), (6, 0), (4, 1)]
LINE = [(7, 0), (8, 0), (9, 0), (8, 0)]
FORMATS = ("obj", "ply", "off", "usda")


def write(path: Path, polygons) -> Path:
    """Polygons in the plane z = 0; texture coordinates are their coordinates."""
    points = [point for polygon in polygons for point in polygon]
    counts = [len(polygon) for polygon in polygons]
    ends = np.cumsum(counts)
    faces = [list(range(end - n, end)) for end, n in zip(ends.tolist(), counts, strict=True)]
    rows = "".join(f"{x} {y} 0\n" for x, y in points)
    lists = "".join(f"{len(face)} {' '.join(map(str, face))}\n" for face in faces)
    if path.suffix == ".obj":
        text = "".join(f"v {x} {y} 0\n" for x, y in points)
        # In the opposite order of the positions.
        text += "".join(f"vt {x} {y}\n" for x, y in points[::-1])
        for k, face in enumerate(faces):
            words = " ".join(f"{i + 1}/{len(points) - i}" for i in face)
            text += f"o part{k}\nf {words}\n"
    elif path.suffix == ".off":
        text = f"OFF\n{len(points)} {len(faces)} 0\n{rows}{lists}"
    elif path.suffix == ".ply":
        header = "".join(f"property float {name}\n" for name in ("x", "y", "z", "s", "t"))
        text = (
            f"ply\nformat ascii 1.0\nelement vertex {len(points)}\n{header}element face "
            f"{len(faces)}\nproperty list uchar int vertex_indices\nend_header\n"
            + "".join(f"{x} {y} 0 {x} {y}\n" for x, y in points)
            + lists
        )
    else:
        return _usd(path, points, counts)
    path.write_text(text)
    return path


def _usd(path: Path, points, counts) -> Path:
    stage = Usd.Stage.CreateNew(str(path))
    UsdGeom.SetStageUpAxis(stage, UsdGeom.Tokens.z)
    UsdGeom.SetStageMetersPerUnit(stage, 1.0)
    mesh = UsdGeom.Mesh.Define(stage, "/it")
    mesh.CreatePointsAttr([(x, y, 0) for x, y in points])
    mesh.CreateFaceVertexCountsAttr(counts)
    mesh.CreateFaceVertexIndicesAttr(list(range(len(points))))
    mesh.CreateSubdivisionSchemeAttr("none")
    st = UsdGeom.PrimvarsAPI(mesh).CreatePrimvar(
        "st", Sdf.ValueTypeNames.TexCoord2fArray, "faceVarying"
    )
    st.Set(points[::-1])
    st.SetIndices(list(range(len(points)))[::-1])
    for k in range(len(counts)):
        subset = UsdShade.MaterialBindingAPI(mesh).CreateMaterialBindSubset(f"part{k}", [k])
        material = UsdShade.Material.Define(stage, f"/looks/m{k}")
        UsdShade.MaterialBindingAPI.Apply(subset.GetPrim()).Bind(material)
    stage.Save()
    return path


def areas(model) -> np.ndarray:
    """Of the triangles, with their sign seen from above."""
    a, b, c = np.moveaxis(model.points[model.faces], 1, 0)
    return 0.5 * np.cross(b - a, c - a)[:, 2]


@pytest.mark.parametrize("looks", [False, True])
@pytest.mark.parametrize("suffix", FORMATS)
def test_a_concave_polygon_has_its_own_area_and_coordinates_in_every_format(
    tmp_path, suffix, looks
):
    model = read_model(write(tmp_path / f"a.{suffix}", POLYGONS), unit_m=1, up="z", looks=looks)
    assert (areas(model) > 0.0).all()
    assert areas(model).sum() == 3.5
    assert len(model.faces) == 8
    assert model.degenerate == 0
    assert model.faces[:2].tolist() == [[0, 1, 2], [2, 3, 0] if suffix == "off" else [0, 2, 3]]
    if looks and suffix != "off":
        assert np.array_equal(model.uv, model.points[model.faces][..., :2])
    if looks and suffix in ("obj", "usda"):
        assert [p.rpartition("/")[2] for p in model.parts] == ["part0", "part1"]
        assert [areas(model)[model.part_of_face == k].sum() for k in (0, 1)] == [1.0, 2.5]


@pytest.mark.parametrize("mirror", [False, True])
@pytest.mark.parametrize("left", [False, True])
def test_usd_polygons_keep_their_side_through_orientation_and_mirrors(tmp_path, left, mirror):
    path = write(tmp_path / "a.usda", POLYGONS)
    stage = Usd.Stage.Open(str(path))
    mesh = UsdGeom.Mesh(stage.GetPrimAtPath("/it"))
    mesh.CreateOrientationAttr("leftHanded" if left else "rightHanded")
    mesh.AddScaleOp().Set(Gf.Vec3f(-1.0 if mirror else 1.0, 1.0, 1.0))
    stage.Save()
    model = read_model(path)
    # A left-handed outline is seen from below; a mirror takes the side that is seen with it.
    assert (areas(model) < 0.0).all() if left else (areas(model) > 0.0).all()
    assert np.abs(areas(model)).sum() == 3.5
    x = -1.0 if mirror else 1.0
    assert np.array_equal(model.uv, model.points[model.faces][..., :2] * [x, 1.0])


def test_off_has_triangles_then_halves_of_quads_then_larger_polygons(tmp_path):
    triangle, pentagon = [(0, 5), (1, 5), (0, 6)], [(4, 5), (6, 5), (7, 6), (5, 7), (3, 6)]
    polygons = [pentagon, SQUARE, triangle, [(x, y + 9) for x, y in SQUARE]]
    (shell,) = parse_model(write(tmp_path / "a.off", polygons)).parts
    assert shell.faces.tolist() == [
        [9, 10, 11],
        [5, 6, 7], [12, 13, 14], [7, 8, 5], [14, 15, 12],
        [0, 1, 2], [0, 2, 3], [0, 3, 4],
    ]  # fmt: skip


def test_off_cut_short_is_refused(tmp_path):
    whole = write(tmp_path / "a.off", POLYGONS).read_text().rstrip()
    for text in (whole.rpartition("\n")[0], whole.rpartition(" ")[0]):
        (tmp_path / "b.off").write_text(text)
        with pytest.raises(Exception, match=r"b\.off: not a sound OFF file: cut short"):
            parse_model(tmp_path / "b.off")


def cfg_with(folder: Path, relief: list, **objects) -> Path:
    cfg = {
        "version": 1, "name": "c", "samples": 1,
        "labels": {"class": {"ground": 1, **dict.fromkeys(objects, 2)}},
        "terrain": {"size_m": [20, 20], "spacing_m": 0.5, "relief": relief,
                    "ground": [{"material": "m", "labels": {"class": "ground"}}]},
        "materials": {"m": {"base_color": [0.3, 0.3, 0.3]}},
        "light": {"sun": {"elevation_deg": 40}},
        "objects": objects,
        "rigs": {"r": {
            "sensors": {"c": {"resolution": [16, 12], "fov_deg": 50}},
            "pose": {"type": "random_target",
                     "position": {"x_m": 0, "y_m": -4, "height_m": 2},
                     "target": {"distance_m": 4, "bearing_deg": 0, "height_m": 2}}}},
    }  # fmt: skip
    path = folder / "c.json"
    path.write_text(json.dumps(cfg))
    return path


@pytest.mark.parametrize("suffix", FORMATS)
def test_what_is_wrong_with_polygons_is_said_on_the_screen_and_stands_in_the_report(
    tmp_path, suffix, capsys
):
    polygons = [*POLYGONS, BOW, [(x, y + 5) for x, y in BOW], LINE]
    file = write(tmp_path / f"a.{suffix}", polygons)
    lines = [f"a.{suffix}: {CROSSES}: 2 in all", f"a.{suffix}: {EMPTY}: 1 in all"]
    model = {"file": file.name, "unit_m": 1, "up": "z"}
    cfg = cfg_with(
        tmp_path,
        [{"type": "plane", "height_m": -1}],
        c={
            "type": "placed", "models": [model], "material": "m", "labels": {"class": "c"},
            "heights": "world", "poses": [{"x_m": 0, "y_m": 0, "z_m": 1}],
        },
    )  # fmt: skip
    assert main(["validate", str(cfg)]) == 0
    err = capsys.readouterr().err
    for line in lines:
        assert f"/objects/c/models/0/file: {line}\n" in err
    compile_cfg(cfg, seed=0, out=tmp_path / "out")
    report = json.loads((tmp_path / "out/batch_0000/report.json").read_text())
    assert set(lines) <= set(report["objects"]["c"]["left_out"])


def test_terrain_of_a_mesh_says_the_same(tmp_path, capsys):
    wide = [[(-20, -20), (20, -20), (20, 20), (-20, 20)], BOW]
    write(tmp_path / "a.obj", wide)
    cfg = cfg_with(tmp_path, [{"type": "mesh", "file": "a.obj", "unit_m": 1, "up": "z"}])
    assert main(["compile", str(cfg), "-o", str(tmp_path / "out")]) == 0
    line = f"{CROSSES}: 1 in all"
    assert f"/terrain/relief/0/file: a.obj: {line}\n" in capsys.readouterr().err
    report = json.loads((tmp_path / "out/batch_0000/report.json").read_text())
    assert report["relief"][0]["left_out"] == [line]
