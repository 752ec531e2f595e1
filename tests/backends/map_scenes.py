"""A plane with surface maps, seen from above, and what it must look like in any renderer."""

from __future__ import annotations

from pathlib import Path

import mitsuba_scenes as ms
import numpy as np
from numpy.typing import NDArray
from PIL import Image
from surface_oracle import brighter

from scenec.backends.stage.scene import Camera, Maps, RenderScene, Surface

IRRADIANCE = 1000.0
WIDTH, HEIGHT = 48, 36
#: Meters across one repeat, and pixels of the picture.
SIZE = 7.0
TEXELS = 5


def pixels() -> NDArray[np.uint8]:
    """A picture without symmetry."""
    return np.random.default_rng(4).integers(30, 230, (TEXELS, TEXELS, 3)).astype(np.uint8)


def albedo_scene(folder: Path, offset: tuple[float, float] = (0.0, 0.0)) -> RenderScene:
    """A diffuse plane under a sun in the zenith; base color (0.9, 0.8, 0.7) times a map."""
    file = folder / "albedo.png"
    Image.fromarray(pixels()).save(file)
    surface = Surface("/M", (0.9, 0.8, 0.7), 0.0, 0.5, 0.0, 0.0, Maps(SIZE, base_color=file))
    return _scene(surface, offset)


def expected_albedo(camera: Camera) -> NDArray[np.float64]:
    """Albedo at pixel centers by the definition of ``render_scene.Maps``, [h, w, 3]."""
    k, pose = camera.intrinsics, camera.camera_to_world
    v, u = np.meshgrid(np.arange(HEIGHT) + 0.5, np.arange(WIDTH) + 0.5, indexing="ij")
    d = np.stack([(u - k[0, 2]) / k[0, 0], (v - k[1, 2]) / k[1, 1], np.ones_like(u)], -1)
    world = d @ pose[:3, :3].T
    hit = pose[:3, 3] - world * (pose[2, 3] / world[..., 2:])
    linear = pixels() / 255.0
    linear = np.where(linear <= 0.04045, linear / 12.92, ((linear + 0.055) / 1.055) ** 2.4)
    x = hit[..., 0] / SIZE * TEXELS - 0.5
    y = (1.0 - hit[..., 1] / SIZE) * TEXELS - 0.5
    x0, y0 = np.floor(x).astype(int), np.floor(y).astype(int)
    fx, fy = (x - x0)[..., None], (y - y0)[..., None]

    def texel(row: NDArray, column: NDArray) -> NDArray:
        return linear[row % TEXELS, column % TEXELS]

    top = (1 - fx) * texel(y0, x0) + fx * texel(y0, x0 + 1)
    bottom = (1 - fx) * texel(y0 + 1, x0) + fx * texel(y0 + 1, x0 + 1)
    return ((1 - fy) * top + fy * bottom) * np.array([0.9, 0.8, 0.7])


def normal_scene(folder: Path, tilt: tuple[float, float], flip_green: bool) -> RenderScene:
    """A white plane whose normal map leans everywhere by the same ``tilt`` (x, y of the normal)."""
    normal = np.array([*tilt, np.sqrt(1 - tilt[0] ** 2 - tilt[1] ** 2)])
    stored = normal * np.array([1, -1 if flip_green else 1, 1])
    code = np.rint((stored + 1) / 2 * 255).astype(np.uint8)
    file = folder / f"normal_{flip_green}.png"
    Image.fromarray(np.broadcast_to(code, (4, 4, 3)).copy()).save(file)
    maps = Maps(2.0, normal=file, flip_green=flip_green)
    return _scene(Surface("/M", (1.0, 1.0, 1.0), 0.0, 0.5, 0.0, 0.0, maps), sun=ms.sun(60.0, 30.0))


def expected_cosine(tilt: tuple[float, float], flip_green: bool) -> float:
    """Cosine between that normal, as 8 bits hold it, and the sun of ``normal_scene``."""
    sign = np.array([1, -1 if flip_green else 1, 1])
    normal = sign * [*tilt, np.sqrt(1 - tilt[0] ** 2 - tilt[1] ** 2)]
    normal = sign * (np.rint((normal + 1) / 2 * 255) / 255 * 2 - 1)
    normal /= np.linalg.norm(normal)
    e, a = np.radians([60.0, 30.0])
    return float(normal @ [np.cos(e) * np.cos(a), np.cos(e) * np.sin(a), np.sin(e)])


def metal_scene(folder: Path | None) -> RenderScene:
    """A plane of colored metal; roughness and metallic as maps if a folder is given."""
    maps, roughness, metallic = None, 0.6, 1.0
    if folder is not None:
        rough, metal = folder / "rough.png", folder / "metal.png"
        Image.fromarray(np.full((2, 2), 153, np.uint8)).save(rough)
        Image.fromarray(np.full((2, 2), 255, np.uint8)).save(metal)
        maps, roughness, metallic = Maps(1.0, roughness=rough, metallic=metal), 0.1, 0.0
    surface = Surface("/M", (0.8, 0.5, 0.2), 0.3, roughness, 0.0, metallic, maps)
    return _scene(surface, sun=ms.sun(60.0, diameter_deg=0.1))


def expected_metal(camera: Camera) -> NDArray[np.float64]:
    """Closed form of the GGX lobe under a point-like sun (Heitz 2014), [h, w, 3]."""
    k, pose = camera.intrinsics, camera.camera_to_world
    v, u = np.meshgrid(np.arange(HEIGHT) + 0.5, np.arange(WIDTH) + 0.5, indexing="ij")
    d = np.stack([(u - k[0, 2]) / k[0, 0], (v - k[1, 2]) / k[1, 1], np.ones_like(u)], -1)
    out = -(d @ pose[:3, :3].T)
    out /= np.linalg.norm(out, axis=-1, keepdims=True)
    e = np.radians(60.0)
    light = np.array([np.cos(e), 0.0, np.sin(e)])
    half = out + light
    half /= np.linalg.norm(half, axis=-1, keepdims=True)
    a2 = 0.6**4

    def hidden(cosine: NDArray) -> NDArray:
        return (np.sqrt(1 + a2 * (1 / cosine**2 - 1)) - 1) / 2

    spread = a2 / (np.pi * (half[..., 2] ** 2 * (a2 - 1) + 1) ** 2)
    g = 1 / (1 + hidden(out[..., 2]) + hidden(np.asarray(light[2])))
    lobe = spread * g / (4 * out[..., 2])
    color = np.array([0.8, 0.5, 0.2])
    return IRRADIANCE * lobe[..., None] * color * brighter(color, 0.6, out[..., 2:])


def _scene(
    surface: Surface, offset: tuple[float, float] = (0.0, 0.0), sun: ms.Sun | None = None
) -> RenderScene:
    points, faces = ms.plane(60.0)
    points += [*offset, 0.0]
    camera = ms.look_at((offset[0] + 2.0, offset[1] - 1.0, 12.0), (*offset, 0.0), WIDTH, HEIGHT)
    light = sun or ms.sun(90.0, irradiance=IRRADIANCE)
    return ms.scene([ms.mesh(points, faces)], [surface], cameras=[camera], lights=[light])
