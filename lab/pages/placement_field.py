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
from scipy.spatial.transform import Rotation

from scenec.compiler.build import BuildLog, build_to
from scenec.compiler.cameras.rigs import build_rigs
from scenec.compiler.cfg.load import load
from scenec.compiler.draw import draw
from scenec.compiler.mesh.build import build_surface
from scenec.compiler.mesh.surface import GroundSurface
from scenec.compiler.objects.build import build_objects
from scenec.compiler.plan import Plan
from scenec.compiler.scene.objects import Placed, Scatter
from scenec.compiler.scene.rig import Rig

#: Extent of the terrain where nothing else is said, meters.
SIZE = (40.0, 32.0)
PLANE = {"type": "plane"}
HILLS = {"type": "multifractal", "amplitude_m": 1, "scale_m": 8, "octaves": 5}


@dataclass(frozen=True)
class PlacedObjects:
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
    surface: GroundSurface
    plan: Plan
    rigs: tuple[Rig, ...]

    @property
    def scatter(self) -> Scatter:
        """The first class, of rocks."""
        assert isinstance(self.objects[0], Scatter)
        return self.objects[0]


def place(
    objects: dict[str, dict[str, Any]],
    folder: Path | None = None,
    size_m: tuple[float, float] = SIZE,
    spacing_m: float = 0.4,
    relief: tuple[dict[str, Any], ...] = (PLANE, HILLS),
) -> PlacedObjects:
    """Places objects on a terrain with one camera, which scales with it, as a compilation would.

    Args:
        objects: Classes; what rocks need is filled in.
        folder: Where the cfg's files are; None: it has none.
        size_m, spacing_m, relief: Of the terrain.

    Raises:
        ScenecError: The cfg has faults, or cannot be built.
    """
    unit = size_m[0] / SIZE[0]
    rocks = {"type": "rocks", "material": "stone", "prototypes": 3, "subdivisions": 2}
    terrain = {"size_m": list(size_m), "spacing_m": spacing_m, "relief": list(relief)}
    pose = {
        "type": "random_target",
        "position": {"x_m": 0, "y_m": -0.4 * size_m[1], "height_m": 1.5 * unit},
        "target": {"distance_m": 10 * unit, "bearing_deg": 0, "height_m": 0},
    }
    sensors = {"eye": {"resolution": [640, 480], "fov_deg": 60}}
    content = {
        "version": 1, "name": "placement", "labels": {}, "outputs": ["rgb"], "light": {},
        "terrain": terrain | {"ground": [{"material": "soil"}]},
        "materials": {"soil": {"base_color": [0.3] * 3}, "stone": {"base_color": [0.2] * 3}},
        "objects": {name: one if one.get("type") == "placed" else rocks | one
                    for name, one in objects.items()},
        "rigs": {"eye": {"pose": pose, "sensors": sensors}},
    }  # fmt: skip
    with tempfile.TemporaryDirectory() as own:
        path = (folder or Path(own)) / "placement.json"
        path.write_text(json.dumps(content))
        spec, log = load(path), BuildLog()
        start = time.perf_counter()
        plan = draw(spec, 4, 0)
        seconds = time.perf_counter() - start
        surface = build_to(build_surface, plan)["surface"]
        rigs, _ = build_rigs(plan.rigs, surface, None, {})
        start = time.perf_counter()
        given = {"surface": surface, "rigs": rigs}
        made = build_to(build_objects, plan, log=log, **given)["objects"]
        seconds += time.perf_counter() - start
    return PlacedObjects(made, log.facts["objects"], seconds, surface, plan, rigs)


def gaps(placed: PlacedObjects, most: int = 500, z: NDArray | None = None) -> NDArray[np.float64]:
    """Measures how far rocks are above the depth asked for, meters: all vertices, all detail.

    Args:
        placed: Of its first class.
        most: Of so many of its objects.
        z: Heights of their middles, other than they have.
    """
    scatter, plan = placed.scatter, placed.plan.objects[0]
    if not scatter.count:
        return np.zeros(0)
    some = np.arange(0, scatter.count, -(-scatter.count // most))
    position = scatter.positions[some].astype(np.float64)
    if z is not None:
        position[:, 2] = z
    turns = Rotation.from_quat(scatter.orientations[some].astype(np.float64)).as_matrix()
    points, starts, heights, total = [], [], [], 0
    for k, n in enumerate(some):
        prototype = scatter.prototypes[scatter.prototype[n]].points.astype(np.float64)
        turned = prototype @ turns[k].T * float(scatter.scales[n, 0])
        points.append(turned + position[k])
        heights.append(np.ptp(turned[:, 2]))
        starts.append(total)
        total += len(turned)
    x, y, z = (np.ascontiguousarray(axis) for axis in np.concatenate(points).T)
    above = np.minimum.reduceat(z - placed.surface.height_at(x, y), starts)
    return np.asarray(above + plan.embed[scatter.ids[some] - 1] * np.array(heights))
