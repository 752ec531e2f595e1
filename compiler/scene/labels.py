"""Names what carries labels: a part of the Scene's vocabulary."""

#: Label id per level.
Labels = dict[str, int]
