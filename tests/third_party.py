"""Backends of a third party: plain but honest ones, which can be told to fail on the way.

Their visibility is the exact caster's, their light a constant with noise of a known size, so what
should come of them is known in closed form. ``install`` makes a package of them that is found
through its entry points, in this process and in workers.
"""

from __future__ import annotations

import ctypes
import json
import os
import signal
import time
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray
from pxr import Gf, Sdf, Usd, UsdGeom, UsdLux, UsdRender, Vt

from scenec.backends.contract import LoadCost, Radiance, Rays, Visibility
from scenec.backends.exact import ExactCaster
from scenec.backends.stage.scene import Camera, RenderScene
from scenec.schemas.errors import BackendError

HERE = Path(__file__).resolve().parent
FAULT = "SCENEC_TEST_FAULT"
#: Radiance of every surface, and the standard deviation of each half's noise.
LEVEL, NOISE = 2.0, 0.5
NAMES = {"plain": "Plain", "heavy": "Heavy", "smooth": "Smooth", "raster": "Raster"}


def install(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Make the package known, here and in processes started from here."""
    info = folder / "site" / "third_party-1.0.dist-info"
    info.mkdir(parents=True)
    (info / "METADATA").write_text("Metadata-Version: 2.1\nName: third-party\nVersion: 1.0\n")
    lines = [f"{name} = third_party:{of}" for name, of in NAMES.items()]
    (info / "entry_points.txt").write_text("\n".join(["[scenec.backends]", *lines, ""]))
    monkeypatch.syspath_prepend(str(info.parent))
    monkeypatch.setenv("PYTHONPATH", os.pathsep.join([str(info.parent), str(HERE)]))


def square_stage(path: Path, samples: int = 3, width: int | None = None) -> Path:
    """A foreign stage: a square under a sun, two cameras, a number of samples.

    Args:
        path: Of the stage.
        samples: How many.
        width: Of the pictures, pixels; None leaves it, and what to render, to the reader.
    """
    made = Usd.Stage.CreateNew(str(path))
    UsdGeom.SetStageUpAxis(made, UsdGeom.Tokens.z)
    UsdGeom.SetStageMetersPerUnit(made, 1.0)
    made.SetTimeCodesPerSecond(1.0)
    made.SetStartTimeCode(0)
    made.SetEndTimeCode(samples - 1)
    made.SetDefaultPrim(UsdGeom.Xform.Define(made, "/World").GetPrim())
    mesh = UsdGeom.Mesh.Define(made, "/World/Square")
    mesh.CreateSubdivisionSchemeAttr("none")
    corners = [(-5, -5, 0), (5, -5, 0), (5, 5, 0), (-5, 5, 0)]
    mesh.CreatePointsAttr(Vt.Vec3fArray([Gf.Vec3f(*c) for c in corners]))
    mesh.CreateFaceVertexCountsAttr([4])
    mesh.CreateFaceVertexIndicesAttr([0, 1, 2, 3])
    sun = UsdLux.DistantLight.Define(made, "/World/Sun")
    sun.CreateIntensityAttr(10.0)
    sun.CreateAngleAttr(0.53)
    sun.CreateNormalizeAttr(True)
    for name in ("left", "right"):
        camera = UsdGeom.Camera.Define(made, f"/World/{name}")
        camera.CreateHorizontalApertureAttr(0.36)
        camera.CreateVerticalApertureAttr(0.27)
        camera.CreateFocalLengthAttr(0.36)
        op = camera.AddTranslateOp()
        for sample in range(samples):
            op.Set(Gf.Vec3d(sample * 0.5, 0, 6), sample)
        if width is not None:
            product = UsdRender.Product.Define(made, f"/Render/{name}")
            product.CreateCameraRel().SetTargets([camera.GetPath()])
            product.CreateResolutionAttr(Gf.Vec2i(width, width * 3 // 4))
            product.CreateOrderedVarsRel().SetTargets(_variables(made))
    made.Save()
    return path


def _variables(made: Usd.Stage) -> list[Sdf.Path]:
    found = []
    for name in ("rgb", "depth", "instance"):
        variable = UsdRender.Var.Define(made, f"/Render/Vars/{name}")
        variable.CreateSourceNameAttr(name)
        found.append(variable.GetPath())
    return found


def plan_fault(folder: Path, monkeypatch: pytest.MonkeyPatch, kind: str, **options: object) -> None:
    """Have a backend fail.

    Args:
        folder: Remembers how often it did.
        monkeypatch: The test's.
        kind: One of ``_FAULTS``.
        options: ``sample`` (default: every one), ``times`` (default: whenever it can), ``where``
            (default: radiance), ``amount``.
    """
    counter = folder / "faults"
    counter.write_text("")
    plan = {"kind": kind, "counter": str(counter), "where": "radiance", **options}
    monkeypatch.setenv(FAULT, json.dumps(plan))


def faults_so_far(folder: Path) -> int:
    """How often it did fail."""
    return len((folder / "faults").read_text())


class Plain:
    """Implements ``contract.Backend``."""

    name = "plain"
    devices: tuple[str, ...] = ("cpu", "optix")
    denoiser: str | None = None
    stochastic = True
    load_cost = LoadCost(row=1000.0, triangle=100.0)

    def __init__(self, device: str = "auto") -> None:
        if device == "optix":
            raise BackendError(f"{self.name}: no driver for optix here")
        self.device = "cpu"
        self._caster: ExactCaster | None = None

    def version(self) -> str:
        """Name and version."""
        return f"{self.name} 1.0"

    def warning(self) -> str | None:
        """None."""
        return None

    def losses(self, scene: RenderScene) -> tuple[str, ...]:
        """One line, always the same."""
        return (f"{self.name}: every surface shines alike",)

    def load(self, scene: RenderScene) -> None:
        """Build the caster."""
        _fail("load", None)
        self._caster = ExactCaster(scene)

    def witness(self, rays: Rays, sample: int, camera: Camera | None = None) -> Visibility | None:
        """Exact first hits."""
        _fail("witness", sample)
        assert self._caster is not None
        row, face, _ = self._caster.cast(rays)
        return Visibility(row, face)

    def radiance(
        self, camera: Camera, sample: int, spp: int, seed: int, denoise: bool = False
    ) -> Radiance:
        """LEVEL, with noise of standard deviation NOISE in each half."""
        _fail("radiance", sample)
        assert self._caster is not None
        shape = (camera.height, camera.width, 3)
        noise = NOISE if self.stochastic else 0.0
        halves = LEVEL + noise * np.random.default_rng(seed).normal(size=(2, *shape))
        smooth = np.full(shape, halves.mean(), np.float32) if denoise else None
        covered = np.ones(shape[:2], np.float32)
        return Radiance(
            halves.astype(np.float32), covered, spp, denoised=smooth, stochastic=self.stochastic
        )


class Heavy(Plain):
    """As ``Plain``, and says that it takes more memory than there is anywhere."""

    name = "heavy"
    load_cost = LoadCost(row=1e15, triangle=0.0, written=1e15)


class Smooth(Plain):
    """Has a denoiser: the mean over the picture."""

    name = "smooth"
    denoiser = "mean"


class Raster(Plain):
    """Has no noise, and knows no error."""

    name = "raster"
    stochastic = False


_kept: list[NDArray] = []


def _hold(megabytes: float) -> None:
    # Written to: memory that nobody touched is not resident.
    _kept.append(np.ones(round(megabytes * 125_000)))


def _grow(_amount: float) -> None:
    while True:
        _hold(20)
        time.sleep(0.02)


def _work(seconds: float) -> None:
    end = time.process_time() + seconds
    while time.process_time() < end:
        pass


def _hold_the_lock(_amount: float) -> None:
    # Called without giving up the interpreter's lock: no thread of this process runs again.
    ctypes.PyDLL(None).pause()


_FAULTS = {
    "sleep": lambda _: time.sleep(3600),
    "stop": lambda _: os.kill(os.getpid(), signal.SIGSTOP),
    "lock": _hold_the_lock,
    "spin": lambda _: _work(3600),
    "work": _work,
    "leak": _hold,
    "grow": _grow,
    "crash": lambda _: ctypes.string_at(0),
    "kill": lambda _: os.kill(os.getpid(), signal.SIGKILL),
    "exit": lambda _: os._exit(3),
}


def _fail(where: str, sample: int | None) -> None:
    plan = json.loads(os.environ.get(FAULT, "{}"))
    if plan.get("where") != where or plan.get("sample", sample) != sample:
        return
    counter = Path(plan["counter"])
    if len(counter.read_text()) < plan.get("times", 10**6):
        with counter.open("a") as file:
            file.write("x")
        _FAULTS[plan["kind"]](plan.get("amount", 0.0))
