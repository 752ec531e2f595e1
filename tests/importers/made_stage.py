"""A stage as another program may have written it: y up, in centimeters, of two layers."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import numpy as np
from pxr import Gf, Sdf, Usd, UsdGeom, UsdLux, UsdRender, Vt


def mesh(stage: Usd.Stage, path: str, low: tuple[float, ...], high: tuple[float, ...]) -> Usd.Prim:
    """A box, or a rectangle where it has no height."""
    made = UsdGeom.Mesh.Define(stage, path)
    corners = [
        (x, y, z) for y in (low[1], high[1]) for z in (low[2], high[2]) for x in (low[0], high[0])
    ]
    flat = [(0, 2, 3, 1)]
    box = [*flat, (4, 5, 7, 6), (0, 1, 5, 4), (2, 6, 7, 3), (0, 4, 6, 2), (1, 3, 7, 5)]
    faces = flat if low[1] == high[1] else box
    made.CreatePointsAttr(Vt.Vec3fArray.FromNumpy(np.array(corners, np.float32)))
    made.CreateFaceVertexCountsAttr([4] * len(faces))
    made.CreateFaceVertexIndicesAttr([i for face in faces for i in face])
    made.CreateSubdivisionSchemeAttr("none")
    return made.GetPrim()


@contextmanager
def changed(file: Path) -> Iterator[Usd.Stage]:
    """Opens a stage, and saves it in the end."""
    stage = Usd.Stage.Open(str(file))
    yield stage
    stage.GetRootLayer().Save()


def z_up(file: Path) -> Usd.Stage:
    """A new stage in meters."""
    stage = Usd.Stage.CreateNew(str(file))
    UsdGeom.SetStageUpAxis(stage, UsdGeom.Tokens.z)
    UsdGeom.SetStageMetersPerUnit(stage, 1.0)
    return stage


def make_stage(folder: Path, *, instancer: bool = True) -> Path:
    """Ground of 20 m by 16 m whose middle is at x 10 m, a crate, a camera, a moving one, a sun."""
    below = Usd.Stage.CreateNew(str(folder / "crate.usda"))
    below.SetDefaultPrim(UsdGeom.Xform.Define(below, "/crate").GetPrim())
    mesh(below, "/crate/body", (-50, 0, -50), (50, 100, 50))
    below.GetRootLayer().Save()
    file = folder / "scene.usda"
    stage = Usd.Stage.CreateNew(str(file))
    UsdGeom.SetStageUpAxis(stage, UsdGeom.Tokens.y)
    UsdGeom.SetStageMetersPerUnit(stage, 0.01)
    stage.SetTimeCodesPerSecond(10)
    stage.SetStartTimeCode(0)
    stage.SetEndTimeCode(2)
    UsdGeom.Xform.Define(stage, "/World")
    mesh(stage, "/World/floor", (0, 0, -800), (2000, 0, 800))
    crate = UsdGeom.Xform.Define(stage, "/World/crate")
    crate.GetPrim().GetReferences().AddReference("crate.usda")
    crate.AddTranslateOp().Set(Gf.Vec3d(1200, 0, 100))
    UsdGeom.Imageable(mesh(stage, "/World/hidden", (0, 0, 0), (9, 9, 9))).MakeInvisible()
    still = UsdGeom.Camera.Define(stage, "/World/still")
    still.AddTranslateOp().Set(Gf.Vec3d(1000, 200, 700))
    # Apertures and focal length in tenths of the unit: 36 mm by 27 mm, and 30 mm.
    still.CreateHorizontalApertureAttr(36.0)
    still.CreateVerticalApertureAttr(27.0)
    still.CreateFocalLengthAttr(30.0)
    product = UsdRender.Product.Define(stage, "/Render/product")
    product.CreateResolutionAttr(Gf.Vec2i(64, 48))
    product.CreateCameraRel().SetTargets([still.GetPath()])
    moving = UsdGeom.Camera.Define(stage, "/World/moving")
    second = UsdRender.Product.Define(stage, "/Render/second")
    second.CreateCameraRel().SetTargets([moving.GetPath()])
    UsdGeom.Camera.Define(stage, "/World/spare")
    move = moving.AddTranslateOp()
    for code in range(3):
        move.Set(Gf.Vec3d(900 + 100 * code, 150, 600), code)
    sun = UsdLux.DistantLight.Define(stage, "/World/sun")
    sun.CreateIntensityAttr(800)
    sun.CreateNormalizeAttr(True)
    sun.AddRotateXOp().Set(-30.0)
    UsdLux.SphereLight.Define(stage, "/World/bulb")
    if instancer:
        made = UsdGeom.PointInstancer.Define(stage, "/World/posts")
        mesh(stage, "/World/posts/post", (-5, 0, -5), (5, 80, 5))
        made.CreatePrototypesRel().SetTargets([Sdf.Path("/World/posts/post")])
        made.CreateProtoIndicesAttr([0, 0])
        made.CreatePositionsAttr([(500, 0, 0), (1500, 0, -200)])
        made.CreateScalesAttr([(1, 1, 1), (2, 2, 2)])
    stage.GetRootLayer().Save()
    return file
