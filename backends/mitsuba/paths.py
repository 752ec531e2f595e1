"""Paths of light through a scene of meshes; those that go on after a bounce are gathered.

In one kernel a path is a lane of a packet, which goes on as long as any of its lanes does: outdoors
most paths leave for the sky after a bounce, and the few others keep nearly all packets busy. So the
first bounce is a launch of its own, and all further ones are another, over the paths that are left.
Both are one kernel, for any size of picture, number of bounces and number of paths that go on.

Tracing a launch in Python takes 0.025 CPU s. ``dr.freeze`` of Dr.Jit 1.5.0 cannot record it: its
first call ends the process, and later ones it refuses for their virtual calls.

The estimator and the order of the sampler's numbers are those of Mitsuba's path integrator.

Import it once Mitsuba's variant is set.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import drjit as dr
import mitsuba as mi


class PathStep(NamedTuple):
    """Holds one step of paths, of Dr.Jit's arrays.

    Attributes:
        to_light: Direction sample of the light that was drawn.
        light: What it gives along the path's last ray if nothing stands before it.
        direction: In which the path goes on.
        weight: What of the light from there goes along the last ray.
        leaving: The light from there if nothing is met, by its share beside what is drawn.
    """

    to_light: Any
    light: Any
    direction: Any
    weight: Any
    leaving: Any


def shade(light: Any, si: Any, bsdf: Any, numbers: tuple[Any, Any, Any], active: Any) -> PathStep:
    """Draws light at hits, and the way on.

    Args:
        light: The scene's only emitter, of no geometry.
        si: The hits.
        bsdf: Of their surfaces.
        numbers: Of the sampler: a point for the light, a number and a point for the way on.
        active: Which there are.
    """
    ds, value = light.sample_direction(si, numbers[0], active)
    reflected, density, bs, weight = bsdf.eval_pdf_sample(
        mi.BSDFContext(), si, si.to_local(ds.d), *numbers[1:]
    )
    share = dr.select(ds.delta, 1.0, _balance(ds.pdf, density))
    direct = dr.select(active & (ds.pdf != 0.0), value * reflected * share, 0.0)
    onward = si.to_world(bs.wo)
    sky = dr.zeros(mi.SurfaceInteraction3f)
    sky.wi = -onward
    toward = dr.zeros(mi.DirectionSample3f)
    toward.d = onward
    leaving = light.eval(sky) * _balance(bs.pdf, light.pdf_direction(si, toward))
    return PathStep(ds, direct, onward, weight, leaving)


def sample(
    scene: Any, light: Any, sampler: Any, ray: Any, bounces: int, meet: Any = None
) -> tuple[Any, Any]:
    """Light from surfaces along camera rays, and whether these meet any.

    Args:
        scene: Mitsuba's; its surfaces give off no light.
        light: Its only emitter.
        sampler: Whose next numbers are those of the first hits; a sample a ray.
        ray: From the camera.
        bounces: As of ``contract.BOUNCES``.
        meet: Finds first hits: ``cutouts.meet`` where anything is cut out; None: the scene does.

    Returns:
        ``mi.Color3f`` and ``mi.Bool``.
    """
    find = meet or type(scene).ray_intersect_preliminary
    hit = find(scene, ray, coherent=True)
    valid = hit.is_valid()
    count = dr.width(ray.d)
    total = dr.zeros(mi.Color3f, count)
    weight = dr.full(mi.Color3f, 1.0, count)
    # As later ones are, or the first launch would be another kernel.
    dr.make_opaque(weight, total)
    origin = ray.o + dr.zeros(mi.Point3f, count)
    lane, order = dr.arange(mi.UInt32, count), sampler.reversed_index
    paths = (
        origin, ray.d, hit.t, hit.prim_uv, hit.prim_index, hit.shape, weight, sampler.key,
        order, lane,
    )  # fmt: skip
    going = valid
    for most in (1, bounces):
        dr.eval(paths, going, valid)
        left = dr.compress(going)
        if not most or not dr.width(left):
            break
        paths = tuple(dr.gather(type(values), values, left) for values in paths)
        paths, going, radiance = _follow(scene, light, sampler, paths, most, meet)
        # Not by scatter_reduce, which adds nothing for what is no number.
        dr.scatter(total, dr.gather(mi.Color3f, total, paths[-1]) + radiance, paths[-1])
        dr.eval(paths, going, total)
    return total, valid


def _follow(
    scene: Any, light: Any, sampler: Any, paths: tuple[Any, ...], most: int, meet: Any
) -> tuple[tuple[Any, ...], Any, Any]:
    """Follows paths from their hits for so many bounces at most; which go on, and their light."""
    *state, order, lane = paths
    sampler.reversed_index = order
    count = dr.width(lane)
    find = meet or type(scene).ray_intersect_preliminary

    def hides(ray: Any, active: Any) -> Any:
        if meet is None:
            return scene.ray_test(ray, active)
        return meet(scene, ray, coherent=False, active=active).is_valid()

    def step(active: Any, left: Any, radiance: Any, _: Any, *path: Any) -> tuple[Any, ...]:
        o, d, t, uv, face, shape, weight, key = path
        hit = dr.zeros(mi.PreliminaryIntersection3f, count)
        hit.valid, hit.t, hit.prim_uv, hit.prim_index, hit.shape = active, t, uv, face, shape
        sampler.key = key
        si = hit.compute_surface_interaction(mi.Ray3f(o, d), mi.RayFlags.All, active)
        numbers = sampler.next_2d(), sampler.next_1d(), sampler.next_2d()
        # The path integrator's of Russian roulette.
        sampler.next_1d()
        shaded = shade(light, si, si.bsdf(), numbers, active)
        direct = weight * shaded.light
        lit = active & dr.any(direct != 0.0)
        lit &= ~hides(si.spawn_ray_to(shaded.to_light.p), lit)
        # What is no number is kept, in shadow, too, to be counted by who takes the light.
        lit |= active & ~dr.all(dr.isfinite(direct))
        radiance = radiance + (direct & lit)
        weight = weight * shaded.weight
        active = active & dr.any(weight != 0.0)
        ray = si.spawn_ray(shaded.direction)
        hit = find(scene, ray, coherent=False, active=active)
        met = active & hit.is_valid()
        radiance = radiance + (weight * shaded.leaving & active & ~met)
        left = left - 1
        return (
            met & (left > 0), left, radiance, met, ray.o, ray.d, hit.t, hit.prim_uv, hit.prim_index,
            hit.shape, weight, sampler.key,
        )  # fmt: skip

    active, left = dr.full(mi.Bool, True, count), dr.opaque(mi.UInt32, most)
    start = (mi.Bool(active), left, dr.zeros(mi.Color3f, count), mi.Bool(active), *state)
    _, _, radiance, going, *state = dr.while_loop(start, lambda active, *_: active, step)
    return (*state, order, lane), going, radiance


def _balance(a: Any, b: Any) -> Any:
    """Weight of a sample of density a that could have been drawn with density b, too."""
    a, b = dr.square(a), dr.square(b)
    weight = a / (a + b)
    return dr.select(dr.isfinite(weight), weight, 0.0)
