"""The fallback without LLVM: the same questions asked of ``scalar_rgb``, ray by ray.

Python emitters cost too much per ray here, so the suns are one-sided far area discs: distance D
beyond the scene, radius D*tan(diameter/2), radiance E/(pi*sin(diameter/2)**2). Moving them costs a
new hierarchy at every sample, which is little beside the rest.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from scenec.backends.contract import NO_ROW, Rays, Visibility
from scenec.backends.mitsuba.emitter import dome_dict
from scenec.backends.mitsuba.geometry import Group
from scenec.backends.picture.sky import MIN_SUN_DIAMETER_RAD, combine
from scenec.backends.stage.scene import Camera, Lamp, Lighting, Sun
from scenec.schemas.errors import CameraRefusedError

#: Half angle of the widest of Mitsuba's spots, radians.
WIDEST_SPOT = np.radians(89.0)


def visibility(
    mi: Any,
    scene: Any,
    meshes: Sequence[Any],
    groups: Sequence[Group],
    rays: Rays,
    center: NDArray[np.float64],
) -> Visibility:
    """First hits, one Python call a ray."""
    n = len(rays.directions)
    origins = (rays.origins - center).tolist()
    directions = rays.directions.tolist()
    index_of = {mesh.id(): i for i, mesh in enumerate(meshes)}
    which = np.full(n, -1)
    prim = np.zeros(n, np.int64)
    for i in range(n):
        hit = scene.ray_intersect_preliminary(mi.Ray3f(origins[i], directions[i]))
        if hit.is_valid():
            which[i] = index_of[hit.shape.id()]
            prim[i] = hit.prim_index
    row = np.full(n, NO_ROW, np.int32)
    face = np.zeros(n, np.int32)
    for i, group in enumerate(groups):
        index = np.flatnonzero(which == i)
        row[index], face[index] = group.locate(prim[index])
    return Visibility(row, face)


def half(
    mi: Any,
    meshes: Sequence[Any],
    integrator: Any,
    camera: Camera,
    lighting: Lighting,
    center: NDArray[np.float64],
    bounds: NDArray[np.float64],
    spp: int,
    seed: int,
) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
    """Light [h, w, 3] and coverage [h, w] of one half.

    Raises:
        BackendError: The camera's pixels are not square; only LLVM draws those.
    """
    parts: dict[str, Any] = {"type": "scene"}
    parts |= {f"mesh{i}": mesh for i, mesh in enumerate(meshes)}
    extent = float(np.linalg.norm(bounds[1] - bounds[0])) + float(
        np.linalg.norm(camera.camera_to_world[:3, 3] - center)
    )
    sky = combine(lighting.domes)
    if sky is not None and np.any(sky.picture):
        parts["dome"] = dome_dict(mi, sky)
    for i, sun in enumerate(lighting.suns):
        if np.any(sun.irradiance):
            parts[f"sun{i}"] = disc_dict(mi, sun, 1e3 * max(extent, 1.0))
    for i, lamp in enumerate(lighting.lamps):
        parts[f"lamp{i}"] = spot_dict(mi, lamp, center)
    parts["sensor"] = _sensor(mi, camera, center, 1e4 * max(extent, 1.0))
    scene = mi.load_dict(parts, optimize=False)
    picture = np.array(mi.render(scene, integrator=integrator, spp=spp, seed=seed))
    return picture[..., :3], picture[..., 3]


def disc_dict(mi: Any, sun: Sun, distance: float) -> dict[str, Any]:
    """A sun as a one-sided far disc that faces the scene's center."""
    theta = 0.5 * max(sun.diameter_rad, MIN_SUN_DIAMETER_RAD)
    radiance = np.asarray(sun.irradiance) / (np.pi * np.sin(theta) ** 2)
    direction = np.asarray(sun.to_light, float)
    up = [0.0, 0.0, 1.0] if abs(direction[2]) < 0.9 else [1.0, 0.0, 0.0]
    transform = mi.ScalarTransform4f()
    to_world = transform.look_at(
        origin=(direction * distance).tolist(), target=[0.0, 0.0, 0.0], up=up
    ) @ transform.scale([float(distance * np.tan(theta))] * 3)
    return {
        "type": "disk",
        "to_world": to_world,
        "emitter": {"type": "area", "radiance": {"type": "rgb", "value": radiance.tolist()}},
    }


def spot_dict(mi: Any, lamp: Lamp, center: NDArray[np.float64]) -> dict[str, Any]:
    """A lamp as Mitsuba's own point, or spot, whose light falls off linearly with the angle."""
    position = (lamp.position - center).tolist()
    intensity = {"type": "rgb", "value": np.asarray(lamp.intensity).tolist()}
    if lamp.cone > WIDEST_SPOT:
        return {"type": "point", "position": position, "intensity": intensity}
    up = [0.0, 0.0, 1.0] if abs(lamp.axis[2]) < 0.9 else [1.0, 0.0, 0.0]
    target = (np.array(position) + lamp.axis).tolist()
    cutoff = float(np.degrees(lamp.cone))
    return {
        "type": "spot",
        "to_world": mi.ScalarTransform4f().look_at(origin=position, target=target, up=up),
        "intensity": intensity,
        "cutoff_angle": cutoff,
        # A ramp of no width divides by zero.
        "beam_width": min(cutoff * (1.0 - lamp.softness), cutoff * 0.999),
    }


def lamp_losses(lamps: Sequence[Lamp]) -> list[str]:
    """What ``spot_dict`` makes of lamps, a line each."""
    found = []
    if any(lamp.radius_m > 0.0 for lamp in lamps):
        found.append("mitsuba (scalar_rgb) draws lamps as points: their shadows are sharp")
    if any(lamp.softness > 0.0 and lamp.cone <= WIDEST_SPOT for lamp in lamps):
        found.append(
            "mitsuba (scalar_rgb) lets lamps fade linearly over the border of the cone: up to 10 % "
            "of the axis's intensity off"
        )
    if any(lamp.cone > WIDEST_SPOT and (lamp.cone < np.pi or lamp.softness) for lamp in lamps):
        found.append("mitsuba (scalar_rgb) lets lamps wider than 89 degrees shine everywhere")
    return found


def _sensor(mi: Any, camera: Camera, center: NDArray[np.float64], far: float) -> dict[str, Any]:
    k = camera.intrinsics
    if abs(k[0, 0] - k[1, 1]) > 1e-6 * k[0, 0] or k[0, 1] != 0.0:
        raise CameraRefusedError(
            f"camera {camera.name}: scalar_rgb draws square pixels only (fx = {k[0, 0]:g}, "
            f"fy = {k[1, 1]:g}, skew = {k[0, 1]:g}). Mend it with: pip install llvm-nanobind"
        )
    pose = np.array(camera.camera_to_world)
    pose[:3, 3] -= center
    # Mitsuba looks along +z with x to the left and y up: a half turn about z from OpenCV's axes.
    pose[:3, :2] *= -1.0
    return {
        "type": "perspective",
        "fov_axis": "x",
        "fov": float(np.degrees(2.0 * np.arctan(0.5 * camera.width / k[0, 0]))),
        "principal_point_offset_x": float(0.5 - k[0, 2] / camera.width),
        "principal_point_offset_y": float(0.5 - k[1, 2] / camera.height),
        "near_clip": 1e-7 * far,
        "far_clip": far,
        "to_world": mi.ScalarTransform4f(pose),
        "film": {
            "type": "hdrfilm",
            "width": camera.width,
            "height": camera.height,
            "rfilter": {"type": "box"},
            "pixel_format": "rgba",
            "component_format": "float32",
        },
        "sampler": {"type": "independent"},
    }
