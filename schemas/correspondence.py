"""Passes that compare a frame with another view of the same scene: names and codes.

======================  ============================================================
``flow``                to the same camera's next sample, pixels right and down
``flow_backward``       to its sample before
``scene_flow``          where the point seen goes until the next sample, in the camera's
                        frames: its coordinates then minus its coordinates now, meters
``occlusion``           what became of it at the next sample: a code
``occlusion_backward``  what it was at the sample before: a code
``disparity``           column here minus column in the partner's picture, pixels
``disparity_occlusion`` whether the partner sees it: a code
======================  ============================================================
"""

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
