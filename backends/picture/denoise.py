"""Denoising by Open Image Denoise, for path tracers that have no denoiser of their own."""

from __future__ import annotations

from importlib.metadata import PackageNotFoundError, version

import numpy as np
from numpy.typing import NDArray

#: As sidecars name it.
NAME = "OpenImageDenoise"


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
    """The mean of two halves, each denoised apart.

    Args:
        halves: Linear light, float32 [2, h, w, 3].
        coverage: Of surfaces, float32 [h, w].
        albedo: Diffuse reflectance that the pixel sees, float32 [h, w, 3]; without noise, as near
            as can be.
        normal: Mean of the surfaces' unit normals, in any one frame, float32 [h, w, 3].

    Returns:
        float32 [h, w, 3].
    """
    # Imported here: a library of 90 MB.
    from pyoidn import denoise as clean

    guides = {"albedo": np.clip(albedo, 0.0, 1.0), "normal": np.clip(normal, -1.0, 1.0)}
    denoised: NDArray[np.float32] = np.mean(
        [clean(half, hdr=True, clean_aux=True, quality="high", **guides) for half in halves],
        axis=0,
        dtype=np.float32,
    )
    return keep_rim(denoised, halves, coverage)


def keep_rim(
    denoised: NDArray[np.float32], halves: NDArray[np.float32], coverage: NDArray[np.float32]
) -> NDArray[np.float32]:
    """The denoised picture, but the plain mean of the halves next to the sky.

    A denoiser knows no coverage: it smears a silhouette's light over the sky, and leaves an eighth
    too little along it (measured with Cycles).
    """
    rim = _near_sky(coverage)
    denoised[rim] = halves.mean(axis=0)[rim]
    return denoised


def _near_sky(coverage: NDArray[np.float32]) -> NDArray[np.bool_]:
    """Pixels in whose 3x3 window some pixel is not covered altogether."""
    height, width = coverage.shape
    wide = np.pad(coverage < 1.0, 1)
    shifted = [wide[y : y + height, x : x + width] for y in range(3) for x in range(3)]
    return np.logical_or.reduce(shifted)
