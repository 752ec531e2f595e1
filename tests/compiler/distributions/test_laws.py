"""Laws of size against closed forms, scipy, and the numbers of the paper they come from."""

from __future__ import annotations

import math

import numpy as np
import pytest
import scipy.integrate
import scipy.stats
from hypothesis import given
from hypothesis import strategies as st

from scenec.compiler.cfg.check_numbers import check_number, read_number
from scenec.compiler.distributions.numbers import draw_number
from scenec.compiler.distributions.streams import Streams
from scenec.compiler.kinds.schema import Field
from scenec.testing.examples import examples

_N = 20000


def findings(value, **keywords):
    keywords = {"x-per": "batch", "x-per-allowed": ["batch"], **keywords}
    return list(check_number(Field((), value, keywords, True)))


def drawn(value, n=_N, **keywords):
    assert not findings(value, **keywords)
    keywords = {"x-per": "batch", "x-per-allowed": ["batch"], **keywords}
    return draw_number(read_number(value, keywords), Streams(5, 0), "a", n)


def power_cdf(exponent, low, high):
    def cdf(x):
        if exponent == 1:
            return np.log(np.asarray(x) / low) / math.log(high / low)
        rate = 1.0 - exponent
        return (np.asarray(x) ** rate - low**rate) / (high**rate - low**rate)

    return cdf


@pytest.mark.parametrize(
    ("value", "cdf"),
    [
        *(
            ({"type": "power_law", "exponent": a, "min": 0.1, "max": 5}, power_cdf(a, 0.1, 5))
            for a in (0, 0.5, 1, 2, 3.5, 20)
        ),
        (
            {"type": "exponential", "scale": 2, "min": 1, "max": 4},
            scipy.stats.truncexpon(1.5, 1, 2).cdf,
        ),
        (
            {"type": "log_normal", "median": 0.3, "sigma": 0.8},
            scipy.stats.lognorm(0.8, scale=0.3).cdf,
        ),
        (
            {"type": "histogram", "edges": [0, 1, 3, 4], "weights": [1, 2, 1]},
            lambda x: np.interp(x, [0, 1, 3, 4], [0, 0.25, 0.75, 1]),
        ),
    ],
)
def test_a_law_has_its_cumulative_distribution(value, cdf):
    assert scipy.stats.kstest(drawn(value), cdf).pvalue > 1e-4


def test_a_log_normal_is_truncated_by_its_bounds_and_those_of_its_key():
    value = {"type": "log_normal", "median": 1, "sigma": 1, "min": 0.5}
    numbers = drawn(value, maximum=3, exclusiveMinimum=0)
    assert numbers.min() >= 0.5
    assert numbers.max() <= 3.0
    law = scipy.stats.truncnorm(math.log(0.5), math.log(3.0))
    assert scipy.stats.kstest(np.log(numbers), law.cdf).pvalue > 1e-4


@pytest.mark.parametrize(
    ("k", "tenth", "half"),
    [(0.02, 0.3888, 0.000678), (0.05, 1.0342, 0.01355), (0.1, 1.8635, 0.04993),
     (0.19, 3.1858, 0.12171), (0.4, 6.1225, 0.28979)],
)  # fmt: skip
def test_rocks_of_mars_come_in_the_published_numbers(k, tenth, half):
    """Numbers a m^2 above 0.1 m and 0.5 m by numerical integration of Golombek and Rapp's law."""
    numbers = drawn({"type": "golombek_rapp", "k": k, "min": 0.1, "max": 50}, 400_000)
    expected = half / tenth
    share = float((numbers > 0.5).mean())
    assert share == pytest.approx(expected, abs=5.0 * math.sqrt(expected / 400_000))


def test_the_table_of_rock_diameters_is_exact_to_a_millionth():
    k, low, high = 0.1, 0.05, 3.0
    q = 1.79 + 0.152 / k

    def number(d):
        return scipy.integrate.quad(
            lambda x: math.exp(-q * x) / x**2, low, d, epsabs=0, epsrel=1e-12
        )[0]

    from scenec.compiler.distributions.laws import golombek_rapp

    u = np.array([0.0, 1e-3, 0.1, 0.5, 0.9, 0.99, 0.9999])
    found = golombek_rapp(u, low, high, k)
    whole = number(high)
    for part, diameter in zip(u, found, strict=True):
        assert number(diameter) / whole == pytest.approx(part, abs=1e-6)


@examples(300)
@given(
    kind=st.sampled_from(["power_law", "exponential", "golombek_rapp", "log_normal"]),
    ends=st.tuples(st.floats(1e-300, 1e300), st.floats(1e-300, 1e300)),
    shape=st.floats(1e-3, 20),
    wide=st.floats(1e-300, 1e300),
    sigma=st.floats(0, 100),
)
def test_any_law_that_passes_the_checks_is_finite_and_within_its_bounds(
    kind, ends, shape, wide, sigma
):
    value = {"type": kind, "min": min(ends), "max": max(ends)}
    value |= {
        "power_law": {"exponent": shape},
        "exponential": {"scale": wide},
        "golombek_rapp": {"k": min(shape, 1.0)},
        "log_normal": {"median": wide, "sigma": sigma},
    }[kind]
    if findings(value):
        return
    with np.errstate(over="raise", invalid="raise", divide="raise"):
        numbers = drawn(value, 50)
    assert (numbers >= value["min"]).all()
    assert (numbers <= value["max"]).all()


@pytest.mark.parametrize(
    ("value", "at"),
    [
        ({"type": "histogram", "edges": [0, 1], "weights": [1, 2]}, ("weights",)),
        ({"type": "histogram", "edges": [0, 0], "weights": [1]}, ("edges", 1)),
        ({"type": "histogram", "edges": [0, 1], "weights": [0]}, ("weights",)),
        ({"type": "histogram", "edges": [-1, 1], "weights": [1]}, ("edges", 0)),
        ({"type": "power_law", "exponent": 2, "min": 3, "max": 1}, ("min",)),
        ({"type": "log_normal", "median": 1e-9, "sigma": 0.1, "min": 5}, ()),
    ],
)
def test_a_law_that_cannot_be_drawn_is_a_finding_at_its_place(value, at):
    assert [finding.path for finding in findings(value, minimum=0)] == [at]
