"""Cut-outs in Mitsuba: ``surface.cutouts`` of its texture coordinates, and rays that go on behind.

Import it once Mitsuba's variant is set.
"""

from __future__ import annotations

from typing import Any

import drjit as dr
import mitsuba as mi

from scenec.backends.mitsuba.aligned import aligned
from scenec.backends.mitsuba.arrays import ARRAYS
from scenec.backends.stage.scene import Maps
from scenec.backends.surface.cutouts import field, folded

#: How far behind what is cut out rays go on, in parts of coordinates: some 30 roundings.
_BEYOND = 2.0**-19


class SurfaceMask:
    """Tells where a surface is opaque, by its mask."""

    def __init__(self, maps: Maps) -> None:
        values = field(maps)
        self._sides = tuple(zip(maps.opacity_wrap, values.shape[::-1], strict=True))
        tensor = mi.TensorXf(aligned(values[..., None]))
        # A GPU's own filter knows places between texels to 1/256.
        self._texture = mi.Texture2f(tensor, use_accel=False, wrap_mode=dr.WrapMode.Repeat)

    def opaque(self, uv: Any, active: Any) -> Any:
        """Whether anything is there."""
        place = (folded(ARRAYS, x, *side) for x, side in zip(uv, self._sides, strict=True))
        return self._texture.eval(mi.Point2f(*place), active)[0] > 0.0


def meet(scene: Any, ray: Any, coherent: bool, active: Any = True) -> Any:
    """``scene.ray_intersect_preliminary``, past all that is cut out.

    Args:
        scene: Mitsuba's.
        ray: Rays; they end at their ``maxt``.
        coherent: Whether they start out side by side.
        active: Which there are.

    Returns:
        ``mi.PreliminaryIntersection3f``; its ``t`` is along ``ray``.
    """
    count = max(dr.width(ray.d), dr.width(ray.o))
    none = dr.zeros(mi.PreliminaryIntersection3f, count)
    parts = none.t, none.prim_uv, none.prim_index, none.shape

    def step(seeking: Any, valid: Any, passed: Any, *parts: Any) -> tuple[Any, ...]:
        # Not as Mitsuba spawns rays, which moves them sideways.
        part = mi.Ray3f(ray.o + ray.d * passed, ray.d, ray.maxt - passed, ray.time, ray.wavelengths)
        hit = scene.ray_intersect_preliminary(part, coherent=coherent, active=seeking)
        met = seeking & hit.is_valid()
        si = hit.compute_surface_interaction(part, mi.RayFlags.All, met)
        cut = met & (si.bsdf().eval_null_transmission(si, met).x > 0.0)
        kept = met & ~cut
        found = passed + hit.t, hit.prim_uv, hit.prim_index, hit.shape
        parts = tuple(dr.select(kept, new, old) for new, old in zip(found, parts, strict=True))
        beyond = hit.t + _BEYOND * (dr.max(dr.abs(si.p)) + dr.abs(passed) + hit.t)
        return cut, valid | kept, passed + dr.select(cut, beyond, 0.0), *parts

    seeking, valid = active & dr.full(mi.Bool, True, count), dr.full(mi.Bool, False, count)
    state = seeking, valid, dr.zeros(mi.Float, count), *parts
    _, hit_valid, _, *found = dr.while_loop(state, lambda seeking, *_: seeking, step)
    none.valid = hit_valid
    none.t, none.prim_uv, none.prim_index, none.shape = found
    return none
