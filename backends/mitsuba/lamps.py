"""Lamps as one emitter of no geometry, so that they change without touching any.

Mitsuba's own spots are points whose light falls off linearly; a glowing sphere as a shape would be
seen by every ray, and rebuild the hierarchy wherever it moves. Here one lamp is chosen, by what it
would give unshadowed, and a direction inside the cone of its sphere. No ray can hit a lamp, so no
other way of sampling finds it, and what is sampled counts in full.

The emitter of sky and suns is inside of this one where there are any: near a lamp most samples go
to lamps, far from all of them to the sky. Mitsuba itself would give each its half everywhere.

Import it once Mitsuba's variant is set.
"""

from __future__ import annotations

from typing import Any

import drjit as dr
import mitsuba as mi
import numpy as np
from numpy.typing import NDArray

from scenec.backends.mitsuba.arrays import ARRAYS
from scenec.backends.stage.scene import Lamp, Lighting
from scenec.backends.surface.lamps import cone, falloff

PLUGIN = "scenec_lamps"
#: Bounds of the fraction of light samples that go to lamps where there are sky or suns too.
LAMP_FRACTION = (0.1, 0.9)
#: Share of the samples that choose among all lamps evenly: a sphere can shine where the cone of
#: its middle does not.
EVENLY = 0.1
#: Of more lamps than this, one is chosen evenly: the choice is part of the kernel, lamp by lamp.
WEIGHED = 16
#: Square meters; keeps what is at a lamp's very middle finite.
_TINY = 1e-20


class Lamps(mi.Emitter):
    """See the module. Driven by ``set_lighting``; never by Mitsuba's own parameters."""

    def __init__(self, props: Any) -> None:
        super().__init__(props)
        # Of the sky in it.
        self.m_flags = mi.EmitterFlags.Infinite | mi.EmitterFlags.SpatiallyVarying
        self.count = 0
        self.around: Any = None
        self.around_weight = mi.Float(0.0)

    def set_lighting(self, lighting: Lighting, center: NDArray[np.float64]) -> None:
        """The light of a sample; positions of lamps are relative to ``center``."""
        lamps = lighting.lamps
        self.count = len(lamps)
        if self.around is not None:
            self.around.set_lighting(lighting, center)
            self.around_weight = dr.opaque(mi.Float, self.around.drawn_irradiance)
        # One that gives nothing, so that arrays are never empty.
        shown = lamps or [Lamp(center, np.array([0.0, 0.0, -1.0]), np.zeros(3), 0.0, 1.0, 0.0)]

        def column(values: Any) -> Any:
            return mi.Float(np.ascontiguousarray(values, np.float32))

        def columns(kind: Any, values: Any) -> Any:
            return kind(*(column(part) for part in np.array(values, np.float64).T))

        self.position = columns(mi.Point3f, [lamp.position - center for lamp in shown])
        self.axis = columns(mi.Vector3f, [lamp.axis for lamp in shown])
        self.intensity = columns(mi.Color3f, [lamp.intensity for lamp in shown])
        self.radius = column([lamp.radius_m for lamp in shown])
        self.cone = columns(mi.Vector3f, [cone(lamp) for lamp in shown])
        dr.make_opaque(self.position, self.axis, self.intensity, self.radius, self.cone)

    def _falloff(self, w: Any, index: Any) -> Any:
        """Returns the cone's factor on light emitted in a direction."""
        axis, numbers = (dr.gather(mi.Vector3f, a, index) for a in (self.axis, self.cone))
        return falloff(ARRAYS, mi.Vector3f(w), axis, tuple(numbers))

    def _weights(self, it: Any) -> list[Any]:
        """Estimates each lamp's light on a surface that faces it; empty for too many lamps."""
        weights = []
        for k in range(self.count if self.count <= WEIGHED else 0):
            index = mi.UInt32(k)
            offset = it.p - dr.gather(mi.Point3f, self.position, index)
            radius = dr.gather(mi.Float, self.radius, index)
            squared = dr.maximum(dr.squared_norm(offset), radius * radius) + _TINY
            falloff = self._falloff(offset * dr.rsqrt(squared), index)
            strength = dr.mean(dr.gather(mi.Color3f, self.intensity, index))
            weights.append(falloff * strength / squared)
        return weights

    def _fraction(self, weights: list[Any]) -> Any:
        """Returns the fraction of samples that go to lamps."""
        if self.around is None:
            return mi.Float(1.0)
        if not self.count:
            return mi.Float(0.0)
        share = mi.Float(0.5)
        if weights:
            total = sum(weights[1:], weights[0])
            share = dr.clip(total / (total + self.around_weight), *LAMP_FRACTION)
        return dr.select(self.around_weight > 0.0, share, 1.0)

    def _choose(self, weights: list[Any], x: Any) -> tuple[Any, Any, Any]:
        """A lamp, its probability, and what is left of the number that chose it."""
        if self.count <= 1:
            return mi.UInt32(0), mi.Float(1.0), x
        if not weights:
            scaled = x * self.count
            index = dr.minimum(mi.UInt32(scaled), self.count - 1)
            return index, mi.Float(1.0 / self.count), scaled - mi.Float(index)
        total = sum(weights[1:], weights[0])
        scale = dr.select(total > 0.0, (1.0 - EVENLY) / total, 0.0)
        even = dr.select(total > 0.0, EVENLY, 1.0) / self.count
        chosen, chance, left = mi.UInt32(self.count - 1), mi.Float(even), mi.Float(x)
        before, found = mi.Float(0.0), mi.Bool(False)
        for k, weight in enumerate(weights):
            p = weight * scale + even
            # The last takes what rounding leaves.
            here = ~found & ((x < before + p) | mi.Bool(k == self.count - 1))
            chosen = dr.select(here, mi.UInt32(k), chosen)
            chance = dr.select(here, p, chance)
            left = dr.select(here, (x - before) / p, left)
            found |= here
            before += p
        return chosen, chance, dr.clip(left, 0.0, dr.one_minus_epsilon(mi.Float))

    def sample_direction(self, it: Any, sample: Any, active: Any = True) -> tuple[Any, Any]:
        weights = self._weights(it)
        if self.around is None:
            return self._sample_lamps(it, weights, sample.x, sample.y, active)
        share = self._fraction(weights)
        here = sample.x < share
        rest = 1.0 - share
        x = dr.select(here, sample.x / share, (sample.x - share) / rest)
        lamp, light = self._sample_lamps(it, weights, x, sample.y, active & here)
        far, sky = self.around.sample_direction(it, mi.Point2f(x, sample.y), active & ~here)
        far.pdf *= rest
        ds = dr.select(here, lamp, far)
        ds.emitter = mi.EmitterPtr(self)
        return ds, dr.select(here, light / share, sky / rest)

    def _sample_lamps(
        self, it: Any, weights: list[Any], x: Any, y: Any, active: Any
    ) -> tuple[Any, Any]:
        index, chance, x = self._choose(weights, x)
        offset = dr.gather(mi.Point3f, self.position, index) - it.p
        radius = dr.gather(mi.Float, self.radius, index)
        squared = dr.squared_norm(offset) + _TINY
        distance = dr.sqrt(squared)
        sine2 = radius * radius / squared
        outside = sine2 < 1.0
        cosine = dr.safe_sqrt(1.0 - sine2)
        # Of the cone of directions to the sphere: versine, height of the sample, its sine.
        height = x * sine2 / (1.0 + cosine)
        across2 = height * (2.0 - height)
        across = dr.safe_sqrt(across2)
        s, c = dr.sincos(dr.two_pi * y)
        frame = mi.Frame3f(mi.Vector3f(offset) / distance)
        w = frame.to_world(mi.Vector3f(across * c, across * s, 1.0 - height))
        near = distance * (1.0 - height) - dr.safe_sqrt(radius * radius - squared * across2)
        # Radiance I / (pi r^2) over the cone's 2 pi (1 - cosine); for a point I / d^2.
        gain = self._falloff(-w, index) * 2.0 / (squared * (1.0 + cosine) * chance)
        value = dr.gather(mi.Color3f, self.intensity, index) * gain
        lit = active & outside & (gain > 0.0)
        ds = dr.zeros(mi.DirectionSample3f)
        ds.p = dr.fma(w, near, it.p)
        ds.n = -w
        ds.d = w
        ds.dist = near
        ds.pdf = dr.select(lit, mi.Float(1.0), 0.0)
        # No ray hits a lamp: nothing else can have found this direction.
        ds.delta = mi.Bool(True)
        ds.time = it.time
        ds.emitter = mi.EmitterPtr(self)
        return ds, dr.select(lit, value, 0.0)

    def pdf_direction(self, it: Any, ds: Any, active: Any = True) -> Any:
        if self.around is None:
            return mi.Float(0.0)
        rest = 1.0 - self._fraction(self._weights(it))
        return rest * self.around.pdf_direction(it, ds, active)

    def eval_direction(self, it: Any, ds: Any, active: Any = True) -> Any:
        if self.around is None:
            return mi.Color3f(0.0)
        return self.around.eval_direction(it, ds, active)

    def eval(self, si: Any, active: Any = True) -> Any:
        return mi.Color3f(0.0) if self.around is None else self.around.eval(si, active)

    def bbox(self) -> Any:
        # It takes no room: an invalid box leaves the scene's alone.
        return mi.ScalarBoundingBox3f()

    def to_string(self) -> str:
        return "Lamps[]"


mi.register_emitter(PLUGIN, Lamps)
