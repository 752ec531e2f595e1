"""Passes that compare a frame with another view of the same scene; what they are: ``passes``."""

from __future__ import annotations

#: Codes of the occlusion passes.
VISIBLE, HIDDEN, OUTSIDE, NOTHING = 0, 1, 2, 3

#: What each code says, for sidecars.
CODES = {
    VISIBLE: "the other picture shows it",
    HIDDEN: "something stands before it",
    OUTSIDE: "it is outside of the other picture, or behind its camera",
    NOTHING: "there is nothing to compare with: no such sample, or the object is gone",
}

#: Passes by what they compare with.
NEXT = ("flow", "scene_flow", "occlusion")
BEFORE = ("flow_backward", "occlusion_backward")
PARTNER = ("disparity", "disparity_occlusion")
