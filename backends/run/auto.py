"""``--backend auto``: the first renderer of an order of preference that works here."""

from __future__ import annotations

import json
import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from statistics import median

from scenec.backends.registry import AUTO, backend_class, backend_names
from scenec.backends.run.doctor import start
from scenec.backends.run.executors import ask
from scenec.backends.run.plan import RenderPlan
from scenec.backends.run.units import OfBackend
from scenec.schemas.errors import BackendError, PluginError
from scenec.schemas.records import BackendChoice
from scenec.schemas.units import Executor, Say

#: What ``scenec converge`` measured, in the output folder.
MEASURED = Path("converge", "converge.json")


def choose(out: Path | None, plan: RenderPlan, say: Say = lambda _line: None) -> BackendChoice:
    """Choose the backend that is to render, and say why.

    Where ``scenec converge`` has measured the output, renderers with less variance times seconds
    come first (their efficiency, as Veach 1997 defines it); else, and after these, those of
    ``backend_names`` in turn.

    Args:
        out: Output folder; None: there is none yet.
        plan: What is to be rendered; its ``backend`` does not count.
        say: Told the reasons.

    Raises:
        BackendError: No renderer works here for what is asked.
    """
    costs = {} if out is None else _costs(out / MEASURED)
    names = sorted(backend_names(), key=lambda name: costs.get(name, math.inf))
    order = ", ".join(names) + (f" (variance times seconds, {MEASURED})" if costs else "")
    left_out: dict[str, str] = {}
    for name in names:
        try:
            if backend_class(name, plan.device).denoiser is None and plan.denoise:
                raise BackendError("it has no denoiser")
            ask(OfBackend(name, partial(start, plan.device)))
        except (BackendError, PluginError) as error:
            left_out[name] = str(error)
            say(f"auto: {name} is left out: {error}")
            continue
        say(f"auto: {name} renders: the first that works of {order}")
        return BackendChoice(name, order, left_out)
    reasons = "; ".join(f"{name}: {why}" for name, why in left_out.items())
    raise BackendError(f"no backend works here for what is asked: {reasons}")


@dataclass(frozen=True)
class Quickest:
    """Describes how pictures are drawn that someone waits for.

    Attributes:
        backend: Name.
        spp: Samples a pixel.
        denoise: Whether they are denoised.
        why: What it was preferred for, a line.
    """

    backend: str
    spp: int
    denoise: bool
    why: str


def quickest(works: Callable[[str, bool], bool]) -> Quickest:
    """Chooses what shows a scene soonest: the rasterizer, then path tracers with few samples.

    On two cores pyrender draws a 640 x 480 picture of the demo in 1.2 CPU s (load 0.8), Mitsuba 4
    samples and their denoising in 4.2 (load 1.6), which come closer to the light (FLIP 0.037 in
    place of 0.060). On an H100, with 16 samples, first and further frames took 4.2 and 0.21 s in
    pyrender, 4.5 and 0.25 in Mitsuba (docs/backends.md): a GPU does not change the order.

    Args:
        works: Whether a backend, by its name, starts here, and can denoise if that is asked.

    Raises:
        BackendError: None does.
    """
    if works("pyrender", False):
        return Quickest("pyrender", 8, False, "a rasterizer starts and draws soonest")
    tracers = [name for name in backend_names() if name != "pyrender"]
    for name in tracers:
        if works(name, True):
            return Quickest(name, 4, True, "pyrender does not work here; 4 samples, denoised")
        if works(name, False):
            why = "pyrender does not work here, nor does a denoiser; 16 samples"
            return Quickest(name, 16, False, why)
    raise BackendError(
        "no renderer works here; pip install 'scenec[pyrender]' brings the one that draws soonest"
    )


def works_here(name: str, denoise: bool) -> bool:
    """Tells whether a backend starts here, and has a denoiser if one is asked for."""
    try:
        if denoise and backend_class(name).denoiser is None:
            return False
        ask(OfBackend(name, partial(start, "auto")))
    except (BackendError, PluginError):
        return False
    return True


def _costs(file: Path) -> dict[str, float]:
    """Variance times seconds of each backend with noise that was measured; none without a file."""
    try:
        series = json.loads(file.read_text(encoding="utf-8"))["series"]
        return {
            str(one["backend"]): median(s["seconds"] * s["mean"] ** 2 for s in one["steps"])
            for one in series
            if one["own"] and one["stochastic"] and not one["denoised"]
        }
    except (OSError, ValueError, KeyError, TypeError):
        # Not measured, or not to be told from the noise of its own reference.
        return {}


def check_backend(
    plan: RenderPlan,
    *,
    rgb: bool,
    apertures: Sequence[str] = (),
    executor: Executor | None = None,
) -> None:
    """Refuse what ``render`` would refuse, before there is a stage.

    Starts each renderer that is asked for.

    Args:
        plan: What will be asked.
        rgb: Whether ``rgb`` will be among the passes.
        apertures: Cameras, by name, that ``rgb`` is asked of and that have an aperture.
        executor: Who starts a renderer that is named, and then has it; None: a process of its own.

    Raises:
        BackendError: A backend is not there, does not start, or cannot do what is asked.
    """
    plan.check_rgb(rgb=rgb)
    if plan.denoise and apertures:
        # Imported here: it compiles kernels, which a command has no need of otherwise.
        from scenec.backends.camera.shutter import undenoised

        raise BackendError(undenoised(apertures[0], "aperture"))
    if not rgb:
        # Annotation needs no renderer.
        return
    if plan.backend == AUTO:
        choose(None, plan)
        return
    ask(OfBackend(plan.backend, partial(start, plan.device)), executor)
