"""For docs/placement.md: laws of size against independent distribution functions."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from typing import Any, cast

import numpy as np
from numpy.typing import NDArray
from scipy import integrate, special, stats

from scenec.compiler.cfg.fill import fill
from scenec.compiler.distributions.laws import golombek_rapp_per_m2
from scenec.compiler.distributions.numbers import draw_number
from scenec.compiler.distributions.streams import Streams
from scenec.compiler.kinds.context import Context
from scenec.compiler.kinds.draw import draw_kind
from scenec.lab.pages.placement_field import number
from scenec.lab.runner import Page, table

Cdf = Callable[[NDArray], NDArray]
_LOW, _HIGH = 0.1, 5.0
#: Golombek and Rapp's law by numerical integration up to 50 m: k, N(> 0.1 m), N(> 0.5 m), 1/m^2.
PUBLISHED = (
    (0.02, 0.3888, 0.000678),
    (0.05, 1.0342, 0.01355),
    (0.10, 1.8635, 0.04993),
    (0.19, 3.1858, 0.12171),
    (0.40, 6.1225, 0.28979),
)


def _power(exponent: float) -> Cdf:
    if exponent == 1.0:
        return lambda d: np.log(d / _LOW) / np.log(_HIGH / _LOW)
    rate = 1.0 - exponent
    return lambda d: (d**rate - _LOW**rate) / (_HIGH**rate - _LOW**rate)


def _scaled_e2(x: NDArray) -> NDArray:
    """exp(x) E2(x), also where E2 underflows: by its asymptotic series (Abramowitz, 5.1.51)."""
    near = special.expn(2, np.minimum(x, 500.0)) * np.exp(np.minimum(x, 500.0))
    far = np.maximum(x, 500.0)
    series = (1 - 2 / far * (1 - 3 / far * (1 - 4 / far * (1 - 5 / far * (1 - 6 / far))))) / far
    return np.where(x < 500.0, near, series)


def _golombek_rapp(k: float) -> Cdf:
    """The integral of exp(-q D) / D**2 from a to b is E2(q a) / a - E2(q b) / b."""
    q = 1.79 + 0.152 / k

    def beyond(d: NDArray) -> NDArray:
        return np.exp(-q * (d - _LOW)) * _scaled_e2(q * d) / d

    low, high = (float(beyond(np.array(d))) for d in (_LOW, _HIGH))
    return lambda d: (low - beyond(d)) / (low - high)


def _log_normal(median: float, sigma: float) -> Cdf:
    low, high = (stats.norm.cdf(np.log(d / median) / sigma) for d in (_LOW, _HIGH))
    return lambda d: (stats.norm.cdf(np.log(d / median) / sigma) - low) / (high - low)


def laws() -> list[tuple[str, dict[str, Any], Cdf]]:
    """All of them, over the same sizes."""
    ends = {"min": _LOW, "max": _HIGH}
    found: list[tuple[str, dict[str, Any], Cdf]] = [
        ("uniform", {"type": "uniform"}, stats.uniform(_LOW, _HIGH - _LOW).cdf),
        ("log_uniform", {"type": "log_uniform"}, _power(1.0)),
    ]
    found += [
        (f"power_law, {a:g}", {"type": "power_law", "exponent": a}, _power(a))
        for a in (0.0, 1.0, 2.5, 6.0, 20.0)
    ]
    for scale in (0.01, 0.4, 1e4):
        cdf = stats.truncexpon((_HIGH - _LOW) / scale, _LOW, scale).cdf
        found.append((f"exponential, {scale:g}", {"type": "exponential", "scale": scale}, cdf))
    for sigma in (0.01, 0.6, 10.0):
        value = {"type": "log_normal", "median": 0.3, "sigma": sigma}
        found.append((f"log_normal, 0.3, {sigma:g}", value, _log_normal(0.3, sigma)))
    for k in (1e-6, 1e-4, 1e-2, 0.02, 0.05, 0.1, 0.19, 0.4):
        value = {"type": "golombek_rapp", "k": k}
        found.append((f"golombek_rapp, {k:g}", value, _golombek_rapp(k)))
    found = [(name, value | ends, cdf) for name, value, cdf in found]
    edges, weights = [_LOW, 0.3, 1.0, 2.0, _HIGH], [3, 1, 0, 2]
    cumulative = np.concatenate([[0.0], np.cumsum(weights) / sum(weights)])
    value = {"type": "histogram", "edges": edges, "weights": weights}
    return [*found, ("histogram", value, lambda d: np.interp(d, edges, cumulative))]


class _Even:
    """Uniform numbers without chance: what is left is the error of a law alone."""

    def uniforms(self, path: str, n: int, sample: int | None = None) -> NDArray[np.float64]:
        """The middles of n equal parts of [0, 1)."""
        return (np.arange(n) + 0.5) / n


def kolmogorov(page: Page) -> str:
    """Every law's distance from its distribution function."""
    n = 10_000 if page.fast else 100_000
    critical = 1.63 / np.sqrt(n)
    many = 100_000 if page.fast else 1_000_000
    rows = []
    for i, (name, value, cdf) in enumerate(laws()):
        law = number(value)
        streams = Streams(11, i)
        at = np.sort(draw_number(law, streams, "size", n))
        assert _LOW <= at[0] <= at[-1] <= _HIGH
        below = np.asarray(cdf(at))
        step = np.arange(n) / n
        distance = max(float((below - step).max()), float((step + 1.0 / n - below).max()))
        even = draw_number(law, cast(Streams, _Even()), "size", n)
        bias = float(np.abs(np.asarray(cdf(even)) - (np.arange(n) + 0.5) / n).max())
        seconds = page.timed(partial(draw_number, law, streams, "time", many), 1)
        verdict = "yes" if distance < critical else "no"
        rows.append([name, f"{bias:.0e}", f"{distance:.5f}", verdict, f"{np.median(at):.4g}",
                     f"{seconds:.2f}"])  # fmt: skip
    return (
        "## Sizes: each law against its distribution function\n\n"
        f"Diameters from {_LOW:g} m to {_HIGH:g} m. The Kolmogorov-Smirnov statistic is the "
        f"largest difference between the share of {n:,} drawn sizes below a size and the "
        "expected share, by closed forms (SciPy's normal distribution and exponential integral "
        f"E₂). One sound law in a hundred lies above the 1 % critical value {critical:.5f} by "
        "chance. The error of the law alone, without chance, is the same difference for evenly "
        "spaced uniform numbers: (i + ½)/n. The number behind a name is its shape: exponent, "
        f"scale in m, median and sigma, k (cfgs take 0.001 and more). Seconds are for {many:,} "
        "sizes.\n\n"
        + table(["law", "error of the law", "statistic", "below critical", "median, m", "s"], rows)
        + "\n" + _numbers_of_rocks(page)
    )  # fmt: skip


def _by_quadrature(low: float, k: float) -> float:
    q = 1.79 + 0.152 / k
    value, _ = integrate.quad(
        lambda s: np.exp(-q * np.exp(s) - s), np.log(low), np.log(50.0), epsabs=0, epsrel=1e-12,
        limit=500,
    )  # fmt: skip
    return float(4.0 * k * q / np.pi * value)


def _numbers_of_rocks(page: Page) -> str:
    """Golombek and Rapp's numbers: published, integrated, realized."""
    side = 50.0 if page.fast else 300.0
    rows = []
    published = {k: (a, b) for k, a, b in PUBLISHED}
    for k in (1e-6, 1e-4, 1e-3, *published):
        size = {"type": "golombek_rapp", "k": k, "min": 0.1, "max": 50}
        thing = {"type": "rocks", "material": "stone", "size_m": size, "subdivisions": 1}
        terrain = {"size_m": [side, side], "spacing_m": 1, "relief": [], "ground": [{}]}
        content = {"terrain": terrain, "objects": {"rocks": thing}, "materials": {}, "rigs": {}}
        filled = fill(content)["objects"]["rocks"]
        plan = draw_kind("objects", filled, "objects/rocks", Context(Streams(5, 0), (side, side)))
        row = [f"{k:g}"]
        for i, low in enumerate((0.1, 0.5)):
            exact, ours = _by_quadrature(low, k), golombek_rapp_per_m2(low, 50.0, k)
            got = int((plan.scale >= low).sum())
            # With nothing to compare it with there is no percentage.
            wanted = exact * side * side
            off = f"{100 * (got / wanted - 1) + 0.0:+.2f}" if wanted >= 1.0 else ""
            off = "0.00" if off in ("-0.00", "+0.00") else off
            noise = f"±{100 / np.sqrt(wanted):.2f}" if wanted >= 1.0 and i else ""
            differs = f"{100 * abs(ours / exact - 1):.0e}" if exact > 1e-300 else ""
            told = f"{published[k][i]:g}" if k in published else ""
            row += [told, f"{exact:.4g}", differs, f"{got:,}", f"{off} {noise}".strip()]
        rows.append(row)
    header = ["k"]
    for low in ("0.1", "0.5"):
        header += [f"N(>{low} m) a m², table", "integral", "ours off, %", "drawn", "off, %"]
    return (
        "### The number of rocks by Golombek and Rapp (1997)\n\n"
        "N(>D) = ∫ 4kq exp(−qD) / (πD²) dD, q = 1.79 + 0.152/k, up to 50 m; without a `count` that "
        f"many are drawn, here on {side:g} m × {side:g} m. The columns *table* come from another "
        "program. The integral is SciPy's adaptive quadrature, and *ours off* is the error of "
        "our Simpson's rule against it. Above 0.1 m the number is the expected one, rounded; "
        "above 0.5 m it is a sample, with its standard deviation after ±. As k falls to 0 so "
        "does the number of rocks, without overflow or error.\n\n" + table(header, rows)
    )
