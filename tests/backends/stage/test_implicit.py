"""Implicit shapes become triangles within a stated error of what USD says they are."""

from __future__ import annotations

import numpy as np
import pytest
from pxr import Gf, Sdf, Usd, UsdGeom, UsdShade, Vt

from scenec.backends.contract import NO_ROW, Rays
from scenec.backends.exact import ExactCaster
from scenec.backends.stage.implicit import ERROR, LENGTHS, dimensions, tessellate
from scenec.schemas.errors import StageError
from scenec.testing.foreign_stages import bind, label, opened, square

PI = np.pi


def tapered(bottom: float, top: float, height: float) -> tuple[float, float]:
    """Volume and area of a Capsule_1: a truncated cone and two caps that it is tangent to."""
    slope = (bottom - top) / height
    volume = PI * height / 3 * (bottom**2 + bottom * top + top**2)
    area = PI * (bottom + top) * np.sqrt((bottom - top) ** 2 + height**2)
    for radius, center in ((bottom, slope * bottom), (top, -slope * top)):
        sphere = np.hypot(radius, center)
        sagitta = sphere + center
        volume += PI * sagitta**2 * (3 * sphere - sagitta) / 3
        area += 2 * PI * sphere * sagitta
    return volume, area


#: Shapes, and their volumes and areas in closed form.
SHAPES = [
    (("Cube", 2.5), 2.5**3, 6 * 2.5**2),
    (("Sphere", 1.5), 4 / 3 * PI * 1.5**3, 4 * PI * 1.5**2),
    (("Cylinder", "X", 0.5, 3.0), PI * 0.25 * 3, 2 * PI * 0.5 * (0.5 + 3)),
    (
        ("Cylinder_1", "Y", 2.0, 1.0, 3.0),
        PI * 3 / 3 * (4 + 2 + 1),
        PI * (4 + 1 + 3 * np.sqrt(1 + 9)),
    ),
    (("Cylinder_1", "Z", 0.0, 1.0, 2.0), PI / 3 * 2, PI * (1 + np.sqrt(5))),
    (("Cylinder_1", "Z", 1.0, 0.0, 2.0), PI / 3 * 2, PI * (1 + np.sqrt(5))),
    (("Cone", "Z", 1.0, 2.0), PI / 3 * 2, PI * (1 + np.sqrt(5))),
    (("Cone", "Y", 3.0, 0.5), PI / 3 * 9 * 0.5, PI * 3 * (3 + np.sqrt(9.25))),
    (
        ("Capsule", "X", 0.5, 2.0),
        PI * 0.25 * 2 + 4 / 3 * PI * 0.125,
        2 * PI * 0.5 * 2 + 4 * PI * 0.25,
    ),
    (("Capsule_1", "Z", 1.0, 0.5, 2.0), *tapered(1.0, 0.5, 2.0)),
    (("Capsule_1", "X", 0.25, 1.0, 0.5), *tapered(0.25, 1.0, 0.5)),
    (("Capsule_1", "Y", 1.0, 0.0, 2.0), *tapered(1.0, 0.0, 2.0)),
    (("Capsule_1", "Z", 1.0, 1.0, 2.0), 2 * PI + 4 / 3 * PI, 4 * PI + 4 * PI),
]


def corners(shape) -> np.ndarray:
    triangles = tessellate(shape)
    return triangles.points.astype(float)[triangles.faces]


def prim_of(stage: Usd.Stage, shape) -> Usd.Prim:
    """A prim of that shape."""
    prim = stage.DefinePrim("/shape", shape[0])
    lengths = shape[1:]
    if shape[0] not in ("Cube", "Sphere"):
        prim.GetAttribute("axis").Set(shape[1])
        lengths = shape[2:]
    for name, value in zip(LENGTHS[shape[0]], lengths, strict=True):
        prim.GetAttribute(name).Set(value)
    return prim


@pytest.mark.parametrize(("shape", "volume", "area"), SHAPES, ids=lambda value: str(value))
def test_volume_area_and_extent_are_those_of_the_closed_form(shape, volume, area):
    a, b, c = corners(shape).transpose(1, 0, 2)
    cross = np.cross(b - a, c - a)
    # What lies inside of a shape by ERROR of its radius lacks three times that of its volume.
    assert 0.0 <= volume - (a * cross).sum() / 6 + 1e-6 <= 3 * ERROR * volume
    assert 0.0 <= area - 0.5 * np.sqrt((cross * cross).sum(axis=1)).sum() + 1e-5 <= 2 * ERROR * area
    # USD's own: the vertices are on the shape, so its boxes are met, not approached.
    stage = Usd.Stage.CreateInMemory()
    boundable = UsdGeom.Boundable(prim_of(stage, shape))
    low, high = UsdGeom.Boundable.ComputeExtentFromPlugins(boundable, Usd.TimeCode.Default())
    points = tessellate(shape).points
    np.testing.assert_allclose(points.min(axis=0), low, rtol=1e-6)
    np.testing.assert_allclose(points.max(axis=0), high, rtol=1e-6)
    assert dimensions(boundable.GetPrim(), Usd.TimeCode.Default()) == shape


@pytest.mark.parametrize("shape", [shape for shape, *_ in SHAPES], ids=str)
def test_surfaces_are_closed_and_wound_outward(shape):
    triangles = tessellate(shape)
    # By place: points on sharp edges stand once for each side.
    places, at = np.unique(triangles.points, axis=0, return_inverse=True)
    faces = at.reshape(-1)[triangles.faces]
    assert (faces != np.roll(faces, 1, axis=1)).all()
    edges = [tuple(edge) for k in range(3) for edge in faces[:, [k, (k + 1) % 3]].tolist()]
    assert len(set(edges)) == len(edges)
    assert {(b, a) for a, b in edges} == set(edges)
    assert len(places) - len(edges) // 2 + len(faces) == 2
    assert set(triangles.faces.ravel().tolist()) == set(range(len(triangles.points)))
    if triangles.normals is not None:
        a, b, c = corners(shape).transpose(1, 0, 2)
        cross = np.cross(b - a, c - a)
        cross /= np.sqrt((cross * cross).sum(axis=1))[:, None]
        # Normals of the shape are no farther off than the triangles' own turn.
        cosine = (cross[:, None] * triangles.normals[triangles.faces]).sum(axis=2)
        assert cosine.min() > 1.0 - 1.01 * ERROR
        np.testing.assert_allclose((triangles.normals**2).sum(axis=1), 1.0, atol=1e-6)


def test_spheres_have_no_slivers_and_the_stated_error():
    p = corners(("Sphere", 1.0))
    edges = [p[:, (k + 1) % 3] - p[:, k] for k in range(3)]
    lengths = [np.sqrt((edge * edge).sum(axis=1)) for edge in edges]
    for k in range(3):
        cosine = -(edges[k] * edges[k - 1]).sum(axis=1) / (lengths[k] * lengths[k - 1])
        assert np.degrees(np.arccos(cosine)).min() > 44.0
    # The deepest point of a triangle whose corners are on a sphere is nearest to the center.
    cross = np.cross(edges[0], edges[1])
    depth = 1.0 - (p[:, 0] * cross).sum(axis=1) / np.sqrt((cross * cross).sum(axis=1))
    assert 0.9 * ERROR < depth.max() <= ERROR


def test_rays_meet_a_sphere_where_they_meet_the_ideal_one(tmp_path):
    radius, center = 0.7, np.array([1.0, -2.0, 3.0])

    def build(stage):
        sphere = UsdGeom.Sphere.Define(stage, "/Root/ball")
        sphere.CreateRadiusAttr(radius)
        sphere.AddTranslateOp().Set(Gf.Vec3d(*center))

    scene = opened(tmp_path, build)
    rng = np.random.default_rng(3)
    origins = center + 5.0 * unit(rng.normal(size=(20000, 3)))
    directions = unit(center + rng.uniform(-1.1, 1.1, (20000, 3)) * radius - origins)
    row, _, t = ExactCaster(scene).cast(Rays(origins, directions, (1, 20000)))
    to_center = ((center - origins) * directions).sum(axis=1)
    aside = np.sqrt(((center - origins) ** 2).sum(axis=1) - to_center**2)
    assert (row[aside > radius] == NO_ROW).all()
    inner = (1.0 - ERROR) * radius
    inside = aside < inner
    assert (row[inside] == 0).all()
    # Between the sphere and the one by ERROR smaller.
    first = to_center - np.sqrt(np.maximum(radius**2 - aside**2, 0.0))
    last = to_center[inside] - np.sqrt(inner**2 - aside[inside] ** 2)
    assert (t[inside] >= first[inside] - 1e-6).all()
    assert (t[inside] <= last + 1e-6).all()
    assert inside.sum() > 5000


def unit(vectors):
    return vectors / np.sqrt((vectors**2).sum(axis=1))[:, None]


@pytest.mark.parametrize(
    ("axis", "extent", "normal"),
    [
        ("X", (0, 3, 2), (1, 0, 0)),
        ("Y", (2, 0, 3), (0, 1, 0)),
        ("Z", (2, 3, 0), (0, 0, 1)),
    ],
)
def test_a_plane_lies_across_its_axis_and_faces_along_it(axis, extent, normal):
    shape = ("Plane", axis, 2.0, 3.0)
    p = corners(shape)
    assert (np.ptp(p.reshape(-1, 3), axis=0) == extent).all()
    cross = np.cross(p[:, 1] - p[:, 0], p[:, 2] - p[:, 0])
    assert (cross / 6.0 == normal).all()
    stage = Usd.Stage.CreateInMemory()
    boundable = UsdGeom.Boundable(prim_of(stage, shape))
    low, high = UsdGeom.Boundable.ComputeExtentFromPlugins(boundable, Usd.TimeCode.Default())
    assert (p.min(axis=(0, 1)) == low).all()
    assert (p.max(axis=(0, 1)) == high).all()


def test_lengths_of_nothing_give_what_is_left_of_a_shape():
    assert not len(tessellate(("Cylinder", "Z", 0.0, 1.0)).faces)
    flat = corners(("Cylinder", "Z", 1.0, 0.0))
    assert np.isfinite(flat).all()
    assert len(corners(("Capsule_1", "Z", 1.0, 0.0, 0.0)))
    for kind, lengths in LENGTHS.items():
        axis = () if kind in ("Cube", "Sphere") else ("Z",)
        triangles = tessellate((kind, *axis, *[0.0] * len(lengths)))
        assert triangles.normals is None or np.isfinite(triangles.normals).all()


def test_a_stages_shapes_have_its_units_labels_colors_and_materials(tmp_path):
    def build(stage):
        ball = UsdGeom.Sphere.Define(stage, "/Root/ball")
        ball.CreateRadiusAttr().Set(50.0, 0)
        ball.AddTranslateOp().Set(Gf.Vec3d(0, 200, 0))
        ball.CreateDisplayColorAttr([(0.1, 0.2, 0.3)])
        label(ball.GetPrim(), "ball")
        box = UsdGeom.Cube.Define(stage, "/Root/box")
        bind(stage, box.GetPrim()).CreateInput("diffuseColor", Sdf.ValueTypeNames.Color3f).Set(
            Gf.Vec3f(0.5, 0, 0)
        )
        label(box.GetPrim(), "box")
        UsdGeom.Imageable(UsdGeom.Cone.Define(stage, "/Root/hidden")).MakeInvisible()

    scene = opened(tmp_path, build, unit=0.01, up=UsdGeom.Tokens.y)
    ball, box = (scene.meshes[i] for i in scene.rows.mesh)
    assert scene.label_names["class"] == {1: "ball", 2: "box"}
    assert (set(ball.labels["class"]), set(box.labels["class"])) == ({1}, {2})
    colors = [scene.surfaces[mesh.layers[0]].base_color for mesh in (ball, box)]
    np.testing.assert_allclose(colors, [(0.1, 0.2, 0.3), (0.5, 0, 0)], rtol=1e-6)
    at = scene.rows.to_world[0]
    world = ball.points @ at[:, :3].T + at[:, 3]
    np.testing.assert_allclose(world.min(axis=0), [-0.5, -0.5, 1.5], atol=1e-6)
    np.testing.assert_allclose(scene.bounds, [[-0.5, -0.5, -0.01], [0.5, 0.5, 2.5]], atol=1e-6)
    assert scene.losses == ()


def test_shapes_are_instanced_and_equal_ones_share_a_mesh(tmp_path):
    def build(stage):
        many = UsdGeom.PointInstancer.Define(stage, "/Root/many")
        UsdGeom.Sphere.Define(stage, "/Root/many/ball").CreateRadiusAttr(0.25)
        many.CreatePrototypesRel().SetTargets(["/Root/many/ball"])
        many.CreatePositionsAttr([(0, 0, 0), (1, 0, 0), (2, 0, 0)])
        many.CreateProtoIndicesAttr([0, 0, 0])
        UsdGeom.Cone.Define(stage, "/Model/top")
        for name in ("a", "b"):
            prim = UsdGeom.Xform.Define(stage, f"/Root/{name}").GetPrim()
            prim.GetReferences().AddInternalReference("/Model")
            prim.SetInstanceable(True)
        UsdGeom.Sphere.Define(stage, "/Root/alike").CreateRadiusAttr(0.25)
        UsdGeom.Sphere.Define(stage, "/Root/other").CreateRadiusAttr(0.3)

    scene = opened(tmp_path, build)
    kinds = [len(scene.meshes[i].faces) for i in scene.rows.mesh]
    assert sorted(kinds) == sorted([8192] * 5 + [256] * 3)
    # The spheres of 0.25, the one of 0.3, the cone itself and in its instances.
    assert len(scene.meshes) == 3
    assert scene.rows.instance_id.tolist()[:3] == [1, 2, 3]


def test_a_shape_that_changes_keeps_its_first_size_and_says_so(tmp_path):
    def build(stage):
        radius = UsdGeom.Sphere.Define(stage, "/Root/ball").CreateRadiusAttr()
        for time in range(3):
            radius.Set(1.0 + time, time)

    scene = opened(tmp_path, build, samples=3)
    assert np.abs(scene.meshes[0].points).max() == 1.0
    (line,) = scene.losses
    assert "deforms" in line
    assert "/Root/ball" in line


@pytest.mark.parametrize("value", [-1.0, np.nan, np.inf, 1e300])
@pytest.mark.parametrize(("kind", "name"), [(k, n) for k, of in LENGTHS.items() for n in of])
def test_lengths_that_cannot_be_are_named(tmp_path, kind, name, value):
    def build(stage):
        stage.DefinePrim("/Root/it", kind).GetAttribute(name).Set(value)

    with pytest.raises(StageError, match=rf"/Root/it(: |\.){name}:? is .*, expected"):
        opened(tmp_path, build)


def test_caps_that_grow_beyond_all_numbers_are_named(tmp_path):
    def build(stage):
        capsule = UsdGeom.Capsule_1.Define(stage, "/Root/it")
        # Tangent to a side as flat as this, a cap is as large as the world.
        capsule.CreateHeightAttr(1e-300)
        capsule.CreateRadiusTopAttr(0.25)

    with pytest.raises(StageError, match="/Root/it: a Capsule_1 too large for its points"):
        opened(tmp_path, build)


def test_a_texture_on_a_shape_without_coordinates_is_a_loss(tmp_path):
    from PIL import Image

    Image.new("RGB", (4, 4), (255, 0, 0)).save(tmp_path / "red.png")

    def build(stage):
        shader = bind(stage, UsdGeom.Sphere.Define(stage, "/Root/ball").GetPrim())
        texture = UsdShade.Shader.Define(stage, "/Root/Looks/material/texture")
        texture.CreateIdAttr("UsdUVTexture")
        texture.CreateInput("file", Sdf.ValueTypeNames.Asset).Set("red.png")
        shader.CreateInput("diffuseColor", Sdf.ValueTypeNames.Color3f).ConnectToSource(
            texture.CreateOutput("rgb", Sdf.ValueTypeNames.Float3)
        )
        # A mesh with coordinates of its own loses nothing.
        mesh = square(stage, "/Root/mesh")
        UsdShade.MaterialBindingAPI.Apply(mesh.GetPrim()).Bind(
            UsdShade.Material.Get(stage, "/Root/Looks/material")
        )
        UsdGeom.PrimvarsAPI(mesh).CreatePrimvar(
            "st", Sdf.ValueTypeNames.TexCoord2fArray, "vertex"
        ).Set(Vt.Vec2fArray([(0, 0), (1, 0), (1, 1), (0, 1)]))

    scene = opened(tmp_path, build)
    assert [mesh.uv.shape for mesh in scene.meshes] == [(8192, 3, 2), (2, 3, 2)]
    (line,) = scene.losses
    assert line.endswith("1 prim, /Root/ball")
    assert "texture" in line
