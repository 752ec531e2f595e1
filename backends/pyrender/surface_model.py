"""The surface model's functions in GLSL, written out from their one definition for each program."""

from __future__ import annotations

from collections.abc import Callable, Collection
from functools import lru_cache
from typing import Any

from scenec.backends.pyrender.glsl import Glsl, Value, function, parameters
from scenec.backends.surface import facets, lamps, lobes, merges, pictures, projections
from scenec.backends.surface.cells import Lattice
from scenec.backends.surface.reflectance import Numbers, terms, value
from scenec.schemas.cells import SIDE

#: Where in the shading program they come.
MARK = "SURFACE_FUNCTIONS"
#: How a surface's maps are looked up, and the feature that says whether any is.
_LOOKS = {
    "look_above": "WITH_ABOVE",
    "look_cells": "WITH_CELLS",
    "look_triplanar": "WITH_TRIPLANAR",
    "look_uv": "WITH_UV",
}
#: Laws by whether light is scattered more than once, and whether the surface is rough.
_LAWS = {"law_once": (False, False), "law_smooth": (True, False), "law_rough": (True, True)}


@lru_cache(maxsize=32)
def surface_functions(features: frozenset[str]) -> str:
    """The text of the functions that a program with these features calls."""
    texts = [
        _lobes("WITH_THROUGH" in features),
        _of(gloss, "float gloss(float alpha, vec3 n, vec3 v, vec3 l)"),
        _of(_albedo, "float gloss_albedo(float alpha, float cosine)"),
    ]
    if "WITH_HEIGHTS" in features:
        texts.append(
            _of(heeded, "float heeded(float weight, float depth, float below, float above)")
        )
    if "WITH_LAMPS" in features:
        texts.append(_of(lamp_falloff, "float lamp_falloff(vec3 away, vec3 axis, vec3 cone)"))
    if "WITH_MAPS" in features:
        texts.append(
            _of(projections.seen, "vec3 seen(vec3 leaned, vec3 normal, vec3 facing, vec3 view)")
        )
        for name, feature in _LOOKS.items():
            if feature in features:
                texts.append(_look(name, features))
    if "WITH_FAR" in features:
        texts.append(_far("far_above"))
        if "WITH_CELLS" in features:
            texts.append(_far("far_cells"))
    if "WITH_FACETS" in features:
        texts += [
            _of(facets.factor, "float facets(float s, float cos_v, float cos_l, float cos_g)"),
            _of(facets.even_sky, "float facets_even(float s, float cos_v)"),
            _of(projections.sided, "vec3 sided(vec3 leaned, vec3 normal, vec3 facing)"),
        ]
    if "WITH_REFLECTANCE" in features:
        texts += [_law(name, multiple, rough) for name, (multiple, rough) in _LAWS.items()]
    return "\n".join(texts)


def _of(body: Callable[..., Any], signature: str) -> str:
    """A function of a formula whose parameters are numbers and vectors."""
    return function(signature, lambda fn: body(fn, *parameters(fn, signature)))


def heeded(fn: Glsl, weight: Value, depth: Value, below: Value, above: Value) -> Any:
    """``merges.heeded`` by the depth."""
    own = merges.slopes(fn.maximum(depth, merges.LEAST_DEPTH))
    return merges.heeded(fn, weight, own, below, above)


def lamp_falloff(fn: Glsl, away: Value, axis: Value, cone: Value) -> Any:
    """``lamps.falloff``."""
    return lamps.falloff(fn, away, axis, fn.parts(cone))


def _lobes(through: bool) -> str:
    """Writes the shader's function from a surface's rows in ``Tables.surfaces`` to lobes."""

    def body(fn: Glsl) -> Any:
        names = ("second.y", "second.x", "second.w", "first.a", "second.z")
        color, *others = fn.given("vec3", "first.rgb"), *(fn.given("float", n) for n in names)
        pictured = {
            "base_color": fn.given("vec3", "found.base_color"),
            "roughness": fn.given("float", "found.roughness"),
            "metallic": fn.given("float", "found.metallic"),
        }
        variations = [fn.given("float", f"hit.{name}") for name in ("variation", "row")]
        passed = fn.given("float", "transmission") if through else None
        numbers = lobes.Numbers(color, *others)._replace(transmission=passed)
        own = lobes.lobes_of(fn, numbers, pictured, variations)
        gloss = lobes.gloss_color(own, fn.given("float", "cosine"))
        made = {"color": own.color, "alpha": own.alpha, "dull": own.dull, "gloss": gloss}
        return made | {"through": own.through} if through else made

    more = ", float transmission" if through else ""
    signature = f"vec4 first, vec4 second, Pictured found, Hit hit, float cosine{more}"
    return function(f"Lobes lobes_of({signature})", body)


def _albedo(fn: Glsl, alpha: Value, cosine: Value) -> Any:
    return lobes.albedo(alpha, cosine)


def gloss(fn: Glsl, alpha: Value, n: Value, v: Value, light: Value) -> Any:
    """``lobes.ggx`` times the cosine."""
    half = fn.unit(v + light)
    cos_h = fn.dot(half, n)
    beside = half - n * cos_h
    cosines = fn.dot(n, v), fn.dot(n, light)
    return lobes.ggx(fn, alpha, cosines, cos_h, fn.dot(beside, beside))[0]


def _point(fn: Glsl) -> pictures.Point:
    """``surface.pictures.Point`` of a ``Hit``."""
    names = ("position", "normal", "along_u", "along_v")
    found = {name: fn.given("vec3", f"hit.{name}") for name in names}
    uv = fn.given("float", "hit.uv.x"), fn.given("float", "hit.uv.y")
    return pictures.Point(**found, flat=fn.given("vec3", "hit.flat_normal"), uv=uv)


def _texels(fn: Glsl, third: bool) -> pictures.Texels:
    """Looks the layers of a ``Lie`` up."""

    def texels(u: Any, v: Any, axis: int = 2, far: bool = False) -> pictures.Values:
        level = f"lie.levels[{axis}]"

        def layer(number: str) -> tuple[Value, Value]:
            place = f"vec3({u.name}, {v.name}, {number})"
            found = fn.emit("vec4", f"textureLod(maps, {place}, {level})").name
            return fn.given("vec3", f"{found}.rgb"), fn.given("float", f"{found}.a")

        color, rough = layer("lie.layer")
        if far:
            return {"base_color": color}
        normal, metallic = layer("lie.layer + 1.0")
        found = {"base_color": color, "roughness": rough, "normal": normal, "metallic": metallic}
        if third:
            found["emission"], found["height"] = layer("lie.third")
        return found

    return texels


def _entry(fn: Glsl) -> Callable[[Any], Any]:
    def entry(corner: Value) -> Any:
        column, row = (f"(int({corner.name}.{axis}) & {SIDE - 1})" for axis in "xy")
        place = f"lie.table + {SIDE} * {row} + {column}"
        found = fn.emit("vec4", f"texelFetch(surfaces, {place})").name
        turn = fn.given("float", f"{found}.z"), fn.given("float", f"{found}.w")
        return fn.given("vec3", f"vec3({found}.xy, 0.0)"), turn

    return entry


def _scale(fn: Glsl, in_cells: bool) -> pictures.Scale:
    def number(name: str) -> Value:
        return fn.given("float", f"lie.{name}")

    lattice = None
    if in_cells:
        corner = number("corner.x"), number("corner.y")
        lattice = Lattice(number("side"), corner, number("repeats"), 0)
    return pictures.Scale(number("step"), fn.given("vec3", "lie.start"), lattice)


def _look(name: str, features: Collection[str]) -> str:
    def body(fn: Glsl) -> Any:
        means = {
            "base_color": fn.given("vec3", "lie.means[0].rgb"),
            "roughness": fn.given("float", "lie.means[0].a"),
            "emission": fn.given("vec3", "lie.means[1].rgb"),
            "height": fn.given("float", "lie.means[1].a"),
            "metallic": fn.given("float", "lie.means[2].x"),
        }
        scale = None if name == "look_uv" else _scale(fn, name == "look_cells")
        projection = "triplanar" if name == "look_triplanar" else "above"
        placement = pictures.Placement(projection, scale, means)
        texels = _texels(fn, "WITH_THIRD" in features)
        return pictures.look_up(fn, placement, _point(fn), texels, _entry(fn))

    return function(f"Pictured {name}(Hit hit, Lie lie)", body)


def _far(name: str) -> str:
    def body(fn: Glsl) -> Any:
        numbers = fn.given("vec3", "lie.gain"), fn.given("vec3", "lie.rest")
        means = {"base_color": fn.given("vec3", "lie.means[0].rgb")}
        scale = _scale(fn, name == "far_cells")
        placement = pictures.Placement("above", None, means, scale, *numbers)
        return pictures.far_factor(fn, placement, _point(fn), _texels(fn, False), _entry(fn))

    return function(f"vec3 {name}(Hit hit, Lie lie)", body)


def _law(name: str, multiple: bool, rough: bool) -> str:
    signature = f"vec3 {name}(vec4 law, vec2 more, vec3 r0, float mu0, float mu, float tangent)"

    def body(fn: Glsl) -> Any:
        r0, mu0, mu, tangent = parameters(fn, signature)
        names = ("law.y", "law.z", "law.w", "more.x", "more.y")
        b, c, surge, width, slope = (fn.given("float", name) for name in names)
        law = Numbers(multiple, b, c, surge, width, slope if rough else None)
        return value(terms(fn, law, mu0, mu, tangent), r0)

    return function(signature, body)
