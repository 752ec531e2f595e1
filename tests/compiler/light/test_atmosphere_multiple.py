"""Light scattered more than once, against photons followed one by one."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray

from scenec.compiler.light import atmosphere
from scenec.compiler.light.atmosphere_multiple import mean_cosine, reduced
from scenec.compiler.light.atmosphere_planets import earth, mars
from scenec.compiler.light.atmosphere_spectra import weights
from scenec.testing.photons import COUNT, SLABS, gray_dust, level_irradiance, scattered_down


@pytest.mark.parametrize("elevation", [20.0, 60.0])
@pytest.mark.parametrize(
    ("depth", "albedo", "forward", "g"),
    SLABS,
)
def test_the_sky_s_light_is_that_of_photons_followed_one_by_one(
    depth, albedo, forward, g, elevation
):
    medium = gray_dust(depth, albedo, forward, g)
    sine = float(np.sin(np.radians(elevation)))
    rng = np.random.default_rng(1)
    photons = sine * scattered_down(rng, depth, albedo, forward, g, sine)
    single = level_irradiance(medium, elevation, multiple=False)
    both = level_irradiance(medium, elevation, multiple=True)
    assert both == pytest.approx(photons, rel=0.1)
    # Single scattering alone always lacks some, in a storm by far.
    assert single < 0.97 * photons
    assert abs(both - photons) < 0.5 * abs(single - photons)


def test_thin_air_scatters_hardly_twice():
    single = level_irradiance(gray_dust(1e-3, 0.97, 0.75, 0.89), 45.0, multiple=False)
    both = level_irradiance(gray_dust(1e-3, 0.97, 0.75, 0.89), 45.0, multiple=True)
    assert single > 0.0
    assert 1.0 <= both / single < 1.01


@pytest.mark.parametrize("elevation", [-90.0, -12.0, -1.0, 0.0, 5.0, 90.0])
@pytest.mark.parametrize("density", [0.0, 10.0])
@pytest.mark.parametrize("altitude", [0.0, 60_000.0])
@pytest.mark.parametrize("planet", [earth, mars])
def test_it_adds_light_and_takes_none_in_extreme_air(planet, altitude, density, elevation):
    medium = planet(COUNT, density, density, density)
    sun = float(np.radians(elevation))
    pictures: list[NDArray] = [
        atmosphere.bake(medium, weights(COUNT), altitude, sun, np.ones(3), 16, multiple=multiple)
        for multiple in (False, True)
    ]
    assert np.isfinite(pictures[1]).all()
    assert np.all(pictures[1] >= pictures[0])


def test_similarity_keeps_absorption_and_the_mean_cosine_of_cornette_and_shanks():
    medium = earth(COUNT, 1.0, 1.0, 1.0)
    g = mean_cosine(medium.phase)
    # By quadrature of their phase function.
    x, weight = np.polynomial.legendre.leggauss(200)
    own = 0.76
    p = 1.5 * (1 - own**2) / (2 + own**2) * (1 + x**2) / (1 + own**2 - 2 * own * x) ** 1.5
    np.testing.assert_allclose(g, (p * x * weight).sum() / (p * weight).sum(), rtol=1e-10)
    spectra = medium.spectra()
    even = reduced(spectra, g)
    np.testing.assert_allclose(even[2] - even[1], spectra[2] - spectra[1], rtol=1e-10)
