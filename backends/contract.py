"""What a backend is: it answers two questions about a RenderScene, and nothing else.

*Visibility*: which (row, face) does each ray meet first? *Radiance*: how much light arrives at each
pixel? All annotation is resolved from visibility by shared code in float64
(``scenec.backends.resolver``), so a renderer never computes a label, an id or a depth.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Protocol

import numpy as np
from numpy.typing import NDArray

from scenec.backends.render_scene import Camera, RenderScene

if TYPE_CHECKING:
    from scenec.backends.exact import ExactCaster

#: ``Visibility.row`` where a ray meets nothing.
NO_ROW = -1


@dataclass(frozen=True)
class Rays:
    """A table of rays, in the world frame.

    Attributes:
        origins: float64 [n, 3], meters.
        directions: float64 [n, 3]; not normalized: its length is such that the ray parameter is
            planar depth for a pinhole camera (direction has z = 1 in the camera's frame).
        shape: (height, width) of the picture the rays belong to; n = height * width, row-major.
    """

    origins: NDArray[np.float64]
    directions: NDArray[np.float64]
    shape: tuple[int, int]


@dataclass(frozen=True)
class Visibility:
    """First hit of each ray: ``row`` int32 [n] (NO_ROW: nothing) and ``face`` int32 [n]."""

    row: NDArray[np.int32]
    face: NDArray[np.int32]


@dataclass(frozen=True)
class Radiance:
    """Two independent halves of a Monte Carlo estimate, without directly seen sky and suns.

    Attributes:
        halves: Light from surfaces (premultiplied by coverage), float32 [2, h, w, 3].
        coverage: Fraction of each pixel (box filter) that surfaces cover, float32 [h, w].
        spp: Samples per pixel in both halves together.
    """

    halves: NDArray[np.float32]
    coverage: NDArray[np.float32]
    spp: int
    #: Samples whose light was negative or not finite (float32 slivers), counted as black.
    dropped: int = 0


class Backend(Protocol):
    """A renderer with a scene loaded. Made by ``scenec.backends.registry.open_backend``."""

    #: Name on the command line.
    name: str
    #: Where the backend is exact itself (``reference``), the caster that settles nothing more; None
    #: for renderers, whose visibility the resolver settles.
    caster: ExactCaster | None

    def version(self) -> str:
        """Name and version of the renderer and its variant, for sidecars and resume keys."""
        ...

    def warning(self) -> str | None:
        """A line the user should see before rendering, or None."""
        ...

    def load(self, scene: RenderScene) -> None:
        """Build the renderer's own scene, once per batch."""
        ...

    def visibility(self, rays: Rays, sample: int) -> Visibility:
        """First hits. Never culls back faces."""
        ...

    def radiance(self, camera: Camera, sample: int, spp: int, seed: int) -> Radiance:
        """Light that arrives, box-filtered over each pixel, in two halves of spp / 2 (up)."""
        ...
