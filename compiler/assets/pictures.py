"""Finds, checks and takes apart pictures that models refer to.

What is of a kind that all renderers read stays as it is. The rest becomes a PNG whose bytes depend
on its pixels alone: it is stored without compression, since compressors differ between machines.
"""

from __future__ import annotations

import re
import struct
import zlib
from pathlib import Path
from urllib.parse import unquote

import numpy as np
from numpy.typing import NDArray

from scenec.compiler.assets.parts import MeshFileError
from scenec.compiler.scene.material import ImageFile
from scenec.schemas.errors import SceneError
from scenec.schemas.maps import read_pixels
from scenec.schemas.scratch import scratch_folder
from scenec.schemas.udim import NO_TILE, Place, is_tiled, joined, tiles_of

#: Where a picture is: beside the model or inside of it.
Source = Path | ImageFile
#: Endings of pictures that are taken as they are.
_COMMON = (".png", ".jpg", ".jpeg", ".tif", ".tiff", ".exr")
_BLOCK = 65535
#: What rounding may put beyond black and white.
_CUT = 1e-3
#: What decoders raise for broken pictures.
_FAULTS = (
    ValueError, TypeError, LookupError, ArithmeticError, RuntimeError, AttributeError, EOFError,
    OSError, MemoryError, SyntaxError, struct.error, zlib.error,
)  # fmt: skip
_MAGIC = {
    b"\x89PNG": ".png", b"\xff\xd8\xff": ".jpg", b"II*\0": ".tif", b"MM\0*": ".tif",
    b"v/1\x01": ".exr", b"BM": ".bmp", b"RIFF": ".webp", b"GIF8": ".gif",
}  # fmt: skip


def companion(file: Path, reference: str, what: str, *, escaped: bool = False) -> Path:
    r"""The file that a model refers to; of UDIM tiles the path that names them.

    Args:
        reference: As it stands there: relative to its folder, ``/`` or ``\`` between names.
        escaped: Whether it is a URI, with ``%20`` for a space.

    Raises:
        MeshFileError: It is not there, or the path is absolute.
    """
    name = " ".join((unquote(reference) if escaped else reference).split("\0")).replace("\\", "/")
    if name.startswith("/") or re.match(r"[A-Za-z][A-Za-z0-9+.-]*:", name):
        raise MeshFileError(
            f"refers to the {what} {reference[:100]!r}: expected a path relative to {file.name}"
        )
    path = file.parent / name
    try:
        there = bool(tiles_of(path)) if is_tiled(path) else bool(name) and path.is_file()
    except (OSError, ValueError):
        there = False
    if not there:
        lacks = "of which no tile is there" if is_tiled(path) else "which is not there"
        raise MeshFileError(
            f"refers to the {what} {reference[:100]!r}, {lacks}; it is sought from the "
            f"folder of {file.name}"
        )
    return path


def embedded(data: bytes) -> ImageFile:
    """A picture that stands inside of another file; its first bytes tell its kind."""
    for magic, suffix in _MAGIC.items():
        if data.startswith(magic):
            return ImageFile(suffix, data)
    # Targa has no magic number; what it is not, the decoder says.
    return ImageFile(".tga", data)


def pixels_of(
    source: Source,
    label: str,
    alpha: bool = False,
    kind: str = "base_color",
    grid: Place = (1, 1),
) -> NDArray:
    """Pixels of a picture, or its alpha, as ``read_pixels`` gives them.

    Args:
        source: The picture, or the path of its UDIM tiles.
        label: What messages call it.
        alpha: Whether its alpha is wanted.
        kind: Of ``schemas.maps.MAP_CHANNELS``: what stands where there is no tile.
        grid: Columns and rows of tiles; one that is in no tiles is in each.

    Raises:
        MeshFileError: It is none that can be read, or its tiles make no picture.
    """
    tiled = isinstance(source, Path) and is_tiled(source)
    if grid == (1, 1) and not tiled:
        return _decoded(source, label, alpha)
    if isinstance(source, Path) and tiled:
        tiles = {
            place: _decoded(file, file.name, alpha) for place, file in tiles_of(source).items()
        }
    else:
        tiles = dict.fromkeys(np.ndindex(grid), _decoded(source, label, alpha))
    channels = max(tile.shape[2] for tile in tiles.values())
    kinds = {tile.dtype for tile in tiles.values()}
    if len(kinds) > 1 or any(number.kind == "f" for number in kinds):
        raise MeshFileError(
            f"the picture {label}: tiles of OpenEXR, or of 8 bits beside tiles of 16, become no "
            "picture here: save them all as PNG of as many bits"
        )
    tiles = {place: np.repeat(tile, channels // tile.shape[2], 2) for place, tile in tiles.items()}
    (number,) = kinds
    fill = np.rint(np.iinfo(number).max * np.array(NO_TILE.get(kind, (0.0,) * 3)))
    try:
        return joined(tiles, grid, tuple(fill.tolist()))
    except ValueError as error:
        raise MeshFileError(f"the picture {label}: {error}") from error


def _decoded(source: Source, label: str, alpha: bool) -> NDArray:
    try:
        if isinstance(source, Path):
            return read_pixels(source, alpha)
        with scratch_folder() as folder:
            path = Path(folder) / f"picture{source.suffix}"
            path.write_bytes(source.data)
            return read_pixels(path, alpha)
    except _FAULTS as error:
        reason = " ".join(str(error).split())
        if "identify" in reason or not reason or "picture" not in reason:
            reason = "not a readable picture"
        raise MeshFileError(f"the picture {label}: {reason[:160]}") from error


def plain(source: Source, pixels: NDArray) -> Source:
    """The picture itself where all renderers read its kind, else the same pixels as PNG."""
    if source.suffix.lower() in _COMMON:
        return source
    return ImageFile(".png", png(pixels))


def channel_of(
    source: Source, pixels: NDArray, channel: int, scale: float, offset: float = 0.0
) -> tuple[float, Source | None]:
    """One channel of a picture, times a factor, plus an offset, clipped to [0, 1].

    Returns:
        Its average; the picture itself where a reader of its first channel sees just that, else a
        gray PNG, but None where all pixels are equal.
    """
    plane = pixels[..., min(channel, pixels.shape[2] - 1)]
    floating = plane.dtype.kind == "f"
    largest = 65535 if floating or plane.dtype == np.uint16 else 255
    values = plane.astype(np.float64) if floating else plane / float(np.iinfo(plane.dtype).max)
    values = np.clip(values * scale + offset, 0.0, 1.0)
    if values.min() == values.max():
        return float(values.flat[0]), None
    average = float(values.mean())
    # The picture's first channel is not its alpha.
    first = channel == 0 or (channel < 3 and pixels.shape[2] == 1)
    if first and scale == 1.0 and offset == 0.0:
        return average, plain(source, pixels)
    codes = np.floor(values * largest + 0.5).astype(np.uint16 if largest > 255 else np.uint8)
    return average, ImageFile(".png", png(codes[..., None]))


def png(pixels: NDArray) -> bytes:
    """A PNG file without compression: the same bytes everywhere (ISO/IEC 15948, RFC 1950, 1951).

    Args:
        pixels: uint8 or uint16, [h, w, 1 or 3]; floating ones in [0, 1] become uint16.
    """
    if pixels.dtype.kind == "f":
        pixels = np.floor(np.clip(pixels, 0.0, 1.0) * 65535.0 + 0.5).astype(np.uint16)
    height, width, channels = pixels.shape
    big = np.ascontiguousarray(pixels.astype(pixels.dtype.newbyteorder(">")))
    rows = np.zeros((height, 1 + width * channels * big.itemsize), np.uint8)
    rows[:, 1:] = big.view(np.uint8).reshape(height, -1)
    raw = rows.tobytes()
    blocks = [
        struct.pack("<BHH", start + _BLOCK >= len(raw), len(part), len(part) ^ 0xFFFF) + part
        for start in range(0, len(raw), _BLOCK)
        for part in (raw[start : start + _BLOCK],)
    ]
    stream = b"\x78\x01" + b"".join(blocks) + struct.pack(">I", zlib.adler32(raw))
    color = 0 if channels == 1 else 2
    header = struct.pack(">IIBBBBB", width, height, 8 * big.itemsize, color, 0, 0, 0)
    chunks = ((b"IHDR", header), (b"IDAT", stream), (b"IEND", b""))
    return b"\x89PNG\r\n\x1a\n" + b"".join(
        struct.pack(">I", len(data)) + name + data + struct.pack(">I", zlib.crc32(name + data))
        for name, data in chunks
    )


def read_gray(file: Path) -> NDArray[np.float64]:
    """A picture of weights, the mean of its channels: float64 [h, w], row 0 at the top.

    Raises:
        SceneError: Not a picture, or nothing in it is above 0, or something is below.
    """
    try:
        pixels = read_pixels(file)
    except ValueError as error:
        raise SceneError(f"{file.name}: {error}") from error
    gray = pixels.astype(np.float64).mean(axis=2)
    if gray.min() < 0.0:
        raise SceneError(f"{file.name}: holds {gray.min():g}; a density is nowhere below 0")
    if not gray.max() > 0.0:
        raise SceneError(f"{file.name}: black everywhere; a density is above 0 somewhere")
    return gray / gray.max()


def read_heights(file: Path) -> NDArray[np.float32]:
    """Reads a raw picture's red channel in [0, 1], float32 [h, w], row 0 at the top.

    Raises:
        SceneError: It cannot be read, or holds what would be cut off.
    """
    try:
        pixels = read_pixels(file)[..., 0]
    except ValueError as error:
        raise SceneError(f"{file.name}: {error}") from error
    if pixels.dtype.kind == "f":
        low, high = float(pixels.min()), float(pixels.max())
        if low < -_CUT or high > 1.0 + _CUT:
            raise SceneError(
                f"{file.name}: its heights reach from {low:.6g} to {high:.6g}: expected 0 for "
                "black to 1 for white, since what lies beyond would be cut off"
            )
        return np.clip(pixels, 0.0, 1.0).astype(np.float32)
    largest = float(np.iinfo(pixels.dtype).max)
    return (pixels.astype(np.float64) / largest).astype(np.float32)
