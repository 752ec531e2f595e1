"""How many examples a property test draws: all in ``make thorough``, a quarter in ``make test``."""

from __future__ import annotations

from typing import Any

from hypothesis import settings


def examples(number: int, *parent: settings, **more: Any) -> settings:
    """Settings of a property test whose full profile draws a number of examples other than 100.

    Args:
        number: Of examples, of the full profile.
        parent: Settings to begin with; None: the profile's.
        more: As of ``hypothesis.settings``.
    """
    return settings(*parent, max_examples=max(3, number * settings().max_examples // 100), **more)
