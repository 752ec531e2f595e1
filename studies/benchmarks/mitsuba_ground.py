"""What maps on the ground cost in Mitsuba: the same terrain plain, and with 1 to 3 mapped layers.

    python studies/benchmarks/mitsuba_ground.py [--spp N] [--rounds N] [--width N]
                                                [--height N] [--fast]

Every layer has maps of base color and of normals of 512 texels a side, projected from above, laid
in cells or not; the plain ground has as many layers without maps. One case merges three layers by
maps of heights, one has gloss with a map of roughness. Rounds are interleaved, a round draws every
ground once; CPU seconds (of all threads) and ratios to the plain ground of one layer are medians
over the rounds. Kernels are compiled anew: they are kept in a folder of their own.
"""

from __future__ import annotations

import dataclasses
import os
import statistics
import time
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from PIL import Image

from scenec.backends.mitsuba import Mitsuba
from scenec.backends.stage.scene import (
    Camera,
    Cells,
    Dome,
    Lighting,
    Maps,
    Mesh,
    RenderScene,
    Rows,
    Sun,
    Surface,
)
from scenec.studies.runner import Study, in_turns, peak_mib, run

SUN = Sun(np.array([0.6, 0.0, 0.8]), np.full(3, 1000.0), float(np.radians(0.53)))
SKY = 48.0
COLORS = ((0.9, 0.7, 0.5), (0.5, 0.45, 0.4), (0.7, 0.55, 0.4))
TEXELS = 512


def terrain(n: int) -> tuple[NDArray[np.float32], NDArray[np.int32]]:
    """A rolling 100 m x 100 m grid of n x n points."""
    rng = np.random.default_rng(0)
    axis = np.linspace(-50, 50, n)
    y, x = np.meshgrid(axis, axis, indexing="ij")
    z = np.zeros_like(x)
    for octave in range(6):
        f, a = 0.06 * 2**octave, 1.5 * 0.45**octave
        px, py = rng.uniform(0, 2 * np.pi, 2)
        z += a * np.sin(f * x + px) * np.cos(0.9 * f * y + py)
    i = np.arange(n * n).reshape(n, n)
    a, b, c, d = (q.ravel() for q in (i[:-1, :-1], i[:-1, 1:], i[1:, 1:], i[1:, :-1]))
    faces = np.concatenate([np.stack([a, b, c], 1), np.stack([a, c, d], 1)])
    return np.stack([x, y, z], -1).reshape(-1, 3).astype(np.float32), faces.astype(np.int32)


def write_maps(folder: Path) -> list[Maps]:
    """Maps of three layers: noise of a few octaves as colors, normals, heights and roughness."""
    found = []
    for layer in range(len(COLORS)):
        rng = np.random.default_rng(layer)
        height = np.zeros((TEXELS, TEXELS))
        for octave in range(2, 8):
            coarse = rng.uniform(-1.0, 1.0, (2**octave, 2**octave))
            height += np.kron(coarse, np.ones((TEXELS >> octave,) * 2)) * 0.6**octave
        height = (height - height.min()) / np.ptp(height)
        slope = [np.roll(height, 1, axis) - height for axis in (1, 0)]
        normal = np.stack([*slope, np.full_like(height, 0.3)], axis=-1)
        normal /= np.linalg.norm(normal, axis=-1, keepdims=True)
        color = 0.5 + 0.5 * height[..., None] * np.array([1.0, 0.9, 0.8])
        pictures = {
            "base_color": color,
            "normal": 0.5 * normal + 0.5,
            "height": height,
            "roughness": 0.5 + 0.4 * height,
        }
        files = {}
        for kind, values in pictures.items():
            files[kind] = folder / f"{kind}_{layer}.png"
            Image.fromarray(np.rint(255.0 * values).astype(np.uint8)).save(files[kind])
        found.append(Maps(1.5 + 0.4 * layer, **files, cells=Cells(1.5 + 0.4 * layer, layer)))
    return found


def ground(maps: list[Maps | None], blends: tuple[float, ...], specular: float) -> RenderScene:
    """The terrain with as many layers as there are maps."""
    points, faces = terrain(512)
    corners = points.astype(np.float64)[faces]
    across = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    normals = np.zeros(points.shape)
    for corner in range(3):
        np.add.at(normals, faces[:, corner], across)
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    x, y = points[:, 0], points[:, 1]
    weights = np.stack(
        [
            np.clip(0.5 + 4.0 * np.sin(0.4 * x) * np.cos(0.3 * y), 0.0, 1.0),
            np.clip(0.5 + 5.0 * np.cos(0.2 * x + 0.25 * y), 0.0, 1.0),
        ]
    )[: len(maps) - 1]
    surfaces = tuple(
        Surface(f"/L{i}", COLORS[i], specular, 0.6, 0.3, 0.0, described)
        for i, described in enumerate(maps)
    )
    variation = (np.sin(1.7 * x) * np.sin(2.3 * y)).astype(np.float32)
    mesh = Mesh(
        "/World/Ground",
        points,
        faces,
        None,
        normals.astype(np.float32),
        {},
        tuple(range(len(maps))),
        weights.astype(np.float32),
        variation,
        height_blends=blends,
    )
    return RenderScene(
        source=Path("none"),
        digest="",
        samples=1,
        meshes=(mesh,),
        rows=Rows(
            np.zeros(1, np.int32),
            np.eye(3, 4)[None],
            np.zeros(1, np.uint32),
            np.zeros(1, np.float32),
        ),
        surfaces=surfaces,
        levels=(),
        label_names={},
        sky_labels={},
        cameras=(),
        lighting=(Lighting((SUN,), (Dome(None, np.full(3, SKY), np.eye(3)),)),),
        bounds=np.array([points.min(0), points.max(0)], np.float64),
    )


def camera(points: NDArray[np.float32], width: int, height: int) -> Camera:
    """Two meters above the middle, looking slightly down."""
    pose = np.eye(4)
    forward = np.array([0.0, 1.0, -0.25]) / np.linalg.norm([0.0, 1.0, -0.25])
    pose[:3, 0] = [1.0, 0.0, 0.0]
    pose[:3, 1] = np.cross(forward, pose[:3, 0])
    pose[:3, 2] = forward
    pose[:3, 3] = [0.0, 0.0, points[512 * 256 + 256, 2] + 2.0]
    f = 0.5 * width / np.tan(np.radians(65.0) / 2.0)
    k = np.array([[f, 0.0, width / 2.0], [0.0, f, height / 2.0], [0.0, 0.0, 1.0]])
    return Camera("c", "/c", width, height, k, pose)


def grounds(maps: list[Maps]) -> dict[str, RenderScene]:
    """What is drawn, by name."""
    dull = [dataclasses.replace(m, height=None, roughness=None) for m in maps]
    flat = [dataclasses.replace(m, cells=None) for m in dull]
    found = {}
    for count in (1, 2, 3):
        found[f"{count} plain"] = ground([None] * count, (), 0.0)
        found[f"{count} mapped"] = ground([*flat[:count]], (), 0.0)
        found[f"{count} in cells"] = ground([*dull[:count]], (), 0.0)
    heeding = [dataclasses.replace(m, roughness=None) for m in maps]
    found["3 in cells, by heights"] = ground([*heeding], (0.3, 0.3), 0.0)
    found["3 in cells, glossy"] = ground([*maps], (), 0.1)
    return found


def main(study: Study) -> None:
    """Prints the table."""
    options = study.options
    # Dr.Jit keeps kernels under it, and reads it when it is first used.
    os.environ["HOME"] = str(study.scratch)
    scenes = grounds(write_maps(study.scratch))
    width, height, spp, rounds = options.width, options.height, options.spp, options.rounds
    if study.fast:
        width, height, spp, rounds = 160, 120, 4, 1
        scenes = dict(list(scenes.items())[:3])
    backends, works, first = {}, {}, {}
    for name, scene in scenes.items():
        backends[name] = backend = Mitsuba(device="cpu")
        backend.load(scene)
        view = camera(scene.meshes[0].points, 16, 16)
        start = time.perf_counter()
        # So few rays that it is compilation that counts.
        backend.radiance(view, 0, 2, 0)
        first[name] = time.perf_counter() - start
        view = camera(scene.meshes[0].points, width, height)
        works[name] = lambda turn, b=backend, v=view: b.radiance(v, 0, spp, turn)
    found = in_turns(works, rounds)
    plain = next(iter(found.values()))
    study.table(
        [f"layers, {width} x {height}, {spp} spp", "first 16 x 16, s", "frame, s", "CPU s",
         "CPU / plain"],
        ([name, first[name], t.median, statistics.median(t.cpu), t.cpu_over(plain)]
         for name, t in found.items()),
    )  # fmt: skip
    study.say(
        f"{next(iter(backends.values())).version()}; all scenes at once: {peak_mib():.0f} MiB."
    )


if __name__ == "__main__":
    run(main, spp=64, rounds=3, width=640, height=480)
