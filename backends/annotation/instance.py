"""``instance``: ids of instances."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from scenec.backends.annotation.contract import View, built_in


def instance(view: View) -> NDArray[np.uint32]:
    """Ids of instances, uint32 [n]; 0 is none."""
    # The last one is that of no row, which is -1.
    ids = np.append(view.scene.rows.instance_id, np.uint32(0))
    return ids[view.hits.row].astype(np.uint32)


INSTANCE = built_in("instance", instance)
