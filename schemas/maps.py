"""Pictures that vary a surface: what files are taken, and what their values mean.

PNG, JPEG and TIFF of 8 or 16 bits, OpenEXR. Colors are sRGB in the former and linear Rec.709 in
OpenEXR; all other kinds are raw. Pillow reads 16 bits in gray alone; in color rasterio does.
"""

from __future__ import annotations

import io
import warnings
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from scenec.schemas.packages import as_file, is_packaged

#: Kinds of map, as they are named in cfgs; the channels of each.
MAP_CHANNELS = {
    "base_color": 3,
    "roughness": 1,
    "metallic": 1,
    "normal": 3,
    "emission": 3,
    "height": 1,
    "opacity": 1,
}
#: Kinds that hold colors: sRGB but for floating pictures, which are linear.
COLORS = ("base_color", "emission")
#: Texels along a side of a picture, at most.
LARGEST = 16384
#: Pixels of a picture that is no map, at most: twice the usual limit of Pillow, as it has it.
MOST_PIXELS = 2 * (1024**3 // 4 // 3)


def read_pixels(path: Path | bytes, alpha: bool = False) -> NDArray:
    """The pixels of a picture as they are stored: uint8, uint16 or float32, [h, w, 1 or 3].

    Row 0 is the top. Alpha and palettes are resolved to gray or RGB.

    Args:
        path: The file, also one inside of a package, or the bytes of one that is no OpenEXR.
        alpha: Whether its alpha is wanted instead, [h, w, 1]: 255 everywhere where it has none.

    Raises:
        ValueError: Not a picture of these kinds, broken, or too large.
    """
    if isinstance(path, Path) and is_packaged(path):
        with as_file(path) as file:
            return read_pixels(file, alpha)
    if isinstance(path, Path) and path.suffix.lower() == ".exr":
        # Imported here: few pictures are.
        from scenec.schemas.exr import read_rgb

        if alpha:
            raise ValueError("alpha of an OpenEXR picture is not taken; store it as PNG")
        picture = read_rgb(path, gray=True)
        if not np.isfinite(picture).all():
            raise ValueError("holds values that are not finite")
        return picture
    from PIL import Image, UnidentifiedImageError

    try:
        with Image.open(io.BytesIO(path) if isinstance(path, bytes) else path) as image:
            if max(image.size) > LARGEST:
                raise ValueError(f"{image.size[0]} x {image.size[1]} pixels: at most {LARGEST}")
            if is_fine_color(image):
                return _fine_pixels(path, alpha)
            if alpha and not ("A" in image.getbands() or "transparency" in image.info):
                return np.full((image.height, image.width, 1), 255, np.uint8)
            if alpha:
                return np.asarray(image.convert("RGBA"))[..., 3:]
            if image.mode.startswith("I;16"):
                return np.asarray(image, np.uint16)[..., None]
            if image.mode in ("1", "L", "LA"):
                return np.asarray(image.convert("L"))[..., None]
            if image.mode in ("P", "PA", "RGB", "RGBA", "CMYK", "YCbCr"):
                return np.asarray(image.convert("RGB"))
            raise ValueError(f"pixels of the kind {image.mode} are not taken; use PNG or OpenEXR")
    except (UnidentifiedImageError, OSError, SyntaxError, Image.DecompressionBombError) as error:
        raise ValueError(f"not a readable picture: {error}") from error


def require_size(image: Any) -> None:
    """Refuses an opened picture of more than ``MOST_PIXELS``, before any is decoded.

    Pillow's own limit is its process's, and other packages lift it.

    Args:
        image: Of Pillow.

    Raises:
        DecompressionBombError: Pillow's.
    """
    from PIL import Image

    if image.width * image.height > MOST_PIXELS:
        raise Image.DecompressionBombError(f"{image.width} x {image.height} pixels")


def is_fine_color(image: Any) -> bool:
    """Whether an opened picture has 16 bits and more than gray, of which Pillow keeps 8 bits.

    Args:
        image: Of Pillow, of which nothing is loaded.
    """
    in_16_bits = any(";16" in str(tile[3]) for tile in image.tile)
    return in_16_bits and not image.mode.startswith("I")


def _fine_pixels(path: Path | bytes, alpha: bool) -> NDArray:
    """Reads a PNG or TIFF of 16 bits in color, or in gray with alpha; as ``read_pixels``."""
    try:
        import rasterio
        from rasterio.errors import NotGeoreferencedWarning, RasterioError
    except ModuleNotFoundError:
        raise ValueError(
            "16 bits a channel in color: reading it needs the extra 'geotiff' (pip install "
            "'scenec[geotiff]'); OpenEXR and 8 bits do not"
        ) from None
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", NotGeoreferencedWarning)
            alone = rasterio.Env(GDAL_DISABLE_READDIR_ON_OPEN="EMPTY_DIR", GDAL_PAM_ENABLED="NO")
            file = path if isinstance(path, Path) else io.BytesIO(path)
            with alone, rasterio.open(file) as source:
                bands = np.moveaxis(source.read(), 0, -1)
    except RasterioError as error:
        raise ValueError(f"not a readable picture: {error}") from error
    colors = bands.shape[2] - (bands.shape[2] % 2 == 0)
    if not alpha:
        return np.ascontiguousarray(bands[..., :colors])
    if bands.shape[2] > colors:
        return np.ascontiguousarray(bands[..., colors:])
    return np.full((*bands.shape[:2], 1), 65535, np.uint16)


def meant(
    pixels: NDArray,
    kind: str,
    srgb: bool | None,
    scale: tuple[float, ...],
    bias: tuple[float, ...],
    channel: str,
) -> NDArray[np.float32]:
    """Decodes stored pixels as a UsdUVTexture does, float32 [h, w, channels of the kind].

    Floating values that ``decode`` takes as they are.

    Args:
        pixels: From ``read_pixels``.
        kind: One of ``MAP_CHANNELS``.
        srgb: Whether they are in sRGB's transfer function; None: where colors are not floating.
        scale, bias: value * scale + bias, of each channel, [3].
        channel: "r", "g" or "b": where a single number stands; "a": the pixels are alpha's.
    """
    floating = pixels.dtype.kind == "f"
    values = pixels.astype(np.float64) / (1.0 if floating else float(np.iinfo(pixels.dtype).max))
    if values.shape[2] == 1:
        values = np.repeat(values, 3, axis=2)
    if srgb or (srgb is None and kind in COLORS and not floating):
        above = ((np.maximum(values, 0.04045) + 0.055) / 1.055) ** 2.4
        values = np.where(values <= 0.04045, values / 12.92, above)
    values = values * np.array(scale) + np.array(bias)
    if MAP_CHANNELS[kind] == 1:
        values = values[..., "rgba".index(channel) % 3][..., None]
    return values.astype(np.float32)


def decode(pixels: NDArray, kind: str, flip_green: bool = False) -> NDArray[np.float32]:
    """Decodes stored pixels, float32 [h, w, channels of the kind].

    ``base_color``, ``emission``: linear Rec.709, decoded from sRGB (IEC 61966-2-1) unless floating;
    the former in [0, 1], the latter not below 0.
    ``roughness``, ``metallic``, ``height``, ``opacity``: in [0, 1]; of an RGB picture its red
    channel.
    ``normal``: 2 * rgb - 1, unit length; floating pictures hold the same encoding.

    Args:
        pixels: From ``read_pixels``.
        kind: One of ``MAP_CHANNELS``.
        flip_green: Whether the y of ``normal`` points down the picture (DirectX's handedness).
    """
    floating = pixels.dtype.kind == "f"
    values = pixels.astype(np.float64) if floating else pixels / float(np.iinfo(pixels.dtype).max)
    if MAP_CHANNELS[kind] == 1:
        return np.ascontiguousarray(np.clip(values[..., :1], 0.0, 1.0), np.float32)
    if values.shape[2] == 1:
        values = np.repeat(values, 3, axis=2)
    if kind in COLORS:
        if not floating:
            values = np.where(values <= 0.04045, values / 12.92, ((values + 0.055) / 1.055) ** 2.4)
        brightest = 1.0 if kind == "base_color" else None
        return np.ascontiguousarray(np.clip(values, 0.0, brightest), np.float32)
    normal = 2.0 * values - 1.0
    if flip_green:
        normal[..., 1] = -normal[..., 1]
    # Straight up where a picture holds no direction at all.
    length = np.sqrt((normal * normal).sum(axis=2, keepdims=True))
    normal = np.where(length > 0.0, normal / np.maximum(length, 1e-12), [0.0, 0.0, 1.0])
    return np.ascontiguousarray(normal, np.float32)
