"""What is asked of a render, refused before it begins where it cannot be done."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from typing import Any

from scenec.backends.registry import AUTO, backend_names, require_name
from scenec.backends.run.auto import choose
from scenec.backends.run.jobs import Wanted
from scenec.backends.run.supervise import WorkerProcess
from scenec.schemas.errors import BackendError, ScenecError


def check_backend(
    backend: str,
    *,
    device: str = "auto",
    denoise: bool = False,
    error: float | None = None,
    seconds: float | None = None,
    rgb: bool = True,
    apertures: Sequence[str] = (),
) -> None:
    """Refuse what ``render`` would refuse, before there is a stage.

    Starts each renderer that is asked for, in a process of its own.

    Args:
        backend: As for ``render``.
        device: As for ``render``.
        denoise: As for ``render``.
        error: As for ``render``.
        seconds: As for ``render``.
        rgb: Whether ``rgb`` will be among the passes.
        apertures: Cameras, by name, that ``rgb`` is asked of and that have an aperture.

    Raises:
        BackendError: A backend is not there, does not start, or cannot do what is asked.
    """
    wanted = Wanted(
        backend, device=device, denoise=denoise, error=error, seconds=seconds,
    )  # fmt: skip
    check_words(wanted, rgb)
    if denoise and apertures:
        # Imported here: it compiles kernels, which a command has no need of otherwise.
        from scenec.backends.camera.shutter import undenoised

        raise BackendError(undenoised(apertures[0], "aperture"))
    if not rgb:
        # Annotation needs no renderer.
        return
    if backend == AUTO:
        choose(None, wanted)
        return
    found = _describe(backend, device)
    if denoise and found["denoiser"] is None:
        raise no_denoiser(backend)


def check_words(wanted: Wanted, rgb: bool) -> None:
    """Refuse what no stage and no machine could make possible.

    Args:
        wanted: What is asked.
        rgb: Whether ``rgb`` will be among the passes, as far as is known.

    Raises:
        BackendError: There is no such backend, or a number is none that can be rendered to.
    """
    if wanted.backend != AUTO:
        require_name(wanted.backend)
    if wanted.spp < 1:
        raise BackendError(f"samples per pixel must be at least 1, not {wanted.spp}")
    for name, value in (("error", wanted.error), ("seconds", wanted.seconds)):
        if value is not None and not 0.0 < value < math.inf:
            raise BackendError(f"{name} to render to must be a number above 0, not {value}")
    check_rgb(wanted, rgb)


def check_rgb(wanted: Wanted, rgb: bool) -> None:
    """Refuse what is asked of ``rgb`` where there is none.

    Raises:
        BackendError: There is none.
    """
    if wanted.denoise and not rgb:
        raise BackendError(
            "there is nothing to denoise without rgb; ask for rgb, or do not denoise"
        )
    if not rgb and (wanted.error is not None or wanted.seconds is not None):
        raise BackendError(
            "error and seconds are targets of rgb; ask for rgb, or leave the targets out"
        )


def no_denoiser(backend: str) -> BackendError:
    """The error of a backend that was asked to denoise and cannot; names those that can."""
    have = []
    for name in backend_names():
        try:
            denoiser = None if name == backend else _describe(name, "auto")["denoiser"]
        except ScenecError:
            # Not installed, or does not start: no help here.
            continue
        if denoiser is not None:
            have.append(f"{name} has one ({denoiser})")
    others = "; " + ", ".join(have) if have else ", nor has any other that works here"
    return BackendError(f"backend {backend} has no denoiser{others}")


def _describe(backend: str, device: str) -> dict[str, Any]:
    request = {"op": "describe", "backend": backend, "device": device, "rgb": True}
    with WorkerProcess() as worker:
        return worker.ask(request, f"backend {backend}")


#: What a stage holds only if some camera asked for it, and only what such cameras see.
_PRUNED_BY = ("rgb", "label", "instance")


def unasked(cameras: list[dict[str, Any]]) -> Iterator[str]:
    """A line for each camera that is to render what its stage was not compiled for."""
    for camera in cameras:
        asked = {name.split(".")[0] for name in camera["passes"]}
        missing = [n for n in _PRUNED_BY if n in asked and n not in camera["outputs"]]
        if missing:
            yield (
                f"camera {camera['name']} did not ask for {', '.join(missing)}: what only that "
                "would show may not be in the stage; compile with that output, or with --keep all"
            )
