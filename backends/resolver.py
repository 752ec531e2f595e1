"""The resolver: from any renderer's visibility to exact annotation, the same for all renderers.

``settle`` makes visibility exact, ``annotate`` computes everything that follows from it.
"""

from __future__ import annotations

from collections.abc import Sequence

from numpy.typing import NDArray

from scenec.backends.contract import Rays, Visibility
from scenec.backends.exact import ExactCaster
from scenec.backends.exact.annotate import NO_FACE, annotate, pass_names
from scenec.backends.exact.settle import Settled, Statistics, settle
from scenec.backends.render_scene import Camera, RenderScene

__all__ = ["NO_FACE", "Settled", "Statistics", "annotate", "pass_names", "resolve", "settle"]


def resolve(
    scene: RenderScene,
    caster: ExactCaster,
    rays: Rays,
    visibility: Visibility | None,
    camera: Camera | None,
    passes: Sequence[str],
    sample: int = 0,
) -> tuple[dict[str, NDArray], Statistics]:
    """Settle a renderer's visibility and annotate: see ``settle`` and ``annotate``.

    Returns:
        (arrays per pass, statistics).
    """
    settled = settle(caster, rays, visibility, camera)
    return annotate(scene, settled, rays, passes, sample), settled.statistics
