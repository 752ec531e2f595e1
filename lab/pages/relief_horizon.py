"""For docs/relief.md: what the mesh of the land beyond the border errs, and what it takes."""

from __future__ import annotations

import time
from dataclasses import replace

import numpy as np

from scenec.compiler.build import BuildLog, build, build_to
from scenec.compiler.cfg.load import load
from scenec.compiler.draw import draw
from scenec.compiler.mesh.build import build_land
from scenec.compiler.views.resolution import pixels_of_balls, views_of
from scenec.lab.runner import Page, table
from scenec.testing.small import small_cfg, write_cfg

#: Of each triangle, at random.
_POINTS = 16
_FAR = {
    "reach_m": 6000,
    "spacing_m": 30,
    "relief": [
        {"type": "plane"},
        {"type": "multifractal", "variant": "fbm", "amplitude_m": 9, "scale_m": 420, "gain": 0.42},
        {
            "type": "multifractal",
            "variant": "ridged",
            "amplitude_m": 300,
            "scale_m": 2500,
            "octaves": 9,
            "mask": [{"type": "point", "x_m": 0, "y_m": 0, "min_m": 1500, "softness_m": 2500}],
        },
    ],
    "material": "sand",
}


def horizon(page: Page) -> str:
    """Errors of the mesh, in pixels of what is seen, by tolerance."""
    cfg = small_cfg()
    cfg["terrain"]["horizon"] = _FAR
    for sensor in cfg["rigs"]["rover"]["sensors"].values():
        sensor |= {"resolution": [640, 480], "fov_deg": 60}
    plan = draw(load(write_cfg(page.scratch, cfg)), 1, 0)
    land = build_to(build_land, plan)["land"]
    rows = []
    for tolerance in (0.25, 0.5, 1.0, 2.0):
        meshing = replace(plan.terrain.meshing, tolerance_px=tolerance)
        asked = replace(plan, terrain=replace(plan.terrain, meshing=meshing))
        without = replace(asked, terrain=replace(asked.terrain, horizon=None))
        seconds = []
        for one in (without, asked):
            begun = time.process_time()
            scene = build(one, BuildLog())
            seconds.append(time.process_time() - begun)
        assert scene.ground.horizon is not None
        tile = scene.ground.horizon.tile
        shares = np.random.default_rng(1).dirichlet([1, 1, 1], (len(tile.faces), _POINTS))
        corners = tile.points.astype(float)[tile.faces]
        at = (shares[..., None] * corners[:, None]).sum(axis=2).reshape(-1, 3)
        # Within a cell of the border its roughness fades out, which the land does not have.
        at = at[land.distance_m(at[:, 0], at[:, 1]) > 1.0]
        error = np.abs(land.height_at(*np.ascontiguousarray(at[:, :2].T)) - at[:, 2])
        pixels = error * pixels_of_balls(views_of(scene.rigs), at, np.zeros(len(at)), 0.0, 1.0)
        seen = pixels[pixels > 0.0]
        share = (float(v) for v in np.percentile(seen, [50.0, 99.0, 99.9]))
        rows.append((tolerance, len(tile.faces), len(seen), *share, float(seen.max()),
                     seconds[1] - seconds[0]))  # fmt: skip
    header = ("tolerance, px", "triangles", "points", "median, px", "99 %", "99.9 %", "at most",
              "CPU s")  # fmt: skip
    return (
        "## Horizons: the error of their mesh\n\n"
        "`terrain.horizon` is land beyond the border: one mesh, coarser the farther it is, whose "
        "innermost vertices are those of the terrain's border, bit for bit. It keeps "
        "`terrain.mesh.tolerance_px` between rows and columns of its samples; the table has what "
        "it errs at random points of its triangles that a camera sees, against the land itself, "
        "of 6 km of hills in pictures of 640 by 480 pixels and 60°, and what it adds to compiling. "
        "What no camera sees may err eight times as much (`unseen`): it casts shadows alone.\n\n"
        + table(header, rows)
    )
