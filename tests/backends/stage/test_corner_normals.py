"""Normals of face corners: shaded as authored, and annotation stays that of the faces."""

from __future__ import annotations

import dataclasses
import math

import numpy as np
import pytest
from pxr import Gf, Sdf, UsdGeom, UsdLux, UsdShade, UsdSkel, Vt

from scenec.backends.registry import open_backend
from scenec.backends.run.session import Session
from scenec.backends.stage import normals as stage_normals
from scenec.backends.stage.scene import RenderScene
from scenec.testing import skinned_stages as arm
from scenec.testing.extras import needs
from scenec.testing.foreign_stages import bind, label, opened, polygons, square

SIDES, ALBEDO, SUN = 12, 0.5, 3.0
#: To the sun: from the camera's side, above.
TO_SUN = np.array([-0.3, -0.8, 0.6]) / math.sqrt(0.09 + 0.64 + 0.36)
PASSES = ("depth", "position", "normal", "face", "instance", "label.class")


def prism(stage, normals: str | None = "faceVarying", primvar: bool = False) -> UsdGeom.Mesh:
    """A cylinder of few sides: smooth around, with sharp caps, unless normals are of points."""
    turn = 2.0 * np.pi * np.arange(SIDES) / SIDES
    ring = np.stack([np.cos(turn), np.sin(turn)], axis=1)
    points = np.concatenate([np.insert(ring, 2, z, axis=1) for z in (-1.0, 1.0)])
    i, j = np.arange(SIDES), (np.arange(SIDES) + 1) % SIDES
    sides = np.stack([i, j, j + SIDES, i + SIDES], axis=1)
    indices = [*sides.ravel().tolist(), *i[::-1].tolist(), *(i + SIDES).tolist()]
    found = polygons(
        stage, "/Root/prism", points.tolist(), [4] * SIDES + [SIDES] * 2, [int(k) for k in indices]
    )
    found.CreateDisplayColorAttr([(ALBEDO,) * 3])
    label(found.GetPrim(), "prism")
    out = np.insert(ring, 2, 0.0, axis=1)
    caps = np.repeat([(0.0, 0.0, -1.0), (0.0, 0.0, 1.0)], SIDES, axis=0)
    corners = np.concatenate([out[(sides % SIDES).ravel()], caps])
    authored = {"faceVarying": corners, "vertex": np.concatenate([out, out])}.get(normals)
    if authored is None:
        return found
    value = Vt.Vec3fArray.FromNumpy(authored.astype(np.float32))
    if primvar:
        api = UsdGeom.PrimvarsAPI(found)
        api.CreatePrimvar("normals", Sdf.ValueTypeNames.Normal3fArray, normals).Set(value)
    else:
        found.CreateNormalsAttr(value)
        found.SetNormalsInterpolation(normals)
    return found


def lit(stage) -> None:
    """A sun, and a camera that sees half of the side and the upper cap."""
    light = UsdLux.DistantLight.Define(stage, "/Root/sun")
    light.CreateIntensityAttr(SUN)
    light.CreateNormalizeAttr(True)
    light.CreateAngleAttr(0.0)
    turn = Gf.Rotation(Gf.Vec3d(0, 0, 1), Gf.Vec3d(*TO_SUN))
    light.AddTransformOp().Set(Gf.Matrix4d().SetRotate(turn))
    eye = UsdGeom.Camera.Define(stage, "/Root/eye")
    view = Gf.Matrix4d().SetLookAt(Gf.Vec3d(0, -6, 3.5), Gf.Vec3d(0), Gf.Vec3d(0, 0, 1))
    eye.AddTransformOp().Set(view.GetInverse())
    eye.CreateFocalLengthAttr(40.0)
    product = stage.DefinePrim("/Render/product", "RenderProduct")
    product.CreateRelationship("camera").SetTargets(["/Root/eye"])
    product.GetAttribute("resolution").Set(Gf.Vec2i(96, 72))


def read(folder, *args, **kwargs) -> RenderScene:
    def build(stage):
        prism(stage, *args, **kwargs)
        lit(stage)

    folder.mkdir(exist_ok=True)
    return opened(folder, build)


def annotation(scene: RenderScene) -> dict[str, np.ndarray]:
    return Session(scene, None).render(scene.cameras[0][0], 0, PASSES, 1, 0).arrays


def inner(mask: np.ndarray) -> np.ndarray:
    """Pixels whose neighbors are in the mask, too."""
    padded = np.pad(mask, 1)
    h, w = mask.shape
    return np.all([padded[y : y + h, x : x + w] for y in range(3) for x in range(3)], axis=0)


def error(scene: RenderScene, backend: str) -> tuple[float, float]:
    """Largest relative error of radiance over the side and the cap, against the cosine law."""
    camera = scene.cameras[0][0]
    h, w = camera.height, camera.width
    # The law is averaged over 5 x 5 places in each pixel.
    fine = dataclasses.replace(
        camera, width=5 * w, height=5 * h, intrinsics=np.diag([5.0, 5.0, 1.0]) @ camera.intrinsics
    )
    known = Session(scene, None).render(fine, 0, PASSES, 1, 0).arrays
    out = known["position"] * [1, 1, 0]
    out /= np.linalg.norm(out, axis=-1, keepdims=True)
    renderer = open_backend(backend, "cpu")
    renderer.load(scene)
    radiance = renderer.radiance(camera, 0, 256, 2).halves.mean(axis=(0, 3))
    found = []
    for at, normal in (
        (known["face"] < SIDES, out),
        (known["face"] == SIDES + 1, np.broadcast_to((0.0, 0.0, 1.0), out.shape)),
    ):
        cosine = (normal * TO_SUN).sum(axis=-1)
        # Not where faces turn away from the sun, and normals do not.
        # Filters of path tracers are wider than pixels.
        places = inner((at & (cosine > 0.3)).reshape(h, 5, w, 5).all(axis=(1, 3)))
        assert places.sum() > 200
        law = ALBEDO / np.pi * SUN * cosine.reshape(h, 5, w, 5).mean(axis=(1, 3))[places]
        found.append(float(np.abs(radiance[places] / law - 1.0).max()))
    return found[0], found[1]


@pytest.mark.parametrize(
    ("backend", "most"),
    [
        ("mitsuba", 0.002),
        pytest.param("cycles", 0.002, marks=needs("cycles", "bpy")),
        # Where a pixel shows two faces it shades them at one place.
        ("pyrender", 0.05),
    ],
)
def test_a_coarse_cylinder_with_corner_normals_is_shaded_round_with_sharp_caps(
    tmp_path, backend, most
):
    side, cap = error(read(tmp_path), backend)
    assert side < most
    assert cap < 1e-4


def test_without_its_normals_it_is_off_by_a_third(tmp_path):
    side, cap = error(read(tmp_path, None), "mitsuba")
    assert 0.3 < side < 0.4
    assert cap < 1e-4


@pytest.mark.parametrize("primvar", [False, True])
def test_annotation_is_that_of_the_faces_to_the_bit(tmp_path, primvar):
    flat = read(tmp_path / "flat", None)
    smooth = read(tmp_path / "smooth", primvar=primvar)
    assert flat.losses == smooth.losses == ()
    plain, with_normals = annotation(flat), annotation(smooth)
    for name in PASSES:
        np.testing.assert_array_equal(plain[name], with_normals[name])


def test_a_point_becomes_as_many_vertices_as_it_has_normals(tmp_path):
    (mesh,) = read(tmp_path).meshes
    assert len(mesh.points) == 2 * 2 * SIDES
    of_face = mesh.normals[mesh.faces]
    geometric = np.cross(*(np.diff(mesh.points[mesh.faces], axis=1).transpose(1, 0, 2)))
    assert ((of_face * geometric[:, None]).sum(axis=2) > 0.0).all()
    on_side = mesh.authored_face < SIDES
    radial = mesh.points[mesh.faces[on_side]] * [1, 1, 0]
    np.testing.assert_allclose(of_face[on_side], radial, atol=1e-6)
    np.testing.assert_allclose(
        np.abs(of_face[~on_side]), np.broadcast_to((0, 0, 1), of_face[~on_side].shape)
    )


def test_parts_by_material_have_the_vertices_of_their_own_faces(tmp_path):
    def build(stage):
        found = prism(stage)
        shader = bind(stage, found.GetPrim())
        shader.CreateInput("diffuseColor", Sdf.ValueTypeNames.Color3f).Set((1, 0, 0))
        material = UsdShade.Material.Define(stage, "/Root/Looks/plain")
        caps = UsdGeom.Subset.Define(stage, "/Root/prism/caps")
        caps.CreateIndicesAttr([SIDES, SIDES + 1])
        caps.CreateElementTypeAttr("face")
        caps.CreateFamilyNameAttr("materialBind")
        UsdShade.MaterialBindingAPI.Apply(caps.GetPrim()).Bind(material)

    parts = opened(tmp_path, build).meshes
    assert [len(part.points) for part in parts] == [2 * SIDES] * 2
    for part, faces in zip(parts, (range(SIDES), (SIDES, SIDES + 1)), strict=True):
        assert set(part.authored_face.tolist()) == set(faces)
        flat = np.abs(part.normals[part.faces][..., 2]) > 0.5
        assert (flat == (part.authored_face >= SIDES)[:, None]).all()


#: Of two squares that share an edge: interpolation, normals, and what triangles' corners get.
TILTED, UP = (0.6, 0.0, 0.8), (0.0, 0.0, 1.0)
KINDS = {
    "constant": ([TILTED], [TILTED] * 12),
    "uniform": ([TILTED, UP], [TILTED] * 6 + [UP] * 6),
    "vertex": ([TILTED] * 6, [TILTED] * 12),
    "varying": ([TILTED] * 6, [TILTED] * 12),
    "faceVarying": ([TILTED] * 4 + [UP] * 4, [TILTED] * 6 + [UP] * 6),
}


def two_squares(stage) -> UsdGeom.Mesh:
    points = [(x, y, 0) for y in range(2) for x in range(3)]
    return polygons(stage, "/Root/two", points, [4, 4], [0, 1, 4, 3, 1, 2, 5, 4])


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("factor", [1.0, 3.0])
def test_normals_of_all_interpolations_are_those_of_the_corners(tmp_path, kind, factor):
    authored, expected = KINDS[kind]

    def build(stage):
        found = two_squares(stage)
        found.CreateNormalsAttr([Gf.Vec3f(*(factor * np.array(n)).tolist()) for n in authored])
        found.SetNormalsInterpolation(kind)

    scene = opened(tmp_path, build)
    (mesh,) = scene.meshes
    np.testing.assert_allclose(mesh.normals[mesh.faces].reshape(-1, 3), expected, atol=1e-6)
    said = () if factor == 1.0 else (f"{stage_normals.UNEVEN}: 1 prim, /Root/two",)
    assert scene.losses == said


NAN = math.nan
WRONG = {
    "too few": ([UP] * 7, stage_normals.MISFIT),
    "too many": ([UP] * 9, stage_normals.MISFIT),
    "not a number": ([UP] * 7 + [(NAN, 0.0, 1.0)], stage_normals.UNFIT),
    "infinite": ([UP] * 7 + [(math.inf, 0.0, 1.0)], stage_normals.UNFIT),
    "zero": ([UP] * 7 + [(0.0, 0.0, 0.0)], stage_normals.UNFIT),
}


@pytest.mark.parametrize("name", WRONG)
def test_normals_that_cannot_be_are_named_and_faces_are_flat(tmp_path, name):
    authored, said = WRONG[name]

    def build(stage):
        found = two_squares(stage)
        found.CreateNormalsAttr(authored)
        found.SetNormalsInterpolation("faceVarying")

    scene = opened(tmp_path, build)
    assert scene.meshes[0].normals is None
    assert scene.losses == (f"{said}: 1 prim, /Root/two",)


def test_normals_of_corners_that_change_are_those_of_each_sample(tmp_path):
    def build(stage):
        found = square(stage, "/Root/it")
        found.SetNormalsInterpolation("faceVarying")
        attribute = found.CreateNormalsAttr()
        # The first two corners have one normal at the first sample, and two at the next.
        attribute.Set([UP] * 4, 0)
        attribute.Set([UP, TILTED, UP, UP], 1)

    scene = opened(tmp_path, build, samples=2)
    shown = [mesh for mesh in scene.meshes if mesh.path]
    for mesh, expected in zip(shown, ([UP] * 4, [UP, TILTED, UP, UP]), strict=True):
        at = np.array([[0, 1, 2], [0, 2, 3]])
        np.testing.assert_allclose(mesh.normals[mesh.faces], np.array(expected)[at], atol=1e-6)


def outward() -> np.ndarray:
    """Unit normals of the arm's points in the frame of its rest pose, float32 [n, 3]."""
    bind = arm.bind_matrix()
    found = arm.rest_points() @ bind[:3, :3].T + bind[:3, 3]
    found[:, 0] = 0.0
    return (found / np.linalg.norm(found, axis=1, keepdims=True)).astype(np.float32)


#: Offsets of the normals of the blend shape's points, and of its inbetween's.
FULL, HALF = np.array([0.5, 0.0, 0.0]), np.array([0.0, 0.25, 0.0])


def bent(folder, sample: int, of_corners: bool) -> np.ndarray:
    """Unit normals of the skin's vertices in the world at a sample, [n, 3]."""

    def build(stage):
        skin, normals = arm.write_arm(stage), outward()
        if of_corners:
            normals = normals[np.array(skin.GetFaceVertexIndicesAttr().Get())]
        skin.CreateNormalsAttr(Vt.Vec3fArray.FromNumpy(normals))
        skin.SetNormalsInterpolation("faceVarying" if of_corners else "vertex")
        shape = UsdSkel.BlendShape.Get(stage, "/Root/arm/bulge")
        count = len(shape.GetOffsetsAttr().Get())
        shape.CreateNormalOffsetsAttr([Gf.Vec3f(*FULL.tolist())] * count)
        shape.GetInbetween("half").SetNormalOffsets([Gf.Vec3f(*HALF.tolist())] * count)

    scene = opened(folder, build)
    assert scene.losses == ()
    rows = scene.rows_at(sample)
    ((mesh, m),) = [
        (scene.meshes[k], m)
        for k, m in zip(rows.mesh, rows.to_world, strict=True)
        if m[:, :3].any()
    ]
    assert len(mesh.points) == len(arm.rest_points())
    turned = mesh.normals @ m[:, :3].T
    return turned / np.linalg.norm(turned, axis=1, keepdims=True)


@pytest.mark.parametrize("of_corners", [False, True])
@pytest.mark.parametrize(("sample", "lean"), [(1, 0.5 * HALF), (2, HALF), (3, FULL)])
def test_skins_and_blend_shapes_turn_normals_as_by_hand(tmp_path, sample, lean, of_corners):
    normals = outward().astype(np.float64)
    normals[5 * 8 : 7 * 8] += lean
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    indices, weights = arm.influences()
    expected = np.zeros_like(normals)
    for number in range(3):
        a = math.radians(arm.BEND_DEG * sample) * (number + 1)
        turn = np.array([(math.cos(a), 0, math.sin(a)), (0, 1, 0), (-math.sin(a), 0, math.cos(a))])
        expected += np.where(indices == number, weights, 0.0).sum(axis=1)[:, None] * (
            normals @ turn.T
        )
    expected /= np.linalg.norm(expected, axis=1, keepdims=True)
    np.testing.assert_allclose(bent(tmp_path, sample, of_corners), expected, atol=2e-6)
