"""Small scenes as BlenderProc writes them."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np

#: A box of 40 mm by 60 mm by 100 mm that stands on its origin.
_PLY = """ply
format ascii 1.0
element vertex 8
property float x
property float y
property float z
element face 12
property list uchar int vertex_indices
end_header
-20 -30 0
20 -30 0
20 30 0
-20 30 0
-20 -30 100
20 -30 100
20 30 100
-20 30 100
3 0 2 1
3 0 3 2
3 4 5 6
3 4 6 7
3 0 1 5
3 0 5 4
3 1 2 6
3 1 6 5
3 2 3 7
3 2 7 6
3 3 0 4
3 3 4 7
"""


def looking(place: tuple[float, float, float], at: tuple[float, float, float]) -> np.ndarray:
    """From a camera's axes (x right, y down, z ahead) to the world, [4, 4]."""
    ahead = np.subtract(at, place)
    ahead = ahead / np.linalg.norm(ahead)
    right = np.cross(ahead, (0, 0, 1))
    right = right / np.linalg.norm(right)
    pose = np.eye(4)
    pose[:3, :3] = np.stack([right, np.cross(ahead, right), ahead], axis=1)
    pose[:3, 3] = place
    return pose


CAMERAS = (looking((0.0, -1.0, 0.5), (0, 0, 0)), looking((0.8, -0.6, 0.4), (0, 0, 0)))


def make_bop(folder: Path, objects: list[list[np.ndarray]], *, world: bool = True) -> Path:
    """A dataset of two pictures and one model.

    Args:
        folder: Where it goes.
        objects: For each picture the poses of the objects in the world, meters.
        world: Whether cameras say where they are.

    Returns:
        The scene's folder.
    """
    scene = folder / "train_pbr" / "000000"
    scene.mkdir(parents=True)
    (folder / "models").mkdir()
    (folder / "models" / "obj_000003.ply").write_text(_PLY)
    info = {"min_x": -20, "min_y": -30, "min_z": 0, "size_x": 40, "size_y": 60, "size_z": 100}
    (folder / "models" / "models_info.json").write_text(json.dumps({"3": info}))
    camera = {"cx": 31.5, "cy": 23.5, "fx": 60, "fy": 60, "width": 64, "height": 48}
    (folder / "camera.json").write_text(json.dumps(camera))
    cameras: dict[str, Any] = {}
    truth: dict[str, Any] = {}
    for number, (pose, placed) in enumerate(zip(CAMERAS, objects, strict=True)):
        view = np.linalg.inv(pose)
        entry: dict[str, Any] = {"cam_K": [60, 0, 31.5, 0, 60, 23.5, 0, 0, 1], "depth_scale": 1.0}
        if world:
            entry["cam_R_w2c"] = view[:3, :3].ravel().tolist()
            entry["cam_t_w2c"] = (1000 * view[:3, 3]).tolist()
        cameras[str(number)] = entry
        truth[str(number)] = [
            {
                "cam_R_m2c": (view @ thing)[:3, :3].ravel().tolist(),
                "cam_t_m2c": (1000 * (view @ thing)[:3, 3]).tolist(),
                "obj_id": 3,
            }
            for thing in placed
        ]
    (scene / "scene_camera.json").write_text(json.dumps(cameras, indent=1))
    (scene / "scene_gt.json").write_text(json.dumps(truth, indent=1))
    return scene


def at(x: float, y: float, z: float, degrees: float = 0.0) -> np.ndarray:
    """A pose in the world, turned about the vertical."""
    pose = np.eye(4)
    s, c = np.sin(np.radians(degrees)), np.cos(np.radians(degrees))
    pose[:2, :2] = [[c, -s], [s, c]]
    pose[:3, 3] = (x, y, z)
    return pose
