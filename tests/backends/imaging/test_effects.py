"""A picture that another package's effect returns is the camera's, or said to be none."""

from __future__ import annotations

import json
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest

from scenec.backends.imaging import effects
from scenec.schemas.errors import BackendError

STATED = json.dumps({"type": "odd", "from": "there 1.0", "key": 7})


def _install(monkeypatch: pytest.MonkeyPatch, change: Callable[[Any], Any]) -> None:
    class Odd:
        def apply(self, picture: Any, _random: np.random.Generator) -> Any:
            return change(picture)

    monkeypatch.setattr(effects, "origin", lambda _group, _name: "there 1.0")
    monkeypatch.setattr(effects, "load_kind", lambda _group, _name: Odd)


@pytest.mark.parametrize(
    "change",
    [
        lambda picture: None,
        lambda picture: picture.astype(float),
        lambda picture: picture[..., 0],
        lambda picture: picture[:-1],
        lambda picture: np.dstack([picture, picture]),
    ],
)
def test_what_is_no_picture_of_that_size_is_said(
    monkeypatch: pytest.MonkeyPatch, change: Callable[[Any], Any]
) -> None:
    _install(monkeypatch, change)
    with pytest.raises(BackendError, match=r"odd.* of there 1.0.*\[4, 6, 3\]"):
        effects.apply(np.zeros((4, 6, 3), np.uint8), [STATED], 0)


def test_effects_follow_one_another(monkeypatch: pytest.MonkeyPatch) -> None:
    _install(monkeypatch, lambda picture: picture + np.uint8(2))
    before = np.zeros((4, 6, 3), np.uint8)
    assert (effects.apply(before, [STATED, STATED], 0) == 4).all()
    assert not before.any()
