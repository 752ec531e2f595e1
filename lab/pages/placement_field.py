"""For docs/placement.md: terrains with objects on them, and how they sit, measured anew."""

from __future__ import annotations

import json
import tempfile
import time
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from scenec.compiler.build import BuildLog, build_to
from scenec.compiler.cameras.rigs import build_rigs
from scenec.compiler.cfg.check_numbers import check_number, read_number
from scenec.compiler.cfg.load import load
from scenec.compiler.distributions.numbers import Distribution
from scenec.compiler.draw import draw
from scenec.compiler.kinds.schema import Field
from scenec.compiler.mesh.build import build_surface
from scenec.compiler.mesh.surface import Surface
from scenec.compiler.objects.build import build_objects
from scenec.compiler.plan import Plan
from scenec.compiler.scene.objects import Placed, Prototype, Scatter
from scenec.compiler.scene.rig import Rig
from scenec.schemas.quaternions import rotation_entries

#: Extent of the terrain where nothing else is said, meters.
SIZE = (40.0, 32.0)
PLANE = {"type": "plane"}
HILLS = {"type": "multifractal", "amplitude_m": 1, "scale_m": 8, "octaves": 5}


@dataclass(frozen=True)
class Stood:
    """Objects that were placed.

    Attributes:
        objects: Class by class.
        facts: What report.json would say of each.
        seconds: To draw and place all of them, shapes included.
        surface: The ground.
        plan: What was drawn.
        rigs: The camera.
    """

    objects: tuple[Scatter | Placed, ...]
    facts: dict[str, dict[str, Any]]
    seconds: float
    surface: Surface
    plan: Plan
    rigs: tuple[Rig, ...]


def cfg(
    objects: dict[str, dict[str, Any]],
    size_m: tuple[float, float] = SIZE,
    spacing_m: float = 0.4,
    relief: tuple[dict[str, Any], ...] = (PLANE, HILLS),
    **change: Any,
) -> dict[str, Any]:
    """A terrain with objects and one camera, which scales with it.

    Args:
        objects: Classes; what rocks need is filled in.
        size_m, spacing_m, relief: Of the terrain.
        change: Other top keys of the cfg.
    """
    unit = size_m[0] / SIZE[0]
    rocks = {"type": "rocks", "material": "stone", "prototypes": 3, "subdivisions": 2}
    return {
        "version": 1,
        "name": "placement",
        "labels": {},
        "outputs": ["rgb"],
        "terrain": {
            "size_m": list(size_m), "spacing_m": spacing_m, "relief": list(relief),
            "ground": [{"material": "soil"}],
        },
        "materials": {"soil": {"base_color": [0.3] * 3}, "stone": {"base_color": [0.2] * 3}},
        "objects": {
            name: one if one.get("type") == "placed" else rocks | one
            for name, one in objects.items()
        },
        "light": {},
        "rigs": {"eye": {
            "pose": {
                "type": "random_target",
                "position": {"x_m": 0, "y_m": -0.4 * size_m[1], "height_m": 1.5 * unit},
                "target": {"distance_m": 10 * unit, "bearing_deg": 0, "height_m": 0},
            },
            "sensors": {"eye": {"resolution": [640, 480], "fov_deg": 60}},
        }},
    } | change  # fmt: skip


def stand(content: dict[str, Any], folder: Path | None = None, seed: int = 4) -> Stood:
    """Places a cfg's objects, as ``scenec compile`` would.

    Args:
        content: The cfg.
        folder: Where its files are; None: it has none.
        seed: Of the cfg.

    Raises:
        ScenecError: It has faults, or cannot be built.
    """
    with tempfile.TemporaryDirectory() as own:
        path = (folder or Path(own)) / "placement.json"
        path.write_text(json.dumps(content))
        spec = load(path)
        log = BuildLog()
        start = time.perf_counter()
        plan = draw(spec, seed, 0)
        seconds = time.perf_counter() - start
        surface = build_to(build_surface, plan)["surface"]
        rigs, _ = build_rigs(plan.rigs, surface, None, {})
        start = time.perf_counter()
        given = {"surface": surface, "rigs": rigs}
        objects = build_to(build_objects, plan, log=log, **given)["objects"]
        seconds += time.perf_counter() - start
    return Stood(objects, log.facts["objects"], seconds, surface, plan, rigs)


def number(value: dict[str, Any]) -> Distribution:
    """A law of size.

    Raises:
        ValueError: It has a fault.
    """
    keywords: dict[str, Any] = {
        "x-per": "instance", "x-per-allowed": ["instance"], "exclusiveMinimum": 0, "maximum": 1e6,
    }  # fmt: skip
    faults = list(check_number(Field((), value, keywords, True)))
    if faults:
        raise ValueError(faults[0].message)
    read = read_number(value, keywords)
    assert isinstance(read, Distribution)
    return read


def gaps(
    surface: Surface,
    prototypes: tuple[Prototype, ...],
    prototype: NDArray,
    position: NDArray,
    orientation: NDArray,
    size: NDArray,
    embed: NDArray,
) -> NDArray[np.float64]:
    """How far each object is above the depth asked for, meters: all its vertices, all detail.

    Objects one by one over ``surface``; below 0 where one is too deep.
    """
    x, y, z, w = orientation.astype(np.float64).T
    entries = rotation_entries(x, y, z, w, 2.0 / (x * x + y * y + z * z + w * w))
    turns = np.stack(entries, axis=1).reshape(-1, 3, 3)
    points, starts, heights, total = [], [], [], 0
    for n in range(len(prototype)):
        turned = prototypes[prototype[n]].points.astype(np.float64) @ turns[n].T * float(size[n])
        points.append(turned + position[n].astype(np.float64))
        heights.append(np.ptp(turned[:, 2]))
        starts.append(total)
        total += len(turned)
    x, y, z = (np.ascontiguousarray(axis) for axis in np.concatenate(points).T)
    above = np.minimum.reduceat(z - surface.height_at(x, y), starts)
    return np.asarray(above + embed * np.array(heights))


def gaps_of(stood: Stood, most: int = 500) -> NDArray[np.float64]:
    """The same of the first class, of some of its objects."""
    scatter, plan = stood.objects[0], stood.plan.objects[0]
    assert isinstance(scatter, Scatter)
    if not scatter.count:
        return np.zeros(0)
    some = np.arange(0, scatter.count, -(-scatter.count // most))
    return gaps(
        stood.surface,
        scatter.prototypes,
        scatter.prototype[some],
        scatter.positions[some],
        scatter.orientations[some],
        scatter.scales[some, 0],
        plan.embed[scatter.ids[some] - 1],
    )
