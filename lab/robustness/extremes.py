"""Scenes, objects, cameras, lights and steps at the ends of their ranges: one table.

    python lab/robustness/extremes.py [--only WORD,WORD,...] [--heavy] [-o FOLDER]

Each case runs in a process of its own: a cfg is compiled, its stage read, and a picture annotated
or drawn by Mitsuba, 16 samples a pixel. The error is that against a closed form, or what the row
says. What is refused is in the table with the line that a user reads.
"""

from __future__ import annotations

import json
import math
import re
import tempfile
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from scenec.backends.camera.rays import camera_rays
from scenec.backends.exact import ExactCaster
from scenec.backends.stage.read import read_stage
from scenec.backends.stage.scene import RenderScene
from scenec.compiler.compile import compile_cfg
from scenec.compiler.terrain.grid import Grid
from scenec.compiler.views.needed import Keep
from scenec.lab.robustness import extreme_dems, extreme_maps
from scenec.lab.runner import Cell, Page, apart, names, run
from scenec.schemas.errors import ScenecError
from scenec.testing.extreme_scenes import (
    DOWN,
    NORTH,
    SLOPE,
    Case,
    extreme_cfg,
    many_poses_cfg,
    true_rays,
)
from scenec.testing.sphere_views import seen_horizon, true_horizon

#: What is found: in words, and an error or None.
Found = tuple[str, float | None]
EYE: dict[str, Any] = {"resolution": [24, 18], "fov_deg": 60}


def _cfg(
    folder: Path, eye: tuple[float, float, float], sensor: dict[str, Any], turn: Any = DOWN
) -> dict[str, Any]:
    """A plane without stones, and a camera whose place is given over it, or below."""
    case = Case("one", "", eye, turn, sensor)
    cfg: dict[str, Any] = json.loads(extreme_cfg(folder, (case,), stones=0).read_text("utf-8"))
    cfg["rigs"]["one"]["allow_below"] = True
    return cfg


def _compiled(folder: Path, cfg: dict[str, Any], **how: Any) -> Path:
    file = folder / "extremes.json"
    file.write_text(json.dumps(cfg), encoding="utf-8")
    return compile_cfg(file, seed=1, out=folder / "out", **how).out / "batch_0000"


def _scene(folder: Path, cfg: dict[str, Any], **how: Any) -> RenderScene:
    return read_stage(_compiled(folder, cfg, **how) / "stage.usda")


def plane(
    folder: Path, eye: Any, sensor: Any = EYE, turn: Any = DOWN, size: Any = None, spacing: Any = 4
) -> Found:
    """Depth and footprint of a plane against the closed form."""
    cfg = _cfg(folder, eye, sensor, turn)
    if size is not None:
        cfg["terrain"] |= {"size_m": list(size), "spacing_m": spacing}
    width, height = cfg["terrain"]["size_m"]
    scene = _scene(folder, cfg)
    camera = scene.cameras[0][0]
    seen = ExactCaster(scene).cast(camera_rays(camera))[2].ravel()
    pose = camera.camera_to_world.astype(np.longdouble)
    d, o = (true_rays(camera)[:, None, :] * pose[None, :3, :3]).sum(axis=2), pose[:3, 3]
    s, r = (np.longdouble(slope) for slope in SLOPE)
    with np.errstate(divide="ignore", invalid="ignore"):
        t = (s * o[0] + r * o[1] - o[2]) / (d[:, 2] - s * d[:, 0] - r * d[:, 1])
        at = o + t[:, None] * d
        inside = (np.abs(at[:, 0]) <= width / 2) & (np.abs(at[:, 1]) <= height / 2)
    true, found = (t > 0) & inside, np.isfinite(seen)
    both = true & found
    error = float((np.abs(seen[both] - t[both]) / t[both]).max()) if both.any() else None
    wrong = int((true != found).sum())
    return f"{both.sum():,} pixels of ground, {wrong} wrong at its border", error


def sphere(folder: Path, radius: float, reach: float, up: float) -> Found:
    """Dip of the horizon from so far above smooth ground."""
    cfg = _cfg(folder, (0.0, 0.0, up), EYE)
    level = [{"type": "plane"}]
    cfg["terrain"] |= {"relief": level, "planet": {"radius_m": radius}, "mesh": {"tolerance_px": 0}}
    material = cfg["terrain"]["ground"][0]["material"]
    cfg["terrain"]["horizon"] = {"reach_m": reach, "relief": level, "material": material}
    cfg["objects"]["rocks"]["count"] = 0
    dip, away = seen_horizon(_scene(folder, cfg), up)
    dipped, expected = true_horizon(radius, up)
    off = f"{np.abs(away - expected).max():.2g} m of {expected:,.0f} m off"
    return f"horizon {off}; error of its dip", float(np.abs(dip / dipped - 1.0).max())


def rocks(folder: Path, count: int, **more: Any) -> Found:
    """Objects that stand in the stage, by number; their ids are 1 to n."""
    cfg = _cfg(folder, (0.0, 0.0, 2000.0), EYE)
    cfg["objects"]["rocks"] |= {"count": count, "subdivisions": 1, "lod_px": 0} | more
    scene = _scene(folder, cfg, keep=Keep.UNPRUNED)
    ids = np.unique(scene.rows.instance_id)
    ids = ids[ids > 0]
    return f"{len(ids):,} objects, ids to {int(ids.max(initial=0)):,}", float(abs(len(ids) - count))


def prototypes(folder: Path, count: int) -> Found:
    """Classes of 64 shapes each; those missing in the stage."""
    cfg = _cfg(folder, (0.0, 0.0, 2000.0), EYE)
    one = cfg["objects"].pop("rocks")
    one |= {"count": 640, "prototypes": 64, "subdivisions": 1, "lod_px": 0}
    for number in range(-(-count // 64)):
        cfg["objects"][f"rocks_{number}"] = one
    scene = _scene(folder, cfg, keep=Keep.UNPRUNED)
    wanted = 64 * len(cfg["objects"])
    return f"{len(scene.meshes):,} meshes for {wanted:,} shapes", None


def labels(folder: Path, levels: int, words: int) -> Found:
    """Values of all levels that differ from what the cfg says, over the ground alone."""
    from scenec.backends.annotation.annotate import annotate
    from scenec.backends.annotation.registry import select

    cfg = _cfg(folder, (0.0, 0.0, 20.0), EYE)
    rocks, cfg["objects"] = cfg["objects"]["rocks"], {}
    cfg["labels"] = {f"level_{i}": {"ground": 1} for i in range(levels)}
    cfg["terrain"]["ground"][0]["labels"] = dict.fromkeys(cfg["labels"], "ground")
    cfg["light"]["sky"]["labels"] = {}
    # A label is there for something: each has a class of its own, of one stone.
    rocks |= {"count": 1, "prototypes": 1, "subdivisions": 1, "size_m": 0.1}
    if words == 1:
        del cfg["materials"]["stone"]
    for number in range(2, words + 1):
        cfg["labels"]["level_0"][f"word_{number}"] = number
        cfg["objects"][f"rock_{number}"] = rocks | {"labels": {"level_0": f"word_{number}"}}
    scene = _scene(folder, cfg, keep=Keep.UNPRUNED)
    made = annotate(scene, ExactCaster(scene), scene.cameras[0][0], select(scene, ["label"]), 0)
    values = [each for each in made.arrays.values() if each.dtype.kind == "u"]
    wrong = sum(int((each != 1).sum()) for each in values[1 if words > 1 else 0 :])
    named = len(scene.label_names["level_0"])
    return f"{len(values):,} levels, {named:,} names of the first", float(wrong + words - named)


def samples(folder: Path, count: int) -> Found:
    """Off by how much the last pose is, of those that were asked for [m]."""
    made = compile_cfg(many_poses_cfg(folder, count), seed=1, out=folder / "out").out
    scene = read_stage(made / "batch_0000" / "stage.usda")
    asked = np.loadtxt(folder / "many.csv", delimiter=",")[:, 1:4]
    found = np.array([cameras[0].camera_to_world[:3, 3] for cameras in scene.cameras])
    return f"{len(found):,} poses", float(np.abs(found - asked).max())


def cameras(folder: Path, count: int) -> Found:
    """Of many cameras, how far the worst is from where the cfg has it [m]."""
    eyes = [Case(f"c{i}", "", (0.3 * i - 70, 0.1 * i, 3.0 + i), DOWN, EYE) for i in range(count)]
    extreme_cfg(folder, tuple(eyes), stones=300)
    cfg = json.loads((folder / "extremes.json").read_text("utf-8"))
    scene = _scene(folder, cfg)
    found = {c.name.removesuffix("_eye"): c.camera_to_world[:3, 3] for c in scene.cameras[0]}
    off = [
        found[e.name] - [e.eye[0], e.eye[1], SLOPE[0] * e.eye[0] + SLOPE[1] * e.eye[1] + e.eye[2]]
        for e in eyes
    ]
    return f"{len(found):,} cameras", float(np.abs(off).max())


def within(folder: Path, up: float) -> Found:
    """A camera in the middle of a boulder: what it sees."""
    cfg = _cfg(folder, (0.0, 0.0, up), EYE, NORTH)
    cfg["objects"]["rocks"] |= {
        "count": 1, "size_m": 60, "clearance_m": -1000, "lod_px": 0,
        "where": [{"type": "point", "x_m": 0, "y_m": 0, "max_m": 6}],
    }  # fmt: skip
    scene = _scene(folder, cfg)
    seen = ExactCaster(scene).cast(camera_rays(scene.cameras[0][0]))[2]
    far = float(seen[np.isfinite(seen)].max())
    return (
        f"{np.isfinite(seen).mean():.0%} of the picture is the rock's inside, to {far:.2g} m",
        None,
    )


def lit(
    folder: Path,
    light: dict[str, Any],
    material: dict[str, Any],
    truth: float,
    sensor: Any = EYE,
    spp: int = 16,
) -> Found:
    """Mean radiance of a level plane against a closed form, relative; absolute where that is 0."""
    from scenec.backends.run.render import render
    from scenec.schemas.frames import read_frame
    from scenec.schemas.units import LocalExecutor

    cfg = _cfg(folder, (0.0, 0.0, 20.0), sensor)
    cfg["terrain"]["relief"][0]["slope"] = [0, 0]
    cfg["light"], cfg["objects"] = {"sky": {"type": "none"}, **light}, {}
    cfg["labels"] = {"class": {"ground": 1}}
    cfg["terrain"]["ground"][0]["labels"] = {"class": "ground"}
    cfg["materials"] = {"sand": {"specular": 0} | material}
    batch = _compiled(folder, cfg)
    report = render(batch.parent, "mitsuba", passes=("rgb",), spp=spp, executor=LocalExecutor())
    rgb = read_frame(report.frames[0]).passes["rgb"]
    assert all(np.isfinite(row).all() for row in rgb)
    # Row by row: a sum of 800 million numbers in float32, or a copy in float64, is none.
    mean = float(np.mean([row.mean(dtype=np.float64) for row in rgb]))
    return f"{mean:.4g} W/(m² sr), {truth:.4g} asked", abs(mean - truth) / (truth or 1.0)


def diffusion(_: Path) -> Found:
    """A mode's decay against the exponential, over twelve decades of steps."""
    from scenec.compiler.terrain.operators.smooth import Diffusion

    n = 64
    grid, i = Grid((n - 1.0, n - 1.0), (n, n)), np.arange(n)
    mode = np.cos(np.pi * 3 * (i + 0.5) / n)[:, None] * np.cos(np.pi * 2 * (i + 0.5) / n)
    rate = sum(2.0 - 2.0 * math.cos(math.pi * k / n) for k in (3, 2))
    steps = [10.0**decade for decade in range(-6, 7)]
    off = [
        np.abs(Diffusion(step, 1.0).apply(grid, mode)[0] - mode * math.exp(-rate * step)).max()
        for step in steps
    ]
    return "a mode's decay, steps of 1e-6 to 1e6 Δx²/κ", float(max(off))


def rivers(_: Path, m: float, n: float) -> Found:
    """The slope-area law in the steady state, over ten decades of steps."""
    from scenec.compiler.terrain.operators.drainage import (
        SIDES,
        drain,
        drainage_area,
        outlet_samples,
    )
    from scenec.compiler.terrain.operators.stream_power import StreamPower

    grid, k, uplift = Grid((2000.0, 1500.0), (31, 41)), 1e-5, 1e-3
    dx = grid.spacing_m[0]
    noise = np.random.default_rng(2).normal(size=grid.shape)
    outlets = outlet_samples(grid.shape, SIDES)
    limit = dx / (k * drainage_area(drain(noise, outlets, dx, dx), dx * dx).max() ** m)
    operator = StreamPower(
        erodibility=k,
        area_exponent=m,
        slope_exponent=n,
        uplift_m_per_a=uplift,
        duration_a=1e9,
        steps=100,
    )
    steady = operator.apply(grid, noise)[0]
    worst = 0.0
    for decade in range(-2, 9):
        step = replace(operator, duration_a=40 * 10.0**decade * limit, steps=40)
        out = step.apply(grid, steady)[0]
        ways = drain(out, outlets, dx, dx)
        inner = ~outlets.ravel()
        slope = (out.ravel() - out.ravel()[ways.receiver])[inner] / ways.distance[inner]
        law = (uplift / (k * drainage_area(ways, dx * dx)[inner] ** m)) ** (1.0 / n)
        worst = max(worst, float(np.abs(slope / law - 1).max()))
    return "slopes by the slope-area law, steps of 0.01 to 1e8 explicit ones", worst


def hillslopes(_: Path) -> Found:
    """The parabola between two outlets, over ten decades of steps."""
    from scenec.compiler.terrain.operators.stream_power import StreamPower

    grid = Grid((200.0, 200.0), (41, 41))
    parabola = 0.01 * (100.0**2 - grid.x()[None, :] ** 2) + np.zeros(grid.shape)
    off = [
        np.abs(
            StreamPower(
                erodibility=0.0,
                diffusivity_m2_per_a=0.05,
                uplift_m_per_a=1e-3,
                duration_a=500 * 10.0**k,
                steps=1,
                outlets=("west", "east"),
            ).run(grid, parabola, 1)[0]
            - parabola
        ).max()
        for k in range(-5, 6)
    ]
    return "a parabola, D Δt/Δx² of 1e-5 to 1e5", float(max(off) / parabola.max())


def slides(_: Path) -> Found:
    """Cliffs that come to rest as ramps, over ten decades of drops; off by so much of the drop."""
    from scenec.compiler.terrain.operators.thermal import Thermal

    grid, slope = Grid((199.0, 199.0), (200, 200)), math.tan(math.radians(33.0))
    x = grid.x()[None, :] + np.zeros(grid.shape)
    worst = 0.0
    for drop in [10.0**decade for decade in range(-4, 7)]:
        out = Thermal(33.0).apply(grid, np.where(x < 0.0, drop, 0.0))[0]
        ramp = np.clip(0.5 * drop - slope * x, 0.0, drop)
        worst = max(worst, float(np.abs(out - ramp).max() / max(drop, slope)))
    return "cliffs of 1e-4 to 1e6 m as ramps of 33°, 1 m a sample", worst


def wear(_: Path) -> Found:
    """Craters' wear against the heat kernel of the plane, over six decades of its time."""
    from scipy.special import i0e

    from scenec.compiler.terrain.operators.crater_profile import fresh, profile_table

    count = 240_000
    at = (np.arange(count) + 0.5) * 12.0 / count
    worst = 0.0
    for largest in (1e-6, 1e-5, 1e-4, 1e-3, 0.03, 0.3, 2.0):
        made = profile_table(largest)
        state, x = made.states[-1], (np.arange(made.rim.shape[1]) + 0.5) * made.step
        for shape, table in zip(fresh(at), (made.rim, made.depth), strict=True):
            for i in range(3, 400, 36):
                kernel = np.exp(-((x[i] - at) ** 2) / (4 * state)) * i0e(x[i] * at / (2 * state))
                exact = (shape * at * kernel).sum() * 12.0 / count / (2 * state)
                worst = max(worst, abs(float(table[-1, i] - exact)))
    return "craters' profiles, κt of 1e-6 to 2 radii²", worst


def half_disc(elevation_deg: float, diameter_deg: float) -> float:
    """Irradiance of level ground over that of a surface which faces the sun, by quadrature."""
    e, a = math.radians(elevation_deg), math.radians(diameter_deg / 2)
    n = 2000
    # Directions of equal solid angle about the sun's middle.
    z = 1.0 - (1.0 - math.cos(a)) * (np.arange(n) + 0.5) / n
    turn = 2 * np.pi * (np.arange(n) + 0.5) / n
    up = math.sin(e) * z[:, None] + math.cos(e) * np.sqrt(1 - z * z)[:, None] * np.cos(turn)
    solid = 2 * math.pi * (1 - math.cos(a))
    return float(np.maximum(up, 0).mean()) * solid / (math.pi * math.sin(a) ** 2)


@dataclass(frozen=True)
class Row:
    """A case.

    Attributes:
        what: In words, the first of which names its group.
        work: Takes a folder.
        promise: What is promised.
        heavy: Whether it takes minutes or gigabytes.
    """

    what: str
    work: Callable[[Path], Found]
    promise: str
    heavy: bool = False


def rows() -> list[Row]:
    """All of them."""
    exact = "1e-7 of the depth, or refused"
    found = []
    for size in (1e-6, 1e-3, 1.0, 1e3, 1e6, 1e7):
        eye = (0.0, 0.0, 0.1 * size)
        work = partial(plane, eye=eye, size=(size, size), spacing=size / 64)
        step = "1e-6 of the depth: float32's step in a tile" if size > 1e6 else exact
        found.append(Row(f"scene: {size:g} m", work, step))
    found += [
        Row(f"scene: {height:g} m up", partial(high, height=height), exact)
        for height in (1e3, 1e6, 1e9)
    ]
    for what, size, spacing in (
        ("20 m × 1,000 km, every 5 m", (20.0, 1e6), 5.0),
        ("20 m × 20 m, spacing of 1,000 m", (20.0, 20.0), 1000.0),
        ("20 m × 20 m, every 1 cm", (20.0, 20.0), 0.01),
    ):
        work = partial(plane, eye=(0.0, 0.0, 5.0), size=size, spacing=spacing)
        found.append(Row(f"scene: {what}", work, exact))
    for what, radius, reach, up in (
        ("1.7 m above the Moon", 1_737_400.0, 6e3, 1.7),
        ("10 km above the Moon", 1_737_400.0, 3e5, 1e4),
        ("1.7 m above the Earth", 6_371_008.4, 1e4, 1.7),
        ("100 m above a sphere of 1 km, to 928 m", 1e3, 400.0, 100.0),
        ("1.7 m above a sphere of a million km", 1e9, 1e5, 1.7),
        ("beyond a sphere of 1 km", 1e3, 500.0, 100.0),
    ):
        work = partial(sphere, radius=radius, reach=reach, up=up)
        found.append(Row(f"planet: {what}", work, "1e-4 of the dip, or refused"))
    for count in (0, 1, 1_000_000, 10_000_000):
        work = partial(rocks, count=count)
        found.append(Row(f"objects: {count:,}", work, "all, or refused", count > 1_000_000))
    ratio = {"size_m": {"type": "log_uniform", "min": 1e-4, "max": 100}}
    found += [
        Row("objects: 0.1 mm to 100 m", partial(rocks, count=10_000, **ratio), "all"),
        Row("objects: 10,000 prototypes", partial(prototypes, count=10_000), "all"),
        Row("labels: 5,000 of a level", partial(labels, levels=2, words=5000), "exact"),
        Row("labels: 100 levels", partial(labels, levels=100, words=1), "exact"),
        Row("samples: 10,000", partial(samples, count=10_000), "1e-12 m"),
        Row("cameras: 500", partial(cameras, count=500), "1e-12 m"),
    ]
    for width, height in ((1, 1), (16384, 1), (16384, 64)):
        sensor = {"resolution": [width, height], "fov_deg": 60}
        work = partial(plane, eye=(3.0, 4.0, 20.0), sensor=sensor)
        found.append(Row(f"picture: {width:,} × {height}", work, "relative 1e-12"))
    for fov in (1e-4, 1e-2, 179.0, 179.99):
        sensor = EYE | {"fov_deg": fov}
        work = partial(plane, eye=(3.0, 4.0, 20.0), sensor=sensor)
        found.append(Row(f"view: {fov:g}° wide", work, exact))
    for up in (1e-9, 1e-3, 1e5, 1e7):
        sensor = EYE | {"fov_deg": min(60.0, math.degrees(1000 / up))}
        work = partial(plane, eye=(3.0, 4.0, up), sensor=sensor)
        found.append(Row(f"view: {up:g} m above the ground", work, exact))
    found += [
        Row("view: under the ground, looking up",
            partial(plane, eye=(3.0, 4.0, -5.0), turn=(1.0, 0.0, 0.0, 0.0)), "as from above"),
        Row("view: over a corner of the mesh",
            partial(plane, eye=(0.0, 0.0, 20.0), sensor=EYE | {"resolution": [25, 19]}), exact),
        Row("view: inside of a rock", partial(within, up=2.0), "its inside, or refused"),
    ]  # fmt: skip
    white, black = {"base_color": [1, 1, 1]}, {"base_color": [0, 0, 0]}
    promised = "noise of 16 samples"

    def sun(elevation: float, diameter: float = 0.53) -> dict[str, Any]:
        of = {"elevation_deg": elevation, "diameter_deg": diameter, "irradiance": 1000}
        return {"sun": of | {"azimuth_deg": 0, "color": [1, 1, 1]}}

    for elevation in (-90, -1, 1, 45, 90):
        truth = 1000 / math.pi * max(0.0, half_disc(elevation, 0.53))
        work = partial(lit, light=sun(elevation), material=white, truth=truth)
        found.append(Row(f"light: sun {elevation}° high", work, promised))
    for elevation in (-10, 0, 90):
        truth = 1000 / math.pi * half_disc(elevation, 40)
        work = partial(lit, light=sun(elevation, 40), material=white, truth=truth)
        found.append(Row(f"light: sun 40° wide, {elevation}° high", work, promised))
    for height in (1024, 4096, 16384):
        sensor, truth = EYE | {"resolution": [16384, height]}, 1000 / math.pi * half_disc(45, 0.53)
        work = partial(lit, light=sun(45), material=white, truth=truth, sensor=sensor, spp=1)
        what = f"radiance: 16,384 × {height:,} pixels, 1 sample"
        found.append(Row(what, work, "noise of 1 sample", height > 1024))
    mirror = white | {"specular": 1, "roughness": 0}
    found += [
        Row("light: black ground", partial(lit, light=sun(90), material=black, truth=0.0), "0"),
        Row("light: a mirror under a black sky",
            partial(lit, light=sun(45), material=mirror, truth=0.0), "0 but for the sun's image"),
        Row("steps: smooth, diffusion", diffusion, "rounding"),
        Row("steps: stream_power, n = 1", partial(rivers, m=0.5, n=1.0), "rounding"),
        Row("steps: stream_power, n = 1.3", partial(rivers, m=0.4, n=1.3), "rounding"),
        Row("steps: hillslopes", hillslopes, "rounding"),
        Row("steps: wear of craters", wear, "3e-4 of the depth"),
        Row("steps: thermal", slides, "within a sample at a ramp's ends"),
    ]  # fmt: skip
    return found + [Row(*case) for case in (*extreme_dems.cases(), *extreme_maps.cases())]


def high(folder: Path, height: float) -> Found:
    """How far the vertices of a plane far up are off it, relative."""
    cfg = _cfg(folder, (0.0, 0.0, height + 20.0), EYE)
    cfg["terrain"]["relief"][0]["height_m"] = height
    scene = _scene(folder, cfg)
    off = 0.0
    for mesh, matrix in zip(scene.rows.mesh, scene.rows.to_world, strict=True):
        x, y, z = (scene.meshes[mesh].points @ matrix[:, :3].T + matrix[:, 3]).T
        off = max(off, float(np.abs(z - height - SLOPE[0] * x - SLOPE[1] * y).max()))
    return f"vertices within {off:.1g} m of the plane", off / height


def _tried(work: Callable[[Path], Found], folder: Path) -> Found:
    try:
        return work(folder)
    except ScenecError as error:
        line = str(error).splitlines()[0].replace(str(folder) + "/", "").replace("|", "\\|")
        line = re.sub(r"\S*extremes\.json(:\d+)*: ", "", line)
        return f"refused: {line[:80]}…", None


def merged(table: list[list[Any]]) -> Iterator[list[Cell]]:
    """Makes one row, of the worst error, of the cases of a group that promise the same."""
    groups: dict[tuple[str, ...], list[list[Any]]] = {}
    for row in table:
        refused = row[1] if row[1].startswith("refused") else ""
        groups.setdefault((row[0].partition(":")[0], row[-1], refused), []).append(row)
    for (group, promise, _), of in groups.items():
        cases = "; ".join(row[0].partition(": ")[2] for row in of)
        worst = max(reversed(of), key=lambda row: row[2] or 0.0)
        error = None if worst[2] is None else f"{worst[2]:.1e}"
        seconds = max(row[3] for row in of)
        yield [f"{group}: {cases}", worst[1], error, seconds, promise]


def main(page: Page) -> None:
    """Prints a row a case, as soon as it is there; refreshes a row a group."""
    wanted = page.options.only
    table: list[list[Any]] = []
    for row in rows():
        if (wanted and row.what.partition(":")[0] not in wanted) or (
            row.heavy and not page.options.heavy
        ):
            continue
        with tempfile.TemporaryDirectory(dir=page.scratch) as folder:
            cost = apart(_tried, row.work, Path(folder))
        words, error = cost.value
        table.append([row.what, words, error, cost.cpu_s, cost.peak_mib, row.promise])
        print(table[-1], flush=True)
    if page.whole:
        page.value("tried", str(len(table)))
        header = ["case", "outcome", "error", "CPU s", "promised"]
        page.block("extremes", header, merged(table))
        page.refresh(("numpy", "mitsuba"), ())


if __name__ == "__main__":
    run(main, page="robustness", only=names, heavy=False)
