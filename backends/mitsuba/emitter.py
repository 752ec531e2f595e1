"""Sky and suns as one emitter at infinity, so that they change without touching geometry.

A far disc as a shape would do for the sun, but moving a shape rebuilds Embree's whole hierarchy
(0.6 s for three million triangles at every sample, measured), shows the disc to camera and
visibility rays, and bends directions by parallax. Here the suns are cones of directions on top of
the dome, with full multiple importance sampling. Irradiance on a surface that faces a sun is E:
radiance E / (pi * sin(diameter / 2)**2) over the cone.

Import it once Mitsuba's variant is set.
"""

from __future__ import annotations

from typing import Any

import drjit as dr
import mitsuba as mi
import numpy as np
from numpy.typing import NDArray

from scenec.backends.picture.sky import MIN_SUN_DIAMETER_RAD, Sky, combine
from scenec.backends.stage.scene import Lighting

PLUGIN = "scenec_sky_sun"
#: Bounds of the fraction of light samples that go to the suns where there is a sky too.
SUN_FRACTION = (0.2, 0.8)
#: Meters; farther than anything, so that shadow rays do not stop short.
FAR = 1e7


def dome_dict(sky: Sky) -> dict[str, Any]:
    """A dome as Mitsuba's own emitter: ``envmap`` without flips, or ``constant``."""
    if sky.constant:
        return {
            "type": "constant",
            "radiance": {"type": "rgb", "value": sky.picture[0, 0].tolist()},
        }
    to_world = np.eye(4)
    to_world[:3, :3] = sky.to_world
    return {
        "type": "envmap",
        "bitmap": mi.Bitmap(envmap_nodes(sky.picture)),
        "to_world": mi.ScalarTransform4f(to_world),
    }


def envmap_nodes(picture: NDArray[np.float32]) -> NDArray[np.float32]:
    """Rows at Mitsuba's nodes, such that its lookup equals ``sky.lookup`` exactly.

    Mitsuba's ``envmap`` has texel centers across, but puts its first and last rows on the poles.
    Twice as many rows, at edges and centers in turn, carry the same piecewise linear function.
    """
    h = len(picture)
    nodes = np.empty((2 * h + 1, *picture.shape[1:]), np.float32)
    nodes[1::2] = picture
    nodes[2:-1:2] = 0.5 * (picture[:-1] + picture[1:])
    nodes[0], nodes[-1] = picture[0], picture[-1]
    return nodes


class SkySun(mi.Emitter):
    """See the module. Driven by ``set_lighting``; never by Mitsuba's own parameters."""

    def __init__(self, props: Any) -> None:
        super().__init__(props)
        self.m_flags = mi.EmitterFlags.Infinite | mi.EmitterFlags.SpatiallyVarying
        self.dome: Any = None
        self.suns: list[tuple[Any, Any, Any, Any]] = []
        self.sun_fraction = mi.Float(0.0)

    def set_lighting(self, lighting: Lighting) -> None:
        sky = combine(lighting.domes)
        dark = sky is None or not np.any(sky.picture)
        self.dome = None if sky is None or dark else mi.load_dict(dome_dict(sky))
        self.suns = []
        lit = [sun for sun in lighting.suns if np.any(sun.irradiance)]
        for sun in lit:
            half = 0.5 * max(sun.diameter_rad, MIN_SUN_DIAMETER_RAD)
            versine = 2.0 * np.sin(0.5 * half) ** 2
            radiance = np.asarray(sun.irradiance) / (np.pi * np.sin(half) ** 2)
            values = (
                mi.Vector3f(np.asarray(sun.to_light, np.float64).tolist()),
                mi.Color3f(radiance.tolist()),
                mi.Float(versine),
                # Solid angle of the cone is 2 * pi * (1 - cos(half)).
                mi.Float(1.0 / (2.0 * np.pi * versine)),
            )
            dr.make_opaque(*values)
            self.suns.append(values)
        fraction = 0.0
        if lit:
            fraction = 1.0 if sky is None or dark else _sun_fraction(sky, lighting)
        self.sun_fraction = dr.opaque(mi.Float, fraction)

    def _light(self, w: Any, active: Any, drawn: Any = None) -> tuple[Any, Any]:
        """Radiance from direction ``w`` and the density with which it is sampled."""
        si = dr.zeros(mi.SurfaceInteraction3f)
        si.wi = -w
        value, pdf = mi.Color3f(0.0), mi.Float(0.0)
        if self.dome is not None:
            value += self.dome.eval(si, active)
            ds = dr.zeros(mi.DirectionSample3f)
            ds.d = w
            pdf += (1.0 - self.sun_fraction) * self.dome.pdf_direction(si, ds, active)
        for i, (axis, radiance, versine, cone_pdf) in enumerate(self.suns):
            inside = dr.squared_norm(w - axis) <= 2.0 * versine
            if drawn is not None:
                # A direction drawn from the cone belongs to it, whatever rounding says.
                inside |= drawn == i
            value += dr.select(inside, radiance, 0.0)
            pdf += dr.select(inside, cone_pdf * self.sun_fraction / len(self.suns), 0.0)
        return value & active, pdf

    def eval(self, si: Any, active: Any = True) -> Any:
        return self._light(-si.wi, active)[0]

    def pdf_direction(self, it: Any, ds: Any, active: Any = True) -> Any:
        return self._light(ds.d, active)[1]

    def sample_direction(self, it: Any, sample: Any, active: Any = True) -> tuple[Any, Any]:
        fraction = self.sun_fraction
        to_sun = sample.x < fraction
        x = dr.select(to_sun, sample.x / fraction, (sample.x - fraction) / (1.0 - fraction))
        w, drawn = mi.Vector3f(0.0, 0.0, 1.0), mi.Int32(-1)
        if self.dome is not None:
            w = mi.Vector3f(self.dome.sample_direction(it, mi.Point2f(x, sample.y), active)[0].d)
        if self.suns:
            x *= len(self.suns)
            chosen = dr.minimum(mi.Int32(x), len(self.suns) - 1)
            x -= mi.Float(chosen)
            drawn = dr.select(to_sun, chosen, -1)
            s, c = dr.sincos(dr.two_pi * sample.y)
            for i, (axis, _, versine, _) in enumerate(self.suns):
                height = x * versine
                radius = dr.safe_sqrt(height * (2.0 - height))
                cone = mi.Vector3f(radius * c, radius * s, 1.0 - height)
                w = dr.select(drawn == i, mi.Frame3f(axis).to_world(cone), w)
        value, pdf = self._light(w, active, drawn)
        ds = dr.zeros(mi.DirectionSample3f)
        ds.p = dr.fma(w, FAR, it.p)
        ds.n = -w
        ds.d = w
        ds.dist = mi.Float(FAR)
        ds.pdf = dr.select(active, pdf, 0.0)
        ds.time = it.time
        ds.emitter = mi.EmitterPtr(self)
        return ds, dr.select(active & (pdf > 0.0), value / pdf, 0.0)

    def eval_direction(self, it: Any, ds: Any, active: Any = True) -> Any:
        return self._light(ds.d, active)[0]

    def bbox(self) -> Any:
        # Light from infinity takes no room: an invalid box leaves the scene's alone.
        return mi.ScalarBoundingBox3f()

    def to_string(self) -> str:
        return "SkySun[]"


mi.register_emitter(PLUGIN, SkySun)


def average_irradiance(sky: Sky | None, lighting: Lighting) -> tuple[float, float]:
    """What an average surface gets of sky and of suns, all channels' mean."""
    from_sky = 0.0
    if sky is not None:
        height = len(sky.picture)
        area = np.sin((np.arange(height) + 0.5) * (np.pi / height))[:, None, None]
        from_sky = np.pi * float((sky.picture * area).mean() / area.mean())
    # A surface turned anyhow towards a sun gets half its irradiance on average.
    return from_sky, 0.5 * float(sum(np.mean(sun.irradiance) for sun in lighting.suns))


def _sun_fraction(sky: Sky, lighting: Lighting) -> float:
    """Share of the suns in the light that falls on an average surface, within bounds."""
    from_sky, from_suns = average_irradiance(sky, lighting)
    return float(np.clip(from_suns / (from_suns + from_sky), *SUN_FRACTION))
