"""Makes what a cfg is made of: poses of objects that fell, and cfgs of other programs' scenes."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

from scenec.api import forms
from scenec.api.declare import CallOptions, Spread, held, option
from scenec.api.steps import AnyCfg, Folder, read_cfg
from scenec.schemas.errors import ScenecError

if TYPE_CHECKING:
    from scenec.importers.output import Imported
    from scenec.settle.settle import SettleReport

#: Formats that can be imported, and what is given of each.
FORMATS = {
    "oaisys": "a cfg of OAISYS, of any generation",
    "usd": "a stage of USD with its meshes, lights and cameras",
    "blenderproc": "a folder of a BOP scene, or of BlenderProc's HDF5 files with camera and "
    "object states",
}
#: As in ``scenec.importers.usd.scene``, which would cost the import of USD; a test compares them.
KEEP = ("cameras", "light")


@dataclass(frozen=True, kw_only=True)
class SettleOptions(CallOptions):
    """Holds options of ``settle_objects``.

    Attributes:
        settings, seed: As of ``CompileOptions``.
    """

    objects: Sequence[str] = option(
        (),
        "classes to drop, of type placed or meshes",
        form=forms.names,
        metavar="CLASS,…",
        required=True,
    )
    among: Sequence[str] | None = option(
        None,
        "classes that they may fall onto (default: all of type placed and rocks)",
        form=forms.names,
        metavar="CLASS,…",
    )
    batch: int = option(0, "on whose ground (default: 0)", form=forms.counted, metavar="B")
    attempt: int = option(
        0,
        "how often --faults redraw drew it again: attempt in the manifest (default: 0)",
        form=forms.counted,
        metavar="N",
    )
    drop: float | None = option(
        None,
        "least height over the ground to fall from (default: a tenth of the object)",
        form=forms.number,
        metavar="METERS",
    )
    friction: float = option(0.6, "default: 0.6", form=forms.number)
    restitution: float = option(0.1, "speed kept in a bounce (default: 0.1)", form=forms.number)
    cells: int = option(
        8,
        "cells of the ground across an object: finer and slower with more (default: 8)",
        form=forms.positive,
    )
    max_steps: int = option(20000, "give up waiting for rest (default: 20000)", form=forms.counted)
    settings: Sequence[str] = held((), many=True)
    seed: int = held(0, form=forms.seed)


@dataclass(frozen=True, kw_only=True)
class ImportOptions(CallOptions):
    """Holds options of ``import_scene``."""

    assets: Sequence[str] = option(
        (),
        "look here first for the files that are named (repeatable; default: the source's folder "
        "and three above it)",
        many=True,
        metavar="DIR",
    )
    stand_ins: bool = option(
        False, "put procedural rocks, grounds and skies in the place of files that are missing"
    )
    ground: str = option(
        "",
        "of usd: the mesh that is the ground, a path or a name (default: the widest)",
        metavar="PRIM",
    )
    keep: Sequence[str] = option(
        (),
        "of usd: leave cameras, light or both as they are, in place of varying them",
        form=forms.some_of(KEEP),
        metavar="A,B",
    )


@Spread(SettleOptions).two
def settle_objects(cfg: AnyCfg, out: Folder, options: SettleOptions) -> SettleReport:
    """Drops objects onto the ground of a batch until all rest; writes tables of their poses.

    Args:
        cfg: As of ``compile``.
        out: The CSV file; with several classes ``STEM_CLASS.csv`` for each.
        options: As fields of ``SettleOptions``.

    Raises:
        CfgError: The cfg has faults.
        SceneError: It cannot be built, a class cannot be dropped, or the library is missing.
        OutputError: A file cannot be written.
    """
    spec = read_cfg(cfg, options.settings)
    for line in spec.warnings:
        options.listener.warn(str(line))
    from scenec.settle.settle import settle
    from scenec.settle.world import Options

    return settle(
        spec,
        seed=options.seed,
        objects=options.objects,
        out=out,
        batch=options.batch,
        attempt=options.attempt,
        among=options.among,
        options=Options(
            drop_m=options.drop,
            friction=options.friction,
            restitution=options.restitution,
            cells=options.cells,
            max_steps=options.max_steps,
        ),
        progress=options.listener.say,
    )


@Spread(ImportOptions).three
def import_scene(
    format: str, source: Path | str, out: Path | str, options: ImportOptions
) -> Imported:
    """Imports another program's scene: writes a cfg, and beside it the files that it needs.

    Args:
        format: "oaisys", "usd" or "blenderproc".
        source: What is imported: a cfg of OAISYS, a stage, a folder.
        out: The cfg, .json.
        options: As fields of ``ImportOptions``.

    Returns:
        What was written; its ``report`` says what became of each value.

    Raises:
        CfgError: The source has faults; nothing is written.
        OutputError: The cfg is there already, or cannot be written.
    """
    from scenec.importers.output import check_free, write

    if format not in FORMATS:
        raise ScenecError(f"format: {format!r}: expected one of {', '.join(FORMATS)}")
    source, out = Path(source), Path(out)
    check_free(out)
    imported = _read(format, source, out, options)
    for line in write(imported):
        options.listener.warn(line)
    return imported


def _read(format: str, source: Path, out: Path, options: ImportOptions) -> Imported:
    folders = [Path(folder) for folder in options.assets]
    if format == "usd":
        from scenec.importers.usd.read import import_usd

        return import_usd(source, out, ground=options.ground, keep=options.keep)
    if format == "blenderproc":
        from scenec.importers.blenderproc.read import import_blenderproc

        return import_blenderproc(source, out, folders=folders, stand_ins=options.stand_ins)
    from scenec.importers.oaisys.read import import_oaisys

    return import_oaisys(source, out, folders=folders, stand_ins=options.stand_ins)
