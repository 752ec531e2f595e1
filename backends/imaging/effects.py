"""Effects of other packages on a camera's picture (``scenec.schemas.plugins``), after all else."""

from __future__ import annotations

import json
from collections.abc import Sequence
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from scenec.schemas.errors import BackendError, ScenecError
from scenec.schemas.plugins import error_line, load_kind, origin
from scenec.schemas.spelling import shown

GROUP = "scenec.effects"


class Effect(Protocol):
    """Declares what a package offers: a dataclass whose fields are the keys of its ``SCHEMA``."""

    def apply(self, picture: NDArray[np.uint8], random: np.random.Generator) -> NDArray[np.uint8]:
        """The changed picture.

        Args:
            picture: sRGB, [h, w, 3]; not to be changed in place.
            random: Of this camera and sample; the only source of chance that repeats.
        """
        ...


def apply(picture: NDArray[np.uint8], effects: Sequence[str], sample: int) -> NDArray[np.uint8]:
    """A picture after a camera's effects.

    Args:
        picture: uint8 [h, w, 3].
        effects: Each as the stage states it, see ``scenec:effects`` in docs/stage.md.
        sample: Time code.

    Raises:
        BackendError: An effect is not installed, is of another version than the stage asks for, or
            fails.
    """
    for text in effects:
        keys = json.loads(text)
        name, wanted, key = keys.pop("type"), keys.pop("from"), keys.pop("key")
        there = origin(GROUP, name)
        if there != wanted:
            raise BackendError(
                f"the effect {shown(name)} is of {wanted}, and {there or 'nothing'} is installed: "
                "install that, or compile again"
            )
        who = f"the effect {shown(name)} of {wanted}"
        try:
            effect: Effect = load_kind(GROUP, name)(**keys)
            changed = effect.apply(picture.copy(), np.random.default_rng([key, sample]))
        except ScenecError:
            raise
        except Exception as error:
            raise BackendError(f"{who}: {error_line(error)}") from error
        if (
            not isinstance(changed, np.ndarray)
            or changed.dtype != np.uint8
            or changed.shape != picture.shape
        ):
            raise BackendError(f"{who}: returned no uint8 picture {list(picture.shape)}")
        picture = changed
    return picture
