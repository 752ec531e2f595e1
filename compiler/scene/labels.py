"""Names what carries labels: a part of the Scene's vocabulary."""

from __future__ import annotations

from collections.abc import Mapping

#: Label id per level.
Labels = dict[str, int]


def label_ids(table: Mapping[str, Mapping[str, int]], choice: Mapping[str, str]) -> Labels:
    """Returns label ids of a choice of names, on every level; 0 where it chooses none.

    Args:
        table: The cfg's labels: per level, name -> id.
    """
    return {level: ids[choice[level]] if level in choice else 0 for level, ids in table.items()}
