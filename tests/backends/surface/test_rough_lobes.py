"""How much light a GGX lobe that scatters once loses, as docs/stage.md says, and its fit."""

from __future__ import annotations

import numpy as np
import pytest

from scenec.backends.surface import lobes


def albedo(roughness: float, mu: float, nodes: int = 300) -> float:
    """Directional albedo of a white single-scatter lobe with alpha = roughness^2.

    Over half vectors h drawn by D cos (tan^2 = alpha^2 u / (1 - u)), with height-correlated G2
    (Heitz 2014): f cos_i dw_i = D G2 (o.h) / mu dw_h, so the mean of G2 (o.h) / (mu cos_h).
    """
    alpha = roughness * roughness
    u = (np.arange(nodes) + 0.5) / nodes
    u, phi = np.meshgrid(u, 2.0 * np.pi * u)
    cosine = 1.0 / np.sqrt(1.0 + alpha * alpha * u / (1.0 - u))
    sine = np.sqrt(1.0 - cosine * cosine)
    along = np.sqrt(1.0 - mu * mu) * sine * np.cos(phi) + mu * cosine
    out = 2.0 * along * cosine - mu
    there = (along > 0.0) & (out > 0.0)

    def hidden(c):
        return 0.5 * np.sqrt(1.0 + alpha * alpha * (1.0 - c * c) / (c * c)) - 0.5

    g2 = 1.0 / (1.0 + hidden(mu) + hidden(np.where(there, out, 1.0)))
    return float(np.where(there, g2 * along / (mu * cosine), 0.0).mean())


@pytest.mark.parametrize("roughness", [0.1, 0.25, 0.5, 0.75, 1.0])
@pytest.mark.parametrize("mu", [0.1, 0.2, 0.35, 0.6, 0.999])
def test_the_definition_s_albedo_is_that(roughness: float, mu: float) -> None:
    assert lobes.albedo(roughness**2, mu) == pytest.approx(albedo(roughness, mu, 1200), rel=6e-3)
