"""Passes by name: ours, and those of other packages (``scenec.schemas.passes``)."""

from __future__ import annotations

import importlib
from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import partial
from typing import Any

import numpy as np
from numpy.typing import NDArray

from scenec.backends.annotation.contract import Pass, View
from scenec.backends.stage.scene import RenderScene
from scenec.schemas.correspondence import BEFORE, NEXT, PARTNER
from scenec.schemas.depth_camera import MEASURED
from scenec.schemas.errors import BackendError, ScenecError
from scenec.schemas.passes import BUILT_IN, GROUP, LABEL, pass_names
from scenec.schemas.plugins import entry_points_of, error_line, load_offered, place
from scenec.schemas.spelling import nearest, shown

#: Modules of ours but ``passes``, where the others are; a pass is its name in capitals.
_MODULES = {MEASURED: "depth_camera", "slope": "terrain", "traversable": "terrain"} | dict.fromkeys(
    (*NEXT, *BEFORE, *PARTNER), "correspondence"
)


def select(scene: RenderScene, names: Sequence[str]) -> dict[str, Pass]:
    """The annotation passes that a list of names stands for, those of the whole picture last.

    Args:
        scene: The scene, for its label levels.
        names: As users ask for them: ``label`` stands for all levels; ``rgb`` is no annotation and
            is skipped.

    Returns:
        Passes by name, with those that they need.

    Raises:
        BackendError: There is no such pass, or it cannot be loaded.
    """
    labels = [f"{LABEL}.{level}" for level in scene.levels]
    selected: dict[str, Pass] = {}
    waiting = [name for name in reversed(names) if name != "rgb"]
    while waiting:
        name = waiting.pop()
        if name == LABEL:
            waiting += reversed(labels)
        elif name not in selected:
            selected[name] = _find_level(name, labels) if "." in name else find_pass(name)
            waiting += reversed(selected[name].needs)
    return dict(sorted(selected.items(), key=lambda item: item[1].whole))


def _find_level(name: str, labels: Sequence[str]) -> Pass:
    if name not in labels:
        raise BackendError(f"no pass {shown(name)}{nearest(name, (*labels, *pass_names()))}")
    every = find_pass(LABEL)
    compute = partial(every.compute, level=name.removeprefix(f"{LABEL}."))
    return replace(every, name=name, compute=compute)


def find_pass(name: str) -> Pass:
    """Import a pass.

    Raises:
        BackendError: There is none of this name, or several; or it is not what it should be.
    """
    points = entry_points_of(GROUP, name)
    if len(points) + (name in BUILT_IN) > 1:
        ours = ["scenec"] if name in BUILT_IN else []
        listed = ", ".join([*ours, *map(place, points)])
        raise BackendError(f"several passes have the name {shown(name)}: {listed}; uninstall one")
    if name in BUILT_IN:
        module = f"scenec.backends.annotation.{_MODULES.get(name, 'passes')}"
        result: Pass = getattr(importlib.import_module(module), name.upper())
        return result
    if not points:
        raise BackendError(f"no pass {shown(name)}{nearest(name, pass_names())}")
    made, who = load_offered(GROUP, name, f"pass {shown(name)}", BackendError)
    fault = _fault(made, name)
    if fault is not None:
        raise BackendError(f"{who}: {fault}")
    return replace(made, compute=_guarded(made, who))


def _fault(candidate: Any, name: str) -> str | None:
    """Returns the first fault of another package's pass, in words; None if it has none."""
    if not isinstance(candidate, Pass):
        return f"expected a {Pass.__module__}.{Pass.__name__}, not {type(candidate).__name__}"
    if candidate.name != name or not name.isidentifier():
        return (
            f"its name is {shown(candidate.name)}: expected that of its entry point, an identifier"
        )
    if not candidate.channels or list(candidate.channels) != sorted(set(candidate.channels)):
        return f"its channels are {list(candidate.channels)}: expected names in alphabetical order"
    if candidate.dtype not in ("float32", "uint32"):
        return f"its dtype is {shown(str(candidate.dtype))}: expected float32 or uint32"
    if "rgb" in candidate.needs:
        return "it needs rgb, which no pass is made of"
    return None


def _guarded(one: Pass, who: str) -> Callable[[View], NDArray[Any]]:
    """Another package's function, so that what goes wrong in it names it."""

    def compute(view: View) -> NDArray[Any]:
        try:
            made = view.once(one.compute)
        except ScenecError:
            raise
        except Exception as error:
            raise BackendError(f"{who}: {error_line(error)}") from error
        count = len(one.channels)
        shape = (len(view.hits.row), count)[: 1 + (count > 1)]
        types = ("uint32",) if one.dtype == "uint32" else ("float32", "float64")
        if not isinstance(made, np.ndarray) or made.shape != shape or made.dtype.name not in types:
            is_array = isinstance(made, np.ndarray)
            got = f"{made.dtype} {list(made.shape)}" if is_array else type(made).__name__
            raise BackendError(
                f"{who}: returned {got}, expected {' or '.join(types)} {list(shape)}"
            )
        return made

    return compute
