"""Builds the picture of a sky's light that path tracers draw directions from.

Of a sky only what is brighter than its mean is drawn: surfaces' own sampling finds the rest with
less noise (Karlik et al. 2019, "MIS Compensation"). Of a constant sky nothing is drawn.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from scenec.backends.picture.sky import Sky, mean_radiance, texel_directions

#: Of directions' weight in the guide: what is the same for all, as for surfaces that face
#: anywhere. The rest is the cosine from the zenith, as for level ground.
ANYWHERE = 0.25


def sky_guide(sky: Sky, least: float) -> Sky | None:
    """Returns the part of a sky that is brighter than its mean, as an average surface sees it.

    Brightness and mean are weighed by how much of a direction's light such a surface gets.

    Args:
        sky: The sky.
        least: Irradiance, W/m^2; None is returned of a sky whose guide's root mean square radiance,
            from all around, gives less.
    """
    if sky.constant:
        return None
    height, width = sky.picture.shape[:2]
    up = texel_directions(height, width) @ sky.to_world[2]
    weight = ANYWHERE + (1.0 - ANYWHERE) * np.maximum(up, 0.0)
    seen = sky.picture.mean(axis=-1) * weight
    mean = mean_radiance(replace(sky, picture=seen[..., None]))
    guide = replace(sky, picture=np.repeat(np.maximum(seen - mean, 0.0)[..., None], 3, axis=-1))
    square = mean_radiance(replace(guide, picture=np.square(guide.picture, dtype=np.float64)))
    return guide if np.pi * float(np.sqrt(square[0])) > least else None
