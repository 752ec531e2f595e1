"""Lat-long pictures as light from all around: loading, looking up, combining.

Convention (USD's, see docs/stage.md): pole +Y at the top row, center of the picture +Z, +X at
u = 0.25. Texel (row, column) has its center at ((column + 0.5) / width, (row + 0.5) / height).
Between centers the picture is bilinear; columns wrap around the seam, rows beyond the first and
last centers clamp.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from scenec.backends.stage.scene import Dome
from scenec.schemas.errors import StageError
from scenec.schemas.exr import read_rgb
from scenec.schemas.files import once_per_file
from scenec.schemas.kernels import kernel
from scenec.schemas.maps import decode, require_size
from scenec.schemas.packages import as_file
from scenec.schemas.threads import over_threads

#: Suns narrower than this are drawn this wide (irradiance unchanged), in radians: float32
#: directions resolve no less. 0.02 degrees, a 26th of the Sun's width from Earth.
MIN_SUN_DIAMETER_RAD = 3.5e-4
#: How far an aureole reaches, radians.
_AUREOLE = math.radians(40.0)


@dataclass(frozen=True)
class Sky:
    """All domes of a sample as one.

    Attributes:
        picture: Lat-long radiance, float32 [h, w, 3]; 1 x 1 is a constant sky.
        to_world: Rotation of the dome's frame to world, float64 [3, 3].
    """

    picture: NDArray[np.float32]
    to_world: NDArray[np.float64]

    @property
    def constant(self) -> bool:
        """Whether the radiance is the same from everywhere."""
        return self.picture.shape[:2] == (1, 1)


def combine(domes: tuple[Dome, ...]) -> Sky | None:
    """Add domes up, in the frame of the largest textured one; None if there are none.

    The others are looked up at its texel centers, so what is finer than its texels is lost.
    """
    if not domes:
        return None
    pictures = [_scaled(dome) for dome in domes]
    lead = max(range(len(domes)), key=lambda i: pictures[i].size)
    total = pictures[lead].astype(np.float64)
    height, width = total.shape[:2]
    for i, picture in enumerate(pictures):
        if i == lead:
            continue
        if picture.shape[:2] == (1, 1):
            total += picture
        else:
            world = texel_directions(height, width) @ domes[lead].to_world.T
            sky = Sky(picture, domes[i].to_world)
            total += lookup(sky, world.reshape(-1, 3)).reshape(height, width, 3)
    return Sky(np.ascontiguousarray(total, np.float32), domes[lead].to_world)


def mean_radiance(sky: Sky) -> NDArray[np.float64]:
    """Over all directions, float64 [3]."""
    height = sky.picture.shape[0]
    # The exact solid angle of each row, over that of all.
    rows = -0.5 * np.diff(np.cos(np.arange(height + 1) * (np.pi / height)))
    mean: NDArray[np.float64] = sky.picture.mean(axis=1, dtype=np.float64)
    return np.asarray((mean * rows[:, None]).sum(axis=0))


def aureole(sky: Sky | None, to_light: NDArray[np.float64]) -> float:
    """Share of a sky's irradiance on level ground that is a glow about a light.

    What comes from within ``_AUREOLE`` of it, less what would as bright as the rest of the sky.
    """
    if sky is None or sky.constant:
        return 0.0
    height, width = sky.picture.shape[:2]
    rows = -np.diff(np.cos(np.arange(height + 1) * (np.pi / height)))
    world = texel_directions(height, width) @ sky.to_world.T
    measure = np.maximum(world[..., 2], 0.0) * rows[:, None]
    light = measure * sky.picture.mean(axis=2, dtype=np.float64)
    near = world @ np.asarray(to_light, np.float64) > math.cos(_AUREOLE)
    inside, outside = measure[near].sum(), measure[~near].sum()
    if inside <= 0.0 or outside <= 0.0 or light.sum() <= 0.0:
        return 0.0
    even = light[~near].sum() / outside
    return float(max(light[near].sum() - even * inside, 0.0) / light.sum())


def texel_directions(height: int, width: int) -> NDArray[np.float64]:
    """Unit directions of texel centers in the dome's frame, float64 [h, w, 3]."""
    theta = (np.arange(height) + 0.5)[:, None] * (np.pi / height)
    phi = (0.5 - (np.arange(width) + 0.5) / width)[None, :] * (2 * np.pi)
    sin = np.sin(theta)
    return np.stack(
        [sin * np.sin(phi), np.broadcast_to(np.cos(theta), (height, width)), sin * np.cos(phi)], -1
    )


def lookup(sky: Sky, directions: NDArray[np.float64]) -> NDArray[np.float32]:
    """Radiance from world directions (any length), float64 [n, 3] -> float32 [n, 3].

    Of a picture with other channels, all of them.
    """
    out = np.empty((len(directions), sky.picture.shape[2]), np.float32)
    over_threads(
        _lookup, len(directions), sky.picture, np.ascontiguousarray(sky.to_world.T), directions, out
    )
    return out


@once_per_file(most=8)
def load_picture(path: Path) -> NDArray[np.float32]:
    """A lat-long picture as linear Rec.709, float32 [h, w, 3].

    OpenEXR files are taken as linear; 8-bit pictures are decoded from sRGB.

    Raises:
        StageError: The file is missing or is not a picture of these kinds.
    """
    try:
        with as_file(path) as file:
            picture = _load_exr(file) if file.suffix.lower() == ".exr" else _load_srgb(file)
    except ValueError as error:
        raise StageError(f"{path}: {error}") from error
    if not np.all(np.isfinite(picture)):
        raise StageError(f"{path}: a sky picture must be finite")
    # Photographed panoramas hold slightly negative values where a color left the gamut.
    picture = np.maximum(picture, np.float32(0.0))
    picture.setflags(write=False)
    return picture


def _load_exr(path: Path) -> NDArray[np.float32]:
    if not path.is_file():
        raise StageError(f"{path}: the sky's texture is missing")
    try:
        return read_rgb(path)
    except ValueError as error:
        raise StageError(f"{path}: {error}") from error


def _load_srgb(path: Path) -> NDArray[np.float32]:
    from PIL import Image, UnidentifiedImageError

    try:
        with Image.open(path) as image:
            require_size(image)
            return decode(np.asarray(image.convert("RGB")), "emission")
    except FileNotFoundError as error:
        raise StageError(f"{path}: the sky's texture is missing") from error
    except (UnidentifiedImageError, OSError, SyntaxError, Image.DecompressionBombError) as error:
        raise StageError(
            f"{path}: cannot read the sky's texture; use OpenEXR (linear) or PNG (sRGB)"
        ) from error


def _scaled(dome: Dome) -> NDArray[np.float32]:
    if dome.texture is None:
        return np.asarray(dome.scale, np.float32).reshape(1, 1, 3)
    picture = load_picture(dome.texture) if isinstance(dome.texture, Path) else dome.texture()
    return (picture * dome.scale).astype(np.float32)


@kernel
def _lookup(first, last, picture, to_dome, directions, out):  # type: ignore[no-untyped-def]
    height, width = picture.shape[0], picture.shape[1]
    for i in range(first, last):
        d = directions[i]
        x = to_dome[0, 0] * d[0] + to_dome[0, 1] * d[1] + to_dome[0, 2] * d[2]
        y = to_dome[1, 0] * d[0] + to_dome[1, 1] * d[1] + to_dome[1, 2] * d[2]
        z = to_dome[2, 0] * d[0] + to_dome[2, 1] * d[1] + to_dome[2, 2] * d[2]
        u = (0.5 - np.arctan2(x, z) / (2 * np.pi)) * width - 0.5
        # atan2 keeps its digits at the poles, where acos loses half of them.
        v = np.arctan2(np.sqrt(x * x + z * z), y) / np.pi * height - 0.5
        v = min(max(v, 0.0), height - 1.0)
        u0, v0 = np.floor(u), np.floor(v)
        fu, fv = u - u0, v - v0
        c0 = int(u0) % width
        c1 = (c0 + 1) % width
        r0 = int(v0)
        r1 = min(r0 + 1, height - 1)
        for k in range(picture.shape[2]):
            top = (1 - fu) * picture[r0, c0, k] + fu * picture[r0, c1, k]
            bottom = (1 - fu) * picture[r1, c0, k] + fu * picture[r1, c1, k]
            out[i, k] = (1 - fv) * top + fv * bottom
