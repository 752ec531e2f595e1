"""From an output folder to the ladders of one of its scenes."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from pathlib import Path

from scenec.compiler.cfg.load import Spec, load
from scenec.compiler.views.needed import Keep
from scenec.quality.ladder.base import Base
from scenec.quality.ladder.craters import craters
from scenec.quality.ladder.lod import lod
from scenec.quality.ladder.results import APPROXIMATIONS, Ladder, LadderReport
from scenec.quality.ladder.sky import sky
from scenec.quality.ladder.smoothing import smoothing
from scenec.quality.ladder.tessellation import tessellation
from scenec.quality.ladder.textures import textures
from scenec.schemas.codec import UNSET
from scenec.schemas.errors import CfgError, OutputError, ScenecError
from scenec.schemas.manifest import CFG, MANIFEST, CfgEntry, find_batches, read_manifest
from scenec.schemas.spelling import closest, shown
from scenec.schemas.units import Say

#: Fewest and most rungs of a ladder.
FEWEST, MOST = 2, 12

_LADDERS: dict[str, Callable[[Base, int], list[Ladder] | str]] = {
    "tessellation": tessellation,
    "lod": lod,
    "sky": sky,
    "smoothing": smoothing,
    "craters": craters,
    "textures": textures,
}


def climb(
    out: Path | str,
    *,
    batch: int | None = None,
    cfg: Path | str | None = None,
    rungs: int = 5,
    only: Sequence[str] | None = None,
    say: Say | None = None,
) -> LadderReport:
    """Error against cost of the approximations of a compiled scene, one varied at a time.

    The scene is built again from the cfg and the seed; nothing is written to ``out``.

    Args:
        out: Output folder of ``compile``.
        batch: Which of its scenes; None: the first that is there.
        cfg: The cfg, where it names files that do not lie relative to ``out``.
        rungs: Of each ladder.
        only: Names of approximations; None: all.
        say: Called with a line before each ladder.

    Raises:
        OutputError: The folder holds no output, or its cfg cannot be read from there.
        ScenecError: An unknown approximation, or too few or too many rungs.
        StageError: The batch is not there.
        SceneError: The scene cannot be built any more.
    """
    chosen = _chosen(only)
    if not FEWEST <= rungs <= MOST:
        raise ScenecError(f"--rungs {rungs}: expected {FEWEST} to {MOST}")
    out = Path(out)
    manifest = read_manifest(out)
    index = find_batches(out, None if batch is None else [batch])[0].index
    said = manifest.cfg or CfgEntry()
    if said.sha256 is UNSET or manifest.seed is UNSET:
        raise OutputError(f"{out / MANIFEST}: does not say what it was compiled from")
    spec = _load(out, said, None if cfg is None else Path(cfg))
    attempt = next(b.attempt or 0 for b in manifest.batches if b.index == index)
    keep = _keep(out, manifest.keep or Keep.SEEN)
    base = Base(spec, manifest.seed, index, keep, attempt)
    return climb_base(base, chosen, rungs, say)


def climb_base(base: Base, only: Sequence[str], rungs: int, say: Say | None = None) -> LadderReport:
    """The ladders of a scene that no output holds; arguments as of ``climb``."""
    ladders: list[Ladder] = []
    absent: dict[str, str] = {}
    for name in only:
        if say is not None:
            say(f"climbing {name}")
        result = _LADDERS[name](base, rungs)
        if isinstance(result, str):
            absent[name] = result
        else:
            ladders.extend(result)
    plan = base.plan
    return LadderReport(plan.name, base.seed, plan.batch, tuple(ladders), absent)


def _chosen(only: Sequence[str] | None) -> list[str]:
    for name in only or ():
        if name not in APPROXIMATIONS:
            guess = closest(name, list(APPROXIMATIONS))
            raise ScenecError(
                f"--only {shown(name)}: expected some of {','.join(APPROXIMATIONS)}"
                + (f"; did you mean {shown(guess)}?" if guess else "")
            )
    return [name for name in APPROXIMATIONS if only is None or name in only]


def _keep(out: Path, word: object) -> Keep:
    try:
        return Keep(str(word))
    except ValueError as error:
        raise OutputError(
            f"{out / MANIFEST}: keep {shown(word)}: expected one of {', '.join(Keep)}; "
            "another version of scenec wrote it"
        ) from error


def _load(out: Path, said: CfgEntry, cfg: Path | None) -> Spec:
    """The cfg of an output folder; one that is given instead must be the same.

    Args:
        out: The folder.
        said: What its manifest says of the cfg.
        cfg: Given instead.

    Raises:
        OutputError: It is another, or files that it names are not found.
    """
    digest = said.sha256
    if cfg is not None:
        spec = load(cfg, said.settings or ())
        if spec.digest != digest:
            raise OutputError(
                f"{cfg}: is not the cfg that {out} was compiled from, or a file that it names or "
                "scenec itself has changed since; compile it again"
            )
        return spec
    try:
        spec = load(out / CFG)
    except CfgError as error:
        raise OutputError(
            f"{error.faults[0]}; files that a cfg names are looked for beside it: say where it "
            "was when it was compiled, by --cfg CFG"
        ) from error
    if spec.digest != digest:
        raise OutputError(
            f"{out / CFG}: is not what {out} was compiled from: a file that it names, or scenec "
            "itself, has changed; give the cfg by --cfg CFG, or compile it again"
        )
    return spec
