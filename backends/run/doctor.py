"""Diagnoses which backends work on this machine, and how to mend the others."""

from __future__ import annotations

import ctypes.util
import importlib.metadata
import platform
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import cast

import numpy as np

from scenec.backends.registry import backend_class, backend_names, open_backend
from scenec.backends.run.executors import ask, make_executor
from scenec.backends.run.limits import Limits
from scenec.backends.run.supervise import FrameLostError
from scenec.backends.run.units import OfBackend
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
from scenec.schemas.errors import BackendError, PluginError

LIBRARIES = (
    "scenec",
    "numpy",
    "numba",
    "usd-core",
    "OpenEXR",
    "pillow",
    "trimesh",
    "mitsuba",
    "llvm-nanobind",
    "pyoidn",
    "bpy",
    "pyrender-maintained",
    "PyOpenGL",
    "lavavu-osmesa",
    "flip-evaluator",
    "materialx",
    "distributed",
)


@dataclass(frozen=True)
class Diagnosis:
    """One backend here.

    Attributes:
        name: The backend's.
        works: Whether it rendered the test scene rightly.
        version: Renderer and variant; "" if it did not get that far.
        device: Where it ran: the fastest device that works here; "" likewise.
        message: What is wrong, with the command that mends it; or a warning; or "".
    """

    name: str
    works: bool
    version: str
    device: str
    message: str


#: Seconds that a backend's fastest device may take, where there is a GPU; then its CPU is tried.
GPU_S = 30.0


def diagnose(names: tuple[str, ...] | None = None) -> list[Diagnosis]:
    """Try each backend on a tiny scene, in its worker process: a crash is a finding, no more."""
    return [_diagnosis(name) for name in names or backend_names()]


def _diagnosis(name: str) -> Diagnosis:
    try:
        if not _may_wait(name):
            return cast(Diagnosis, ask(OfBackend(name, probe)))
        limits = Limits(timeout_s=GPU_S, start_s=0.0, retries=0)
        try:
            with make_executor(1, limits=limits) as hurried:
                return cast(Diagnosis, ask(OfBackend(name, probe), hurried))
        except FrameLostError as lost:
            on_cpu = ask(OfBackend(name, partial(probe, device="cpu")))
            message = (
                f"on the GPU: {lost}. A GPU's kernels are compiled once, which can take minutes: "
                "render something with --device cuda, or optix, and ask again"
            )
            return replace(on_cpu, message=message)
    except (BackendError, PluginError) as error:
        return Diagnosis(name, False, "", "", str(error))


def _may_wait(name: str) -> bool:
    """Tells whether a backend tries a GPU first, which may be busy for minutes before it draws."""
    if ctypes.util.find_library("cuda") is None:
        return False
    try:
        return "cpu" in (devices := backend_class(name).devices) and len(devices) > 1
    except BackendError:
        return False


def library_versions() -> dict[str, str]:
    """Versions of what scenec stands on; "not installed" where it is not."""
    versions = {"python": platform.python_version(), "platform": platform.platform()}
    for name in LIBRARIES:
        try:
            versions[name] = importlib.metadata.version(name)
        except importlib.metadata.PackageNotFoundError:
            versions[name] = "not installed"
    return versions


def start(device: str, name: str) -> None:
    """Start a backend in this process, and have it load a tiny scene.

    Raises:
        BackendError: It cannot start.
    """
    open_backend(name, device).load(tiny_scene())


def probe(name: str, device: str = "auto") -> Diagnosis:
    """Render a tiny scene with a backend, in this process, and check what comes out.

    Raises:
        BackendError: It cannot start, or what it renders is wrong.
    """
    backend = open_backend(name, device)
    scene = tiny_scene()
    camera = scene.cameras[0][0]
    backend.load(scene)
    light = backend.radiance(camera, 0, 16, 0)
    if light.coverage[0].any() or not (light.coverage[-1] == 1.0).all():
        raise BackendError(f"backend {name} starts, but sees the test scene wrongly")
    value = float(light.halves.mean(axis=0)[-1].mean())
    expected = 0.5 * (np.pi + 1.0) / np.pi
    if not abs(value - expected) < 0.1 * expected:
        raise BackendError(
            f"backend {name} starts, but the test scene's ground has radiance {value:g} "
            f"instead of {expected:g}"
        )
    return Diagnosis(name, True, backend.version(), backend.device, backend.warning() or "")


def tiny_scene() -> RenderScene:
    """Gray ground to the horizon under a sun in the zenith (E = 1) and a sky of radiance 1."""
    size = 1000.0
    points = np.array([[-size, -size, 0], [size, -size, 0], [size, size, 0], [-size, size, 0]])
    pose = np.array([[1.0, 0, 0, 0], [0, 0, 1, 0], [0, -1, 0, 2], [0, 0, 0, 1]])
    k = np.array([[8.0, 0, 8.0], [0, 8.0, 8.0], [0, 0, 1]])
    mesh = Mesh(
        path="/World/Ground",
        points=points.astype(np.float32),
        faces=np.array([[0, 1, 2], [0, 2, 3]], np.int32),
        authored_face=None,
        normals=None,
        labels={},
        layers=(0,),
        weights=np.empty((0, 4), np.float32),
    )
    lighting = Lighting(
        (Sun(np.array([0.0, 0.0, 1.0]), np.ones(3), np.radians(0.53)),),
        (Dome(None, np.ones(3), np.eye(3)),),
    )
    return RenderScene(
        source=Path("doctor"),
        digest="",
        samples=1,
        meshes=(mesh,),
        rows=Rows(
            np.zeros(1, np.int32),
            np.eye(4)[None, :3],
            np.zeros(1, np.uint32),
            np.zeros(1, np.float32),
        ),
        surfaces=(Surface("", (0.5, 0.5, 0.5), 0.0, 0.5, 0.0),),
        levels=(),
        label_names={},
        sky_labels={},
        cameras=((Camera("doctor", "/doctor", 16, 16, k, pose),),),
        lighting=(lighting,),
        bounds=np.array([points.min(0), points.max(0)]),
    )
