"""Merges materials pairwise by noise (the seed paper's equation 1), as functions of position.

Merge i lays material i over the result so far with a weight alpha_i(x, y) in [0, 1]:

    t_i = alpha_i * material_i + (1 - alpha_i) * t_(i-1)

alpha = smoothstep(t), t clamped to [0, 1]. A noise gives t = 1/2 + sharpness * (noise - center),
conditions on the place give theirs (``signed_bound``), and the smallest counts.

Colors blend by alpha. The label at a point is that of the last merge with alpha_i >= threshold_i,
or of the base: an outcome of the merges in order, not an argmax.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from scenec.compiler.arithmetic import elementary
from scenec.compiler.arithmetic.ranks import ranked
from scenec.compiler.mesh.signed_bound import SignedBound
from scenec.compiler.noise.fractal import fbm2
from scenec.compiler.terrain.condition import Interval
from scenec.compiler.terrain.quantities import Samples
from scenec.schemas.kernels import kernel


@dataclass(frozen=True)
class Merge:
    """One merge: where its material lies.

    Attributes:
        key: Noise key.
        scale_m: Size of the largest patches, meters.
        octaves, gain, lacunarity, distortion: Of the noise, see ``fbm2_points``.
        sharpness: Slope of the transition; larger is narrower.
        threshold: Weight at which the label changes, in (0, 1).
        center: Noise value at which the weight is 1/2.
        noisy: Whether the noise has a say; it must have where there are no conditions.
        where: Conditions that must hold as well. ``cover.fit_merges`` makes ``limits`` of them.
        limits: The conditions on the relief that the merge is laid on.
    """

    key: int
    scale_m: float
    octaves: int
    gain: float
    lacunarity: float
    distortion: float
    sharpness: float
    threshold: float
    center: float = 0.0
    noisy: bool = True
    where: tuple[Interval, ...] = ()
    limits: tuple[SignedBound, ...] = ()

    def noise(self, x: NDArray[np.float64], y: NDArray[np.float64]) -> NDArray[np.float64]:
        """The noise at points, float64 [n]."""
        return fbm2(*self._form()).at(x, y)

    def noise_on(self, samples: Samples) -> NDArray[np.float64]:
        """The noise at the points of a grid: float64 [ny, nx], not to be changed."""
        return samples.noise(self._form(), fbm2(*self._form()))

    def _form(self) -> tuple[int, float, int, float, float, float]:
        form = self.key, self.scale_m, self.octaves, self.gain, self.lacunarity, self.distortion
        return form

    def level_t(self) -> float:
        """The t at which the weight is the threshold: the label line's."""
        # Inverse of the smoothstep s(t) = 3t^2 - 2t^3 in [0, 1]: t = 1/2 - sin(asin(1 - 2s) / 3).
        return 0.5 - elementary.sin(elementary.asin(1.0 - 2.0 * self.threshold) / 3.0)

    def level(self) -> float:
        """Noise value at which the weight reaches the threshold."""
        return self.center + (self.level_t() - 0.5) / self.sharpness

    def side(self, x: NDArray[np.float64], y: NDArray[np.float64]) -> NDArray[np.float64]:
        """Signed distance to the label line, float64 [n]: >= 0 is this material.

        In units of t where there are conditions, of the noise where there are none.

        Raises:
            ValueError: The merge has conditions and is not laid.
        """
        if len(self.limits) != len(self.where):
            raise ValueError("a merge with conditions is laid on a relief first: cover.fit_merges")
        values = [limit.value(x, y) for limit in self.limits]
        return self.side_of(values, self.noise(x, y) if self.noisy else None)

    def side_on(self, samples: Samples) -> NDArray[np.float64]:
        """``side`` at the points of a grid: float64 [ny, nx]."""
        values = [limit.condition.value_on(limit.quantities, samples) for limit in self.limits]
        return self.side_of(values, self.noise_on(samples) if self.noisy else None)

    def side_of(
        self, values: Sequence[NDArray[np.float64]], noise: NDArray[np.float64] | None
    ) -> NDArray[np.float64]:
        """``side`` where the limits' values and, if it has a say, the noise are known."""
        if not self.where and noise is not None:
            return noise - self.level()
        parts = [limit.t(value) for limit, value in zip(self.limits, values, strict=True)]
        if noise is not None:
            parts.append(0.5 + self.sharpness * (noise - self.center))
        least = parts[0]
        for part in parts[1:]:
            np.minimum(least, part, out=least)
        least -= self.level_t()
        return least

    def weight_of_side(self, side: NDArray[np.float64]) -> NDArray[np.float64]:
        """alpha, from what ``side`` returned."""
        alpha = np.empty(side.shape)
        # t is this, plus a factor times the side and a level, less a center.
        form = (0.5, self.sharpness, self.level(), self.center)
        form = (0.0, 1.0, self.level_t(), 0.0) if self.where else form
        _weigh(np.ascontiguousarray(side).ravel(), *form, alpha.ravel())
        return alpha


@kernel
def _weigh(
    side: NDArray, least: float, factor: float, level: float, center: float, alpha: NDArray
) -> None:
    """Smoothstep of t = least + factor * (side + level - center), clamped to [0, 1]."""
    for k in range(side.size):
        alpha[k] = elementary.smoothstep(least + factor * (side[k] + level - center))


def center_for_coverage(noise: NDArray[np.float64], coverage: float) -> float:
    """Center with which a merge covers a given fraction of its samples.

    Args:
        noise: Noise at evenly spread points, float64 [n].
        coverage: Fraction in [0, 1].

    Returns:
        The noise value below which 1 - coverage of the samples lie; beyond the extremes at 0 and 1.
    """
    rank = int((1.0 - coverage) * noise.size)
    if rank >= noise.size:
        return float(noise.max()) + 10.0
    if rank == 0:
        return float(noise.min()) - 10.0
    below, above = ranked(noise, (rank - 1, rank))
    return 0.5 * (below + above)


def label_index(sides: Sequence[NDArray[np.float64]] | NDArray[np.float64]) -> NDArray[np.int32]:
    """Index of the material that labels each point: the last merge with side >= 0, else 0."""
    if not len(sides):
        raise ValueError("label_index needs at least one merge")
    index = np.zeros(sides[0].shape, np.int32)
    for i, side in enumerate(sides, start=1):
        index[side >= 0.0] = i
    return index
