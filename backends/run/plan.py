"""Declares the plan of a render, which is checked when it is made, before anything is read."""

from __future__ import annotations

import math
from collections.abc import Collection, Sequence
from dataclasses import dataclass
from pathlib import Path

from scenec.backends.picture.adaptive import MOST_SPP
from scenec.backends.registry import AUTO, backend_class, backend_names, require_name
from scenec.schemas.errors import BackendError
from scenec.schemas.frames import FrameKey, quality
from scenec.schemas.passes import ANNOTATION_NAMES

#: Samples per pixel where a user says nothing.
USUAL_SPP = 64


@dataclass(frozen=True)
class RenderPlan:
    """Declares what to render, and how well.

    What else is told of a field stands at ``scenec.api.options.RenderOptions``, of which a
    command's plan is made.

    Attributes:
        backend: Name, see ``registry``; "auto" for the first that works (``run.auto``).
            Without ``rgb`` no renderer starts, and frames go to ``frames/annotation``.
        passes: ``amodal`` brings ``instance`` with it; None takes the stage's own choice.
        samples, batches, cameras: Only these: time codes, numbers, names.
        spp: None is 64; with ``error`` or ``seconds`` 4096.
        error: As of ``noise.estimate``.
        seconds: A frame's, without loading and annotation; one that is there still counts as made.
        denoise: Whether to; the error that remains is then unknown.
        rgb: "float", or "half" for half floats in the frame's EXR.
        noise_seed: Renderings with different ones have independent noise.
        device: One of the backend's devices, or "auto".
        folder: Where frames go (``<folder>/frames``; for several batches, a folder each in it);
            None puts them into the batches' own.
        allow_missing: Sidecars then say what was missing, under ``losses``, and a later render of
            the whole stage makes these frames again.
        replace: Whether frames of the same stage may be replaced that have what this plan does not
            ask for.

    Raises:
        BackendError: What no stage and no machine could make possible: there is no such backend, it
            has no such device or no denoiser, or a number is none that can be rendered to.
    """

    backend: str
    passes: Sequence[str] | None = None
    samples: Collection[int] | None = None
    batches: Collection[int] | None = None
    cameras: Collection[str] | None = None
    spp: int | None = None
    error: float | None = None
    seconds: float | None = None
    denoise: bool = False
    rgb: str = "float"
    noise_seed: int = 0
    device: str = "auto"
    folder: Path | None = None
    allow_missing: bool = False
    replace: bool = False

    def __post_init__(self) -> None:
        if self.backend != AUTO:
            require_name(self.backend)
        if self.most_spp < 1:
            raise BackendError(f"samples per pixel must be at least 1, not {self.spp}")
        for name, value in (("error", self.error), ("seconds", self.seconds)):
            if value is not None and not 0.0 < value < math.inf:
                raise BackendError(f"{name} to render to must be a number above 0, not {value}")
        self.check_rgb(rgb=self.passes is None or "rgb" in self.passes)

    @property
    def most_spp(self) -> int:
        """Samples per pixel; with a target the most there may be."""
        if self.spp is not None:
            return self.spp
        return USUAL_SPP if self.error is None and self.seconds is None else MOST_SPP

    @property
    def quality(self) -> str:
        """Describes how well ``rgb`` is rendered, in words."""
        return quality(self.most_spp, self.error, self.seconds)

    def check_rgb(self, *, rgb: bool) -> None:
        """Refuse what cannot be had of ``rgb``: where there is none, or of its backend.

        Args:
            rgb: Whether ``rgb`` is among the passes, as far as is known.

        Raises:
            BackendError: There is none, or its backend has no such device or no denoiser.
        """
        if not rgb and self.denoise:
            raise BackendError(
                "there is nothing to denoise without rgb; ask for rgb, or do not denoise"
            )
        if not rgb and self.rgb == "half":
            raise BackendError("there is no rgb to write as half; ask for rgb, or leave half out")
        if not rgb and (self.error is not None or self.seconds is not None):
            raise BackendError(
                "error and seconds are targets of rgb; ask for rgb, or leave the targets out"
            )
        if not rgb or self.backend == AUTO or self.backend in ANNOTATION_NAMES:
            return
        if self.device != "auto":
            backend_class(self.backend, self.device)
        if self.denoise and backend_class(self.backend).denoiser is None:
            extra = backend_class(self.backend).denoiser_extra
            mend = f" here: pip install 'scenec[{extra}]'" if extra else ""
            raise BackendError(f"backend {self.backend} has no denoiser{mend}{_denoisers()}")

    def key(self, digest: str, passes: Sequence[str], backend: str, version: str) -> FrameKey:
        """Returns the resume key of a frame: all that decides its content.

        Args:
            digest: Of the stage.
            passes: Of this frame, as ``Session.passes`` returns them.
            backend: Who draws it, or "annotation".
            version: Of that.
        """
        pictures = "rgb" in passes
        return FrameKey(
            stage_digest=digest,
            passes=tuple(passes),
            spp=self.most_spp if pictures else 0,
            noise_seed=self.noise_seed if pictures else 0,
            backend=backend,
            backend_version=version,
            denoise=self.denoise and pictures,
            half=self.rgb == "half" and pictures,
            error=self.error if pictures else None,
            seconds=self.seconds if pictures else None,
        )


def _denoisers() -> str:
    """Lists other backends that have a denoiser."""
    have = []
    for name in backend_names():
        try:
            denoiser = backend_class(name).denoiser
        except BackendError:
            # Not installed: no help here.
            continue
        if denoiser is not None:
            have.append(f"{name} has one ({denoiser})")
    return "; " + ", ".join(have) if have else ", nor has any other that is installed"
