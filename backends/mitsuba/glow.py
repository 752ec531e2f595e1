"""Surfaces that give off light: an emitter on a flattened mesh, from both sides of it.

Mitsuba's own ``area`` shines from one side only, and samples textures by coordinates that no two
points of a mesh may share. This one samples the mesh by its area.

Import it once Mitsuba's variant is set.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import drjit as dr
import mitsuba as mi
import numpy as np
from numpy.typing import NDArray

from scenec.backends.mitsuba.aligned import aligned
from scenec.backends.mitsuba.geometry import FlatMesh
from scenec.backends.mitsuba.stack import Glow as Radiance
from scenec.backends.stage.scene import RenderScene, Surface

PLUGIN = "scenec_glow"
#: Of ``light_share``.
WEIGHTS = (0.05, 1.0)


def make_emitter(radiance: Radiance, weight: float) -> Any:
    """An emitter; ``place`` it once its mesh is made.

    Args:
        radiance: What it gives off.
        weight: How often it is looked at for light; the sky and the suns together have 1.
    """
    made = mi.load_dict({"type": PLUGIN, "sampling_weight": weight})
    made.radiance = radiance
    return made


def light_share(scene: RenderScene, surfaces: Sequence[Surface], flat: FlatMesh) -> float:
    """A weight for ``make_emitter``: roughly the share of the scene's light, within bounds.

    Any weight leaves the mean picture as it is; a bad one makes it noisier.
    """
    width, depth, _ = scene.bounds[1] - scene.bounds[0]
    brightest = max(max(surface.emission) for surface in surfaces)
    filled = min(float(face_areas(flat).sum()) / max(float(width * depth), 1e-30), 1.0)
    others = 0.0
    for light in scene.lighting:
        suns = sum(float(np.max(sun.irradiance)) for sun in light.suns)
        others = max(others, suns + sum(np.pi * float(np.max(d.scale)) for d in light.domes))
    if others <= 0.0:
        return 1.0
    return float(np.clip(np.pi * brightest * filled / others, *WEIGHTS))


def face_areas(flat: FlatMesh) -> NDArray[np.float64]:
    """Square meters of each face, [m]."""
    corners = flat.points.astype(np.float64)[flat.faces]
    across = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    areas: NDArray[np.float64] = 0.5 * np.sqrt((across * across).sum(axis=1))
    return areas


class Glow(mi.Emitter):
    """See the module."""

    def __init__(self, props: Any) -> None:
        super().__init__(props)
        self.radiance: Any = None
        self.m_flags = mi.EmitterFlags.Surface | mi.EmitterFlags.SpatiallyVarying

    def place(self, mesh: Any, flat: FlatMesh) -> None:
        """Say what it shines from: again when that moves."""
        areas = face_areas(flat)
        self.area = dr.opaque(mi.Float, max(float(areas.sum()), 1e-30))
        self.faces = mi.DiscreteDistribution(mi.Float(areas.astype(np.float32)))
        self.corners = mi.UInt32(flat.faces.ravel())
        self.points = mi.Float(flat.points.ravel())
        self.normals = None if flat.normals is None else mi.Float(flat.normals.ravel())
        self.coordinates = (
            None if flat.texcoords is None else mi.Float(aligned(flat.texcoords).ravel())
        )
        # Its number: the mesh itself would hold this, and this it, for ever.
        pointer = dr.reinterpret_array(mi.UInt32, mi.ShapePtr(mesh))
        self.shape = dr.opaque(mi.UInt32, int(np.array(pointer)[0]))

    def eval(self, si: Any, active: Any = True) -> Any:
        return self.radiance.eval(si, active) & active

    def _drawn(self, sample: Any, active: Any) -> tuple[Any, Any]:
        """A point drawn by area, as an interaction, and its face's unit normal."""
        face, reused = self.faces.sample_reuse(sample.x, active)
        share = mi.warp.square_to_uniform_triangle(mi.Point2f(reused, sample.y))
        corners = [dr.gather(mi.UInt32, self.corners, 3 * face + k, active) for k in range(3)]

        def between(kind: Any, values: Any) -> Any:
            a, b, c = (dr.gather(kind, values, corner, active) for corner in corners)
            return a, a + share.x * (b - a) + share.y * (c - a), b - a, c - a

        si = dr.zeros(mi.SurfaceInteraction3f)
        _, si.p, ab, ac = between(mi.Point3f, self.points)
        normal = dr.normalize(dr.cross(mi.Vector3f(ab), mi.Vector3f(ac)))
        si.n = mi.Normal3f(normal)
        shading = si.n
        if self.normals is not None:
            shading = mi.Normal3f(dr.normalize(between(mi.Normal3f, self.normals)[1]))
        si.sh_frame = mi.Frame3f(mi.Vector3f(shading))
        if self.coordinates is not None:
            si.uv = between(mi.Point2f, self.coordinates)[1]
        si.prim_index = face
        si.shape = dr.reinterpret_array(mi.ShapePtr, mi.UInt32(self.shape))
        return si, normal

    def _density(self, ds: Any) -> Any:
        """Returns the density by the shading normal, the one that a hit has and weights use."""
        cosine = dr.abs(dr.dot(ds.d, ds.n))
        return dr.select(cosine > 0.0, dr.square(ds.dist) / (cosine * self.area), 0.0)

    def sample_direction(self, it: Any, sample: Any, active: Any = True) -> tuple[Any, Any]:
        si, normal = self._drawn(sample, active)
        ds = dr.zeros(mi.DirectionSample3f)
        ds.p, ds.n, ds.uv = si.p, si.sh_frame.n, si.uv
        ds.time = it.time
        away = si.p - it.p
        ds.dist = dr.norm(away)
        ds.d = away / ds.dist
        ds.emitter = mi.EmitterPtr(self)
        density = self._density(ds)
        active = active & (density > 0.0) & dr.isfinite(density)
        ds.pdf = dr.select(active, density, 0.0)
        cosine = dr.abs(dr.dot(ds.d, normal))
        weight = cosine * self.area / dr.square(ds.dist)
        return ds, dr.select(active, self.radiance.eval(si, active) * weight, 0.0)

    def pdf_direction(self, it: Any, ds: Any, active: Any = True) -> Any:
        return dr.select(active, self._density(ds), 0.0)

    def to_string(self) -> str:
        return "Glow[]"


mi.register_emitter(PLUGIN, Glow)
