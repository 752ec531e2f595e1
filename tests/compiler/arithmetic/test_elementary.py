"""The elementary functions are accurate to the ulp they state, over the whole range."""

from __future__ import annotations

import math

import mpmath
import numpy as np
import pytest
from scipy.special import betainc

from scenec.compiler.arithmetic import elementary

mpmath.mp.prec = 200


def ulps(got: np.ndarray, exact: list[mpmath.mpf]) -> float:
    """Largest error in units of the last place of the exact value."""
    worst = 0.0
    for value, truth in zip(got.tolist(), exact, strict=True):
        unit = math.ulp(float(truth))
        worst = max(worst, float(abs(mpmath.mpf(value) - truth) / unit))
    return worst


def spread(low: float, high: float, n: int = 1500) -> np.ndarray:
    return np.random.default_rng(7).uniform(low, high, n)


def small(n: int = 500) -> np.ndarray:
    return np.exp(np.random.default_rng(8).uniform(-80, 0, n))


CASES = [
    ("exp", np.concatenate([spread(-700, 700), spread(-1, 1), small()]), mpmath.exp, 1.5),
    ("log", np.concatenate([np.exp(spread(-700, 700)), spread(0.5, 2)]), mpmath.log, 1.0),
    ("sin", np.concatenate([spread(-50, 50), spread(-1e6, 1e6), small()]), mpmath.sin, 2.0),
    ("cos", np.concatenate([spread(-50, 50), spread(-1e6, 1e6), small()]), mpmath.cos, 2.0),
    ("atan", np.concatenate([spread(-3, 3), 1 / small(), small()]), mpmath.atan, 2.0),
    ("acos", spread(-1, 1), mpmath.acos, 4.0),
    ("asin", np.concatenate([spread(-1, 1), small()]), mpmath.asin, 4.0),
]


@pytest.mark.parametrize(("name", "x", "exact", "bound"), CASES, ids=[c[0] for c in CASES])
def test_error_stays_below_the_stated_ulps(name, x, exact, bound):
    got = getattr(elementary, f"{name}_array")(x)
    assert ulps(got, [exact(mpmath.mpf(v)) for v in x.tolist()]) <= bound


def test_smoothstep_is_the_cumulative_beta_distribution_of_2_and_2():
    x = spread(-0.5, 1.5)
    got = elementary.smoothstep_array(x)
    np.testing.assert_allclose(got, betainc(2, 2, np.clip(x, 0.0, 1.0)), rtol=0, atol=1e-15)
    assert [elementary.smoothstep(t) for t in x] == got.tolist()


def test_atan2_is_right_in_every_quadrant():
    for angle in np.linspace(-3.14, 3.14, 101):
        assert elementary.atan2(math.sin(angle), math.cos(angle)) == pytest.approx(angle, abs=1e-15)
    assert elementary.atan2(0.0, -1.0) == math.pi
    assert elementary.atan2(0.0, 0.0) == 0.0


def test_pow_keeps_its_stated_relative_error():
    rng = np.random.default_rng(3)
    for x, y in zip(np.exp(rng.uniform(-20, 20, 500)), rng.uniform(-8, 8, 500), strict=True):
        exact = mpmath.power(mpmath.mpf(x), mpmath.mpf(y))
        error = abs(mpmath.mpf(elementary.pow(x, y)) - exact) / exact
        assert error <= (1 + abs(y * math.log(x))) * 2e-16


def test_limits_are_those_of_ieee_754():
    assert elementary.exp(-math.inf) == 0.0
    assert elementary.exp(math.inf) == math.inf
    assert elementary.exp(710.0) == math.inf
    assert elementary.exp(0.0) == 1.0
    assert elementary.log(0.0) == -math.inf
    assert elementary.log(1.0) == 0.0
    assert elementary.log(math.inf) == math.inf
    assert math.isnan(elementary.log(-1.0))
    assert math.isnan(elementary.exp(math.nan))
    assert elementary.log(5e-324) == pytest.approx(math.log(5e-324), rel=1e-15)
