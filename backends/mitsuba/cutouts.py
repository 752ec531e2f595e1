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


class Mask:
    """What is left of one surface."""

    def __init__(self, maps: Maps) -> None:
        values = field(maps)
        self._sides = tuple(zip(maps.opacity_wrap, values.shape[::-1], strict=True))
        tensor = mi.TensorXf(aligned(values[..., None]))
        # A GPU's own filter knows places between texels to 1/256.
        self._texture = mi.Texture2f(tensor, use_accel=False, wrap_mode=dr.WrapMode.Repeat)

    def keeps(self, uv: Any, active: Any) -> Any:
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
    start, end = ray.o + dr.zeros(mi.Point3f, count), ray.maxt + dr.zeros(mi.Float, count)
    none = dr.zeros(mi.PreliminaryIntersection3f, count)
    parts = (none.t, none.prim_uv, none.prim_index, none.shape)

    def step(
        seeking: Any, valid: Any, gone: Any, at: Any, t: Any, uv: Any, face: Any, shape: Any
    ) -> tuple[Any, ...]:
        part = mi.Ray3f(at, ray.d, end - gone, ray.time, ray.wavelengths)
        hit = scene.ray_intersect_preliminary(part, coherent=coherent, active=seeking)
        met = seeking & hit.is_valid()
        si = hit.compute_surface_interaction(part, mi.RayFlags.All, met)
        cut = met & (si.bsdf().eval_null_transmission(si, met).x > 0.0)
        kept = met & ~cut
        found = gone + hit.t, hit.prim_uv, hit.prim_index, hit.shape
        kept_parts = tuple(
            dr.select(kept, new, old)
            for new, old in zip(found, (t, uv, face, shape), strict=True)
        )
        onward = si.spawn_ray(ray.d).o
        return cut, valid | kept, gone + dr.select(cut, hit.t, 0.0), dr.select(cut, onward, at), *kept_parts

    state = (active & dr.full(mi.Bool, True, count), dr.full(mi.Bool, False, count),
             dr.zeros(mi.Float, count), start, *parts)  # fmt: skip
    _, valid, _, _, *found = dr.while_loop(state, lambda seeking, *_: seeking, step)
    hit = dr.zeros(mi.PreliminaryIntersection3f, count)
    hit.valid = valid
    hit.t, hit.prim_uv, hit.prim_index, hit.shape = found
    return hit
