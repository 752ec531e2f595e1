"""``label.<level>``: ids of labels."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from scenec.backends.annotation.contract import View, built_in


def label(view: View, level: str) -> NDArray[np.uint32]:
    """Ids of labels on a level, uint32 [n]; the sky's without a hit; 0 is none."""
    scene = view.scene
    out = view.of_faces(
        lambda mesh: mesh.labels.get(level, np.zeros(len(mesh.faces), np.uint32)),
        scene.sky_labels.get(level, 0),
    )
    sky = scene.sky_label_maps[view.sample].get(level) if scene.sky_label_maps else None
    if sky is not None:
        # Imported here: few scenes have a map of labels.
        from scenec.backends.stage.sky_labels import label_of_sky

        missed = np.flatnonzero(view.hits.row < 0)
        out[missed] = label_of_sky(sky, view.rays.directions, missed)
    if view.rays.known is not None:
        out[~view.rays.known] = 0
    return out


LABEL = built_in("label", label)
