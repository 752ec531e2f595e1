"""Draws the shapes of a class of rocks."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from scenec.compiler.cfg.check_objects import LYING
from scenec.compiler.distributions.resolve import resolve
from scenec.compiler.distributions.streams import Streams
from scenec.compiler.draw.scatter import Turn, draw_scattered
from scenec.compiler.kinds.context import Context
from scenec.compiler.kinds.schema import own_schema
from scenec.compiler.objects.coatings import CoatingPlan
from scenec.compiler.objects.families.angular import draw_angular
from scenec.compiler.objects.families.bedded import draw_bedded
from scenec.compiler.objects.families.breccia import draw_breccia
from scenec.compiler.objects.families.rounded import draw_rounded
from scenec.compiler.objects.families.shape import Shape
from scenec.compiler.objects.families.slab import draw_slab
from scenec.compiler.objects.families.ventifact import Ventifact, draw_ventifact
from scenec.compiler.objects.families.vesicular import draw_vesicular
from scenec.compiler.objects.families.weathered import draw_weathered
from scenec.compiler.objects.plan import RockShapes, ScatterPlan
from scenec.compiler.scene.labels import Labels
from scenec.compiler.terrain.mask import Masked
from scenec.schemas.plugins import Kinds

_FAMILIES: dict[str, Callable[..., Shape]] = {
    "weathered": draw_weathered,
    "angular": draw_angular,
    "rounded": draw_rounded,
    "slab": draw_slab,
    "vesicular": draw_vesicular,
    "ventifact": draw_ventifact,
    "bedded": draw_bedded,
    "breccia": draw_breccia,
}


#: Families of other packages.
_OTHERS = Kinds[type[Any]]("scenec.rocks", {})


class _Usual(NamedTuple):
    """What a family has where the cfg says nothing.

    Fragments have axes of about 2 : sqrt(2) : 1, whatever broke them (Michikami et al. 2010 on
    Itokawa, Eros and in the laboratory; 2022 on Ryugu). What rolls loses its corners before its
    proportions; slabs come from between bedding planes; the rest is judgment.
    """

    elongation: float
    flatness: float
    wear: float


_USUAL = {
    # Its wear is what angularity leaves.
    "weathered": _Usual(0.18, 0.4, 0.4),
    "angular": _Usual(0.29, 0.5, 0.1),
    "rounded": _Usual(0.22, 0.45, 0.7),
    "slab": _Usual(0.25, 0.8, 0.15),
    "vesicular": _Usual(0.2, 0.35, 0.4),
    "ventifact": _Usual(0.28, 0.5, 0.12),
    "bedded": _Usual(0.25, 0.45, 0.35),
    "breccia": _Usual(0.22, 0.4, 0.4),
}
#: How far from the wind a ventifact's facet looks at most, in whole turns (30 degrees).
_ASTRAY = 1.0 / 12.0


def draw_rocks(name: str, cfg: dict[str, Any], labels: Labels, setting: Context) -> ScatterPlan:
    """The plan of a class of procedural rocks."""
    path, streams = f"objects/{name}", setting.streams
    node = resolve(cfg, streams, path)
    prototypes = int(node["prototypes"])
    shapes = tuple(_shape(f"{path}/prototypes/{i}", node, streams) for i in range(prototypes))
    return draw_scattered(
        name,
        cfg,
        node,
        labels,
        setting,
        source=RockShapes(
            shapes,
            tuple(
                CoatingPlan(**own, key=streams.key(f"{path}/coatings/{i}"))
                for i, own in enumerate(node["coatings"])
            ),
        ),
        weights=[1.0] * prototypes,
        orientation="normal" if cfg["family"] in LYING else "random",
        size_key="size_m",
        turn=_into_wind(shapes, setting) if cfg["family"] == "ventifact" else None,
    )


def _into_wind(shapes: Sequence[Shape], setting: Context) -> Turn:
    """Turns each ventifact so that one of its facets looks into the wind, more or less.

    All of a batch have one wind: that of the relief, if it has one, or one of their own.
    """
    operators = (o.operator if isinstance(o, Masked) else o for o in setting.relief)
    winds = (getattr(operator, "wind_deg", None) for operator in operators)
    to_deg = next((wind for wind in winds if wind is not None), None)
    to = to_deg / 360.0 if to_deg is not None else setting.streams.uniforms("wind", 1)[0]
    looks = [shape.bearings() for shape in shapes if isinstance(shape, Ventifact)]
    counts = np.array([len(each) for each in looks])
    padded = np.array([np.resize(each, counts.max()) for each in looks])

    def turn(prototype: NDArray[np.int32], u: NDArray[np.float64]) -> NDArray[np.float64]:
        facet = (u[:, 1] * counts[prototype]).astype(np.int64)
        astray = _ASTRAY * (u[:, 0] + u[:, 2] - 1.0)
        turns: NDArray[np.float64] = to + 0.5 + astray - padded[prototype, facet]
        return turns - np.floor(turns)

    return turn


def _shape(path: str, cfg: dict[str, Any], streams: Streams) -> Shape:
    family = cfg["family"]
    other = None if family in _FAMILIES else _OTHERS[family]
    usual = _USUAL[family] if other is None else getattr(other, "USUAL", _Usual(0.25, 0.4, 0.3))
    elongation, flatness, wear = (
        own if cfg[key] is None else cfg[key]
        for key, own in zip(_Usual._fields, usual, strict=True)
    )
    if family == "weathered":
        wear = 1.0 - cfg["angularity"]
    # Axes b <= a by elongation, c <= b by flatness: their means are as asked.
    u = streams.uniforms(f"{path}/axes", 2)
    middle = 1.0 - min(elongation * (0.4 + 1.2 * u[0]), 0.95)
    low = 1.0 - flatness * (0.75 + 0.5 * u[1])
    axes = 1.0, middle, min(max(low, 0.05), middle)
    common = streams.key(path), cfg["bumpiness"], axes, int(cfg["subdivisions"])
    if other is None:
        return _FAMILIES[family](path, streams, wear, common)
    keys = own_schema(_OTHERS.group, family)["properties"]
    return other(*common, **{key: cfg[key] for key in keys})
