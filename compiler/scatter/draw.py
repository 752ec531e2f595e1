"""What is drawn for a class of rocks: shapes once, sizes and turns for each."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from scenec.compiler.arithmetic import elementary
from scenec.compiler.frontend.numbers import draw_number
from scenec.compiler.frontend.resolve import resolve
from scenec.compiler.frontend.streams import Streams
from scenec.compiler.plan import RocksPlan
from scenec.compiler.scatter.families.angular import draw_angular
from scenec.compiler.scatter.families.rounded import draw_rounded
from scenec.compiler.scatter.families.shape import Shape, unit_vectors
from scenec.compiler.scatter.families.slab import draw_slab
from scenec.compiler.scatter.families.vesicular import draw_vesicular
from scenec.compiler.scatter.families.weathered import Weathered
from scenec.compiler.scatter.placement import NoiseDensity, UniformDensity
from scenec.compiler.scene import Labels

_PLANES = 14
_NEAREST_PLANE = 0.55

_FAMILIES: dict[str, Callable[..., Shape]] = {
    "angular": draw_angular,
    "rounded": draw_rounded,
    "slab": draw_slab,
    "vesicular": draw_vesicular,
}


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
    "angular": _Usual(0.29, 0.5, 0.1),
    "rounded": _Usual(0.22, 0.45, 0.7),
    "slab": _Usual(0.25, 0.8, 0.15),
    "vesicular": _Usual(0.2, 0.35, 0.4),
}
#: 1 - c/a of weathered rocks.
_FLATNESS = 0.35


def draw_rocks(name: str, cfg: dict[str, Any], labels: Labels, streams: Streams) -> RocksPlan:
    """The plan of one class.

    Args:
        name: Of the class.
        cfg: Its part of the cfg.
        labels: Its label ids.
        streams: The batch's streams.
    """
    path = f"objects/{name}"
    node = resolve(cfg, streams, path)
    n = int(node["count"])
    # Plates lie.
    orientation = cfg["orientation"] or ("normal" if cfg["family"] == "slab" else "random")
    align = orientation == "normal"
    return RocksPlan(
        name=name,
        material=cfg["material"],
        labels=labels,
        instances=cfg["instances"],
        shapes=tuple(
            _shape(f"{path}/prototypes/{i}", node, streams) for i in range(int(node["prototypes"]))
        ),
        density=_density(node["density"], streams, path),
        position_u=_uniforms(streams, f"{path}/position", n, 3),
        prototype=np.minimum(
            (streams.uniforms(f"{path}/prototype", n) * node["prototypes"]).astype(np.int32),
            int(node["prototypes"]) - 1,
        ),
        orientations=(
            _random_turns(streams, path, n) if orientation == "random" else _spins(streams, path, n)
        ),
        align=align,
        size_m=draw_number(cfg["size_m"], streams, f"{path}/size_m", n),
        embed=draw_number(cfg["embed"], streams, f"{path}/embed", n),
        variation=2.0 * streams.uniforms(f"{path}/variation", n) - 1.0,
        lod_px=cfg["lod_px"],
    )


def _uniforms(streams: Streams, path: str, n: int, columns: int) -> NDArray[np.float64]:
    """[n, columns]; a larger n leaves the first rows as they are."""
    return streams.uniforms(path, n * columns).reshape(n, columns)


def _density(cfg: dict[str, Any], streams: Streams, path: str) -> UniformDensity | NoiseDensity:
    if cfg["type"] == "uniform":
        return UniformDensity()
    return NoiseDensity(
        key=streams.key(f"{path}/density"),
        scale_m=cfg["scale_m"],
        octaves=int(cfg["octaves"]),
        contrast=cfg["contrast"],
    )


def _shape(path: str, cfg: dict[str, Any], streams: Streams) -> Shape:
    if cfg["family"] == "weathered":
        return _weathered(path, cfg, streams)
    usual = _USUAL[cfg["family"]]
    elongation, flatness, wear = (
        own if cfg[key] is None else cfg[key]
        for key, own in zip(_Usual._fields, usual, strict=True)
    )
    # Axes b <= a by elongation, c <= b by flatness: their means are as asked.
    u = streams.uniforms(f"{path}/axes", 2)
    middle = 1.0 - min(elongation * (0.4 + 1.2 * u[0]), 0.95)
    low = 1.0 - flatness * (0.75 + 0.5 * u[1])
    return _FAMILIES[cfg["family"]](
        streams.key(path),
        path,
        streams,
        wear,
        cfg["bumpiness"],
        (1.0, middle, min(max(low, 0.05), middle)),
        int(cfg["subdivisions"]),
    )


def _weathered(path: str, cfg: dict[str, Any], streams: Streams) -> Weathered:
    u = _uniforms(streams, f"{path}/planes", _PLANES, 3)
    middle, low = streams.uniforms(f"{path}/axes", 2)
    flat = _FLATNESS if cfg["flatness"] is None else cfg["flatness"]
    long = 0.6 * flat * middle
    if cfg["elongation"] is not None:
        long = min(cfg["elongation"] * (0.4 + 1.2 * middle), 0.95)
    return Weathered(
        key=streams.key(path),
        plane_normals=unit_vectors(u[:, :2]),
        plane_distances=_NEAREST_PLANE + (1.0 - _NEAREST_PLANE) * u[:, 2],
        axes=(1.0, 1.0 - long, max(1.0 - flat * (0.7 + 0.6 * low), 0.05)),
        angularity=cfg["angularity"],
        bumpiness=cfg["bumpiness"],
        subdivisions=int(cfg["subdivisions"]),
    )


def _random_turns(streams: Streams, path: str, n: int) -> NDArray[np.float64]:
    """Rotations uniform over SO(3) (Shoemake 1992), as quaternions (x, y, z, w), [n, 4]."""
    u = _uniforms(streams, f"{path}/orientation", n, 3)
    a, b = 2.0 * elementary.PI * u[:, 1], 2.0 * elementary.PI * u[:, 2]
    p, q = np.sqrt(1.0 - u[:, 0]), np.sqrt(u[:, 0])
    return np.stack(
        [
            p * elementary.sin_array(a),
            p * elementary.cos_array(a),
            q * elementary.sin_array(b),
            q * elementary.cos_array(b),
        ],
        axis=1,
    )


def _spins(streams: Streams, path: str, n: int) -> NDArray[np.float64]:
    """Rotations about the vertical, as quaternions (x, y, z, w), [n, 4]."""
    half = elementary.PI * _uniforms(streams, f"{path}/orientation", n, 3)[:, 0]
    zero = np.zeros(n)
    return np.stack([zero, zero, elementary.sin_array(half), elementary.cos_array(half)], axis=1)
