"""Formulas of the surface model are the same numbers in every language that they are lowered to."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from scenec.backends.cycles.graph import NODES
from scenec.backends.stage.scene import Reflectance
from scenec.backends.surface import cells, lamps, lobes, merges, projections, reflectance
from scenec.backends.surface.algebra import FLOAT64, Algebra
from scenec.backends.testing import scenes as ms
from scenec.testing.extras import needs

POINTS = 64


@dataclass(frozen=True)
class Formula:
    """A formula of numbers in [0, 1].

    Attributes:
        inputs: How many it takes.
        of: Gives numbers, from the algebra and them.
    """

    inputs: int
    of: Callable[..., Sequence[Any]]


def vectors(fn: Algebra, numbers: Sequence[Any]) -> list[Any]:
    """Vectors of three numbers each, in [-1, 1]."""
    threes = zip(*[iter(numbers)] * 3, strict=True)
    return [fn.vector(*(2.0 * x - 1.0 for x in three)) for three in threes]


def merged(fn: Algebra, *x: Any) -> Sequence[Any]:
    weights = merges.heeded_weights(fn, x[:3], merges.all_slopes(fn, (0.3, 0.0, 0.7)), x[3:])
    return merges.shares(weights)


def looked(fn: Algebra, *x: Any) -> Sequence[Any]:
    numbers = lobes.Numbers(fn.vector(*x[:3]), 0.4, x[8], -0.3, x[9], x[10], x[12])
    found = lobes.lobes_of(fn, numbers, {"base_color": fn.vector(*x[5:8])}, x[3:5])
    gloss = fn.parts(lobes.gloss_color(found, 0.05 + 0.95 * x[11]))
    return [*gloss, found.alpha, found.dull, found.through]


def in_cells(fn: Algebra, *x: Any) -> Sequence[Any]:
    def entry(corner: Any) -> Any:
        i, j, _ = fn.parts(corner)
        # Shader nodes take the angle.
        turn = math.atan2(0.8, 0.6) if fn is NODES else (0.6, 0.8)
        return fn.vector(0.1 * i, 0.2 * j, 0.0), turn

    lattice = cells.Lattice(0.7, (3.1, 5.2), 1.3, 0)
    corners = cells.corners(fn, lattice, fn.vector(9.0 * x[0], 9.0 * x[1], 0.0), entry)
    value = cells.mixed(fn, corners, x[2:5], 0.4, 1.0)
    turned = cells.turned_back(fn, corners, vectors(fn, x[5:14]))
    # Not u and v: at a triangle's edge float32 may take the other one, which has no share of it.
    return [value, *fn.parts(turned)]


def from_sides(fn: Algebra, *x: Any) -> Sequence[Any]:
    normal, *mapped = vectors(fn, x)
    normal = fn.unit(normal)
    shares = projections.plane_shares(fn, normal)
    return fn.parts(projections.from_sides(fn, normal, shares, mapped))


def leaned(fn: Algebra, *x: Any) -> Sequence[Any]:
    mapped, normal, flat, u, v, view = vectors(fn, x)
    normal, view = fn.unit(normal), fn.unit(view)
    by_uv = projections.leaned(fn, mapped, normal, u, v)
    above = projections.leaned(fn, mapped, normal, projections.along_x(fn, fn.unit(flat)), None)
    seen = projections.seen(fn, by_uv, normal, normal * -1.0, view)
    return [*fn.parts(above), *fn.parts(seen)]


def gloss(fn: Algebra, *x: Any) -> Sequence[Any]:
    cosines = 0.05 + 0.95 * x[1], 0.05 + 0.95 * x[2]
    cos_h = 0.2 + 0.8 * x[3]
    return lobes.ggx(fn, 0.05 + 0.95 * x[0], cosines, cos_h, 1.0 - cos_h * cos_h)


def lamp(fn: Algebra, *x: Any) -> Sequence[Any]:
    away, axis = (fn.unit(v) for v in vectors(fn, x))
    return [lamps.falloff(fn, away, axis, (0.5, 2.5, 0.5))]


def law(fn: Algebra, *x: Any) -> Sequence[Any]:
    hapke = reflectance.numbers_of(
        Reflectance("hapke", 0.3, 0.2, 1.2, 0.06, math.radians(20.0)), fn
    )
    mu0, mu = 0.05 + 0.95 * x[0], 0.05 + 0.95 * x[1]
    terms = reflectance.terms(fn, hapke, mu0, mu, 0.02 + 1.5 * x[2])
    return fn.parts(reflectance.value(terms, fn.vector(*x[3:6])))


FORMULAS = {
    "merges": Formula(7, merged),
    "lobes": Formula(13, looked),
    "cells": Formula(14, in_cells),
    "triplanar": Formula(12, from_sides),
    "leaned normals": Formula(18, leaned),
    "GGX": Formula(4, gloss),
    "lamps": Formula(6, lamp),
    "Hapke": Formula(6, law),
}


#: Where the median error is above that of float32: Mesa's arc sine is a polynomial.
MEDIANS = {("lamps", "GLSL"): 5e-4}


def numbers(formula: Formula) -> NDArray[np.float32]:
    """Inputs of points, [inputs, points]."""
    return np.random.default_rng(8).random((formula.inputs, POINTS), np.float32)


def defined(formula: Formula) -> NDArray[np.float64]:
    """Outputs of points, [outputs, points]."""
    found = formula.of(FLOAT64, *numbers(formula).astype(np.float64))
    return np.stack(np.broadcast_arrays(*found))


def drjit(formula: Formula) -> NDArray:
    from scenec.backends.mitsuba.variant import load_mitsuba

    mi = load_mitsuba()
    from scenec.backends.mitsuba.arrays import ARRAYS

    return np.stack([np.array(out) for out in formula.of(ARRAYS, *map(mi.Float, numbers(formula)))])


def glsl(formula: Formula) -> NDArray:
    """A pixel a number."""
    from scenec.backends.pyrender import Pyrender

    # It chooses the platform that PyOpenGL is for.
    backend = Pyrender()
    from OpenGL import GL
    from pyrender.shader_program import ShaderProgram

    from scenec.backends.pyrender import resources
    from scenec.backends.pyrender.glsl import Glsl, function
    from scenec.backends.pyrender.renderer import SHADERS

    def inputs(fn: Glsl) -> list[Any]:
        return [fn.given("float", f"x[{i}]") for i in range(formula.inputs)]

    count = len(defined(formula))
    texts = [
        function(f"float out{k}()", lambda fn, k=k: formula.of(fn, *inputs(fn))[k])
        for k in range(count)
    ]
    choice = "".join(f"row == {k} ? out{k}() : " for k in range(count))
    source = f"""#version 420 core
        layout(binding = 0) uniform samplerBuffer inputs;
        layout(location = 0) out vec4 light;
        float x[{formula.inputs}];
        {"".join(texts)}
        void main() {{
            for (int i = 0; i < {formula.inputs}; i++)
                x[i] = texelFetch(inputs, i * {POINTS} + int(gl_FragCoord.x)).x;
            int row = int(gl_FragCoord.y);
            light = vec4({choice} 0.0);
        }}"""

    class Program(ShaderProgram):
        def _load(self, name: str) -> str:
            return source if name == "" else super()._load(name)

    program = Program(str(SHADERS / "full.vert"), "")
    program._add_to_context()
    program._bind()
    table = resources.Table()
    table.fill(numbers(formula).ravel())
    target = resources.picture_target(POINTS, count, GL.GL_RGBA32F, depth=False)
    target.bind()
    GL.glActiveTexture(GL.GL_TEXTURE0)
    GL.glBindTexture(GL.GL_TEXTURE_BUFFER, table.texture)
    for state in (GL.GL_DEPTH_TEST, GL.GL_BLEND, GL.GL_CULL_FACE, GL.GL_SCISSOR_TEST):
        GL.glDisable(state)
    empty = GL.glGenVertexArrays(1)
    GL.glBindVertexArray(empty)
    GL.glDrawArrays(GL.GL_TRIANGLES, 0, 3)
    found = np.empty((count, POINTS, 4), np.float32)
    target.read(GL.GL_RGBA, GL.GL_FLOAT, found)
    GL.glDeleteVertexArrays(1, [empty])
    program.delete()
    target.delete()
    table.delete()
    del backend
    return found[..., 0]


def nodes(formula: Formula, monkeypatch: pytest.MonkeyPatch) -> NDArray:
    """A stripe a number, a pixel a point, which give it off."""
    from scenec.backends.cycles import Cycles, materials
    from scenec.backends.cycles.graph import Graph

    count = len(defined(formula))
    inputs = numbers(formula)

    def make(bpy: Any, scene: Any, frame: Any, light: Any) -> Any:
        image = materials.picture_image(bpy, np.repeat(inputs[:, :, None], 3, axis=2))
        made = {}
        for k in range(count):
            material = bpy.data.materials.new("formula")
            material.node_tree.nodes.clear()
            graph = Graph(material.node_tree)
            u = NODES.parts(graph.geometry("Position"))[0] * (1.0 / (frame.scale * POINTS)) + 0.5
            rows = [1.0 - (i + 0.5) / formula.inputs for i in range(formula.inputs)]
            x = [NODES.parts(graph.picture(image, u, v, "EXTEND", False))[0] for v in rows]
            emission = graph.node("ShaderNodeEmission")
            graph.feed(emission.inputs["Color"], np.ones(3) * formula.of(NODES, *x)[k])
            graph.feed(graph.node("ShaderNodeOutputMaterial").inputs[0], emission.outputs[0])
            made[(k,), (), False] = material
        return made

    monkeypatch.setattr(materials, "make_materials", make)
    corners = np.array([[-0.5, 0.5, 0.0], [0.5, 0.5, 0.0], [-0.5, -0.5, 0.0], [0.5, -0.5, 0.0]])
    stripes = []
    for k in range(count):
        points = corners * [POINTS, 1.0, 0.0] + [0.0, 0.5 * count - k - 0.5, 0.0]
        stripes.append(ms.mesh(points, np.array([[0, 2, 1], [1, 2, 3]]), (k,)))
    # 100 m up, so that a pixel is a meter wide.
    fov = math.degrees(2.0 * math.atan(0.5 * POINTS / 100.0))
    camera = ms.look_at((0.0, 0.0, 100.0), (0.0, 0.0, 0.0), POINTS, count, fov)
    surfaces = [ms.surface() for _ in range(count)]
    scene = ms.scene(stripes, surfaces, cameras=[camera], lights=[])
    backend = Cycles()
    backend.load(scene)
    return backend.radiance(camera, 0, 1, 1).halves[0][..., 0]


@pytest.mark.parametrize("name", FORMULAS)
@pytest.mark.parametrize(
    "language", ["Dr.Jit", "GLSL", pytest.param("nodes", marks=needs("cycles", "bpy"))]
)
def test_a_formula_is_the_definition(name, language, monkeypatch):
    formula = FORMULAS[name]
    if language == "nodes":
        got = nodes(formula, monkeypatch)
    else:
        got = (drjit if language == "Dr.Jit" else glsl)(formula)
    expected = defined(formula)
    assert np.abs(expected).max() > 0.1
    # float32, in which some of these subtract numbers that are nearly the same.
    off = np.abs(got - expected) / np.maximum(np.abs(expected), 0.05)
    assert np.median(off) < MEDIANS.get((name, language), 1e-5)
    assert off.max() < 5e-3
