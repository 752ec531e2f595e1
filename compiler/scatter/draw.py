"""What is drawn for a class of rocks: shapes once, sizes and turns for each."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from scenec.compiler.arithmetic import elementary
from scenec.compiler.frontend.numbers import draw_number
from scenec.compiler.frontend.resolve import resolve
from scenec.compiler.frontend.streams import Streams
from scenec.compiler.plan import RocksPlan
from scenec.compiler.scatter.placement import NoiseDensity, UniformDensity
from scenec.compiler.scatter.rocks import RockShape
from scenec.compiler.scene import Labels

_PLANES = 14
_NEAREST_PLANE = 0.55


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
    align = cfg["orientation"] == "normal"
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
            _random_turns(streams, path, n)
            if cfg["orientation"] == "random"
            else _spins(streams, path, n)
        ),
        align=align,
        size_m=draw_number(cfg["size_m"], streams, f"{path}/size_m", n),
        embed=draw_number(cfg["embed"], streams, f"{path}/embed", n),
        variation=2.0 * streams.uniforms(f"{path}/variation", n) - 1.0,
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


def _shape(path: str, cfg: dict[str, Any], streams: Streams) -> RockShape:
    u = _uniforms(streams, f"{path}/planes", _PLANES, 3)
    up = 2.0 * u[:, 0] - 1.0
    level = np.sqrt(np.maximum(1.0 - up * up, 0.0))
    bearing = 2.0 * elementary.PI * u[:, 1]
    normals = np.stack(
        [level * elementary.cos_array(bearing), level * elementary.sin_array(bearing), up], axis=1
    )
    middle, low = streams.uniforms(f"{path}/axes", 2)
    flat = cfg["flatness"]
    return RockShape(
        key=streams.key(path),
        plane_normals=normals,
        plane_distances=_NEAREST_PLANE + (1.0 - _NEAREST_PLANE) * u[:, 2],
        axes=(1.0, 1.0 - 0.6 * flat * middle, max(1.0 - flat * (0.7 + 0.6 * low), 0.05)),
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
