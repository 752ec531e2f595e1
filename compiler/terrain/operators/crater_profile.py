"""Models the radial shape of simple craters, fresh and worn.

Lengths are in crater radii, x = r / R. A fresh crater is rim * A(x) - depth * B(x):

- within the rim A = 1 and B = 1 - w(x), w a hyperbola from the floor's middle to the rim's crest:
  a round floor and walls that are nearly cones, within 0.02 diameters of the mean of fresh lunar
  craters (Fassett and Thomson 2014, eq. 4);
- outside B = 0, and A is 0.45 x**-3, the ejecta blanket (McGetchin et al. 1973; its part in the
  rim after Sharpton 2014), plus the uplifted rim, which falls to 0 at x = 1.7. With a depth of 0.2
  diameters and a rim of 0.04, bowl and rim have the same volume within 3 %.

Craters wear by topographic diffusion (Fassett and Thomson 2014), whose rate over their life grows
with their area (Minton et al. 2019), so one number says how worn a crater of any size is: kappa * t
/ R**2. Diffusion is linear: A and B are diffused once, for all craters.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from scenec.compiler.arithmetic import elementary
from scenec.compiler.terrain.grid import catmull_rom
from scenec.schemas.kernels import inlined, kernel

#: Radius at which the blanket ends, in crater radii; from 4 on it is faded out.
REACH = 5.0
_FADE = 4.0
_FLOOR = 0.25
_EJECTA = 0.45
_UPLIFTED = 1.7
_STEP = 0.01
# Beyond it no shape is left; the diffusion's border is there.
_BORDER = 12.0
_FIRST_STATE = 1e-4
# TR-BDF2 (Bank et al. 1985): both of its stages have the same matrix.
_GAMMA = 2.0 - np.sqrt(2.0)


@dataclass(frozen=True)
class ProfileTable:
    """A and B over x and the state of wear.

    Attributes:
        states: kappa * t / R**2 of each row, rising from 0, float64 [s].
        rim: A at x = (i + 1/2) * step, float64 [s, n]; the blanket is faded out at ``REACH``.
        depth: B, float64 [s, n].
        step: Distance of samples, in crater radii.
    """

    states: NDArray[np.float64]
    rim: NDArray[np.float64]
    depth: NDArray[np.float64]
    step: float = _STEP


def fresh(x: NDArray[np.float64]) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """A and B of a fresh crater, the blanket without its end: float64 [n] each."""
    wall = (np.sqrt(x * x + _FLOOR * _FLOOR) - _FLOOR) / (np.sqrt(1.0 + _FLOOR * _FLOOR) - _FLOOR)
    outside = np.maximum(x, 1.0)
    uplift = np.maximum((_UPLIFTED - outside) / (_UPLIFTED - 1.0), 0.0)
    rim = _EJECTA / (outside * outside * outside) + (1.0 - _EJECTA) * uplift * uplift
    return rim, np.maximum(1.0 - wall, 0.0)


def profile_table(largest_state: float) -> ProfileTable:
    """The table up to a state of wear, at most 2 (a Gaussian of two radii).

    Finite volumes in x, TR-BDF2 in time with steps that grow with it: against the convolution with
    a Gaussian the error is below 3e-4 of the depth.
    """
    states = [0.0, _FIRST_STATE]
    while states[-1] < largest_state:
        # Eight rows and sixteen steps for each doubling.
        states.append(states[-1] * 1.0905077326652577)
    x = (np.arange(round(_BORDER / _STEP), dtype=np.float64) + 0.5) * _STEP
    rim, depth = fresh(x)
    shown = round(REACH / _STEP)
    rims, depths = np.empty((len(states), shown)), np.empty((len(states), shown))
    rims[0], depths[0] = rim[:shown], depth[:shown]
    for row in range(1, len(states)):
        dt = 0.5 * (states[row] - states[row - 1])
        for _ in range(2):
            rim, depth = _diffuse(rim, dt), _diffuse(depth, dt)
        rims[row], depths[row] = rim[:shown], depth[:shown]
    window = 1.0 - elementary.smoothstep_array((x[:shown] - _FADE) / (REACH - _FADE))
    return ProfileTable(np.array(states), rims * window, depths * window)


@kernel
def _diffuse(z: NDArray, dt: float) -> NDArray:
    """One step of dz/dt = (1/x) d/dx (x dz/dx) with no flux through either end."""
    n = z.size
    theta = 0.5 * _GAMMA * dt / (_STEP * _STEP)
    # Cell i has the volume (i + 1/2) and faces of the lengths i and i + 1.
    laplacian = np.empty(n)
    for i in range(n):
        inner = i * (z[i] - z[i - 1]) if i > 0 else 0.0
        outer = (i + 1) * (z[i + 1] - z[i]) if i + 1 < n else 0.0
        laplacian[i] = (outer - inner) / (i + 0.5)
    middle = _solve(z + theta * laplacian, theta)
    keep = (1.0 - _GAMMA) * (1.0 - _GAMMA)
    return _solve((middle - keep * z) / (_GAMMA * (2.0 - _GAMMA)), theta)


@kernel
def _solve(right: NDArray, theta: float) -> NDArray:
    """Solves (1 - theta * laplacian) z = right by elimination."""
    n = right.size
    ratio = np.empty(n)
    z = np.empty(n)
    for i in range(n):
        lower = -theta * i / (i + 0.5)
        upper = -theta * (i + 1) / (i + 0.5) if i + 1 < n else 0.0
        pivot = 1.0 - lower - upper - (lower * ratio[i - 1] if i > 0 else 0.0)
        ratio[i] = upper / pivot
        z[i] = (right[i] - (lower * z[i - 1] if i > 0 else 0.0)) / pivot
    for i in range(n - 2, -1, -1):
        z[i] -= ratio[i] * z[i + 1]
    return z


@kernel
def blend_row(
    states: NDArray, rim: NDArray, depth: NDArray, state: float, rim_m: float, depth_m: float
) -> tuple[NDArray, float]:
    """Heights of one crater at the table's radii, meters, float64 [n], and the part of B left."""
    row = 1
    while row < states.size - 1 and states[row] < state:
        row += 1
    t = min(max((state - states[row - 1]) / (states[row] - states[row - 1]), 0.0), 1.0)
    out = np.empty(rim.shape[1])
    for i in range(out.size):
        a = rim[row - 1, i] + t * (rim[row, i] - rim[row - 1, i])
        b = depth[row - 1, i] + t * (depth[row, i] - depth[row - 1, i])
        out[i] = rim_m * a - depth_m * b
    left = depth[row - 1, 0] + t * (depth[row, 0] - depth[row - 1, 0])
    return out, left / depth[0, 0]


@inlined
def height_at(profile: NDArray, x: float) -> float:
    """Height at a radius below ``REACH``, in crater radii: a cubic through the samples."""
    t = x / _STEP - 0.5
    i = int(np.floor(t))
    t -= i
    last = profile.size - 1
    # Mirrored at the middle, 0 beyond the end.
    before, at = profile[i - 1 if i > 0 else -i], profile[i if i >= 0 else 0]
    return catmull_rom(before, at, profile[min(i + 1, last)], profile[min(i + 2, last)], t)
