"""How much of a scene a compilation keeps."""

from __future__ import annotations

from enum import StrEnum


class Keep(StrEnum):
    """What stays in the stage.

    ``SEEN``: what the cameras of the batch can see the effect of (the default).
    ``UNPRUNED``: everything, as coarse where no camera sees it as ``SEEN`` would have it: meshes
    and levels of detail are the same, so annotation is, too (``--no-prune``).
    ``ALL``: everything, as fine out of view as in view, for walking around the stage in a viewer
    (``--keep all``).
    """

    SEEN = "seen"
    UNPRUNED = "unpruned"
    ALL = "all"
