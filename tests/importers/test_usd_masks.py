"""Masks, colors of vertices and lenses in what an import compiles: the same as in the stage."""

from __future__ import annotations

import numpy as np
import pytest
from both_ways import both, notes, seen
from PIL import Image
from pxr import Gf, Sdf, Usd, UsdGeom, UsdRender, UsdShade

from scenec.backends.stage.scene import RenderScene
from scenec.importers.report import APPROXIMATED
from scenec.testing.foreign_stages import new_stage, polygons

TYPES = Sdf.ValueTypeNames
COLORS = [(0.9, 0.1, 0.1), (0.1, 0.9, 0.1), (0.1, 0.1, 0.9), (0.8, 0.8, 0.2)]


def upright(stage: Usd.Stage, name: str, x: float) -> UsdGeom.Mesh:
    """A square of 2 m that stands on the ground, facing -y."""
    points = [(x, 0, 0), (x + 2, 0, 0), (x + 2, 0, 2), (x, 0, 2)]
    return polygons(stage, f"/World/{name}", points, [4], [0, 1, 2, 3])


def masked(stage: Usd.Stage, prim: Usd.Prim, channel: str) -> None:
    """A material whose picture cuts out what is dark, or clear."""
    UsdGeom.PrimvarsAPI(prim).CreatePrimvar("st", TYPES.TexCoord2fArray, "vertex").Set(
        [(0, 0), (1, 0), (1, 1), (0, 1)]
    )
    path = "/World/Looks/leaf"
    material = UsdShade.Material.Define(stage, path)
    shader = UsdShade.Shader.Define(stage, f"{path}/surface")
    shader.CreateIdAttr("UsdPreviewSurface")
    shader.CreateInput("opacityThreshold", TYPES.Float).Set(0.25)
    texture = UsdShade.Shader.Define(stage, f"{path}/mask")
    texture.CreateIdAttr("UsdUVTexture")
    texture.CreateInput("file", TYPES.Asset).Set("mask.png")
    output = texture.CreateOutput(channel, TYPES.Float)
    shader.CreateInput("opacity", TYPES.Float).ConnectToSource(output)
    material.CreateSurfaceOutput().ConnectToSource(shader.CreateOutput("surface", TYPES.Token))
    UsdShade.MaterialBindingAPI.Apply(prim).Bind(material)


def written(folder, channel: str, ground_colors: bool = False):
    y, x = np.mgrid[0:16, 0:16]
    disk = (np.hypot(x - 7.5, y - 7.5) < 6) * 150
    four = np.stack([disk if channel == "r" else 0 * disk] * 3 + [disk], axis=-1)
    Image.fromarray(four.astype(np.uint8)).save(folder / "mask.png")
    stage = new_stage(folder / "stage.usda")
    floor = polygons(stage, "/World/floor", [(-6, -6, 0), (6, -6, 0), (6, 6, 0), (-6, 6, 0)], [4],
                     [0, 1, 2, 3])  # fmt: skip
    floor.CreateDisplayColorPrimvar("vertex" if ground_colors else "constant").Set(
        COLORS if ground_colors else COLORS[:1]
    )
    masked(stage, upright(stage, "leaf", -2.5).GetPrim(), channel)
    upright(stage, "painted", 0.5).CreateDisplayColorPrimvar("vertex").Set(COLORS)
    eye = UsdGeom.Camera.Define(stage, "/World/eye")
    eye.AddTransformOp().Set(Gf.Matrix4d().SetLookAt((0, -8, 2), (0, 0, 1), (0, 0, 1)).GetInverse())
    made = UsdRender.Product.Define(stage, "/Render/eye")
    made.CreateResolutionAttr(Gf.Vec2i(160, 120))
    made.CreateCameraRel().SetTargets(["/World/eye"])
    stage.Save()
    return folder / "stage.usda"


@pytest.mark.parametrize("channel", ["r", "a"])
def test_what_a_mask_leaves_of_a_leaf_is_what_its_import_leaves(tmp_path, channel):
    theirs, ours, made = both(written(tmp_path, channel), samples=1)
    a, b = (seen(scene, scene.cameras[0][0]) for scene in (theirs, ours))
    # Behind the corners of the leaf there are floor and sky.
    solid = np.abs(a.depth - 8.0) < 0.6
    assert solid.sum() > 1500
    wrong = ~np.isclose(a.depth, b.depth, rtol=1e-5)
    assert wrong.mean() < 2e-3
    assert made.cfg["materials"]["leaf"]["maps"]["opacity_threshold"] == 0.25


def colored(scene: RenderScene) -> tuple[np.ndarray, np.ndarray]:
    """Places and colors of the corners of the mesh that has any, by x and z."""
    (number,) = [i for i, mesh in enumerate(scene.meshes) if mesh.color is not None]
    mesh, (row,) = scene.meshes[number], np.flatnonzero(scene.rows.mesh == number)
    matrix = scene.rows.to_world[row]
    places = (mesh.points @ matrix[:, :3].T + matrix[:, 3])[mesh.faces].reshape(-1, 3)
    surface = scene.surfaces[mesh.layers[0]]
    assert (surface.specular, surface.roughness) == (0.0, 1.0)
    colors = mesh.color.reshape(-1, 3) * surface.base_color
    order = np.lexsort(np.round(places.T, 6))
    return places[order], colors[order]


def test_colors_of_vertices_are_carried(tmp_path):
    theirs, ours, _ = both(written(tmp_path, "r"), samples=1)
    for a, b in zip(colored(theirs), colored(ours), strict=True):
        np.testing.assert_allclose(b, a, atol=1e-6)


def test_ground_of_varied_colors_has_their_mean_and_says_so(tmp_path):
    """Of two triangles of one size, whose corners are four colors: two of them count twice."""
    _, _, made = both(written(tmp_path, "r", ground_colors=True), samples=1)
    mean = (2 * np.array(COLORS[0]) + COLORS[1] + 2 * np.array(COLORS[2]) + COLORS[3]) / 6
    np.testing.assert_allclose(made.cfg["materials"]["ground"]["base_color"], mean, rtol=1e-5)
    assert "the mean of its vertices' colors" in notes(made, APPROXIMATED).values()


def test_a_lens_of_omniverse_s_is_carried_with_its_border(tmp_path):
    file = written(tmp_path, "r")
    stage = Usd.Stage.Open(str(file))
    eye = stage.GetPrimAtPath("/World/eye")
    eye.CreateAttribute("cameraProjectionType", TYPES.Token).Set("fisheyeOpenCV")
    for name, value in {
        "fthetaWidth": 160.0, "fthetaHeight": 120.0, "fthetaCx": 81.0, "fthetaCy": 58.5,
        "openCVFx": 70.0, "openCVFy": 69.0, "fthetaPolyA": -0.02, "fthetaMaxFov": 120.0,
    }.items():  # fmt: skip
        eye.CreateAttribute(name, TYPES.Float).Set(value)
    stage.Save()
    theirs, ours, _ = both(file, samples=1)
    a, b = (scene.cameras[0][0] for scene in (theirs, ours))
    np.testing.assert_allclose(b.intrinsics, a.intrinsics, rtol=1e-8)
    np.testing.assert_allclose(b.lens.coefficients, a.lens.coefficients, rtol=1e-8)
    assert b.lens.max_angle == pytest.approx(a.lens.max_angle, rel=1e-8)
