"""Cameras at their limits over a plane, whose depth has a closed form; for tests and a page.

The ground is z = x / 16 - y / 32 over 512 m x 512 m: its vertices lie on multiples of 4 m, so
float32 holds them exactly and the mesh is the plane itself. Stones lie on it.
"""

from __future__ import annotations

import json
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from scenec.backends.stage.scene import Camera
from scenec.schemas.lens import EQUIRECTANGULAR, KANNALA_BRANDT
from scenec.testing.small import small_cfg

SIDE = 512.0
SLOPE = (1.0 / 16.0, -1.0 / 32.0)
GROUND = 2

#: Camera axes (x right, y down, z forward) as quaternions w, x, y, z.
_HALF = float(np.sqrt(0.5))
DOWN = (0.0, 1.0, 0.0, 0.0)
UP = (1.0, 0.0, 0.0, 0.0)
NORTH = (_HALF, -_HALF, 0.0, 0.0)


@dataclass(frozen=True)
class Case:
    """A camera.

    Attributes:
        name: Of its rig.
        what: In words.
        eye: Where it is: x, y and meters above the plane.
        turn: Quaternion w, x, y, z of its axes.
        sensor: As in a cfg.
        limits: What a backend cannot do: name -> a part of the line in which it says so.
    """

    name: str
    what: str
    eye: tuple[float, float, float]
    turn: tuple[float, float, float, float]
    sensor: dict[str, Any]
    limits: dict[str, str] = field(default_factory=dict)


def _k(
    size: tuple[int, int], fx: float, fy: float, cx: float, cy: float, skew: float = 0.0
) -> dict[str, Any]:
    numbers = {"fx": fx, "fy": fy, "cx": cx, "cy": cy, "skew": skew}
    return {"resolution": list(size), "intrinsics": numbers}


def _pitched(degrees: float) -> tuple[float, float, float, float]:
    """To the north and down."""
    half = np.radians(0.5 * (90.0 + degrees))
    return float(np.cos(half)), -float(np.sin(half)), 0.0, 0.0


def _fov(size: tuple[int, int], degrees: float, **more: Any) -> dict[str, Any]:
    return {"resolution": list(size), "fov_deg": degrees, **more}


_SMALL = (48, 36)
_FISHEYE = {"type": "kannala_brandt", "max_angle_deg": 110}
CASES = (
    Case("down", "straight down, 20 m up", (3, 4, 20), DOWN, _fov(_SMALL, 60)),
    Case("up", "straight up", (3, 4, 2), UP, _fov(_SMALL, 60)),
    Case("low", "1 cm above ground, level", (3, 4, 0.01), NORTH, _fov(_SMALL, 60)),
    Case("low_down", "1 cm above ground, straight down", (3, 4, 0.01), DOWN, _fov(_SMALL, 60)),
    Case("far", "100 km above, all of the terrain in half of the picture", (0.3, 0.2, 1e5), DOWN,
         _fov(_SMALL, 0.6)),
    Case("narrow", "0.1° of view, 150 m up, level distance 240 m", (0, -240, 150),
         _pitched(33.275), _fov(_SMALL, 0.1)),
    Case("wide", "179° of view, straight down, 5 m up", (3, 4, 5), DOWN, _fov(_SMALL, 179)),
    Case("wide_level", "179° of view, level, 5 m up", (3, 4, 5), NORTH, _fov(_SMALL, 179)),
    Case("pixel", "1 × 1 pixel", (3, 4, 20), DOWN, _fov((1, 1), 60)),
    Case("column", "1 × 48 pixels", (3, 4, 20), DOWN, _k((1, 48), 40, 40, 0.5, 24)),
    Case("line", "20,000 × 1 pixels", (3, 4, 20), DOWN, _fov((20000, 1), 60)),
    Case("tower", "1 × 20,000 pixels", (3, 4, 20), DOWN, _k((1, 20000), 15000, 15000, 0.5, 10000)),
    Case("aside", "principal point six pictures beside the picture", (3, 4, 20), DOWN,
         _k(_SMALL, 300, 300, -250, 220)),
    Case("skewed", "skew as large as the focal length", (3, 4, 20), DOWN,
         _k(_SMALL, 40, 40, 24, 18, 40), {"cycles": "a skew of 40"}),
    Case("flat", "pixels 150 times as long as wide", (3, 4, 20), DOWN,
         _k(_SMALL, 6000, 40, 24, 18)),
    Case("flatter", "pixels 1,000 times as long as wide", (3, 4, 20), DOWN,
         _k(_SMALL, 40000, 40, 24, 18), {"cycles": "fx / fy = 1000"}),
    Case("sphere", "equirectangular, 360° × 180°", (3, 4, 5), NORTH,
         {"resolution": [48, 24], "lens": {"type": "equirectangular"}}),
    Case("fisheye", "fisheye, 220°, straight down", (3, 4, 5), DOWN,
         _fov((48, 48), 220, lens=_FISHEYE)),
)  # fmt: skip


def extreme_cfg(folder: Path, cases: tuple[Case, ...] = CASES, stones: int = 3000) -> Path:
    """Writes a cfg with a rig a case, and their tracks, into a folder; returns its path."""
    cfg = small_cfg(samples=1, outputs=["rgb", "label", "instance", "depth", "range"])
    cfg["name"] = "extremes"
    cfg["terrain"] = {
        "size_m": [SIDE, SIDE],
        "spacing_m": 4,
        "relief": [{"type": "plane", "slope": list(SLOPE)}],
        "ground": [{"material": "sand", "labels": {"class": "ground", "surface": "sand"}}],
    }
    for level, unused in (("surface", "gravel"), ("surface", "mud")):
        del cfg["labels"][level][unused], cfg["materials"][unused]
    rocks = cfg["objects"]["rocks"]
    rocks |= {"count": stones, "size_m": {"type": "log_uniform", "min": 0.3, "max": 4}}
    del rocks["density"]
    cfg["light"]["sun"] = {"elevation_deg": 50, "azimuth_deg": 130}
    cfg["rigs"] = {}
    for case in cases:
        x, y, up = case.eye
        z = SLOPE[0] * x + SLOPE[1] * y + up
        row = ",".join(repr(float(v)) for v in (0.0, x, y, z, *case.turn))
        (folder / f"{case.name}.csv").write_text(row + "\n", encoding="utf-8")
        cfg["rigs"][case.name] = {
            "pose": {"type": "track", "file": f"{case.name}.csv"},
            "sensors": {"eye": case.sensor},
        }
    path = folder / "extremes.json"
    path.write_text(json.dumps(cfg, indent=1), encoding="utf-8")
    return path


def true_rays(camera: Camera) -> NDArray[np.longdouble]:
    """Rays through pixel centers, camera axes, by the lens's formula: [h * w, 3], NaN for none."""
    k = camera.intrinsics.astype(np.longdouble)
    v, u = np.meshgrid(
        np.arange(camera.height, dtype=np.longdouble) + 0.5,
        np.arange(camera.width, dtype=np.longdouble) + 0.5,
        indexing="ij",
    )
    b = (v.ravel() - k[1, 2]) / k[1, 1]
    a = (u.ravel() - k[0, 2] - k[0, 1] * b) / k[0, 0]
    lens = camera.lens
    if lens is None:
        return np.stack([a, b, np.ones_like(a)], axis=1)
    if lens.model == EQUIRECTANGULAR:
        rays = np.stack([np.sin(a) * np.cos(b), np.sin(b), np.cos(a) * np.cos(b)], axis=1)
        return rays
    assert lens.model == KANNALA_BRANDT
    assert not any(lens.coefficients)
    angle = np.hypot(a, b)
    rays = np.stack([a * np.sinc(angle / np.pi), b * np.sinc(angle / np.pi), np.cos(angle)], 1)
    rays[angle > lens.max_angle] = np.nan
    return rays


def true_plane(camera: Camera) -> tuple[NDArray[np.bool_], NDArray[np.longdouble]]:
    """Which pixels show the plane where no stone is, and at which ray parameter, both [h, w].

    The parameter is planar depth for a pinhole, distance for the lenses. o + t d lies on
    z = s x + r y where t = (s o_x + r o_y - o_z) / (d_z - s d_x - r d_y).
    """
    pose = camera.camera_to_world.astype(np.longdouble)
    d = (true_rays(camera)[:, None, :] * pose[None, :3, :3]).sum(axis=2)
    o = pose[:3, 3]
    s, r = (np.longdouble(slope) for slope in SLOPE)
    with np.errstate(divide="ignore", invalid="ignore"):
        t = (s * o[0] + r * o[1] - o[2]) / (d[:, 2] - s * d[:, 0] - r * d[:, 1])
        at = o + t[:, None] * d
        hit = (t > 0) & (np.abs(at[:, :2]) <= SIDE / 2).all(axis=1)
    shape = (camera.height, camera.width)
    return hit.reshape(shape), np.where(hit, t, np.inf).reshape(shape)


def many_poses_cfg(folder: Path, count: int) -> Path:
    """Writes a cfg of as many samples, along a straight track 10 m up; returns its path."""
    along = np.linspace(-200.0, 200.0, count)
    rows = np.zeros((count, 8))
    rows[:, 0], rows[:, 1], rows[:, 3] = np.arange(count) * 0.01, along, SLOPE[0] * along + 10.0
    rows[:, 4:] = DOWN
    np.savetxt(folder / "many.csv", rows, delimiter=",", fmt="%.17g")
    cfg = json.loads(extreme_cfg(folder, (), stones=100).read_text(encoding="utf-8"))
    cfg |= {"samples": count, "outputs": ["label", "depth"]}
    sensor = {"resolution": [16, 12], "fov_deg": 60}
    pose = {"type": "track", "file": "many.csv"}
    cfg["rigs"] = {"many": {"pose": pose, "sensors": {"eye": sensor}}}
    path = folder / "many.json"
    path.write_text(json.dumps(cfg), encoding="utf-8")
    return path


NEAR_AND_FAR = """#usda 1.0
(
    metersPerUnit = 1
    upAxis = "Z"
    defaultPrim = "World"
)

def Xform "World"
{
    def Camera "Eye"
    {
        float focalLength = 1
        float horizontalAperture = 2
        float verticalAperture = 1.5
        float2 clippingRange = (0.001, 1e8)
    }

    def Mesh "Near"
    {
        uniform token subdivisionScheme = "none"
        int[] faceVertexCounts = [4]
        int[] faceVertexIndices = [0, 1, 2, 3]
        point3f[] points = [(-1, -1, -0.01), (0, -1, -0.01), (0, 1, -0.01), (-1, 1, -0.01)]
    }

    def Mesh "Far"
    {
        uniform token subdivisionScheme = "none"
        int[] faceVertexCounts = [4]
        int[] faceVertexIndices = [0, 1, 2, 3]
        point3f[] points = [
            (-1e8, -1e8, -1e7), (1e8, -1e8, -1e7), (1e8, 1e8, -1e7), (-1e8, 1e8, -1e7)
        ]
    }
}
"""


def near_and_far_stage(folder: Path) -> Path:
    """Writes a USD file: a sheet 1 cm before a camera hides half of one 10,000 km away."""
    path = folder / "near_and_far.usda"
    path.write_text(NEAR_AND_FAR, encoding="utf-8")
    return path
