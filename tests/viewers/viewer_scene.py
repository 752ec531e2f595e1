"""A small stage for viewers: several prototypes, a mixed ground, two unlike cameras."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from PIL import Image

from scenec.backends.camera.rays import camera_rays
from scenec.backends.contract import Visibility
from scenec.backends.exact import ExactCaster
from scenec.backends.stage.scene import Camera, RenderScene
from scenec.compiler.compile import compile_cfg
from scenec.compiler.views.needed import Keep
from scenec.testing.small import small_cfg, write_cfg

SKY, GROUND, ROCK = 0, 1, 2


def viewer_cfg() -> dict[str, Any]:
    """The small cfg with glossy and metallic ground, and a second camera that looks elsewhere."""
    cfg = small_cfg(samples=2)
    cfg["materials"]["gravel"] |= {"specular": 0.15, "roughness": 0.5, "roughness_variation": -0.6,
                                   "diffuse_transmission": 0.2}  # fmt: skip
    cfg["materials"]["mud"] |= {"metallic": 0.6, "roughness": 0.4, "specular": 0.0}
    cfg["rigs"]["rover"]["sensors"] = {
        "front": {"resolution": [96, 96], "fov_deg": 70},
        "side": {
            "resolution": [120, 80],
            "intrinsics": {"fx": 100, "fy": 100, "cx": 55.5, "cy": 44.25},
            "mount": {"position_m": [0.4, -0.1, 0.2], "rotation_deg": [-8, 25, 3]},
        },
    }
    return cfg


def mapped_cfg(folder: Path) -> dict[str, Any]:
    """The same with maps of every kind on its ground; writes the pictures into a folder."""
    rng = np.random.default_rng(1)
    cfg = viewer_cfg()
    # Large texels: a renderer's filter between them is the only one that matters.
    codes = {
        "color.png": rng.integers(60, 230, (8, 8, 3)),
        "roughness.png": rng.integers(90, 230, (8, 8)),
        "metallic.png": rng.integers(0, 255, (8, 8)),
        "normal.png": np.rint(127.5 * (1 + _unit(rng.normal(size=(8, 8, 3)) * 0.2 + [0, 0, 1]))),
    }
    for name, values in codes.items():
        Image.fromarray(values.astype(np.uint8)).save(folder / name)
    sand, gravel, mud = (cfg["materials"][name] for name in ("sand", "gravel", "mud"))
    sand["maps"] = {"size_m": 9, "base_color": "color.png", "normal": "normal.png"}
    sand |= {"base_color": [0.9, 0.8, 0.7]}
    gravel["maps"] = {
        "size_m": 7,
        "roughness": "roughness.png",
        "normal": "normal.png",
        "normal_convention": "directx",
    }
    mud["maps"] = {"size_m": 8, "metallic": "metallic.png"}
    return cfg


def _unit(vectors: NDArray) -> NDArray:
    return vectors / np.sqrt((vectors**2).sum(axis=-1, keepdims=True))


def compiled(folder: Path, cfg: dict[str, Any], seed: int = 3) -> Path:
    """Compiles a cfg; returns the stage of its first batch."""
    compile_cfg(write_cfg(folder, cfg), seed=seed, out=folder / "out", keep=Keep.UNPRUNED)
    return folder / "out" / "batch_0000" / "stage.usda"


def run_apart(script: Path, *arguments: object) -> subprocess.CompletedProcess[str]:
    """Runs a script in a process of its own: bpy's USD and GL share one with nobody."""
    return subprocess.run(
        [sys.executable, str(script), *map(str, arguments)],
        capture_output=True,
        text=True,
        check=False,
    )


def first_hits(scene: RenderScene, camera: Camera) -> Visibility:
    """What the exact caster sees."""
    row, face, _ = ExactCaster(scene).cast(camera_rays(camera))
    return Visibility(row, face)


def classes(scene: RenderScene, camera: Camera) -> NDArray[np.int64]:
    """SKY, GROUND or ROCK at each pixel center, [h, w], from the exact caster."""
    row = first_hits(scene, camera).row
    rock = scene.rows.instance_id[np.maximum(row, 0)] > 0
    return np.where(row < 0, SKY, np.where(rock, ROCK, GROUND)).reshape(camera.height, -1)
