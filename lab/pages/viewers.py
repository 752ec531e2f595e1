"""Makes what docs/viewers.md shows of stages held against Hydra Storm and Blender's importer.

    python lab/pages/viewers.py [--fast] [-o FOLDER]

Needs the extras "mitsuba" and "cycles" (bpy has Storm, too) and OpenGL 4.5 by EGL. Each stage is
drawn by Mitsuba, by Storm and by Blender's importer with Cycles. Coverage is what shows at pixel
centers: ours of the exact caster, theirs of their alpha.
"""

from __future__ import annotations

import json
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import OpenEXR
from numpy.typing import NDArray
from PIL import Image
from pxr import Gf, Sdf, Usd, UsdGeom, UsdLux, UsdShade, Vt
from scipy.ndimage import binary_dilation, binary_erosion

from scenec.backends.run.render import render
from scenec.lab.pictures import save, sheet
from scenec.lab.runner import ROOT, Cell, Page, run
from scenec.schemas.errors import ScenecError
from scenec.schemas.frames import Frame, read_frame
from scenec.schemas.picture import develop
from scenec.testing.foreign_stages import new_stage, polygons
from scenec.testing.skinned_stages import write_arm

WIDTH, HEIGHT = 320, 240
_STORM = ROOT / "tests" / "viewers" / "storm_render.py"
_BLENDER = ROOT / "lab" / "pages" / "blender_render.py"
_TYPES = Sdf.ValueTypeNames


def look(stage: Usd.Stage, x: float, y: float, z: float, tilt_deg: float) -> None:
    """Defines the camera, a sun and a gray sky."""
    eye = UsdGeom.Camera.Define(stage, "/World/eye")
    eye.AddTranslateOp().Set(Gf.Vec3d(x, y, z))
    eye.AddRotateXOp().Set(tilt_deg)
    eye.CreateFocalLengthAttr(24.0)
    aperture = eye.GetHorizontalApertureAttr().Get()
    # Storm's recorder rounds the height that it takes from this down.
    eye.CreateVerticalApertureAttr(aperture * HEIGHT / WIDTH * (1 + 1e-6))
    product = stage.DefinePrim("/Render/view", "RenderProduct")
    product.CreateRelationship("camera").SetTargets([eye.GetPath()])
    product.CreateAttribute("resolution", _TYPES.Int2).Set(Gf.Vec2i(WIDTH, HEIGHT))
    sun = UsdLux.DistantLight.Define(stage, "/World/sun")
    sun.CreateIntensityAttr(2.0)
    sun.CreateNormalizeAttr(True)
    sun.AddRotateXYZOp().Set(Gf.Vec3f(50, 25, 0))
    gray = Path(stage.GetRootLayer().realPath).parent / "gray.png"
    Image.new("RGB", (8, 4), (188, 188, 188)).save(gray)
    UsdLux.DomeLight.Define(stage, "/World/sky").CreateTextureFileAttr("./gray.png")


def colored(shape: UsdGeom.Gprim, red: float, green: float, blue: float) -> None:
    """Gives a shape one color."""
    shape.CreateDisplayColorAttr([(red, green, blue)])


def skinned(stage: Usd.Stage) -> None:
    """An arm of two joints, with a blend shape, once as polygons and once subdivided."""
    for name, scheme, x in (("smooth", "catmullClark", 0.0), ("polygons", "none", 2.2)):
        arm = write_arm(stage, f"/World/{name}", scheme)
        colored(arm, 0.7, 0.25, 0.15)
        UsdGeom.Xformable(arm.GetPrim().GetParent()).AddTranslateOp().Set(Gf.Vec3d(x, 0, 0))
    look(stage, 1.6, -5.6, 0.0, 90.0)


def grass(stage: Usd.Stage) -> None:
    """Blades of pinned B-splines that taper, and a bent pipe of a periodic linear curve."""
    rng, count = np.random.default_rng(1), 150
    root = np.concatenate([rng.uniform(-1.5, 1.5, (count, 2)), np.zeros((count, 1))], axis=1)
    height, lean = rng.uniform(0.8, 1.6, count), rng.normal(0, 0.35, (count, 2))
    t = np.array([0, 1 / 3, 2 / 3, 1])
    across = (lean * height[:, None])[:, None] * (t * t)[:, None]
    points = root[:, None] + np.concatenate([across, height[:, None, None] * t[:, None]], axis=2)
    blades = curve(stage, "grass", points.reshape(-1, 3), [4] * count, "cubic", "pinned")
    blades.CreateWidthsAttr(np.tile([0.07, 0.06, 0.04, 0.0], count).tolist())
    blades.SetWidthsInterpolation("vertex")
    blades.CreateDisplayColorPrimvar("uniform").Set(
        Vt.Vec3fArray.FromNumpy(
            rng.uniform((0.1, 0.25, 0.02), (0.3, 0.5, 0.06), (count, 3)).astype(np.float32)
        )
    )
    ring = np.array([(-2.4, 0, 0.2), (-1.8, 0, 0.2), (-1.8, 0, 1.4), (-2.4, 0, 1.4)])
    pipe = curve(stage, "pipe", ring, [4], "linear", "periodic")
    pipe.CreateWidthsAttr([0.15])
    pipe.SetWidthsInterpolation("constant")
    colored(pipe, 0.15, 0.25, 0.7)
    look(stage, -0.4, -4.6, 1.0, 87.0)


def curve(
    stage: Usd.Stage, name: str, points: Any, counts: list[int], kind: str, wrap: str
) -> UsdGeom.BasisCurves:
    """Defines curves of B-splines, or of straight pieces."""
    made = UsdGeom.BasisCurves.Define(stage, f"/World/{name}")
    made.CreatePointsAttr(Vt.Vec3fArray.FromNumpy(np.asarray(points, np.float32)))
    made.CreateCurveVertexCountsAttr(counts)
    made.CreateTypeAttr(kind)
    made.CreateBasisAttr("bspline")
    made.CreateWrapAttr(wrap)
    return made


def cutout(stage: Usd.Stage) -> None:
    """Three cards with the opacity of a leaf, cut at a threshold of a half."""
    y, x = np.mgrid[:128, :128] / 63.5 - 1.0
    lobes = 0.55 + 0.35 * np.cos(5.0 * np.arctan2(y, x))
    alpha = np.clip(0.5 + 8.0 * (lobes - np.hypot(x, y)), 0, 1)
    green = np.dstack([0.15 + 0 * x, 0.4 + 0.1 * np.sin(12 * x), 0.05 + 0 * x, alpha])
    folder = Path(stage.GetRootLayer().realPath).parent
    Image.fromarray(np.rint(255 * green).astype(np.uint8), "RGBA").save(folder / "leaf.png")
    shader = surface(stage, "leaf")
    shader.CreateInput("opacityThreshold", _TYPES.Float).Set(0.5)
    picture = UsdShade.Shader.Define(stage, "/World/Looks/leaf/picture")
    picture.CreateIdAttr("UsdUVTexture")
    picture.CreateInput("file", _TYPES.Asset).Set("./leaf.png")
    st = UsdShade.Shader.Define(stage, "/World/Looks/leaf/st")
    st.CreateIdAttr("UsdPrimvarReader_float2")
    st.CreateInput("varname", _TYPES.String).Set("st")
    picture.CreateInput("st", _TYPES.Float2).ConnectToSource(
        st.CreateOutput("result", _TYPES.Float2)
    )
    for name, kind, output in (
        ("diffuseColor", _TYPES.Color3f, "rgb"),
        ("opacity", _TYPES.Float, "a"),
    ):
        shader.CreateInput(name, kind).ConnectToSource(
            picture.CreateOutput(output, _TYPES.Float3 if output == "rgb" else _TYPES.Float)
        )
    for k, turn in enumerate((0, 40, -35)):
        card = polygons(
            stage,
            f"/World/card{k}",
            [(-1, 0, -1), (1, 0, -1), (1, 0, 1), (-1, 0, 1)],
            [4],
            [0, 1, 2, 3],
        )
        card.AddTranslateOp().Set(Gf.Vec3d(1.3 * (k - 1), 0.8 * k, 0))
        card.AddRotateZOp().Set(float(turn))
        st_values = UsdGeom.PrimvarsAPI(card).CreatePrimvar("st", _TYPES.TexCoord2fArray, "vertex")
        st_values.Set(Vt.Vec2fArray([(0, 0), (1, 0), (1, 1), (0, 1)]))
        bind(stage, card, "leaf")
    look(stage, 0.0, -4.8, 0.0, 90.0)


def surface(stage: Usd.Stage, name: str) -> UsdShade.Shader:
    """Defines a material of UsdPreviewSurface; its shader."""
    material = UsdShade.Material.Define(stage, f"/World/Looks/{name}")
    shader = UsdShade.Shader.Define(stage, f"/World/Looks/{name}/shader")
    shader.CreateIdAttr("UsdPreviewSurface")
    shader.CreateInput("roughness", _TYPES.Float).Set(0.8)
    material.CreateSurfaceOutput().ConnectToSource(shader.CreateOutput("surface", _TYPES.Token))
    return shader


def bind(stage: Usd.Stage, shape: UsdGeom.Gprim, name: str) -> None:
    """Binds a material to a shape."""
    UsdShade.MaterialBindingAPI.Apply(shape.GetPrim()).Bind(
        UsdShade.Material.Get(stage, f"/World/Looks/{name}")
    )


def painted(stage: Usd.Stage) -> None:
    """A wave with a color a vertex, and a cube with a color a face corner."""
    n = 40
    x, y = (each.ravel() for each in np.meshgrid(np.linspace(-2, 1, n), np.linspace(-1, 1, n)))
    points = np.stack([x, y, 0.2 * np.sin(3 * x) * np.cos(3 * y)], axis=1)
    a = (np.arange(n - 1)[:, None] * n + np.arange(n - 1)).ravel()
    quads = np.stack([a, a + 1, a + n + 1, a + n], axis=1)
    wave = polygons(stage, "/World/wave", points.tolist(), [4] * len(a), quads.ravel().tolist())
    colors = 0.5 + 0.45 * np.stack([np.sin(4 * x), np.sin(5 * y), np.cos(3 * x + y)], axis=1)
    wave.CreateDisplayColorPrimvar("vertex").Set(Vt.Vec3fArray.FromNumpy(colors.astype(np.float32)))
    cube = box(stage, "/World/cube")
    cube.AddTranslateOp().Set(Gf.Vec3d(2.0, 0, 0.3))
    cube.AddRotateZOp().Set(30.0)
    rng = np.random.default_rng(2)
    each = Vt.Vec3fArray.FromNumpy(rng.uniform(0.05, 0.9, (24, 3)).astype(np.float32))
    cube.CreateDisplayColorPrimvar("faceVarying").Set(each)
    look(stage, 0.4, -3.7, 2.2, 60.0)


def box(stage: Usd.Stage, path: str) -> UsdGeom.Mesh:
    """Defines a cube of edge 1.2 as a mesh."""
    corners = [(x, y, z) for z in (-0.6, 0.6) for y in (-0.6, 0.6) for x in (-0.6, 0.6)]
    sides = [0, 2, 3, 1, 4, 5, 7, 6, 0, 1, 5, 4, 2, 6, 7, 3, 0, 4, 6, 2, 1, 3, 7, 5]
    return polygons(stage, path, corners, [4] * 6, sides)


def subdivided(stage: Usd.Stage) -> None:
    """Catmull-Clark cubes: smooth, with a crease around the top, with a sharp corner; Loop."""
    for k, name in enumerate(("smooth", "crease", "corner", "loop")):
        mesh = box(stage, f"/World/{name}")
        mesh.CreateSubdivisionSchemeAttr("loop" if name == "loop" else "catmullClark")
        if name == "loop":
            corners = np.array(mesh.GetFaceVertexIndicesAttr().Get()).reshape(-1, 4)
            mesh.CreateFaceVertexIndicesAttr(corners[:, [0, 1, 2, 0, 2, 3]].ravel().tolist())
            mesh.CreateFaceVertexCountsAttr([3] * 12)
        if name == "crease":
            mesh.CreateCreaseIndicesAttr([4, 5, 7, 6, 4])
            mesh.CreateCreaseLengthsAttr([5])
            mesh.CreateCreaseSharpnessesAttr([10.0])
        if name == "corner":
            mesh.CreateCornerIndicesAttr([5])
            mesh.CreateCornerSharpnessesAttr([10.0])
        mesh.AddTranslateOp().Set(Gf.Vec3d(1.3 * k - 2.0, 0, 0))
        mesh.AddRotateZOp().Set(25.0)
        colored(mesh, 0.3, 0.45, 0.6)
    look(stage, -0.1, -5.4, 1.3, 77.0)


def scattered(stage: Usd.Stage) -> None:
    """Instances of implicit shapes, turned and stretched, and mirrored ones."""
    many = UsdGeom.PointInstancer.Define(stage, "/World/many")
    for name, kind in (("cone", UsdGeom.Cone), ("pill", UsdGeom.Capsule), ("ball", UsdGeom.Sphere)):
        shape = kind.Define(stage, f"/World/many/{name}")
        colored(
            shape, *{"cone": (0.7, 0.5, 0.1), "pill": (0.2, 0.6, 0.4)}.get(name, (0.5, 0.2, 0.5))
        )
    many.CreatePrototypesRel().SetTargets([f"/World/many/{n}" for n in ("cone", "pill", "ball")])
    rng, count = np.random.default_rng(3), 40
    turns = rng.normal(size=(count, 4))
    turns /= np.linalg.norm(turns, axis=1, keepdims=True)
    many.CreateProtoIndicesAttr(rng.integers(0, 3, count).tolist())
    many.CreatePositionsAttr(
        Vt.Vec3fArray.FromNumpy(rng.uniform((-3, 0, -2), (3, 3, 2), (count, 3)).astype(np.float32))
    )
    # Blender's importer does not know orientationsf.
    many.CreateOrientationsAttr([Gf.Quath(*turn) for turn in turns.tolist()])
    many.CreateScalesAttr(
        Vt.Vec3fArray.FromNumpy(rng.uniform(0.1, 0.35, (count, 3)).astype(np.float32))
    )
    look(stage, 0.0, -4.5, 0.0, 90.0)


#: Name, what it is, its builder and the time code of its picture.
STAGES: tuple[tuple[str, Callable[[Usd.Stage], None], int], ...] = (
    ("skinned meshes", skinned, 2),
    ("curves", grass, 0),
    ("opacity cut-outs", cutout, 0),
    ("vertex colors", painted, 0),
    ("subdivision surfaces", subdivided, 0),
    ("instances, implicit shapes", scattered, 0),
)


def ours(stage: Path, time: int) -> Frame:
    """Renders a stage's picture at a time code.

    Raises:
        ScenecError: It could not be.
    """
    report = render(
        stage, "mitsuba", passes=("rgb", "depth"), folder=stage.parent, spp=64,
        samples=range(time, time + 1),
    )  # fmt: skip
    if report.failed or not report.frames:
        raise ScenecError(f"{stage.name}: {'; '.join(report.failed) or 'no frame was made'}")
    return read_frame(report.frames[0])


def outside(script: Path, job: dict[str, Any], folder: Path) -> None:
    """Runs a program of its own over a job.

    Raises:
        ScenecError: It ended otherwise than well.
    """
    file = folder / "job.json"
    file.write_text(json.dumps(job), encoding="utf-8")
    done = subprocess.run([sys.executable, str(script), str(file)], capture_output=True, text=True)
    if done.returncode:
        raise ScenecError(f"{script.name}: {done.stdout[-500:]}{done.stderr[-2000:]}")


def layers(file: Path) -> dict[str, NDArray[np.float64]]:
    """All channels of an EXR by the last parts of their names."""
    with OpenEXR.File(str(file), separate_channels=True) as picture:
        return {
            name.removeprefix("ViewLayer."): np.array(channel.pixels, float)
            for part in picture.parts
            for name, channel in part.channels.items()
        }


def compared(mine: NDArray[np.bool_], theirs: NDArray[np.bool_]) -> list[Cell]:
    """Intersection over union, pixels that differ, and those of them off both contours."""
    edge = [binary_dilation(m) & ~binary_erosion(m) for m in (mine, theirs)]
    differ = mine != theirs
    share = (mine & theirs).sum() / max(int((mine | theirs).sum()), 1)
    off = int((differ & ~(edge[0] | edge[1])).sum())
    return [f"{share:.4f}", f"{int(differ.sum()):,}, {off:,}"]


def held(page: Page) -> None:
    """Draws all stages by all, writes the sheet, gives the table its rows."""
    rows: list[list[Cell]] = []
    tiles = []
    chosen = STAGES[:2] if page.fast else STAGES
    for number, (name, build, time) in enumerate(chosen):
        folder = page.scratch / f"stage{number}"
        folder.mkdir()
        path = folder / "stage.usda"
        stage = new_stage(path)
        build(stage)
        stage.Save()
        frame = ours(path, time)
        files = folder / "storm.exr", folder / "blender.exr"
        storm = {"stage": str(path), "session": "#usda 1.0\n", "mute": [], "complexity": 1.4}
        shot = ["/World/eye", time, WIDTH, str(files[0])]
        outside(_STORM, storm | {"shots": [shot]}, folder)
        shot = [str(path), "eye", time, WIDTH, HEIGHT, str(files[1])]
        outside(_BLENDER, {"shots": [shot]}, folder)
        hydra, cycles = layers(files[0]), layers(files[1])
        depth = frame.passes["depth"]
        mine = np.isfinite(depth)
        coverage = hydra["A"] > 0.5, cycles["Combined.A"] > 0.5
        both = mine & coverage[1] & (cycles["Depth.Z"] < 1e9)
        off = np.abs(cycles["Depth.Z"][both] / depth[both] - 1.0)
        rows.append(
            [name, f"{100 * mine.mean():.2f} %", *compared(mine, coverage[0]),
             *compared(mine, coverage[1]), f"{100 * np.median(off):.4f} %"]
        )  # fmt: skip
        ev = frame.sidecar.exposure_ev
        background = np.full((HEIGHT, WIDTH, 3), 0.5 * 2.0**-ev)
        pictures = [np.where(mine[..., None], frame.passes["rgb"], background)]
        for each, prefix, alpha in ((hydra, "", coverage[0]), (cycles, "Combined.", coverage[1])):
            color = np.dstack([each[prefix + c] for c in "RGB"])
            # Each as bright as ours, on average over what both show.
            scale = np.median(pictures[0][mine & alpha]) / max(np.median(color[mine & alpha]), 1e-9)
            pictures.append(np.where(alpha[..., None], color * scale, background))
        tiles.append(
            [Image.fromarray(develop(picture.astype(np.float32), ev)) for picture in pictures]
        )
    for table in (None, rows, None, None, None):
        page.rows(table)
    titles = ("scenec with Mitsuba", "Storm", "Blender's importer with Cycles")
    captioned = [
        [
            (title if row == len(tiles) - 1 else "", tile)
            for title, tile in zip(titles, three, strict=True)
        ]
        for row, three in enumerate(tiles)
    ]
    save(sheet(captioned, 280), page.picture("outside").with_suffix(".jpg"))


def main(page: Page) -> None:
    """Makes the parts."""
    page.refresh(("mitsuba", "bpy"), [held])


if __name__ == "__main__":
    run(main, page="viewers")
