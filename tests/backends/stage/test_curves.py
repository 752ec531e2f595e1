"""BasisCurves as tubes: against splines of SciPy, closed surfaces, widths, colors, losses."""

from __future__ import annotations

import numpy as np
import pytest
from pxr import Gf, Sdf, UsdGeom, Vt
from scipy.interpolate import BSpline, CubicHermiteSpline

from scenec.backends.stage import tubes
from scenec.backends.stage.read import read_stage
from scenec.schemas.errors import StageError
from scenec.testing.foreign_stages import bind, label, opened, written

POINTS = np.array([(0, 0, 0), (1, 0.2, 1), (2, 0, 1.2), (3, -0.4, 0), (3.5, 0.3, -1)], float)
RADIUS = 0.05


def curves(stage, path="/Root/hair", points=POINTS, counts=None, widths=(2 * RADIUS,), **said):
    """Defines curves; ``said``: type, basis, wrap, and the interpolation of widths."""
    found = UsdGeom.BasisCurves.Define(stage, path)
    found.CreatePointsAttr(Vt.Vec3fArray.FromNumpy(np.asarray(points, np.float32)))
    found.CreateCurveVertexCountsAttr([len(points)] if counts is None else counts)
    found.CreateTypeAttr(said.get("type", "cubic"))
    found.CreateBasisAttr(said.get("basis", "bezier"))
    found.CreateWrapAttr(said.get("wrap", "nonperiodic"))
    if widths is not None:
        found.CreateWidthsAttr(list(widths))
        found.SetWidthsInterpolation(said.get("interpolation", "constant"))
    return found


def hermite(points):
    """Catmull and Rom's curve: slopes are half of the way between the neighbors."""
    slopes = 0.5 * (points[2:] - points[:-2])
    t = np.arange(len(slopes))
    return CubicHermiteSpline(t, points[1:-1], slopes)(np.linspace(0, t[-1], 4001))


def uniform(points):
    knots = np.arange(len(points) + 4) - 3
    return BSpline(knots, points, 3)(np.linspace(0, len(points) - 3, 4001))


def bezier(points):
    t = np.linspace(0, 1, 4001)[:, None]
    a, b, c, d = points
    return (1 - t) ** 3 * a + 3 * (1 - t) ** 2 * t * b + 3 * (1 - t) * t**2 * c + t**3 * d


def around(points, n=3):
    return np.concatenate([points, points[:n]])


def beyond(points):
    return np.concatenate([[2 * points[0] - points[1]], points, [2 * points[-1] - points[-2]]])


CASES = {
    "bezier": ({}, POINTS[:4], bezier(POINTS[:4])),
    "bspline": ({"basis": "bspline"}, POINTS, uniform(POINTS)),
    "bspline periodic": (
        {"basis": "bspline", "wrap": "periodic"}, POINTS, uniform(around(POINTS)),
    ),
    "bspline pinned": ({"basis": "bspline", "wrap": "pinned"}, POINTS, uniform(beyond(POINTS))),
    "catmullRom": ({"basis": "catmullRom"}, POINTS, hermite(POINTS)),
    "catmullRom periodic": (
        {"basis": "catmullRom", "wrap": "periodic"}, POINTS, hermite(around(POINTS)),
    ),
    "catmullRom pinned": (
        {"basis": "catmullRom", "wrap": "pinned"}, POINTS, hermite(beyond(POINTS)),
    ),
}  # fmt: skip


def inside(mesh, seed=5):
    """Places on the triangles, float64 [n, 3]."""
    corners = mesh.points[mesh.faces].astype(float)
    shares = np.random.default_rng(seed).dirichlet((1, 1, 1), len(corners))
    return (corners * shares[:, :, None]).sum(axis=1)


def off(places, line):
    """Distance of places from a fine polyline's points."""
    return np.array([np.sqrt(((line - place) ** 2).sum(axis=1).min()) for place in places])


@pytest.mark.parametrize("case", CASES)
def test_a_tube_is_within_its_error_of_the_round_one_around_the_spline(tmp_path, case):
    said, points, line = CASES[case]
    scene = opened(tmp_path, lambda stage: curves(stage, points=points, **said) and None)
    (mesh,) = scene.meshes
    assert scene.losses == ()
    # The caps' triangles are flat: nearer to the curve's end.
    sides = np.arange(len(mesh.faces)) < len(mesh.faces) - (0 if "periodic" in case else 60)
    distance = off(inside(mesh)[sides][::3], line)
    limit = tubes.ERROR * np.ptp(points, axis=0).max()
    step = np.sqrt((np.diff(line, axis=0) ** 2).sum(axis=1)).max()
    assert np.abs(distance - RADIUS).max() < limit + step


@pytest.mark.parametrize(
    ("said", "widths"),
    [
        ({"type": "linear"}, [0.1]),
        ({"type": "linear", "wrap": "periodic"}, [0.1]),
        ({"basis": "catmullRom", "wrap": "pinned", "interpolation": "varying"},
         [0.1, 0.2, 0.1, 0.05, 0.0]),
        ({"basis": "bspline", "wrap": "periodic", "interpolation": "vertex"},
         [0.1, 0.2, 0.1, 0.05, 0.1]),
    ],
)  # fmt: skip
def test_tubes_are_closed_and_wound_outward(tmp_path, said, widths):
    scene = opened(tmp_path, lambda stage: curves(stage, widths=widths, **said) and None)
    (mesh,) = scene.meshes
    corners = np.unique(mesh.points, axis=0, return_inverse=True)[1].ravel()[mesh.faces]
    edges = corners[:, [[0, 1], [1, 2], [2, 0]]].reshape(-1, 2)
    there, back = (np.unique(each, axis=0, return_counts=True) for each in (edges, edges[:, ::-1]))
    np.testing.assert_array_equal(there[0], back[0])
    np.testing.assert_array_equal(there[1], back[1])
    a, b, c = mesh.points[mesh.faces].astype(float).transpose(1, 0, 2)
    assert np.einsum("ij,ij->", a, np.cross(b, c)) > 0.0
    flat = np.cross(b - a, c - a)
    shading = mesh.normals[mesh.faces].sum(axis=1)
    assert ((flat * shading).sum(axis=1) > 0.0).mean() > 0.99


def test_a_corner_of_straight_pieces_keeps_its_width(tmp_path):
    """A square frame of round bars: Pappus gives its volume."""
    square = np.array([(0, 0, 0), (1, 0, 0), (1, 1, 0), (0, 1, 0)], float)
    scene = opened(
        tmp_path,
        lambda stage: curves(stage, points=square, type="linear", wrap="periodic") and None,
    )
    a, b, c = scene.meshes[0].points[scene.meshes[0].faces].astype(float).transpose(1, 0, 2)
    volume = np.einsum("ij,ij->", a, np.cross(b, c)) / 6.0
    assert volume == pytest.approx(4.0 * np.pi * RADIUS**2, rel=0.01)


def test_widths_and_colors_are_those_along_the_curve(tmp_path):
    line = np.array([(0, 0, 0), (1, 0, 0), (2, 0, 0)], float)

    def build(stage):
        found = curves(stage, points=line, type="linear", widths=[0.2, 0.4, 0.0],
                       interpolation="vertex")  # fmt: skip
        found.CreateDisplayColorPrimvar("vertex").Set([(1, 0, 0), (0, 1, 0), (0, 0, 1)])

    (mesh,) = opened(tmp_path, build).meshes
    x = mesh.points[:, 0]
    radius = np.sqrt((mesh.points[:, 1:].astype(float) ** 2).sum(axis=1))
    # Rings are as wide on average as the round tube.
    sides = 32 / np.pi * np.sin(np.pi / 32)
    np.testing.assert_allclose(radius * sides, np.interp(x, [0, 1, 2], [0.1, 0.2, 0]), atol=1e-6)
    at = mesh.points[mesh.faces][..., 0]
    np.testing.assert_allclose(mesh.color[..., 1], np.interp(at, [0, 1, 2], [0, 1, 0]), atol=1e-6)


def test_curves_are_one_thing_with_a_label_a_material_and_the_curve_of_each_face(tmp_path):
    def build(stage):
        points = np.concatenate([POINTS[:4], POINTS[:4] + 1])
        found = curves(stage, points=points, counts=[4, 4])
        label(found.GetPrim(), "hair")
        bind(stage, found.GetPrim()).CreateInput("roughness", Sdf.ValueTypeNames.Float).Set(0.25)

    scene = opened(tmp_path, build)
    (mesh,) = scene.meshes
    assert scene.losses == ()
    assert scene.rows.instance_id.tolist() == [1]
    assert np.unique(mesh.labels["class"]).tolist() == [1]
    assert np.unique(mesh.authored_face).tolist() == [0, 1]
    assert scene.surfaces[mesh.layers[0]].roughness == 0.25


def test_curves_that_move_have_their_points_of_each_sample(tmp_path):
    def build(stage):
        attribute = curves(stage, points=POINTS[:4]).GetPointsAttr()
        for time in range(3):
            moved = (POINTS[:4] * [1, 1, 1 + time]).astype(np.float32)
            attribute.Set(Vt.Vec3fArray.FromNumpy(moved), time)

    scene = opened(tmp_path, build, samples=3)
    assert scene.losses == ()
    for sample in range(3):
        rows = scene.rows_at(sample)
        (index,) = [m for m, at in zip(rows.mesh, rows.to_world, strict=True) if at[:, :3].any()]
        line = bezier(POINTS[:4] * [1, 1, 1 + sample])
        distance = off(inside(scene.meshes[index])[:-28:7], line)
        assert np.abs(distance - RADIUS).max() < 0.01


def ribbons(stage):
    curves(stage, points=POINTS[:4]).CreateNormalsAttr([Gf.Vec3f(0, 0, 1)] * 4)


def two(stage):
    curves(stage, points=np.concatenate([POINTS[:4], POINTS[:3]]), counts=[4, 3])


@pytest.mark.parametrize(
    ("build", "line"),
    [
        (ribbons, "curves with normals are ribbons, and are drawn as round tubes: 1 prim"),
        (two, "curves of too few points for their basis are left out: 1 prim"),
        (
            lambda stage: curves(stage, points=POINTS[:4], widths=None) and None,
            "curves without widths have no surface and are not drawn: 1 prim",
        ),
    ],
)
def test_what_is_lost_of_curves_is_told(tmp_path, build, line):
    (told,) = opened(tmp_path, build).losses
    assert told.startswith(line)


def test_too_many_curves_are_coarser_and_told_by_how_much(tmp_path, monkeypatch):
    monkeypatch.setattr(tubes, "MOST_TRIANGLES", 300)
    scene = opened(tmp_path, lambda stage: curves(stage, points=POINTS[:4]) and None)
    assert 60 < len(scene.meshes[0].faces) <= 300
    assert scene.losses[0].startswith("curves of too many segments are within ")
    share = float(scene.losses[0].split()[7]) / 100
    distance = off(inside(scene.meshes[0])[:-28], bezier(POINTS[:4]))
    assert 0.25 * share < np.abs(distance - RADIUS).max() / 3.0 < share


@pytest.mark.parametrize(
    ("change", "words"),
    [
        (lambda c: c.CreateCurveVertexCountsAttr([9]), "curveVertexCounts add up to 9, there are"),
        (lambda c: c.CreateWidthsAttr([-1.0]), "widths below 0"),
        (lambda c: c.CreateWidthsAttr([0.1, 0.1, 0.1]), "3 widths"),
        (lambda c: c.CreateBasisAttr("bezir"), 'is "bezir"; did you mean "bezier"'),
        (lambda c: c.CreateWrapAttr("round"), 'is "round"; known: nonperiodic'),
    ],
)
def test_arrays_that_contradict_each_other_are_refused(tmp_path, change, words):
    path = written(tmp_path, lambda stage: change(curves(stage, points=POINTS[:4])) and None)
    with pytest.raises(StageError, match=words):
        read_stage(path)
