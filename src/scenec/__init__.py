"""Scenes from a cfg and a seed: USD stages, pictures, exact annotation.

Each name is imported when it is first used, so that ``import scenec`` costs nothing.
"""

from __future__ import annotations

import importlib
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from scenec.api.check import check
    from scenec.api.evaluate import evaluate
    from scenec.api.explain.explanation import explain
    from scenec.api.explain.why import why
    from scenec.api.export import export
    from scenec.api.listener import Listener
    from scenec.api.make import import_scene, settle_objects
    from scenec.api.measure import converge, ladder
    from scenec.api.outputs import OutputFolder, open_frames
    from scenec.api.preview import preview
    from scenec.api.shown import FrameView, StageView
    from scenec.api.stream import StreamFrame, stream
    from scenec.api.sweep import sweep
    from scenec.api.view import view
    from scenec.api.work import compile, render, run, scan

__all__ = [
    "FrameView", "Listener", "OutputFolder", "StageView", "StreamFrame", "check", "compile",
    "converge", "evaluate", "explain", "export", "import_scene", "ladder", "open_frames", "preview",
    "render", "run", "scan", "settle_objects", "stream", "sweep", "view", "why",
]  # fmt: skip
#: Public name -> the module of ``scenec.api`` that has it, where that is named otherwise.
_HOMES = {name: name for name in __all__} | {
    **dict.fromkeys(("FrameView", "StageView"), "shown"),
    **dict.fromkeys(("import_scene", "settle_objects"), "make"),
    **dict.fromkeys(("converge", "ladder"), "measure"),
    **dict.fromkeys(("OutputFolder", "open_frames"), "outputs"),
    **dict.fromkeys(("compile", "render", "run", "scan"), "work"),
    "Listener": "listener",
    "StreamFrame": "stream",
    "explain": "explain.explanation",
    "why": "explain.why",
}

if not TYPE_CHECKING:

    def __getattr__(name: str) -> object:
        if name == "__version__":
            from scenec.schemas.versions import version_of

            return version_of()
        if name not in _HOMES:
            raise AttributeError(f"module 'scenec' has no attribute {name!r}")
        value = getattr(importlib.import_module(f"scenec.api.{_HOMES[name]}"), name)
        globals()[name] = value
        return value


def __dir__() -> list[str]:
    return sorted({*globals(), *__all__, "__version__"})
