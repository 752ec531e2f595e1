"""Frames on disk of a scene with a formula, for tests of formats that hold poses and depth.

A tilted plane and ellipsoids, met by rays in closed form: no renderer, and so an oracle. Cameras on
a rig drive past; whatever a format's reader says of poses, intrinsics and depth must put pixels
back on these surfaces.
"""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from scenec.schemas import rle
from scenec.schemas.amodal import Amodal, amodal_path, write_amodal
from scenec.schemas.exr import write_exr
from scenec.schemas.files import sha256, write_json
from scenec.schemas.frames import frame_stem
from scenec.schemas.imu import Imu, ImuNoise, RigState
from scenec.schemas.instances import (
    BATCH_TABLE,
    FRAME_COLUMNS,
    InstanceTable,
    frame_table_path,
    write_frame_table,
    write_table,
)
from scenec.schemas.manifest import read_manifest, stage_digest
from scenec.schemas.picture import develop, write_png

LABELS = {"class": {1: "sky", 2: "ground", 3: "rock", 4: "lander"}}
_NORMAL = np.array([0.1, -0.05, 1.0]) / np.linalg.norm([0.1, -0.05, 1.0])


@dataclass(frozen=True)
class Ellipsoid:
    """x = R (scale * m) + position, for m with |m / half| = 1."""

    number: int
    kind: str
    position: tuple[float, float, float]
    turn: tuple[float, float, float]
    half: tuple[float, float, float]
    scale: tuple[float, float, float]

    @property
    def rotation(self) -> NDArray[np.float64]:
        """R."""
        return Rotation.from_euler("xyz", self.turn, degrees=True).as_matrix()

    def model(self, points: NDArray[np.float64]) -> NDArray[np.float64]:
        """World points in the model's frame, along its half axes: 1 long on the surface."""
        local = (points - np.array(self.position)) @ self.rotation
        return local / (np.array(self.scale) * self.half)


_LANDER, _ROCKS = "/World/Objects/lander", "/World/Objects/rocks"
THINGS = (
    Ellipsoid(2, _LANDER, (0.4, 4.0, 0.3), (10, 20, 30), (0.9, 0.6, 0.4), (1, 1, 1)),
    Ellipsoid(5, _ROCKS, (-1.2, 3.2, 0.2), (40, 0, 70), (1, 0.7, 0.5), (0.5, 0.5, 0.5)),
    Ellipsoid(6, _ROCKS, (0.1, 5.6, 0.4), (0, 50, 20), (1, 0.7, 0.5), (0.9, 0.9, 0.9)),
    Ellipsoid(9, _ROCKS, (2.2, 4.5, 0.1), (5, 5, 5), (1, 0.7, 0.5), (0.3, 0.4, 0.5)),
)


@dataclass(frozen=True)
class Sensor:
    """A camera: name, prim, offset from the rig in the rig's own axes, turn about its y axis."""

    name: str
    prim: str
    offset: tuple[float, float, float] = (0.0, 0.0, 0.0)
    yaw_deg: float = 0.0
    size: tuple[int, int] = (64, 48)
    focal: float = 50.0


LEFT = Sensor("rover_left", "/World/Rigs/rover/left")
RIGHT = Sensor("rover_right", "/World/Rigs/rover/right", (0.25, 0.0, 0.0))
SIDE = Sensor("rover_side", "/World/Rigs/rover/side", (0.1, 0.05, -0.2), 25.0, (40, 30), 30.0)


def rig_pose(sample: int) -> NDArray[np.float64]:
    """Rig to world, [4, 4]: drives along x, pitches and rolls a little."""
    turn = Rotation.from_euler("XYZ", [-100.0 + 2.0 * sample, 3.0 * sample, 4.0], degrees=True)
    pose = np.eye(4)
    pose[:3, :3] = turn.as_matrix()
    pose[:3, 3] = 0.15 * sample - 0.3, 0.05 * sample**2, 1.2 + 0.02 * sample
    return pose


def camera_pose(sensor: Sensor, sample: int) -> NDArray[np.float64]:
    """Camera to world, [4, 4]."""
    mount = np.eye(4)
    mount[:3, :3] = Rotation.from_euler("y", sensor.yaw_deg, degrees=True).as_matrix()
    mount[:3, 3] = sensor.offset
    return rig_pose(sample) @ mount


def made_rigs(samples: int = 4) -> tuple[RigState, ...]:
    """The rig as its stage would have it: with the mounts of three cameras, and two IMUs."""
    time = 0.1 * np.arange(samples, dtype=np.float64)
    to_world = np.stack([rig_pose(k) for k in range(samples)])
    to_rig = np.eye(4)
    to_rig[:3, :3] = Rotation.from_euler("xyz", [80, -10, 35], degrees=True).as_matrix()
    to_rig[:3, 3] = 0.3, -0.1, 0.2
    body = to_world @ to_rig
    turn: NDArray[np.float64] = np.roll(
        Rotation.from_matrix(body[:, :3, :3]).as_quat(), 1, axis=1
    ).astype(np.float64)
    values = np.random.default_rng(3).normal(size=(7, samples, 3))
    noise = ImuNoise(1e-4, 0.5, 2e-5, 3e-3, 0.6, 4e-4)
    imu = Imu("unit", to_rig, 10.0, 3.71, noise, time, body[:, :3, 3], turn, *values)
    mounts = {
        one.prim: np.linalg.inv(to_world[0]) @ camera_pose(one, 0) for one in (LEFT, RIGHT, SIDE)
    }
    return (
        RigState(
            "rover", time, to_world, mounts, (imu, replace(imu, name="more", to_rig=np.eye(4)))
        ),
    )


def camera_matrix(sensor: Sensor) -> NDArray[np.float64]:
    """K of the frame contract: the top-left pixel's center is (0.5, 0.5)."""
    w, h = sensor.size
    return np.array(
        [[sensor.focal, 0, w / 2 + 1.3], [0, sensor.focal * 1.1, h / 2 - 0.7], [0, 0, 1]]
    )


def _hits(origin: NDArray, rays: NDArray, thing: Ellipsoid) -> NDArray:
    size = np.array(thing.scale) * thing.half
    o, d = (origin - thing.position) @ thing.rotation / size, rays @ thing.rotation / size
    a, b, c = (d * d).sum(-1), (d * o).sum(-1), (o * o).sum(-1) - 1.0
    root = b * b - a * c
    t = (-b - np.sqrt(np.maximum(root, 0.0))) / a
    return np.where((root >= 0.0) & (t > 0.0), t, np.inf)


def _rays(sensor: Sensor, pose: NDArray, margin: int = 0) -> NDArray:
    w, h = sensor.size
    k = camera_matrix(sensor)
    v, u = np.mgrid[-margin * h : h + margin * h, -margin * w : w + margin * w] + 0.5
    rays = np.stack([(u - k[0, 2]) / k[0, 0], (v - k[1, 2]) / k[1, 1], np.ones_like(u)], -1)
    return rays @ pose[:3, :3].T


def off_surface(points: NDArray) -> NDArray:
    """How far points are from the nearest surface, meters (to first order)."""
    found = [np.abs(points @ _NORMAL)]
    for thing in THINGS:
        q = thing.model(points)
        size = np.array(thing.scale) * thing.half
        slope = np.linalg.norm(q / size, axis=-1) / np.maximum(np.linalg.norm(q, axis=-1), 1e-9)
        found.append(np.abs(np.linalg.norm(q, axis=-1) - 1.0) / np.maximum(slope, 1e-9))
    return np.min(found, axis=0)


@dataclass
class Made:
    """What is on disk."""

    out: Path
    sensors: tuple[Sensor, ...]
    samples: int
    passes: dict[tuple[str, int], dict[str, NDArray]] = field(default_factory=dict)


def make_out(
    out: Path,
    sensors: Sequence[Sensor] = (LEFT, RIGHT),
    samples: int = 4,
    batches: int = 1,
    times: Sequence[float] | None = None,
    without: Sequence[str] = (),
    amodal: bool = True,
    ids: Mapping[int, int] | None = None,
    empty: bool = False,
) -> Made:
    """An output folder as ``compile`` and ``render`` leave it.

    Args:
        out: The folder.
        sensors: Cameras.
        samples: Frames of each.
        batches: How many, all alike.
        times: Of the samples, seconds; default 0.1 s apart.
        without: Passes to leave out.
        amodal: Whether there are amodal masks.
        ids: Other frame ids for those of ``THINGS``.
        empty: Nothing but sky.
    """
    made = Made(out, tuple(sensors), samples)
    manifest: dict[str, Any] = {
        "name": "made", "format": 1, "seed": 1, "scenec": "0", "libraries": {},
        "cfg": {"sha256": "0" * 64, "inputs": {}}, "batches": [], "files": {},
    }  # fmt: skip
    for index in range(batches):
        name = f"batch_{index:04d}"
        manifest["batches"].append(
            {"index": index, "path": name, "stage": f"{name}/stage.usda", "samples": samples}
        )
        manifest["files"][f"{name}/stage.usda"] = {"sha256": f"{index:064d}"}
    write_json(out / "manifest.json", manifest)
    renamed = {thing.number: thing.number for thing in THINGS} | dict(ids or {})
    things = [replace(thing, number=renamed[thing.number]) for thing in THINGS]
    things.sort(key=lambda thing: thing.number)
    for index in range(batches):
        name = f"batch_{index:04d}"
        digest = stage_digest(read_manifest(out), name)
        write_table(out / name / "frames" / BATCH_TABLE, _table(digest, things))
        for sensor in sensors:
            for sample in range(samples):
                stem = frame_stem(out / name, "mitsuba", sensor.name, sample)
                time = 0.1 * sample if times is None else times[sample]
                made.passes[sensor.name, sample] = _frame(
                    stem, sensor, sample, time, digest, without, amodal, things, empty
                )
    return made


def _table(digest: str, things: Sequence[Ellipsoid]) -> InstanceTable:
    classes = ("/World/Objects/lander", "/World/Objects/rocks")
    half = np.array([np.array(t.scale) * t.half for t in things])
    turns = [Rotation.from_matrix(t.rotation).as_quat(canonical=True) for t in things]
    return InstanceTable(
        digest,
        classes,
        ("class",),
        np.array([t.number for t in things], np.uint32),
        np.array([classes.index(t.kind) for t in things], np.int32),
        np.array([t.number for t in things], np.uint32),
        np.array([[4 if "lander" in t.kind else 3] for t in things], np.uint32),
        np.array([t.position for t in things], np.float64),
        np.array(turns, np.float32),
        np.array([t.scale for t in things], np.float32),
        np.stack([-half, half], axis=1).astype(np.float32),
        np.zeros(0, np.int64),
        np.zeros((0, 0, 3)),
        np.zeros((0, 0, 4), np.float32),
        np.zeros((0, 0), np.bool_),
    )


def _frame(
    stem: Path,
    sensor: Sensor,
    sample: int,
    time: float,
    digest: str,
    without: Sequence[str],
    amodal: bool,
    things: Sequence[Ellipsoid],
    empty: bool,
) -> dict[str, NDArray]:
    pose = camera_pose(sensor, sample)
    rays = _rays(sensor, pose)
    eye = pose[:3, 3]
    slope = rays @ _NORMAL
    with np.errstate(divide="ignore"):
        ground = np.where(slope < 0.0, -(eye @ _NORMAL) / slope, np.inf)
    layers = [ground, *(_hits(eye, rays, thing) for thing in things)]
    if empty:
        layers = [np.full_like(layer, np.inf) for layer in layers]
    order = np.argmin(layers, axis=0)
    depth = np.min(layers, axis=0)
    hit = np.isfinite(depth)
    numbers = np.array([0, *(t.number for t in things)], np.uint32)
    kinds = np.array([2, *(4 if "lander" in t.kind else 3 for t in things)], np.uint32)
    instance = np.where(hit, numbers[order], 0).astype(np.uint32)
    points = np.where(hit[..., None], eye + np.where(hit, depth, 0.0)[..., None] * rays, 0.0)
    rgb = 0.3 + 0.25 * np.sin(3.0 * points + np.array([0.0, 1.0, 2.0]))
    passes: dict[str, NDArray] = {
        "rgb": np.where(hit[..., None], rgb, 0.9).astype(np.float32),
        "label.class": np.where(hit, kinds[order], 1).astype(np.uint32),
        "instance": instance,
        "depth": depth.astype(np.float32),
    }
    passes = {name: array for name, array in passes.items() if name not in without}
    exr = stem.with_suffix(".exr")
    write_exr(exr, passes)
    if "rgb" in passes:
        write_png(stem.with_suffix(".png"), develop(passes["rgb"]))
    listed = frame_table_path(stem)
    if "instance" in passes:
        seen = [t for t in things if (instance == t.number).any()]
        write_frame_table(listed, _columns(seen, sensor, pose, instance, depth, amodal))
        if amodal:
            _write_amodal(stem, seen, sensor, pose)
    w, h = sensor.size
    sidecar = {
        "version": "1.3",
        "camera": sensor.name,
        "camera_prim": sensor.prim,
        "sample": sample,
        "time_s": time,
        "resolution": [w, h],
        "intrinsics": camera_matrix(sensor).tolist(),
        "camera_to_world": pose.tolist(),
        "exposure_ev": 0.0,
        "passes": list(passes),
        "labels": {level: {str(n): t for n, t in names.items()} for level, names in LABELS.items()},
        "sky_labels": {"class": 1},
        "instances": {"/World/Objects/lander": 0, "/World/Objects/rocks": 3},
        "backend": "mitsuba",
        "stage_digest": digest,
        "exr": vouched(exr),
        "png": "rgb" in passes,
        "instance_table": vouched(listed) if "instance" in passes else None,
        "amodal": vouched(masks) if (masks := amodal_path(stem)).is_file() else None,
    }
    stem.with_suffix(".json").write_text(json.dumps(sidecar), encoding="utf-8")
    return passes


def vouched(path: Path) -> dict[str, Any]:
    """What a sidecar says of a file beside it."""
    return {"bytes": path.stat().st_size, "sha256": sha256(path)}


def rewrite(
    stem: Path,
    passes: Mapping[str, NDArray],
    table: dict[str, NDArray] | None = None,
    **told: Any,
) -> None:
    """Other passes, another table and other values in the sidecar, which vouches for both."""
    if table is not None:
        write_frame_table(listed := frame_table_path(stem), table)
        told["instance_table"] = vouched(listed)
    exr, path = stem.with_suffix(".exr"), stem.with_suffix(".json")
    write_exr(exr, dict(passes))
    sidecar = json.loads(path.read_bytes()) | {"passes": list(passes)} | told
    sidecar["exr"] = vouched(exr)
    path.write_text(json.dumps(sidecar), encoding="utf-8")


def _columns(
    seen: Sequence[Ellipsoid],
    sensor: Sensor,
    pose: NDArray,
    instance: NDArray,
    depth: NDArray,
    amodal: bool,
) -> dict[str, NDArray]:
    rows: list[dict[str, Any]] = []
    w, h = sensor.size
    for thing in seen:
        mask = instance == thing.number
        y, x = np.nonzero(mask)
        near = depth[mask]
        in_camera = np.linalg.inv(pose) @ np.array([*thing.position, 1.0])
        turn = Rotation.from_matrix(pose[:3, :3].T @ thing.rotation).as_quat(canonical=True)
        own = Rotation.from_matrix(thing.rotation).as_quat(canonical=True)
        size = 2.0 * np.array(thing.scale) * thing.half
        border = x.min() == 0 or y.min() == 0 or x.max() == w - 1 or y.max() == h - 1
        row: dict[str, Any] = {
            "id": thing.number, "class": thing.kind, "local_id": thing.number,
            "label.class": "lander" if "lander" in thing.kind else "rock",
            "pixels": int(mask.sum()), "x_min": x.min(), "y_min": y.min(), "x_max": x.max(),
            "y_max": y.max(), "truncated": int(border),
            "depth_min": near.min(), "depth_mean": near.mean(), "depth_max": near.max(),
        }  # fmt: skip
        if amodal:
            row["amodal"] = int(outline(thing, sensor, pose).sum())
            row["amodal_full"] = int(outline(thing, sensor, pose, 1).sum())
            row["amodal_bounded"] = 1
        row |= dict(zip(("cam_x", "cam_y", "cam_z"), in_camera[:3], strict=True))
        row |= dict(zip(("cam_qx", "cam_qy", "cam_qz", "cam_qw"), turn, strict=True))
        row |= dict(zip(("x", "y", "z"), thing.position, strict=True))
        row |= dict(zip(("qx", "qy", "qz", "qw"), own, strict=True))
        row |= dict(zip(("size_x", "size_y", "size_z"), size, strict=True))
        row |= {"box_x": 0.0, "box_y": 0.0, "box_z": 0.0}
        rows.append(row)
    names = list(rows[0]) if rows else [*FRAME_COLUMNS, "label.class"]
    return {name: np.array([row[name] for row in rows]) for name in names}


def outline(thing: Ellipsoid, sensor: Sensor, pose: NDArray, margin: int = 0) -> NDArray[np.bool_]:
    """Pixels whose center would show a thing alone, the picture continued by its size."""
    return np.isfinite(_hits(pose[:3, 3], _rays(sensor, pose, margin), thing))


def _write_amodal(stem: Path, seen: Sequence[Ellipsoid], sensor: Sensor, pose: NDArray) -> None:
    runs = [rle.encode_mask(outline(thing, sensor, pose)) for thing in seen]
    starts = np.concatenate([[0], np.cumsum([len(run) for run in runs])]).astype(np.int64)
    w, h = sensor.size
    numbers = np.array([t.number for t in seen], np.uint32)
    counts = np.concatenate([np.zeros(0, np.uint32), *runs])
    write_amodal(amodal_path(stem), Amodal((h, w), numbers, counts, starts))


def lift(depth: NDArray, k: NDArray, pose: NDArray) -> NDArray:
    """World points of the pixels that have depth, [n, 3], with K for whole-numbered centers."""
    v, u = np.nonzero(depth > 0.0)
    z = depth[v, u]
    points = np.stack([(u - k[0, 2]) / k[0, 0] * z, (v - k[1, 2]) / k[1, 1] * z, z], -1)
    return points @ pose[:3, :3].T + pose[:3, 3]


def misprediction(
    depth_a: NDArray, depth_b: NDArray, k_a: NDArray, k_b: NDArray, b_from_a: NDArray
) -> tuple[float, int]:
    """How wrong depth in B is, predicted from A: the median of relative errors; pixels compared.

    Inverse depth of a plane is linear in pixels, so it is interpolated; only where the four pixels
    around are of one smooth surface, and where A's point is not hidden in B.
    """
    points = lift(depth_a, k_a, b_from_a)
    points = points[points[:, 2] > 0.1]
    u = points[:, 0] / points[:, 2] * k_b[0, 0] + k_b[0, 2]
    v = points[:, 1] / points[:, 2] * k_b[1, 1] + k_b[1, 2]
    h, w = depth_b.shape
    inside = (u >= 0) & (v >= 0) & (u < w - 1) & (v < h - 1)
    u, v, z = u[inside], v[inside], points[inside, 2]
    x, y = u.astype(int), v.astype(int)
    four = np.stack([depth_b[y, x], depth_b[y, x + 1], depth_b[y + 1, x], depth_b[y + 1, x + 1]])
    smooth = (four.min(0) > 0.0) & (four.max(0) < 1.15 * four.min(0)) & (z < 1.15 * four.max(0))
    fu, fv, z, four = (u - x)[smooth], (v - y)[smooth], z[smooth], four[:, smooth]
    weights = np.stack([(1 - fu) * (1 - fv), fu * (1 - fv), (1 - fu) * fv, fu * fv])
    predicted = 1.0 / (weights / four).sum(0)
    return float(np.median(np.abs(z / predicted - 1.0))), len(z)
