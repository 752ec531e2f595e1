"""Error against cost: of renderers, and of the compiler's own approximations."""

from __future__ import annotations

from collections.abc import Collection, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

from scenec.api import forms
from scenec.api.declare import CallOptions, Spread, held, option
from scenec.api.options import ALLOW_MISSING
from scenec.api.steps import Folder

if TYPE_CHECKING:
    from scenec.quality.converge import ConvergeReport
    from scenec.quality.ladder import LadderReport


@dataclass(frozen=True, kw_only=True)
class ConvergeOptions(CallOptions):
    """Holds options of ``converge``."""

    backends: Sequence[str] = option(
        ("mitsuba",), "default: mitsuba", form=forms.names, metavar="A,B,…"
    )
    spp: Sequence[int] | None = option(
        None,
        "samples per pixel of the rungs (default: 4,16,64,256; none with --seconds)",
        form=forms.ascending(forms.positive),
        metavar="N,N,…",
    )
    seconds: Sequence[float] | None = option(
        None,
        "rungs by seconds a frame instead, or too",
        form=forms.ascending(forms.amount),
        metavar="S,S,…",
    )
    repeats: int = option(4, "seeds of each rung (default: 4)", form=forms.positive, metavar="N")
    reference: int | None = option(
        None,
        "samples per pixel of each backend's reference (default: 8 times the highest rung)",
        form=forms.positive,
        metavar="N",
    )
    samples: Collection[int] = option(
        range(1), "default: the first", form=forms.span, metavar="A:B"
    )
    batches: Collection[int] = option(
        range(1), "default: the first", form=forms.span, metavar="A:B"
    )
    cameras: Sequence[str] | None = option(None, "only these", form=forms.names, metavar="A,B,…")
    denoise: bool = option(False, "climb again with denoising, where there is one")
    device: str = option("auto", "default: auto", metavar="NAME")
    allow_missing: bool = option(False, ALLOW_MISSING)


@dataclass(frozen=True, kw_only=True)
class LadderOptions(CallOptions):
    """Holds options of ``ladder``.

    Attributes:
        batch: Of which scene; None takes the first there is.
    """

    batch: int | None = held(None, form=forms.counted)
    cfg: Path | str | None = option(
        None, "the cfg, where files that it names are not found beside OUT's", metavar="CFG"
    )
    rungs: int = option(
        5,
        "of each ladder, 2 to 12 (default: 5)",
        form=forms.whole(2, 12, "a whole number from 2 to 12"),
        metavar="K",
    )
    only: Sequence[str] | None = option(
        None,
        "of tessellation,lod,sky,smoothing,craters,textures",
        form=forms.names,
        metavar="A,B,…",
    )


@Spread(ConvergeOptions).one
def converge(out: Folder, options: ConvergeOptions) -> ConvergeReport:
    """Renders a ladder of qualities with each backend, and writes ``OUT/converge/``.

    Args:
        out: Output folder of a compile, or a USD file (``converge`` then lies beside it).
        options: As fields of ``ConvergeOptions``.

    Raises:
        BackendError: There is no such backend, or a ladder has no rungs.
        StageError: A stage cannot be read, or has no such sample or camera.
        OutputError: There is no manifest, or a file cannot be written.
    """
    from scenec.quality.converge import Ladder, converge

    spp = options.spp
    if spp is None:
        spp = () if options.seconds else Ladder().spp
    ladder = Ladder(
        spp=tuple(spp),
        seconds=tuple(options.seconds or ()),
        repeats=options.repeats,
        reference_spp=options.reference,
        denoise=options.denoise,
        samples=options.samples,
        cameras=None if options.cameras is None else tuple(options.cameras),
        device=options.device,
        allow_missing=options.allow_missing,
    )
    say = options.listener.say
    return converge(out, options.backends, ladder, batches=options.batches, say=say)


@Spread(LadderOptions).one
def ladder(out: Folder, options: LadderOptions) -> LadderReport:
    """Varies each approximation of a compiled scene alone: error measured and claimed, and cost.

    The scene is built again from its cfg and seed; nothing is written to ``out``.

    Args:
        out: Output folder of a compile.
        options: As fields of ``LadderOptions``.

    Raises:
        OutputError: The folder holds no output, or its cfg cannot be read from there.
        StageError: There is no such batch.
        SceneError: The scene cannot be built any more.
        ScenecError: There is no such approximation.
    """
    from scenec.quality.ladder import climb

    return climb(
        out,
        batch=options.batch,
        cfg=options.cfg,
        rungs=options.rungs,
        only=options.only,
        say=options.listener.say,
    )
