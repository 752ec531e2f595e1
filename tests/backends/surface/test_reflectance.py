"""The laws of reflectance hold what theory says of them."""

from __future__ import annotations

import dataclasses
import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.typing import NDArray

from scenec.backends.stage.scene import Reflectance
from scenec.backends.surface.reflectance import ALBEDO_NODES, albedo, albedo_table, brdf

CLASSIC = Reflectance("lommel_seeliger", 0.0, 0.0, 0.0, 0.06, 0.0)
MARE = Reflectance("hapke", 0.254, 0.16, 1.993, 0.06, math.radians(23.657))
SMOOTH = dataclasses.replace(MARE, roughness=0.0)
ISOTROPIC = Reflectance("hapke", 0.0, 0.0, 0.0, 0.06, 0.0)

laws = st.builds(
    Reflectance,
    st.sampled_from(["hapke", "lommel_seeliger"]),
    st.floats(0.0, 0.9),
    st.floats(-1.0, 1.0),
    st.floats(0.0, 3.0),
    st.floats(0.002, 0.5),
    st.just(0.0) | st.floats(1e-6, math.radians(60.0)),
)
colors = st.floats(0.0, 1.0)
angles = st.floats(0.0, 0.5 * math.pi)
azimuths = st.floats(0.0, math.pi)


def albedo_of_grains(r0: float) -> float:
    return 4.0 * r0 / (1.0 + r0) ** 2


def phase_cosine(i: float, e: float, psi: float) -> float:
    return math.cos(i) * math.cos(e) + math.sin(i) * math.sin(e) * math.cos(psi)


def published(law: Reflectance, w: float, i: float, e: float, psi: float) -> float:
    """Bidirectional reflectance as Hapke (1984, 2002, 2012) prints it, both branches."""
    tan = math.tan(law.roughness)
    chi = 1.0 / math.sqrt(1.0 + math.pi * tan**2)
    g = math.acos(phase_cosine(i, e, psi))

    def e1(y: float) -> float:
        return math.exp(-2.0 / math.pi / tan / math.tan(y))

    def e2(y: float) -> float:
        return math.exp(-1.0 / math.pi / tan**2 / math.tan(y) ** 2)

    def eta(y: float) -> float:
        return chi * (math.cos(y) + math.sin(y) * tan * e2(y) / (2.0 - e1(y)))

    half, gate = math.sin(psi / 2.0) ** 2, math.exp(-2.0 * math.tan(psi / 2.0))
    if i <= e:
        below = 2.0 - e1(e) - psi / math.pi * e1(i)
        m0 = math.cos(psi) * e2(e) + half * e2(i)
        m = e2(e) - half * e2(i)
        shadow = 1.0 - gate + gate * chi * math.cos(i) / eta(i)
    else:
        below = 2.0 - e1(i) - psi / math.pi * e1(e)
        m0 = e2(i) - half * e2(e)
        m = math.cos(psi) * e2(i) + half * e2(e)
        shadow = 1.0 - gate + gate * chi * math.cos(e) / eta(e)
    m0 = chi * (math.cos(i) + math.sin(i) * tan * m0 / below)
    m = chi * (math.cos(e) + math.sin(e) * tan * m / below)
    s = m / eta(e) * math.cos(i) / eta(i) * chi / shadow
    r0 = (1.0 - math.sqrt(1.0 - w)) / (1.0 + math.sqrt(1.0 - w))

    def h(x: float) -> float:
        return 1.0 / (1.0 - w * x * (r0 + 0.5 * (1.0 - 2.0 * r0 * x) * math.log((1.0 + x) / x)))

    b, c = law.b, law.c
    back = (1.0 - b * b) / (1.0 - 2.0 * b * math.cos(g) + b * b) ** 1.5
    forth = (1.0 - b * b) / (1.0 + 2.0 * b * math.cos(g) + b * b) ** 1.5
    phase = 0.5 * (1.0 + c) * back + 0.5 * (1.0 - c) * forth
    surge = law.opposition / (1.0 + math.tan(g / 2.0) / law.opposition_width)
    inner = phase * (1.0 + surge) + h(m0) * h(m) - 1.0
    return w / (4.0 * math.pi) * m0 / (m0 + m) * inner * s


@given(st.floats(0.02, 1.55), st.floats(0.02, 1.55), st.floats(0.01, 3.12), st.floats(0.01, 0.95))
def test_it_is_hapke_s_law_as_published(i, e, psi, r0):
    w = albedo_of_grains(r0)
    expected = published(MARE, w, i, e, psi) / math.cos(i)
    found = brdf(MARE, r0, math.cos(i), math.cos(e), phase_cosine(i, e, psi))
    assert found == pytest.approx(expected, rel=1e-9)


@pytest.mark.parametrize("phase_deg", [10.0, 60.0, 120.0, 160.0])
def test_a_lommel_seeliger_sphere_has_its_known_phase_curve(phase_deg):
    """1 - sin(a/2) tan(a/2) ln cot(a/4) of what it shows at full phase (Seeliger 1887)."""

    def disc(alpha: float) -> float:
        t, weight = np.polynomial.legendre.leggauss(200)
        low, high = alpha - 0.5 * np.pi, 0.5 * np.pi
        longitude = 0.5 * (low + high) + 0.5 * (high - low) * t
        latitude = 0.5 * np.pi * t
        lon, lat = np.meshgrid(longitude, latitude, indexing="ij")
        mu, mu0 = np.cos(lat) * np.cos(lon), np.cos(lat) * np.cos(lon - alpha)
        shown = brdf(CLASSIC, 0.1, mu0, mu, np.cos(alpha)) * mu0 * mu * np.cos(lat)
        return float((shown * np.outer(weight, weight)).sum() * (high - low) * np.pi / 4.0)

    a = math.radians(phase_deg)
    expected = 1.0 - math.sin(a / 2) * math.tan(a / 2) * math.log(1.0 / math.tan(a / 4))
    assert disc(a) / disc(0.0) == pytest.approx(expected, rel=1e-4)


def test_the_full_moon_is_flat():
    """At full phase a Lommel-Seeliger sphere is even, and Hapke's rough one nearly so."""
    mu = np.cos(np.radians([0.0, 40.0, 70.0, 80.0]))
    even = brdf(CLASSIC, 0.1, mu, mu, 1.0) * mu
    np.testing.assert_allclose(even, even[0], rtol=1e-12)
    rough = brdf(MARE, 0.06, mu, mu, 1.0) * mu
    assert np.all(np.abs(rough / rough[0] - 1.0) < 0.12)


@given(laws, colors, angles, angles, azimuths)
def test_directions_can_be_exchanged(law, r0, i, e, psi):
    forth = brdf(law, r0, math.cos(i), math.cos(e), phase_cosine(i, e, psi))
    back = brdf(law, r0, math.cos(e), math.cos(i), phase_cosine(i, e, psi))
    assert forth == back


@given(laws, colors, angles, angles, azimuths)
def test_it_is_finite_and_not_negative_from_everywhere(law, r0, i, e, psi):
    found = brdf(law, r0, math.cos(i), math.cos(e), phase_cosine(i, e, psi))
    assert np.isfinite(found)
    assert found >= 0.0


@given(laws, angles, angles, azimuths)
def test_black_grains_reflect_nothing(law, i, e, psi):
    assert brdf(law, 0.0, math.cos(i), math.cos(e), phase_cosine(i, e, psi)) == 0.0


@given(st.floats(0.0, 1.4), st.floats(0.0, 1.4), azimuths, colors)
def test_roughness_begins_smoothly(i, e, psi, r0):
    args = (r0, math.cos(i), math.cos(e), phase_cosine(i, e, psi))
    slight = brdf(dataclasses.replace(MARE, roughness=2e-4), *args)
    assert slight == pytest.approx(brdf(SMOOTH, *args), rel=1e-4)


def test_smooth_ground_has_true_cosines():
    """Without roughness, phase function and surge Hapke's law is Chandrasekhar's (closed form)."""
    mu0, mu, r0 = 0.7, 0.2, 0.3
    w = albedo_of_grains(r0)

    def h(x: float) -> float:
        return 1.0 / (1.0 - w * x * (r0 + 0.5 * (1.0 - 2.0 * r0 * x) * math.log((1.0 + x) / x)))

    expected = w / (4.0 * math.pi) / (mu0 + mu) * h(mu0) * h(mu)
    assert brdf(ISOTROPIC, r0, mu0, mu, 0.5) == pytest.approx(expected, rel=1e-12)


def chandrasekhar(w: float) -> tuple[NDArray, NDArray]:
    """His H function at Gauss nodes, by iteration of its integral equation."""
    x, weight = np.polynomial.legendre.leggauss(48)
    x, weight = 0.5 * (x + 1.0), 0.5 * weight
    h = np.ones_like(x)
    for _ in range(300):
        inner = (0.5 * w * x * h * weight / (x[:, None] + x)).sum(axis=1)
        h = 1.0 / (math.sqrt(1.0 - w) + inner)
    return x, h


@pytest.mark.parametrize(("r0", "error"), [(0.05, 1e-3), (0.3, 0.01), (0.9, 0.02)])
def test_isotropic_ground_has_the_plane_albedo_that_transfer_theory_gives(r0, error):
    """1 - gamma H(mu), and nearly (1 - gamma) / (1 + 2 gamma mu) (Hapke 2012, 11.9)."""
    gamma = (1.0 - r0) / (1.0 + r0)
    mu, h = chandrasekhar(albedo_of_grains(r0))
    found = albedo(ISOTROPIC, np.array([r0]), mu)[0]
    np.testing.assert_allclose(found, 1.0 - gamma * h, rtol=error)
    np.testing.assert_allclose(found, (1.0 - gamma) / (1.0 + 2.0 * gamma * mu), rtol=0.1)


@given(
    st.builds(
        Reflectance,
        st.just("hapke"),
        st.floats(0.0, 0.5),
        st.floats(-1.0, 1.0),
        st.floats(0.0, 2.0),
        st.floats(0.01, 0.1),
        st.floats(0.0, math.radians(45.0)),
    )
)
def test_natural_ground_gives_back_less_than_it_gets(law):
    found = albedo(law, np.array([0.1, 0.5]), np.array([1e-3, 0.2, 0.6, 1.0]), 24)
    assert np.all(found[1] < 0.87)
    assert np.all(found[0] < 0.26)


@pytest.mark.parametrize("law", [CLASSIC, SMOOTH, MARE])
def test_the_table_of_albedos_is_linear_enough(law):
    table = albedo_table(law).astype(float)
    assert table.shape == ALBEDO_NODES
    colors, cosines = np.linspace(0.02, 0.99, 9), np.linspace(0.06, 0.99, 14)
    r, m = colors * (ALBEDO_NODES[0] - 1), cosines * (ALBEDO_NODES[1] - 1)
    i, j = r.astype(int), m.astype(int)
    u, v = (r - i)[:, None], m - j
    rows = [(1 - u) * table[np.ix_(i, j + k)] + u * table[np.ix_(i + 1, j + k)] for k in (0, 1)]
    found = colors[:, None] * ((1 - v) * rows[0] + v * rows[1])
    np.testing.assert_allclose(found, albedo(law, colors, cosines), rtol=5e-3)


def test_the_opposition_surge_is_as_high_and_wide_as_said():
    mu = 0.8
    plain = dataclasses.replace(SMOOTH, opposition=0.0, model="lommel_seeliger")
    surging = dataclasses.replace(plain, opposition=2.0)
    half = math.cos(2.0 * math.atan(plain.opposition_width))
    for cos_g, factor in ((1.0, 3.0), (half, 2.0)):
        ratio = brdf(surging, 0.1, mu, mu, cos_g) / brdf(plain, 0.1, mu, mu, cos_g)
        assert ratio == pytest.approx(factor, rel=1e-6)
