"""Words messages about values and misspelled names."""

from __future__ import annotations

import difflib
import json
from collections.abc import Iterable
from typing import Any

_LONGEST = 60


def shown(value: Any) -> str:
    """A value as JSON, cut where it is long."""
    text = json.dumps(value, ensure_ascii=False)
    return text if len(text) <= _LONGEST else text[: _LONGEST - 1] + "…"


def closest(word: str, candidates: Iterable[str]) -> str | None:
    """The candidate that ``word`` is likely a slip for; None where none is near."""
    # Case is a common slip, which the matcher would weigh in full.
    lowered = {name.lower(): name for name in reversed(list(candidates))}
    match = difflib.get_close_matches(word[:200].lower(), lowered, n=1, cutoff=0.6)
    return lowered[match[0]] if match else None


def nearest(word: str, candidates: Iterable[str]) -> str:
    """A question after the closest candidate, or where none is near, what there is.

    Returns:
        "; did you mean 'x'?", or "; known: a, b, c", or "" where there is no candidate.
    """
    known = list(candidates)
    guess = closest(word, known)
    if guess is not None:
        return f"; did you mean {shown(guess)}?"
    if not known:
        return ""
    listed = ", ".join(known[:12]) + (" …" if len(known) > 12 else "")
    return f"; known: {listed}"
