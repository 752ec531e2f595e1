"""The name until 0.19 of what ``import scenec`` gives; it goes with the next version."""

from __future__ import annotations

import warnings
from pathlib import Path
from typing import Any

from scenec.api.outputs import OutputFolder as Output
from scenec.api.shown import FrameView as Frame
from scenec.api.shown import StageView as Stage
from scenec.compiler.cfg.builder import CompleteCfg
from scenec.compiler.compile import compile_cfg

__all__ = ["Frame", "Output", "Stage", "compile"]

warnings.warn(
    "scenec.cli.notebook is scenec now: import scenec; scenec.compile(cfg, OUT)",
    DeprecationWarning,
    stacklevel=2,
)


def compile(
    cfg: CompleteCfg | Path | str, out: Path | str, seed: int = 0, **options: Any
) -> Output:
    """Compiles a cfg, as ``scenec.compile`` does, with the options of ``compile_cfg``."""
    given = cfg.check() if isinstance(cfg, CompleteCfg) else cfg
    compile_cfg(given, seed=seed, out=out, **options)
    return Output(out)
