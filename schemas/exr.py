"""OpenEXR pictures of three float channels, with stable bytes."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from numpy.typing import NDArray


def write_rgb(path: Path, picture: NDArray[np.float32]) -> None:
    """Writes a linear Rec.709 picture, float32 [h, w, 3], as R, G, B with ZIP compression."""
    import OpenEXR

    header = {"compression": OpenEXR.ZIP_COMPRESSION, "type": OpenEXR.scanlineimage}
    channels = {"RGB": np.ascontiguousarray(picture, dtype=np.float32)}
    with OpenEXR.File(header, channels) as file:
        file.write(str(path))
