"""Numbers drawn from distributions, against scipy's."""

from __future__ import annotations

import math

import numpy as np
import pytest
import scipy.special
import scipy.stats
from hypothesis import given
from hypothesis import strategies as st

from scenec.compiler.cfg.check_numbers import check_number, read_number
from scenec.compiler.distributions import normal
from scenec.compiler.distributions.numbers import Distribution, draw_number
from scenec.compiler.distributions.streams import Streams
from scenec.compiler.kinds.schema import Field

_STREAMS = Streams(5, 0)
_N = 20000


def _number(value, **keywords):
    keywords = {"x-per": "batch", "x-per-allowed": ["batch"], **keywords}
    assert not list(check_number(Field((), value, keywords, True)))
    return read_number(value, keywords)


def _normal(mean, std, low=-math.inf, high=math.inf):
    return scipy.stats.truncnorm((low - mean) / std, (high - mean) / std, mean, std)


@pytest.mark.parametrize(
    ("value", "law"),
    [
        ({"type": "uniform", "min": -3, "max": 5}, scipy.stats.uniform(-3, 8)),
        ({"type": "log_uniform", "min": 0.01, "max": 40}, scipy.stats.loguniform(0.01, 40)),
        ({"type": "normal", "mean": 2, "std": 0.5}, scipy.stats.norm(2, 0.5)),
        ({"type": "normal", "mean": 1, "std": 2, "min": 0}, _normal(1, 2, 0)),
        ({"type": "normal", "mean": 1, "std": 2, "max": -4}, _normal(1, 2, high=-4)),
        ({"type": "normal", "mean": 0, "std": 1, "min": 8, "max": 9}, _normal(0, 1, 8, 9)),
        ({"type": "normal", "mean": 0, "std": 1, "min": -1, "max": 3}, _normal(0, 1, -1, 3)),
        ({"type": "normal", "mean": 0, "std": 1, "min": 25}, _normal(0, 1, 25)),
    ],
)
def test_a_continuous_distribution_has_its_law_moments_and_support(value, law):
    drawn = draw_number(_number(value), _STREAMS, "a", _N)
    assert drawn.dtype == np.float64
    assert scipy.stats.kstest(drawn, law.cdf).pvalue > 1e-4
    assert abs(drawn.mean() - law.mean()) < 5.0 * law.std() / math.sqrt(_N)
    assert drawn.std() == pytest.approx(law.std(), rel=0.05)
    assert drawn.min() >= law.support()[0]
    assert drawn.max() <= law.support()[1]


def test_a_whole_uniform_gives_both_bounds_and_all_between_equally():
    number = _number({"type": "uniform", "min": -1, "max": 3}, **{"x-kind": "integer"})
    drawn = draw_number(number, _STREAMS, "a", _N)
    assert drawn.dtype == np.int64
    values, counts = np.unique(drawn, return_counts=True)
    assert values.tolist() == [-1, 0, 1, 2, 3]
    assert scipy.stats.chisquare(counts).pvalue > 1e-4


def test_a_choice_follows_its_weights_and_never_gives_a_weight_of_zero():
    value = {"type": "choice", "values": [1, 2, 3, 4], "weights": [0, 3, 1, 0]}
    values, counts = np.unique(draw_number(_number(value), _STREAMS, "a", _N), return_counts=True)
    assert values.tolist() == [2.0, 3.0]
    assert scipy.stats.chisquare(counts, [0.75 * _N, 0.25 * _N]).pvalue > 1e-4


def test_whole_numbers_of_a_normal_are_rounded_and_stay_inside():
    value = {"type": "normal", "mean": 2, "std": 3}
    number = _number(value, **{"x-kind": "integer", "minimum": 1, "maximum": 4})
    assert set(draw_number(number, _STREAMS, "a", _N)) == {1, 2, 3, 4}


def test_a_normal_is_truncated_to_the_bounds_of_its_key():
    number = _number({"type": "normal", "mean": 0, "std": 1}, exclusiveMinimum=0, maximum=2)
    drawn = draw_number(number, _STREAMS, "a", _N)
    assert drawn.min() > 0.0
    assert drawn.max() <= 2.0
    assert scipy.stats.kstest(drawn, _normal(0, 1, 0, 2).cdf).pvalue > 1e-4


def test_a_constant_is_itself_and_one_number_is_the_first_of_many():
    assert draw_number(3.5, _STREAMS, "a") == 3.5
    assert draw_number(7, _STREAMS, "a", 3).tolist() == [7, 7, 7]
    number = _number({"type": "uniform", "min": 0, "max": 1})
    assert draw_number(number, _STREAMS, "a") == draw_number(number, _STREAMS, "a", 9)[0]
    whole = _number({"type": "uniform", "min": 0, "max": 9}, **{"x-kind": "integer"})
    assert isinstance(draw_number(whole, _STREAMS, "a"), int)


_FINITE = st.floats(-1e300, 1e300)


@given(
    kind=st.sampled_from(["uniform", "log_uniform", "normal"]),
    a=_FINITE,
    b=_FINITE,
    mean=_FINITE,
    std=st.floats(0, 1e300),
    whole=st.booleans(),
    seed=st.integers(0, 99),
)
def test_what_passes_the_checks_is_drawn_within_its_bounds(kind, a, b, mean, std, whole, seed):
    value = {"type": kind, "min": min(a, b), "max": max(a, b)}
    if kind == "normal":
        value |= {"mean": mean, "std": std}
    if kind == "log_uniform" and value["min"] <= 0:
        return
    keywords = {"x-per": "batch", "x-per-allowed": ["batch"]}
    if whole:
        keywords["x-kind"] = "integer"
        value |= {key: float(round(value[key] % 1e9)) for key in ("min", "max")}
        value["min"], value["max"] = (
            1 + min(value["min"], value["max"]),
            2 + max(value["min"], value["max"]),
        )
    if list(check_number(Field((), value, keywords, True))):
        return
    drawn = draw_number(read_number(value, keywords), Streams(seed, 0), "a", 20)
    assert (drawn >= value["min"]).all()
    assert (drawn <= value["max"]).all()


def test_the_normal_distribution_agrees_with_scipys():
    x = -np.linspace(0.0, 37.0, 1500)
    ours = np.array([normal.lower_tail(v) for v in x])
    assert np.abs(ours / scipy.special.ndtr(x) - 1.0).max() < 1e-12
    p = np.concatenate([np.logspace(-300, -0.302, 1500), 1.0 - np.logspace(-15, -0.302, 500)])
    ours = np.array([normal.quantile(v) for v in p])
    assert np.abs(ours / scipy.special.ndtri(p) - 1.0).max() < 1e-14


def test_the_ends_of_a_stream_give_finite_normal_numbers():
    ends = np.array([0.0, 2.0**-53, 1.0 - 2.0**-53])
    drawn = normal.truncated(ends)
    assert np.isfinite(drawn).all()
    assert drawn[0] < drawn[1] < -8.0
    assert drawn[2] > 8.0
    for low, high in ((29.0, math.inf), (-math.inf, -29.0), (-1.0, 1.0), (5.0, 5.0)):
        drawn = normal.truncated(ends, low, high)
        assert ((drawn >= low) & (drawn <= high) & np.isfinite(drawn)).all()
        assert (np.diff(drawn) >= 0.0).all()


def test_a_distribution_knows_itself_as_json_values():
    number = _number({"type": "normal", "mean": 1, "std": 2})
    assert isinstance(number, Distribution)
    assert number.as_dict()["min"] is None
    assert number.as_dict()["mean"] == 1.0
