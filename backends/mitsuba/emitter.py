"""Sky and suns as one emitter at infinity, so that they change without touching geometry.

A far disc as a shape would do for the sun, but moving a shape rebuilds Embree's whole hierarchy
(0.6 s for three million triangles at every sample, measured), shows the disc to camera and
visibility rays, and bends directions by parallax. Here the suns are cones of directions on top of
the dome, with full multiple importance sampling. Irradiance on a surface that faces a sun is E:
radiance E / (pi * sin(diameter / 2)**2) over the cone.

A sun that shines through a picture (``Gobo``) is found by samples of light alone, which count in
full: where a ray comes from that leaves the scene, Mitsuba does not say. Only lobes narrower than
the disc are noisier for it.

Of the sky only what is brighter than its mean is drawn, by a ``guide``: surfaces' own sampling
finds the rest with less noise (Karlik et al. 2019, "MIS Compensation"). Of a constant sky nothing
is drawn.

Import it once Mitsuba's variant is set.
"""

from __future__ import annotations

from typing import Any

import drjit as dr
import mitsuba as mi
import numpy as np
from numpy.typing import NDArray

from scenec.backends.picture.guide import sky_guide
from scenec.backends.picture.sky import (
    MIN_SUN_DIAMETER_RAD,
    Sky,
    combine,
    mean_radiance,
)
from scenec.backends.stage.scene import Gobo, Lighting
from scenec.backends.surface.gobo import load_gobo

PLUGIN = "scenec_sky_sun"
#: A sample of the sky's guide is about as noisy as so many times its light from a sun (measured).
SKY_NOISE = 3.0
#: Of a sky that differs from its mean by less than this share of the suns' light nothing is drawn:
#: all samples of light go to the suns.
LEAST_DRAWN = 0.1
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
        self.guide: Any = None
        self.suns: list[tuple[Any, Any, Any, Any]] = []
        # Of each: its picture, and from places to coordinates in it; None without one.
        self.gobos: list[tuple[Any, Any, Any] | None] = []
        # Of what is drawn, on an average surface; the suns' share of samples, and of those now.
        self.drawn_irradiance = self.sun_share = 0.0
        self.sun_fraction = mi.Float(0.0)

    def set_lighting(self, lighting: Lighting, center: NDArray[np.float64]) -> None:
        """The light of a sample, for places relative to ``center``."""
        sky = combine(lighting.domes)
        lit = sky is not None and np.any(sky.picture)
        self.dome = mi.load_dict(dome_dict(sky)) if sky is not None and lit else None
        powers = np.array([np.mean(sun.irradiance) for sun in lighting.suns])
        # A surface turned anyhow towards a sun gets half its irradiance on average.
        from_suns = 0.5 * float(powers.sum())
        guide = None if sky is None else sky_guide(sky, LEAST_DRAWN * from_suns)
        self.guide = None if guide is None else mi.load_dict(dome_dict(guide))
        self.suns, self.gobos = [], []
        for sun, power in zip(lighting.suns, powers, strict=True):
            if power <= 0.0:
                continue
            half = 0.5 * max(sun.diameter_rad, MIN_SUN_DIAMETER_RAD)
            versine = 2.0 * np.sin(0.5 * half) ** 2
            radiance = np.asarray(sun.irradiance) / (np.pi * np.sin(half) ** 2)
            values = (
                mi.Vector3f(np.asarray(sun.to_light, np.float64).tolist()),
                mi.Color3f(radiance.tolist()),
                mi.Float(versine),
                # How often it is chosen of all suns.
                mi.Float(power / powers.sum()),
            )
            dr.make_opaque(*values)
            self.suns.append(values)
            self.gobos.append(None if sun.gobo is None else _upload(sun.gobo, center))
        from_sky = 0.0 if guide is None else np.pi * float(mean_radiance(guide).mean())
        self.drawn_irradiance = from_suns + from_sky
        self.sun_share = 0.0
        if from_suns > 0.0:
            self.sun_share = from_suns / (from_suns + SKY_NOISE * from_sky)
        self.split(1)

    def split(self, samples: int) -> None:
        """Share samples between suns and sky, for pixels of so many.

        In quarters or halves of them: any other share leaves one sample of a pixel to chance.
        """
        parts = 4 if samples % 4 == 0 else 2
        share = self.sun_share
        if 0.0 < share < 1.0:
            share = float(np.clip(round(share * parts), 1, parts - 1)) / parts
        self.sun_fraction = dr.opaque(mi.Float, share)

    def _light(self, w: Any, active: Any, drawn: Any = None) -> tuple[Any, Any]:
        """Radiance from direction ``w`` and the density with which it is sampled."""
        si = dr.zeros(mi.SurfaceInteraction3f)
        si.wi = -w
        value, pdf = mi.Color3f(0.0), mi.Float(0.0)
        if self.dome is not None:
            value += self.dome.eval(si, active)
        if self.guide is not None:
            ds = dr.zeros(mi.DirectionSample3f)
            ds.d = w
            pdf += (1.0 - self.sun_fraction) * self.guide.pdf_direction(si, ds, active)
        for i, (axis, radiance, versine, chance) in enumerate(self.suns):
            if self.gobos[i] is not None:
                continue
            inside = dr.squared_norm(w - axis) <= 2.0 * versine
            if drawn is not None:
                # A direction drawn from the cone belongs to it, whatever rounding says.
                inside |= drawn == i
            value += dr.select(inside, radiance, 0.0)
            # Solid angle of the cone is 2 * pi * (1 - cos(half)).
            cone_pdf = self.sun_fraction * chance / (dr.two_pi * versine)
            pdf += dr.select(inside, cone_pdf, 0.0)
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
        if self.guide is not None:
            w = mi.Vector3f(self.guide.sample_direction(it, mi.Point2f(x, sample.y), active)[0].d)
        s, c = dr.sincos(dr.two_pi * sample.y)
        before = mi.Float(0.0)
        for i, (axis, _, versine, chance) in enumerate(self.suns):
            # The last takes what rounding leaves.
            here = to_sun & (x >= before)
            height = dr.clip((x - before) / chance, 0.0, 1.0) * versine
            radius = dr.safe_sqrt(height * (2.0 - height))
            cone = mi.Vector3f(radius * c, radius * s, 1.0 - height)
            w = dr.select(here, mi.Frame3f(axis).to_world(cone), w)
            drawn = dr.select(here, i, drawn)
            before += chance
        value, pdf = self._light(w, active, drawn)
        alone = mi.Bool(False)
        for i, (_, radiance, versine, chance) in enumerate(self.suns):
            if self.gobos[i] is None:
                continue
            here = drawn == i
            alone |= here
            value = dr.select(here, radiance * _passed(self.gobos[i], it.p), value) & active
            pdf = dr.select(here, fraction * chance / (dr.two_pi * versine), pdf)
        ds = dr.zeros(mi.DirectionSample3f)
        ds.p = dr.fma(w, FAR, it.p)
        ds.n = -w
        ds.d = w
        ds.dist = mi.Float(FAR)
        ds.pdf = dr.select(active, pdf, 0.0)
        ds.delta = alone
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


def _upload(gobo: Gobo, center: NDArray[np.float64]) -> tuple[Any, Any, Any]:
    """A picture, and the rows that take places relative to ``center`` to its coordinates."""
    shares = load_gobo(gobo.file)
    picture = mi.Texture2f(
        mi.TensorXf(np.ascontiguousarray(shares[..., None])),
        use_accel=False,
        filter_mode=dr.FilterMode.Linear,
        wrap_mode=dr.WrapMode.Mirror,
    )
    rows = [mi.Vector3f(row.tolist()) for row in gobo.to_picture[:, :3]]
    start = mi.Point2f((gobo.to_picture[:, :3] @ center + gobo.to_picture[:, 3]).tolist())
    dr.make_opaque(*rows, start)
    return picture, rows, start


def _passed(gobo: Any, place: Any) -> Any:
    """Share of a sun's light that comes through its picture to places."""
    picture, rows, start = gobo
    u, v = (dr.dot(row, mi.Vector3f(place)) for row in rows)
    return picture.eval(mi.Point2f(start.x + u, start.y + v))[0]


mi.register_emitter(PLUGIN, SkySun)
