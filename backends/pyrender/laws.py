"""The laws of ``scenec.backends.surface.reflectance`` as the shading program looks them up."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from scenec.backends.stage.scene import Reflectance, RenderScene, Surface
from scenec.backends.surface.reflectance import ALBEDO_NODES, albedo, albedo_table, numbers_of

#: Rows of a law's part of the table: albedos, then its numbers.
LAW_ROWS = ALBEDO_NODES[0] + 1


def laws_of(surfaces: Sequence[Surface]) -> list[Reflectance]:
    """Distinct laws of surfaces, in order."""
    return list(dict.fromkeys(s.reflectance for s in surfaces if s.reflectance is not None))


def law_table(surfaces: Sequence[Surface]) -> NDArray[np.float32]:
    """All laws, one below the other, float32 [rows, nodes over the cosine, 4].

    Of each, in the first channel, ``albedo_table``; then a row of (whether light is scattered more
    than once, b, c, B0), (h, tan(theta bar), 0, 0).
    """
    laws = laws_of(surfaces)
    table = np.zeros((max(len(laws), 1), LAW_ROWS, ALBEDO_NODES[1], 4), np.float32)
    for part, law in zip(table, laws, strict=False):
        numbers = numbers_of(law)
        part[:-1, :, 0] = albedo_table(law)
        part[-1, 0] = (numbers.multiple, law.b, law.c, law.opposition)
        part[-1, 1] = (law.opposition_width, numbers.slope or 0.0, 0.0, 0.0)
    return table.reshape(-1, ALBEDO_NODES[1], 4)


def law_features(scene: RenderScene) -> set[str]:
    """Returns the features that the shading program needs for the laws in use."""
    used = [scene.surfaces[i] for mesh in scene.meshes for i in mesh.layers]
    if not laws_of(used):
        return set()
    # Layers are shaded one by one: laws are not linear in the color.
    return {"WITH_REFLECTANCE", "WITH_MIXED"}


def even_albedo(surface: Surface) -> NDArray[np.float32]:
    """Returns the diffuse albedo of a surface under even light, by channel, float32 [3]."""
    color = np.array(surface.base_color, np.float32)
    if surface.reflectance is None:
        return color
    t, weight = np.polynomial.legendre.leggauss(8)
    mu = 0.5 * (t + 1.0)
    found = albedo(surface.reflectance, np.clip(color, 0.0, 1.0).astype(np.float64), mu, 16)
    mean: NDArray[np.float32] = (found * (mu * weight)).sum(axis=1).astype(np.float32)
    return mean
