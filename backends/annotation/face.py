"""``face``: which of the authored faces is hit."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from scenec.backends.annotation.contract import View, built_in
from scenec.backends.stage.scene import Mesh

#: Where a ray meets nothing.
NO_FACE = 0xFFFFFFFF


def face(view: View) -> NDArray[np.uint32]:
    """Indices of authored faces, uint32 [n], NO_FACE without a hit."""
    return view.of_faces(_authored, NO_FACE)


def _authored(mesh: Mesh) -> NDArray[np.uint32]:
    if mesh.authored_face is None:
        return np.arange(len(mesh.faces), dtype=np.uint32)
    return mesh.authored_face.astype(np.uint32)


FACE = built_in("face", face)
