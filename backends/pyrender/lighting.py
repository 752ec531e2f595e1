"""Light as the shading program takes it: sky as spherical harmonics, suns' shadow maps."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from scenec.backends.picture.sky import aureole, combine, texel_directions
from scenec.backends.pyrender.geometry import View
from scenec.backends.stage.scene import Lighting, RenderScene, Sun
from scenec.backends.surface.facets import deviation
from scenec.schemas.kernels import kernel

#: Radians; suns wider than this, three times ours, throw visibly soft shadows.
_WIDE_SUN = 0.03
#: Shadow maps of a sun: the nearer what is seen, the finer.
CASCADES = 3
#: Samples a picture's shadow maps are fitted to, at most.
_FIT_SAMPLES = 1 << 17
#: Of a shadow map's extent, on each side, for what lies between those samples.
_FIT_MARGIN = 0.03

# Constants of the real spherical harmonics, times what a cosine lobe leaves of each band
# (Ramamoorthi and Hanrahan 2001).
_BAND = np.pi * np.array([1.0] + 3 * [2.0 / 3.0] + 5 * [0.25])
_NORM = np.array(
    [0.28209479, 0.48860251, 0.48860251, 0.48860251, 1.09254843, 1.09254843, 0.31539157,
     1.09254843, 0.54627421]
)  # fmt: skip


@dataclass(frozen=True)
class SmoothSky:
    """A sky to the second order in the direction: sums of these times ``polynomials``.

    Attributes:
        irradiance: Of a surface, by its normal, float64 [9, 3].
        mirrored: Radiance by direction, float64 [9, 3]; over ground, what is below the horizon is
            the mirror image of what is above, so that a glossy lobe does not end there.
        dark: Whether there is no light at all.
        aureole: Share of it that comes from about the first sun (``picture.sky.aureole``).
    """

    irradiance: NDArray[np.float64]
    mirrored: NDArray[np.float64]
    dark: bool = False
    aureole: float = 0.0


DARK = SmoothSky(np.zeros((9, 3)), np.zeros((9, 3)), True)


def smooth_sky(lighting: Lighting, ground: bool = False, facets: bool = False) -> SmoothSky:
    """The domes of a sample.

    Args:
        lighting: The light.
        ground: Whether ground hides what is below the world's horizon.
        facets: Whether ``SmoothSky.aureole`` is asked for; else it is 0.
    """
    sky = combine(lighting.domes)
    if sky is None:
        return SmoothSky(np.zeros((9, 3)), np.zeros((9, 3)))
    picture = sky.picture
    if sky.constant:
        # Fine enough for the step at the horizon.
        picture = np.broadcast_to(picture, (64, 128, 3))
    height, width = picture.shape[:2]
    # The exact solid angle of each row's texels.
    solid = -np.diff(np.cos(np.arange(height + 1) * (np.pi / height))) * (2.0 * np.pi / width)
    world = texel_directions(height, width).reshape(-1, 3) @ sky.to_world.T
    light = (picture * solid[:, None, None]).reshape(-1, 3).astype(np.float64)
    if ground:
        light = light * (world[:, 2:] >= 0.0)
    moments = polynomials(world).T @ light
    mirrored = moments
    if ground:
        mirrored = moments + polynomials(world * [1.0, 1.0, -1.0]).T @ light
    norm = (_NORM**2)[:, None]
    suns = [sun for sun in lighting.suns if np.any(np.asarray(sun.irradiance) > 0.0)]
    about = aureole(sky, suns[0].to_light) if suns and facets else 0.0
    return SmoothSky(_BAND[:, None] * norm * moments, norm * mirrored, aureole=about)


def polynomials(n: NDArray[np.float64]) -> NDArray[np.float64]:
    """1, y, z, x, xy, yz, 3z^2 - 1, xz, x^2 - y^2 of unit vectors [k, 3], float64 [k, 9]."""
    x, y, z = n[:, 0], n[:, 1], n[:, 2]
    return np.stack(
        [np.ones_like(x), y, z, x, x * y, y * z, 3.0 * z * z - 1.0, x * z, x * x - y * y], axis=1
    )


def losses(scene: RenderScene) -> tuple[str, ...]:
    """Lists what the preview leaves out of a scene, a line each."""
    lines = []
    suns = [sun for lighting in scene.lighting for sun in lighting.suns]
    domes = [dome for lighting in scene.lighting for dome in lighting.domes]
    surfaces = [scene.surfaces[i] for i in sorted({i for m in scene.meshes for i in m.layers})]
    lamps = [lamp for lighting in scene.lighting for lamp in lighting.lamps]
    if lamps:
        lines.append(
            "pyrender's lamps shine on what they reach, with sharp shadows; what surfaces throw on "
            "of their light is left out"
        )
    if any(surface.emits for surface in surfaces):
        lines.append("pyrender's surfaces that give off light light no others")
    if suns or domes:
        lines.append(
            "pyrender draws a preview: light from ground to ground and the sky that hills hide are "
            "estimates on a coarse height field, other light from surface to surface is left out"
        )
    if domes:
        lines.append(
            "pyrender's sky is smooth (second order); small things hide nothing of it"
            + (
                " but leaves a share, on a coarse lattice, and nothing where OpenGL has no 18 "
                "texture units"
                if any(surface.transmits for surface in surfaces)
                else ""
            )
        )
    if any(s.specular or s.metallic or (s.maps and s.maps.metallic) for s in surfaces):
        lines.append("pyrender's gloss and metals mirror suns and a blurred sky, no surfaces")
    if domes and any(s.reflectance is not None for s in surfaces):
        lines.append(
            "pyrender reflects the sky by the albedo towards the camera of Hapke's and Lommel and "
            "Seeliger's laws: mean radiance is off by up to 5 % under a bright aureole"
        )
    if domes and any(deviation(s) > 0.0 for s in surfaces):
        lines.append(
            "pyrender shades facets of maps of normals exactly under suns and lamps, under a sky "
            "by their mean under an even one: radiance is off by 1.4 %, by up to 6 % against a "
            "bright aureole"
        )
    if any(sun.diameter_rad > _WIDE_SUN for sun in suns):
        lines.append("pyrender's shadows are sharp, however wide the sun")
    return tuple(lines)


@dataclass(frozen=True)
class ShadowMap:
    """One cascade.

    Attributes:
        view: How it is drawn; depth is 1 at the sun's side of what it covers, 0 at the other.
        texel_m: Size of its texels, meters.
        depth_m: Depth that it covers.
        of_lamp: Whether it is seen from a lamp: sizes are those at a meter along its axis, and
            depth is the inverse of the way along it.
    """

    view: View
    texel_m: float
    depth_m: float
    of_lamp: bool = False


def fit_shadow_maps(
    depth: NDArray[np.float32],
    near: float,
    rays: NDArray[np.float64],
    origin: NDArray[np.float64],
    sun: Sun,
    size: int,
) -> list[ShadowMap]:
    """Shadow maps that just cover what a picture shows (Lauritzen et al. 2011).

    Args:
        depth: near / planar depth of each sample, 0 where there is nothing, [h, w].
        near: See ``depth``.
        rays: From (column, row, 1) of that picture, centers at + 0.5, to directions with z = 1.
        origin: The camera's position; the views are relative to it.
        sun: The sun.
        size: Texels a side.

    Returns:
        The finest first; [] if nothing is seen.
    """
    stride = max(1, int(np.sqrt(depth.size / _FIT_SAMPLES)))
    low, high = _range(depth, stride)
    if high <= 0.0:
        return []
    nearest, farthest = near / high, near / low
    edges = nearest * (farthest / nearest) ** (np.arange(1, CASCADES + 1) / CASCADES)
    edges[-1] = np.inf
    forward = rays @ np.array([0.5 * depth.shape[1], 0.5 * depth.shape[0], 1.0])
    axes = sun_axes(sun.to_light, forward)
    bounds = _bounds(depth, near, rays, axes, edges, stride)
    found = []
    for box in bounds:
        if not np.all(np.isfinite(box)):
            continue
        low3, high3 = box
        reach = np.maximum((high3 - low3) * _FIT_MARGIN, 1e-6 * farthest)
        found.append(_shadow_map(axes, low3 - reach, high3 + reach, origin, size))
    return found


def sun_axes(to_sun: NDArray[np.float64], forward: NDArray[np.float64]) -> NDArray[np.float64]:
    """Right, up, to the sun, as rows; right lies along the picture's forward where it can."""
    right = forward - to_sun * (forward * to_sun).sum()
    if np.sqrt((right**2).sum()) < 1e-3 * np.sqrt((forward**2).sum()):
        right = np.cross(to_sun, np.eye(3)[np.argmin(np.abs(to_sun))])
    right = right / np.sqrt((right**2).sum())
    return np.stack([right, np.cross(to_sun, right), to_sun])


def _shadow_map(
    axes: NDArray[np.float64],
    low: NDArray[np.float64],
    high: NDArray[np.float64],
    origin: NDArray[np.float64],
    size: int,
) -> ShadowMap:
    extent = high - low
    clip = np.zeros((4, 4))
    clip[:3, :3] = axes * (np.array([2.0, 2.0, 1.0]) / extent)[:, None]
    clip[:3, 3] = -low * (np.array([2.0, 2.0, 1.0]) / extent) - np.array([1.0, 1.0, 0.0])
    clip[3, 3] = 1.0
    # What lies beyond towards the sun throws its shadow too: no plane there.
    planes = np.array(
        [
            [*axes[0], -low[0]],
            [*-axes[0], high[0]],
            [*axes[1], -low[1]],
            [*-axes[1], high[1]],
            [*axes[2], -low[2]],
        ]
    )
    texel = float(max(extent[:2])) / size
    view = View(origin, clip.astype(np.float32), planes, (1.4 * texel, 0.0), np.inf)
    return ShadowMap(view, texel, float(extent[2]))


@kernel
def _range(depth, stride):  # type: ignore[no-untyped-def]
    low, high = np.inf, 0.0
    for y in range(0, depth.shape[0], stride):
        for x in range(0, depth.shape[1], stride):
            if depth[y, x] > 0.0:
                low = min(low, depth[y, x])
                high = max(high, depth[y, x])
    return low, high


@kernel
def _bounds(depth, near, rays, axes, edges, stride):  # type: ignore[no-untyped-def]
    out = np.empty((len(edges), 2, 3))
    out[:, 0] = np.inf
    out[:, 1] = -np.inf
    for y in range(0, depth.shape[0], stride):
        for x in range(0, depth.shape[1], stride):
            if not depth[y, x] > 0.0:
                continue
            t = near / depth[y, x]
            cascade = 0
            while t > edges[cascade]:
                cascade += 1
            for k in range(3):
                value = 0.0
                for j in range(3):
                    direction = rays[j, 0] * (x + 0.5) + rays[j, 1] * (y + 0.5) + rays[j, 2]
                    value += axes[k, j] * direction * t
                out[cascade, 0, k] = min(out[cascade, 0, k], value)
                out[cascade, 1, k] = max(out[cascade, 1, k], value)
    return out
