"""Scenes from a cfg and a seed: USD stages, pictures, exact annotation.

Each name is imported when it is first used, so that ``import scenec`` costs nothing.
"""

from __future__ import annotations

import importlib
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from scenec.api.outputs import Output, Stage, compile

#: Public name -> the module of ``scenec.api`` that has it.
_HOMES = {
    "compile": "outputs",
    "Output": "outputs",
    "Stage": "outputs",
}
__all__ = ["Output", "Stage", "compile"]

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
