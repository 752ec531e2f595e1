"""A stage while it becomes a cfg."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray
from pxr import Usd

from scenec.backends.stage.frame import StageFrame
from scenec.backends.stage.scene import RenderScene
from scenec.importers.output import Imported
from scenec.importers.report import DROPPED
from scenec.importers.scene import LEVEL, Taxonomy, identifier, unused
from scenec.importers.usd.models import ModelWriter

#: What may stay as it is.
KEEP = ("cameras", "light")


class Labels:
    """Holds the levels of the cfg: the stage's own, or one with a label for each class."""

    def __init__(self, scene: RenderScene) -> None:
        self._scene = scene
        self._own = Taxonomy()
        #: Of each level of the stage, its name here and those of its labels that are in use, by id.
        self._names: dict[str, str] = {}
        self._used: dict[str, dict[int, str]] = {level: {} for level in scene.levels}
        for level in scene.levels:
            self._names[level] = unused(level, self._names.values())

    @property
    def authored(self) -> bool:
        """Tells whether the stage has labels."""
        return bool(self._scene.levels)

    def of_class(self, name: str) -> dict[str, str]:
        """Returns a label of its own for a class, where the stage has none."""
        return {} if self.authored else self._own.choice(name)

    def choice(self, numbers: Sequence[int]) -> dict[str, str]:
        """Returns the stage's labels of these ids, one a level; 0 is none."""
        return {
            self._names[level]: self._label(level, number)
            for level, number in zip(self._scene.levels, numbers, strict=True)
            if number
        }

    def sky(self) -> dict[str, str]:
        """Returns the sky's labels."""
        if not self.authored:
            return self._own.choice("sky")
        return self.choice([self._scene.sky_labels.get(level, 0) for level in self._scene.levels])

    def added(self, name: str) -> dict[str, str]:
        """Adds a label for what is in no stage."""
        if not self.authored:
            return self._own.choice(name)
        level = LEVEL if LEVEL in self._scene.levels else self._scene.levels[0]
        known = {text: number for number, text in self._scene.label_names[level].items()}
        number = known.get(name, max(known.values(), default=0) + 1)
        self._used[level].setdefault(number, unused(name, self._used[level].values()))
        return {self._names[level]: self._used[level][number]}

    def as_cfg(self, report_unused: Imported) -> dict[str, dict[str, int]]:
        """Returns levels by name, each with its labels and ids; reports those never visible."""
        if not self.authored:
            return {LEVEL: self._own.ids}
        for level in self._scene.levels:
            for number, text in self._scene.label_names[level].items():
                if number not in self._used[level]:
                    why = "nothing that is shown has this label"
                    report_unused.report.add(DROPPED, f"{level}:{text}", number, "", why)
        return {
            self._names[level]: {text: number for number, text in sorted(used.items())}
            for level, used in self._used.items()
            if used
        }

    def _label(self, level: str, number: int) -> str:
        used = self._used[level]
        if number not in used:
            text = self._scene.label_names[level].get(number, f"label_{number}")
            used[number] = unused(text, used.values())
        return used[number]


@dataclass
class Scene:
    """A stage under way.

    Attributes:
        stage: The stage.
        read: What ``render`` would draw of it.
        frame: Its unit and its upward axis.
        imported: The cfg and its report.
        keep: Of ``KEEP``, what stays as it is.
        labels: Its labels.
        models: Shapes for the cfg.
        shift: What all is moved by, [3], m.
        extent_m: Size of the terrain.
        moves: Whether anything differs from sample to sample.
        tracked: Whether a camera says when samples are.
    """

    stage: Usd.Stage
    read: RenderScene
    frame: StageFrame
    imported: Imported
    keep: Sequence[str]
    labels: Labels
    models: ModelWriter
    shift: NDArray[np.float64] = field(default_factory=lambda: np.zeros(3))
    extent_m: tuple[float, float] = (10.0, 10.0)
    moves: bool = False
    tracked: bool = False

    @property
    def times_s(self) -> NDArray[np.float64]:
        """Returns times of the samples, from the first one."""
        return self.read.times - self.read.times[0]


def name_of(path: str) -> str:
    """Returns the last part of a prim's path, as a name of a cfg."""
    return identifier(path.rpartition("/")[2])
