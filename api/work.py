"""Compile, render and scan: the main calls."""

from __future__ import annotations

from collections.abc import Collection
from contextlib import nullcontext
from typing import TYPE_CHECKING

from scenec.api.declare import Spread
from scenec.api.options import CompileOptions, RenderOptions, RunOptions, ScanOptions
from scenec.api.outputs import OutputFolder
from scenec.api.steps import (
    AnyCfg,
    Folder,
    compile_spec,
    hire,
    read_cfg,
    refuse_early,
    render_output,
    scan_output,
)
from scenec.schemas.errors import SceneError

if TYPE_CHECKING:
    from scenec.compiler.cfg.load import Spec
    from scenec.schemas.units import Executor


@Spread(CompileOptions).two
def compile(cfg: AnyCfg, out: Folder, options: CompileOptions) -> OutputFolder:
    """Compiles a cfg into USD stages, one per batch.

    The same cfg, seed and version give the same bytes in every file of the manifest.

    Args:
        cfg: A file, ``package:configs/NAME``, a dict, or a ``Cfg`` of ``compiler.cfg.builder``.
        out: Output folder; made if it is not there.
        options: As fields of ``CompileOptions``.

    Returns:
        The output; what was done is in ``compiled``.

    Raises:
        CfgError: The cfg has faults; all of them are in the error.
        SceneError: What the cfg asks for cannot be built; batches before that one are there.
        OutputError: The folder cannot be written, or holds what is not to be replaced.
    """
    report = compile_spec(read_cfg(cfg, options.settings), out, options, options.seed)
    return OutputFolder(out, compiled=report)


@Spread(RenderOptions).one
def render(out: Folder, options: RenderOptions) -> OutputFolder:
    """Renders what is not rendered yet: every batch, camera and sample.

    Args:
        out: Output folder of a compile, or a USD file (its frames go beside it).
        options: As fields of ``RenderOptions``.

    Returns:
        The output; what was done is in ``rendered``, frames that were given up among it.

    Raises:
        StageError: There is nothing to render, or no stage can be read.
        BackendError: The backend is not there, or cannot do what is asked.
        OutputError: There is no manifest, or a frame cannot be written or is not to be replaced.
    """
    return OutputFolder(out, rendered=render_output(out, options))


@Spread(ScanOptions).one
def scan(out: Folder, options: ScanOptions) -> OutputFolder:
    """Scans with all lidars; needs no renderer.

    Args:
        out: Output folder of a compile, or a USD file.
        options: As fields of ``ScanOptions``.

    Returns:
        The output; what was done is in ``scanned``.

    Raises:
        StageError: A stage cannot be read, or no stage has what is asked for.
        OutputError: A file cannot be written.
        BackendError: Workers died over it, again and again.
    """
    return OutputFolder(out, scanned=scan_output(out, options))


@Spread(RunOptions).two
def run(cfg: AnyCfg, out: Folder, options: RunOptions) -> OutputFolder:
    """Compiles a cfg, renders it, and scans where there are lidars.

    Args:
        cfg: As of ``compile``.
        out: Output folder; made if it is not there.
        options: As fields of ``RunOptions``.

    Returns:
        The output, with what was done.

    Raises:
        SceneError: A batch cannot be built; those before it are rendered.
        CfgError, StageError, BackendError, OutputError: As of ``compile`` and ``render``.
    """
    spec = read_cfg(cfg, options.settings)
    # Its worker starts the renderer now, and has it once there is a stage.
    with hire(options) if options.cluster is None else nullcontext() as executor:
        return _run(spec, out, options, executor)


def _run(spec: Spec, out: Folder, options: RunOptions, executor: Executor | None) -> OutputFolder:
    lidars = refuse_early(options, spec.cfg, executor)
    compiled = scanned = stopped = None
    batches: Collection[int] | None = options.batches
    try:
        compiled = compile_spec(spec, out, options, options.seed)
    except SceneError as error:
        if not error.batches:
            raise
        # What compiled before it is rendered all the same; that it stopped is said at the end.
        stopped, batches = error, error.batches
    if lidars:
        # First: where no camera is triggered rendering ends in an error.
        scanned = scan_output(out, options, batches=batches)
    rendered = render_output(out, options, executor, batches)
    if stopped is not None:
        raise stopped
    return OutputFolder(out, compiled=compiled, rendered=rendered, scanned=scanned)
