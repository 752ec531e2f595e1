"""The name until 0.19 of what ``import scenec`` gives; it goes with the next version."""

from __future__ import annotations

import warnings

from scenec.api.outputs import Frame, Output, Stage, compile

__all__ = ["Frame", "Output", "Stage", "compile"]

warnings.warn(
    "scenec.cli.notebook is scenec now: import scenec; scenec.compile(cfg, OUT)",
    DeprecationWarning,
    stacklevel=2,
)
