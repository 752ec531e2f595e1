"""``amodal``: masks of what a frame's instances would show if nothing stood before them."""

from __future__ import annotations

from scenec.backends.annotation.contract import Picture, built_in
from scenec.schemas.amodal import Amodal


def amodal(picture: Picture) -> Amodal | None:
    """The masks of all instances that the picture shows."""
    return picture.seen.amodal


#: Ids name its masks.
AMODAL = built_in("amodal", amodal, whole=True, needs=("instance",))
