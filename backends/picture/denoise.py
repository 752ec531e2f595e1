"""Denoising by Open Image Denoise, for path tracers that have no denoiser of their own."""

from __future__ import annotations

import os
from importlib.metadata import PackageNotFoundError, version

import numpy as np
from numpy.typing import NDArray

from scenec.schemas.budget import thread_budget
from scenec.schemas.errors import BackendError

#: As sidecars name it.
NAME = "OpenImageDenoise"
#: Pixels by which pictures are mirrored over their borders: without, an even one comes back up to
#: 10 % off there, and one of a single pixel by 80 %; with 8 to 64 of them it is 0.2 % at most.
_MARGIN = 16


def installed() -> str | None:
    """Name and version where the package is installed, else None; it is not imported."""
    try:
        return f"{NAME} {version('pyoidn')}"
    except PackageNotFoundError:
        return None


def denoise(
    halves: NDArray[np.float32],
    coverage: NDArray[np.float32],
    albedo: NDArray[np.float32],
    normal: NDArray[np.float32],
) -> NDArray[np.float32]:
    """Two halves, each denoised apart.

    Args:
        halves: Linear light, float32 [2, h, w, 3].
        coverage: Of surfaces, float32 [h, w].
        albedo: Diffuse reflectance that the pixel sees, float32 [h, w, 3]; without noise, as near
            as can be.
        normal: Mean of the surfaces' unit normals, in any one frame, float32 [h, w, 3].

    Returns:
        float32 [2, h, w, 3].

    Raises:
        BackendError: The library cannot be loaded, or fails.
    """
    threads = thread_budget()
    if threads is not None:
        # Read when its device is made.
        os.environ.setdefault("OIDN_NUM_THREADS", str(threads))
    guides = {
        "albedo": _wider(np.clip(albedo, 0.0, 1.0)),
        "normal": _wider(np.clip(normal, -1.0, 1.0)),
    }
    inner = slice(_MARGIN, -_MARGIN)
    try:
        # Imported here: a library of 90 MB.
        from pyoidn import denoise as clean

        clear = [
            clean(_wider(half), hdr=True, clean_aux=True, quality="high", **guides)[inner, inner]
            for half in halves
        ]
    except (ImportError, OSError, RuntimeError) as error:
        raise BackendError(
            f"{NAME} does not work here ({error}); render without denoising, or mend it with: "
            "pip install --force-reinstall pyoidn"
        ) from error
    found = np.stack(clear)
    keep_rim(found, halves, coverage)
    return found


def _wider(picture: NDArray[np.float32]) -> NDArray[np.float32]:
    """With a margin, mirrored."""
    margin = (_MARGIN, _MARGIN)
    return np.pad(picture, (margin, margin, (0, 0)), mode="symmetric")


def keep_rim(
    denoised: NDArray[np.float32], halves: NDArray[np.float32], coverage: NDArray[np.float32]
) -> None:
    """Put halves, [2, h, w, 3], back as they were next to the sky.

    A denoiser knows no coverage: it smears a silhouette's light over the sky, and leaves an eighth
    too little along it (measured with Cycles).
    """
    rim = _near_sky(coverage)
    denoised[:, rim] = halves[:, rim]


def _near_sky(coverage: NDArray[np.float32]) -> NDArray[np.bool_]:
    """Pixels in whose 3x3 window some pixel is not covered altogether."""
    height, width = coverage.shape
    wide = np.pad(coverage < 1.0, 1)
    shifted = [wide[y : y + height, x : x + width] for y in range(3) for x in range(3)]
    return np.logical_or.reduce(shifted)
