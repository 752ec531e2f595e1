"""``scenec run``: compile, render, and scan where there are lidars."""

from __future__ import annotations

import argparse
from contextlib import ExitStack
from typing import TYPE_CHECKING

from scenec.cli import compile_command
from scenec.cli.output import print_json, say_next, status
from scenec.schemas.errors import SceneError

if TYPE_CHECKING:
    from scenec.compiler.cfg.fill import Cfg
    from scenec.compiler.cfg.load import Spec
    from scenec.schemas.units import Executor


def run(options: argparse.Namespace) -> int:
    """Compiles, renders, and scans.

    Raises:
        SceneError: A batch cannot be built; those before it are rendered.
    """
    status(f"reading {options.cfg}")
    from scenec.cli.render_command import executor_of
    from scenec.compiler.cfg.load import load

    spec = load(options.cfg, options.settings)
    with ExitStack() as stack:
        executor = None
        if options.cluster is None:
            # Its worker starts the renderer now, and has it once there is a stage.
            executor = stack.enter_context(executor_of(options))
        return _run(options, spec, executor)


def _run(options: argparse.Namespace, spec: Spec, executor: Executor | None) -> int:
    from scenec.cli import render_command

    lidars = refuse_early(options, spec.cfg, executor)
    made: dict[str, object] = {}
    stopped: SceneError | None = None
    failed = False
    try:
        compiled = compile_command.compile_now(options, spec)
        made["compile"] = compile_command.as_json(compiled)
        failed = bool(compiled.failed)
    except SceneError as error:
        if not error.batches:
            raise
        # What compiled before it is rendered all the same; that it stopped is said at the end.
        stopped, options.batches = error, error.batches
    if lidars:
        from scenec.cli import scan_command

        # First: where no camera is triggered rendering ends in an error.
        scanned = scan_command.scan_now(options)
        made["scan"] = scan_command.as_json(scanned)
        failed = failed or bool(scanned.failed)
    rendered = render_command.render_now(options, executor)
    made["render"] = render_command.as_json(rendered)
    if options.json:
        print_json(made)
    if stopped is not None:
        raise stopped
    say_next(("view", options.out), ("export --format coco", options.out))
    return 1 if failed or rendered.failed else 0


def refuse_early(options: argparse.Namespace, cfg: Cfg, executor: Executor | None = None) -> bool:
    """What no renderer here can do should not cost a compilation.

    Args:
        options: Of the command line.
        cfg: What will be compiled.
        executor: Who starts the renderer, and has it then; None: a process of its own.

    Returns:
        Whether there are lidars.

    Raises:
        BackendError: The backend cannot render what is asked for.
    """
    from scenec.backends.run.auto import check_backend
    from scenec.cli.render_command import plan_of
    from scenec.schemas.frames import ANNOTATION_NAMES

    wanted = options.passes
    rigs = cfg["rigs"]
    sensors = {f"{rig}_{name}": s for rig in rigs for name, s in rigs[rig]["sensors"].items()}
    drawn = [n for n, s in sensors.items() if "rgb" in (wanted or s["outputs"])]
    if wanted is None:
        wanted = [name for s in sensors.values() for name in s["outputs"]]
        if options.backend in ANNOTATION_NAMES and set(wanted) != {"rgb"}:
            # All but that is made.
            wanted = [name for name in wanted if name != "rgb"]
    apertures = [name for name in drawn if "focus" in sensors[name]]
    check_backend(plan_of(options), rgb="rgb" in wanted, apertures=apertures, executor=executor)
    return any("lidars" in rig for rig in rigs.values())
