"""Polygons become triangles that cover them once, whatever their outlines."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from scenec.schemas.polygons import triangulate
from scenec.testing.examples import examples
from scenec.testing.outlines import (
    CROSSES,
    EMPTY,
    SHAPES,
    C,
    edges,
    is_simple,
    keyhole,
    shoelace,
    turn,
)

FLAT = "a polygon with corners that repeat or stand in line has triangles without area"


def cut(outline, faults=()):
    """Triangles of one polygon, as indices of its corners; None takes any faults."""
    points = np.zeros((len(outline), 3))
    points[:, : len(outline[0])] = outline
    found = triangulate(points, np.arange(len(points)), np.array([len(points)]))
    assert faults is None or tuple(found.faults) == tuple(faults)
    assert (found.polygon == 0).all()
    assert len(found.corners) == len(outline) - 2
    return found.corners.tolist()


def inside(outline, x, y):
    """By the even-odd rule, for points that are on no edge."""
    odd = np.zeros(len(x), bool)
    for (ax, ay), (bx, by) in edges(outline):
        if ay != by:
            odd ^= ((ay > y) != (by > y)) & (x < (bx - ax) * (y - ay) / (by - ay) + ax)
    return odd


def covered(triangles, x, y):
    """How many triangles each point is in, and whether it is clear of all their edges."""
    count, clear = np.zeros(len(x), int), np.ones(len(x), bool)
    for corners in triangles:
        within = np.ones(len(x), bool)
        for (ax, ay), (bx, by) in edges(corners):
            side = (bx - ax) * (y - ay) - (by - ay) * (x - ax)
            within &= side > 0.0
            clear &= np.abs(side) > 1e-6 * np.hypot(bx - ax, by - ay)
        count += within
    return count, clear


@given(st.integers(0, 2**32 - 1), st.sampled_from(sorted(SHAPES)), st.data())
@examples(1000)
def test_the_triangles_of_any_simple_polygon_cover_it_once(seed, shape, data):
    rng = np.random.default_rng(seed)
    outline = SHAPES[shape](rng, data.draw(st.integers(4, 40)))
    if shape != "keyhole" and not is_simple(outline):
        return
    if data.draw(st.booleans()):
        outline = outline[::-1]
    step = data.draw(st.integers(0, len(outline) - 1))
    outline = outline[step:] + outline[:step]
    # Whole numbers: a tilted plane, in any order of axes, is exact as well.
    slope = data.draw(st.tuples(st.integers(-3, 3), st.integers(-3, 3)))
    axes = data.draw(st.permutations(range(3)))
    points = np.array([(x, y, slope[0] * x + slope[1] * y) for x, y in outline], float)
    found = triangulate(points[:, axes], np.arange(len(points)), np.array([len(points)]))
    assert found.faults == {}
    assert found.corners.shape == (len(outline) - 2, 3)

    triangles = [[outline[i] for i in corners] for corners in found.corners.tolist()]
    areas = [turn(*corners) for corners in triangles]
    total = shoelace(outline)
    assert all(area * total > 0 for area in areas)
    assert sum(map(abs, areas)) == abs(total)

    low, high = np.min(outline, axis=0), np.max(outline, axis=0)
    many = 100 * settings().max_examples
    x, y = rng.uniform(low, high, (many, 2)).T
    count, clear = covered([t if total > 0 else t[::-1] for t in triangles], x, y)
    assert clear.sum() > 0.9 * many
    assert np.array_equal(count[clear] == 1, inside(outline, x, y)[clear])
    assert count[clear].max() == 1


@given(st.lists(st.floats(0.0, 6.28), min_size=4, max_size=30, unique=True), st.floats(-0.02, 0.02))
def test_a_convex_polygon_keeps_the_fan_from_its_first_corner(angles, warp):
    angle = np.sort(angles)
    if np.diff([*angle, angle[0] + 2.0 * np.pi]).min() < 0.1:
        return
    ring = np.stack([3.0 * np.cos(angle), np.sin(angle), warp * np.cos(3.0 * angle)], axis=1)
    assert cut(ring) == [[0, k, k + 1] for k in range(1, len(ring) - 1)]
    # Corners in line are no reason to cut otherwise, though two of these triangles have no area.
    square = [(0, 0), (2, 0), (4, 0), (4, 4), (0, 4), (0, 2)]
    assert cut(square, [FLAT]) == [[0, k, k + 1] for k in range(1, 5)]


def test_a_fan_that_is_right_is_kept_of_concave_polygons_too():
    arrow = [(0, 0), (2, -1), (6, 0), (2, 1)]
    for step in range(4):
        turned = arrow[step:] + arrow[:step]
        assert cut(turned) == [[0, 1, 2], [0, 2, 3]]
    dart = [(0, 0), (3, 3), (1, 0), (3, -3)]
    assert cut(dart) == [[0, 1, 2], [0, 2, 3]]
    assert cut([*dart[1:], dart[0]]) != [[0, 1, 2], [0, 2, 3]]


def test_a_quad_far_out_of_plane_is_seen_along_its_normal():
    # Along an axis it crosses itself; along its normal it is convex.
    quad = np.array([[0.8994140625, -4.5458984375, 1.923828125],
                     [0.9638671875, -4.5458984375, 2.4521484375],
                     [1.421875, -2.7275390625, 2.6640625],
                     [2.8564453125, -2.7275390625, 2.2158203125]])  # fmt: skip
    assert cut(quad) == [[0, 1, 2], [0, 2, 3]]


@given(st.integers(0, 2**32 - 1), st.integers(4, 12), st.floats(1e-5, 0.05))
def test_a_polygon_out_of_plane_is_cut_as_it_is_seen_along_its_normal(seed, corners, warp):
    rng = np.random.default_rng(seed)
    ring = np.array([(*p, 0.0) for p in SHAPES["star"](rng, corners)])
    ring[:, 2] = 1000.0 * warp * rng.standard_normal(len(ring))
    turned = ring @ np.linalg.qr(rng.standard_normal((3, 3)))[0].T
    found = triangulate(turned, np.arange(len(ring)), np.array([len(ring)]))
    a, b, c = np.moveaxis(turned[found.corners], 1, 0)
    normals = np.cross(b - a, c - a)
    # Any triangles of it have the same sum.
    newell = np.cross(turned, np.roll(turned, -1, axis=0)).sum(axis=0)
    assert np.allclose(normals.sum(axis=0), newell, atol=1e-9 * np.abs(newell).max())
    seen = normals @ newell / (newell @ newell)
    # Seen obliquely, an outline with thin parts may cross itself.
    assert found.faults or (seen > -1e-12).all()
    assert not found.faults or warp > 1e-3


@pytest.mark.parametrize("size", [1e-9, 1.0, 1e9, 1e30])
@pytest.mark.parametrize("away", [0.0, 3e6])
@pytest.mark.parametrize("aspect", [1.0, 1e-9])
def test_size_distance_and_aspect_do_not_matter(size, away, aspect):
    outline = (np.array(C) + np.array([away, -away])) * [size, size * aspect]
    for step in range(8):
        triangles = np.roll(outline, step, axis=0)[cut(np.roll(outline, step, axis=0))]
        ab, ac = triangles[:, 1] - triangles[:, 0], triangles[:, 2] - triangles[:, 0]
        area = 0.5 * (ab[:, 0] * ac[:, 1] - ab[:, 1] * ac[:, 0])
        assert (area > 0.0).all()
        assert area.sum() == pytest.approx(2.5 * size * size * aspect, rel=1e-6)


def test_a_polygon_without_area_is_said_and_still_has_its_triangles():
    assert len(cut([(0, 0), (1, 1), (2, 2), (3, 3), (1, 1)], [EMPTY])) == 3
    assert len(cut([(1, 1)] * 4, [EMPTY])) == 2
    # There and back again, with a turn; a line that rounding bends.
    assert len(cut([(0, 0), (1, 0), (1, 1), (1, 0)], [EMPTY])) == 2
    line = [(7.1 + 0.1 * k, 3.3 + 0.3 * k, 0.7 * k) for k in (0, 3, 1, 2, 5, 1, 4)]
    assert len(cut(line, [EMPTY])) == 5


@pytest.mark.parametrize(
    "outline",
    [
        [(-1, 0), (1, 2), (1, 0), (-1, 2)],
        [(0, 0), (1e-9, 1), (1e-9, 0), (0, 1)],
        [(9e5, 9e5), (9e5 + 1, 9e5 + 1), (9e5 + 1, 9e5), (9e5, 9e5 + 1)],
        # Both halves meet at a corner that is there twice; a figure of three crossings.
        [(-1, -1), (-1, 1), (0, 0), (1, -1), (1, 1), (0, 0)],
        [(0, 0), (2, 2), (4, 0), (6, 2), (6, 0), (4, 2), (2, 0), (0, 2)],
    ],
)
@pytest.mark.parametrize("slope", [(0, 0), (2, -3)])
@pytest.mark.parametrize("axes", [(0, 1, 2), (2, 0, 1)])
def test_halves_of_opposite_signs_cross_and_are_no_lack_of_area(outline, slope, axes):
    points = [(x, y, slope[0] * x + slope[1] * y) for x, y in outline]
    for step in range(len(points)):
        turned = np.array(points[step:] + points[:step])[:, axes]
        # The fan is as good as any.
        assert cut(turned, [CROSSES]) == [[0, k, k + 1] for k in range(1, len(points) - 1)]


def area_of(outline, triangles):
    return sum(abs(turn(*(outline[i] for i in corners))) for corners in triangles)


@pytest.mark.parametrize(
    "outline",
    [
        [(0, 0), (0, 0), (4, 0), (4, 4), (0, 4)],
        [(0, 0), (4, 0), (4, 4), (2, 2), (2, 2), (2, 2), (0, 4)],
        # A tip without width: outward, inward, along an edge.
        [(0, 0), (4, 0), (9, 0), (4, 0), (4, 4), (2, 1), (0, 4)],
        [(0, 0), (4, 0), (4, 4), (2, 4), (2, 3), (2, 4), (2, 2), (0, 4)],
        [(0, 0), (3, 0), (1, 0), (4, 0), (4, 4), (2, 1), (0, 4)],
    ],
)
def test_corners_that_repeat_and_tips_without_width_are_said_and_add_no_area(outline):
    for step in range(len(outline)):
        turned = outline[step:] + outline[:step]
        triangles = cut(turned, [FLAT])
        assert area_of(turned, triangles) == abs(shoelace(outline))
        assert sorted({i for t in triangles for i in t}) == list(range(len(outline)))


def test_corners_in_line_get_triangles_with_area():
    # All of a triangle's sides but the first corner's own are dense with corners.
    side = [(12 - k, k) for k in range(13)]
    outline = [*side, (0, 8), (0, 4), (0, 0), (4, 0), (8, 0)]
    notched = [*outline[:14], (2, 4), *outline[15:]]
    for step in range(len(notched)):
        turned = notched[step:] + notched[:step]
        triangles = cut(turned)
        assert area_of(turned, triangles) == shoelace(notched)


def test_outlines_that_touch_themselves_are_no_crossings():
    # Two squares at one corner (two triangles each, of six); a hole that touches a side; a slit,
    # whose end may or may not become a triangle's corner.
    pinched = [(0, 0), (2, 0), (2, 2), (4, 2), (4, 4), (2, 4), (2, 2), (0, 2)]
    touching = [(0, 0), (8, 0), (8, 8), (0, 8), (0, 4), (2, 6), (6, 4), (2, 2), (0, 4)]
    slit = [(0, 0), (8, 0), (8, 4), (2, 4), (8, 4), (8, 8), (0, 8)]
    for outline, said in ((pinched, [FLAT]), (touching, []), (slit, None)):
        for step in range(len(outline)):
            turned = outline[step:] + outline[:step]
            assert area_of(turned, cut(turned, said)) == shoelace(outline)


@pytest.mark.parametrize(
    "outline",
    [
        # Unequal halves; a spike through the far side; a pentagram; a ring that is walked twice;
        # a ring at a corner, and at a side, that is wound as the outline is.
        [(0, 0), (4, 4), (4, 0), (0, 2)],
        [(0, 0), (8, 0), (8, 4), (5, 4), (4, -3), (3, 4), (0, 4)],
        [(0, 3), (2, -3), (-3, 1), (3, 1), (-2, -3)],
        [(0, 0), (4, 0), (4, 4), (0, 4), (1, 1), (5, 1), (5, 5), (1, 5)],
        [(0, 0), (8, 0), (8, 8), (0, 8), (0, 4), (2, 2), (6, 4), (2, 6), (0, 4)],
        [(0, 0), (8, 0), (8, 8), (4, 8), (4, 9), (6, 4), (8, 4), (3, 8), (0, 8)],
    ],
)
def test_a_polygon_that_crosses_itself_is_said_and_still_has_its_triangles(outline):
    for step in range(len(outline)):
        triangles = cut(outline[step:] + outline[:step], [CROSSES])
        assert sorted({i for t in triangles for i in t}) == list(range(len(outline)))


def test_ten_thousand_corners():
    rng = np.random.default_rng(4)
    angle = np.sort(rng.uniform(0.0, 2.0 * np.pi, 10_000))
    radius = rng.uniform(0.5, 1.0, len(angle))
    ring = 1e6 * radius * [np.cos(angle), np.sin(angle)]
    outline = [(round(x), round(y)) for x, y in ring.T.tolist()]
    assert area_of(outline, cut(outline)) == shoelace(outline)


def test_every_polygon_of_a_mesh_is_counted_and_cut_as_if_alone():
    rng = np.random.default_rng(1)
    outlines = [keyhole(rng, 8) for _ in range(5)] + [
        [(0, 0), (4, 4), (4, 0), (0, 2)],
        [(0, 0), (1, 0)],
        [(0, 0), (1, 0), (1, 1)],
        C,
        [(0, 0), (1, 1), (2, 2), (3, 3)],
    ]
    flat = np.array([(*p, 0.0) for outline in outlines for p in outline], float)
    order = rng.permutation(len(flat))
    counts = np.array([len(outline) for outline in outlines])
    corners = np.argsort(order, kind="stable")
    found = triangulate(flat[order], corners, counts)
    assert found.faults == {
        "a polygon of fewer than three corners is left out": 1, CROSSES: 1, EMPTY: 1
    }  # fmt: skip
    start = np.cumsum(counts) - counts
    for k, outline in enumerate(outlines):
        if len(outline) > 2:
            points = np.array([(*p, 0.0) for p in outline], float)
            alone = triangulate(points, np.arange(len(points)), np.array([len(points)]))
            assert np.array_equal(found.corners[found.polygon == k] - start[k], alone.corners)
    # Those that are left out, by their numbers, count for nothing.
    rest = triangulate(flat[order], corners, counts, np.array([5, 6, 9]))
    assert rest.faults == {}
    assert np.array_equal(np.unique(rest.polygon), [0, 1, 2, 3, 4, 7, 8])
