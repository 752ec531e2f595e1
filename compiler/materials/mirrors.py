"""Materials so smooth that they show single objects, wherever those stand."""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np

from scenec.compiler.cache.memo import memoized
from scenec.compiler.materials.values import forget_pixels, raw
from scenec.compiler.scene.material import Material
from scenec.compiler.views.illumination import SHARP

#: Albedos count as no less where gloss is weighed against them.
_DARKEST = 0.04
#: The part of a picture's texels that may be smoother than what counts.
_SMOOTHEST = 0.01


def any_mirror(materials: Iterable[Material]) -> bool:
    """Whether one of some finished materials is a mirror.

    At its peak a glossy lobe of weight g sends on g / (4 pi alpha^2) per solid angle (GGX: Walter
    et al. 2007), a dull surface of albedo a at most a / pi: a mirror is what has more than
    ``SHARP`` times as much.

    Args:
        materials: With all their pictures made.
    """
    found = any(_is_mirror(material) for material in materials)
    forget_pixels()
    return found


def _is_mirror(material: Material) -> bool:
    albedo = max(sum(material.base_color) / 3.0, _DARKEST)
    files = material.maps.files if material.maps is not None else {}
    metallic = 1.0 if "metallic" in files else material.metallic
    # alpha is the square of the roughness.
    fourth = (material.specular / albedo + metallic) / (4.0 * SHARP)
    smooth = float(np.sqrt(np.sqrt(fourth)))
    if "roughness" in files:
        return _has_smooth_texels(material, smooth)
    return material.roughness * (1.0 - min(abs(material.roughness_variation), 1.0)) < smooth


@memoized("mirrors")
def _has_smooth_texels(material: Material, smooth: float) -> bool:
    assert material.maps is not None
    return bool((raw(material.maps.files["roughness"]) < smooth).mean() > _SMOOTHEST)
