"""What the Mitsuba adapter costs beside a bare Mitsuba script on the same arrays.

    python studies/benchmarks/mitsuba_adapter.py [--cfg CFG] [--rocks N] [--spp N] [--rounds N]

Two scenes of 640x480: a plain one (diffuse terrain and rocks, a sun, a constant sky) and the
first sample of a cfg's first batch (mixed glossy ground, a textured sky). Runs are interleaved
(adapter, bare, adapter, bare ...) and the table gives medians and the median of the paired ratios.
The bare script is what Mitsuba's own documentation would have one write: meshes, a far disc for the
sun, an environment map or a constant, a perspective sensor with a box filter, ``mi.render``.
"""

from __future__ import annotations

import argparse
import statistics
import tempfile
import time
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from scenec.backends.mitsuba import Mitsuba
from scenec.backends.mitsuba.emitter import dome_dict
from scenec.backends.mitsuba.scalar import disc_dict
from scenec.backends.picture.sky import combine
from scenec.backends.stage.read import read_stage
from scenec.backends.stage.scene import (
    Camera,
    Dome,
    Lighting,
    Mesh,
    RenderScene,
    Rows,
    Sun,
    Surface,
)
from scenec.compiler.compile import compile_cfg

ROOT = Path(__file__).resolve().parents[2]
GROUND = (0.42, 0.29, 0.18)
ROCK = (0.13, 0.11, 0.1)
SUN = Sun(np.array([0.6, 0.0, 0.8]), np.full(3, 1000.0), float(np.radians(0.53)))
SKY = 48.0


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


def rock(rings: int = 7) -> tuple[NDArray[np.float32], NDArray[np.int32]]:
    """A unit ball of 2 * rings * 2 * rings triangles, poles included."""
    columns = 2 * rings
    theta = np.linspace(0, np.pi, rings + 1)[:, None]
    phi = np.arange(columns)[None, :] * (2 * np.pi / columns)
    points = np.stack(
        [np.sin(theta) * np.cos(phi), np.sin(theta) * np.sin(phi), np.cos(theta) + 0 * phi], -1
    )
    i = np.arange((rings + 1) * columns).reshape(rings + 1, columns)
    j = np.roll(i, -1, axis=1)
    a, b, c, d = i[:-1].ravel(), i[1:].ravel(), j[1:].ravel(), j[:-1].ravel()
    faces = np.concatenate([np.stack([a, b, c], 1), np.stack([a, c, d], 1)])
    return points.reshape(-1, 3).astype(np.float32), faces.astype(np.int32)


def make_scene(rocks: int) -> RenderScene:
    """The terrain, rocks on it, a camera over it."""
    ground_points, ground_faces = terrain(512)
    rock_points, rock_faces = rock()
    rng = np.random.default_rng(1)
    to_world = np.zeros((rocks + 1, 3, 4))
    to_world[:, [0, 1, 2], [0, 1, 2]] = 1.0
    where = rng.integers(0, len(ground_points), rocks)
    scale = np.exp(rng.uniform(np.log(0.04), np.log(0.8), rocks)) / 2
    to_world[1:, :, :3] *= scale[:, None, None]
    to_world[1:, :, 3] = ground_points[where]
    eye = np.array([0.0, 0.0, ground_points[512 * 256 + 256, 2] + 2.0])
    pose = np.eye(4)
    forward = np.array([0.0, 1.0, -0.15]) / np.linalg.norm([0.0, 1.0, -0.15])
    pose[:3, 0] = [1.0, 0.0, 0.0]
    pose[:3, 1] = np.cross(forward, pose[:3, 0])
    pose[:3, 2] = forward
    pose[:3, 3] = eye
    f = 320 / np.tan(np.radians(65) / 2)
    k = np.array([[f, 0, 320.0], [0, f, 240.0], [0, 0, 1.0]])
    none = np.empty((0, 0), np.float32)

    def part(points: NDArray[np.float32], faces: NDArray[np.int32], layer: int) -> Mesh:
        return Mesh("/World/Part", points, faces, None, None, {}, (layer,), none)

    return RenderScene(
        source=Path("none"),
        digest="",
        samples=1,
        meshes=(part(ground_points, ground_faces, 0), part(rock_points, rock_faces, 1)),
        rows=Rows(
            np.array([0] + [1] * rocks, np.int32),
            to_world,
            np.arange(rocks + 1, dtype=np.uint32),
            np.zeros(rocks + 1, np.float32),
        ),
        surfaces=(Surface("g", GROUND, 0.0, 0.5, 0.0), Surface("r", ROCK, 0.0, 0.5, 0.0)),
        levels=(),
        label_names={},
        sky_labels={},
        cameras=((Camera("c", "/c", 640, 480, k, pose),),),
        lighting=(Lighting((SUN,), (Dome(None, np.full(3, SKY), np.eye(3)),)),),
        bounds=np.array([ground_points.min(0), ground_points.max(0)], np.float64),
    )


def bare(scene: RenderScene, sampler: str) -> Any:
    """A closure that draws one picture with Mitsuba alone."""
    import mitsuba as mi

    def shape(points: NDArray, faces: NDArray, color: tuple[float, float, float]) -> Any:
        props = mi.Properties()
        props["bsdf"] = mi.load_dict(
            {
                "type": "twosided",
                "bsdf": {"type": "diffuse", "reflectance": {"type": "rgb", "value": list(color)}},
            }
        )
        mesh = mi.Mesh("m", len(points), len(faces), props=props)
        params = mi.traverse(mesh)
        params["vertex_positions"] = np.ascontiguousarray(points, np.float32).ravel()
        params["faces"] = np.ascontiguousarray(faces, np.uint32).ravel()
        params.update()
        return mesh

    base = scene.meshes[1]
    m = scene.rows.to_world[1:]
    rocks = np.einsum("rij,vj->rvi", m[:, :, :3], base.points.astype(float)) + m[:, None, :, 3]
    faces = base.faces[None] + (np.arange(len(m)) * len(base.points))[:, None, None]
    shapes = {
        "ground": shape(scene.meshes[0].points, scene.meshes[0].faces, GROUND),
        "rocks": shape(rocks.reshape(-1, 3), faces.reshape(-1, 3), ROCK),
    }
    sky = {"type": "constant", "radiance": {"type": "rgb", "value": [SKY] * 3}}
    return rendering(scene, shapes, sky, np.zeros(3), sampler)


def bare_stage(scene: RenderScene, backend: Mitsuba, sampler: str) -> Any:
    """The same for a stage: the adapter's meshes (so the same arrays), Mitsuba's own lights."""
    import mitsuba as mi

    center = 0.5 * (scene.bounds[0] + scene.bounds[1])
    shapes = {f"mesh_{i}": mesh for i, mesh in enumerate(backend._meshes)}
    sky = combine(scene.lighting[0].domes)
    return rendering(scene, shapes, dome_dict(mi, sky) if sky else None, center, sampler)


def rendering(
    scene: RenderScene, shapes: dict[str, Any], sky: Any, center: NDArray, sampler: str
) -> Any:
    """A closure that draws sample 0 with ``mi.render``."""
    import mitsuba as mi

    camera = scene.cameras[0][0]
    pose = camera.camera_to_world.copy()
    pose[:3, 3] -= center
    pose[:3, :2] *= -1
    fov = 2 * np.degrees(np.arctan(0.5 * camera.width / camera.intrinsics[0, 0]))
    parts: dict[str, Any] = {
        "type": "scene",
        **shapes,
        "sensor": {
            "type": "perspective",
            "fov": float(fov),
            "far_clip": 1e6,
            "sampler": {"type": sampler},
            "to_world": mi.ScalarTransform4f(pose),
            "film": {
                "type": "hdrfilm",
                "width": camera.width,
                "height": camera.height,
                "rfilter": {"type": "box"},
                "pixel_format": "rgba",
                "component_format": "float32",
            },
        },
    }
    parts |= {f"sun_{i}": disc_dict(mi, sun, 1e5) for i, sun in enumerate(scene.lighting[0].suns)}
    if sky is not None:
        parts["sky"] = sky
    loaded = mi.load_dict(parts)
    integrator = mi.load_dict(
        {"type": "path", "max_depth": 6, "rr_depth": 7, "hide_emitters": True}
    )
    return lambda spp, seed: np.array(mi.render(loaded, integrator=integrator, spp=spp, seed=seed))


def main() -> None:
    """Measure and print."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--rocks", type=int, default=5000)
    parser.add_argument("--spp", type=int, default=64)
    parser.add_argument("--rounds", type=int, default=7)
    parser.add_argument(
        "--sampler", default="independent", help="of the bare script; the adapter has independent"
    )
    parser.add_argument("--cfg", type=Path, default=ROOT / "configs" / "jacksboro.json")
    args = parser.parse_args()

    plain = make_scene(args.rocks)
    backend = Mitsuba()
    backend.load(plain)
    name = f"plain scene, {args.rocks} rocks"
    measure(name, plain, backend, bare(plain, args.sampler), args.spp, args.rounds)
    with tempfile.TemporaryDirectory() as folder:
        out = compile_cfg(args.cfg, seed=1, out=Path(folder) / "out").out
        scene = read_stage(out / "batch_0000" / "stage.usda")
        backend = Mitsuba()
        backend.load(scene)
        draw = bare_stage(scene, backend, args.sampler)
        measure(args.cfg.name, scene, backend, draw, args.spp, args.rounds)


def measure(
    name: str, scene: RenderScene, backend: Mitsuba, draw: Any, spp: int, rounds: int
) -> None:
    """Renders in turns and prints the table of one scene."""
    camera = scene.cameras[0][0]
    ours, theirs = [], []
    # Round 0 compiles the kernels of both and does not count.
    for turn in range(rounds + 1):
        start = time.perf_counter()
        radiance = backend.radiance(camera, 0, spp, turn)
        middle = time.perf_counter()
        picture = draw(spp, turn)
        end = time.perf_counter()
        if turn:
            ours.append(middle - start)
            theirs.append(end - middle)
    mean = radiance.halves.mean(axis=0)
    half_difference = 0.5 * (radiance.halves[0] - radiance.halves[1])
    ratios = [a / b for a, b in zip(ours, theirs, strict=True)]
    print(
        f"{name}: {backend.version()}, {camera.width}x{camera.height}, {spp} spp, {rounds} rounds"
    )
    print(f"  radiance, adapter (median) {statistics.median(ours):8.3f} s")
    print(f"  radiance, bare    (median) {statistics.median(theirs):8.3f} s")
    print(f"  adapter / bare    (median) {statistics.median(ratios):8.3f}   target <= 1.05")
    print(f"  mean radiance, adapter     {mean.mean():8.4f}")
    print(f"  mean radiance, bare        {picture[..., :3].mean():8.4f}")
    print(f"  relative rms noise         {np.sqrt((half_difference**2).mean()) / mean.mean():8.4f}")


if __name__ == "__main__":
    main()
