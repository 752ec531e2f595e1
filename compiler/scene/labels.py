"""Names what carries labels: a part of the Scene's vocabulary."""

from __future__ import annotations

#: Label id per level.
Labels = dict[str, int]
