"""The files that a cfg names: that they are there, are what they must be, and what they hold."""

from __future__ import annotations

import hashlib
import zipfile
import zlib
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path as FilePath
from typing import Any

from scenec.compiler.assets.pose_table import read_poses
from scenec.compiler.assets.track import read_track
from scenec.compiler.assets.track_formats import FORMATS, ORDERS, read_stamped
from scenec.compiler.cfg.faults import Finding
from scenec.compiler.cfg.json_positions import Path
from scenec.compiler.cfg.resources import ResourceError, find_file, find_folder
from scenec.compiler.cfg.schema import Field
from scenec.compiler.geometry.affine import TO_Z_UP
from scenec.schemas.errors import SceneError
from scenec.schemas.maps import read_pixels
from scenec.schemas.spelling import nearest, shown

_EXR_MAGIC = b"\x76\x2f\x31\x01"


@dataclass(frozen=True)
class InputFile:
    """A file that the cfg names.

    Attributes:
        path: Where it is on this machine, a file or a folder; never written to any output.
        sha256: Of its bytes, in hexadecimal; with those of the files that belong to a model.
        reference: The string in the cfg.
    """

    path: FilePath
    sha256: str
    reference: str = ""


def check_file(
    field: Field, document: Any, folder: FilePath
) -> tuple[InputFile | None, list[Finding]]:
    """Finds, checks and hashes one file.

    Args:
        field: The string that names it; its keyword "x-file" says what it must be.
        document: The whole cfg, for the keys beside it.
        folder: The cfg's folder.

    Returns:
        The file, or None where there is a finding.
    """
    if field.keywords["x-file"] == "texture_set":
        return _check_texture_set(field, document, folder)
    try:
        path = find_file(field.value, folder)
        with path.open("rb") as stream:
            digest = hashlib.file_digest(stream, "sha256").hexdigest()
    except ResourceError as error:
        return None, [Finding(field.path, str(error))]
    except OSError as error:
        return None, [Finding(field.path, f"{shown(field.value)}: {error.strerror or error}")]
    owner = document
    for key in field.path[:-1]:
        owner = owner[key]
    kind = field.keywords["x-file"]
    try:
        findings = _CHECKS[kind](path, field.path, owner, document)
        if kind == "model" and not findings:
            digest = _with_companions(path, digest)
    except SceneError as error:
        findings = [Finding(field.path, str(error))]
    return (None if findings else InputFile(path, digest, field.value)), findings


def _check_texture_set(
    field: Field, document: Any, folder: FilePath
) -> tuple[InputFile | None, list[Finding]]:
    """A folder of pictures: its digest is of the names and bytes of those that are taken."""
    from scenec.compiler.assets.texture_set import TextureSetError, read_texture_set

    owner = document
    for key in field.path[:-1]:
        owner = owner[key]
    findings: list[Finding] = []
    digests = []
    try:
        path = find_folder(field.value, folder)
        files = read_texture_set(path, frozenset(owner)).files
        for key, given, why in (
            ("base_color", document["materials"][field.path[1]], "no base_color is given"),
            ("displacement", owner, "displacement_m is given"),
        ):
            needed = key == "base_color" or owner.get("displacement_m", 0) != 0
            if needed and key not in (*files, *owner, *given):
                findings.append(
                    Finding(
                        field.path,
                        f"{shown(field.value)}: no picture of {key}, and {why}: found "
                        f"{', '.join(files.values())}",
                    )
                )
        for kind, name in files.items():
            with (path / name).open("rb") as stream:
                digests.append(f"{kind} {hashlib.file_digest(stream, 'sha256').hexdigest()}")
            findings.extend(_check_map(path / name, field.path, owner, document))
    except ResourceError as error:
        return None, [Finding(field.path, str(error))]
    except (TextureSetError, OSError) as error:
        reason = error.strerror if isinstance(error, OSError) else None
        return None, [Finding(field.path, f"{shown(field.value)}: {reason or error}")]
    digest = hashlib.sha256("\n".join(digests).encode("ascii")).hexdigest()
    return (None if findings else InputFile(path, digest, field.value)), findings


def _check_dem(file: FilePath, path: Path, owner: Any, document: Any) -> list[Finding]:
    # Imported here: it compiles kernels, and most faults are found without it.
    from scenec.compiler.assets.dem_file import read_dem

    array = owner.get("array")
    member = array if isinstance(array, str) else None
    try:
        if member is not None and zipfile.is_zipfile(file):
            with zipfile.ZipFile(file) as archive:
                members = [name.removesuffix(".npy") for name in archive.namelist()]
            if member not in members:
                return [
                    Finding(
                        (*path[:-1], "array"),
                        f"no array {shown(member)} in {file.name}{nearest(member, members)}",
                    )
                ]
        span = owner.get("height_range_m")
        given = isinstance(span, list) and len(span) == 2
        dem = read_dem(file, member, height_range_m=(0.0, 1.0) if given else None)
    except (zipfile.BadZipFile, zlib.error, NotImplementedError, MemoryError) as error:
        return [Finding(path, f"{file.name}: a broken file: {error or type(error).__name__}")]
    if "pixel_m" not in owner and (dem.reference is None or dem.reference.pixel_m() is None):
        return [
            Finding(
                path[:-1],
                f'the key "pixel_m" is missing: {file.name} does not give its pixels in meters',
            )
        ]
    return []


def _check_mesh(file: FilePath, path: Path, owner: Any, document: Any) -> list[Finding]:
    from scenec.compiler.assets.mesh_file import finish_mesh, missing_keys, parse_mesh

    keys = ("unit_m", "up", "part")
    unit_m, up, part = (owner.get(key) for key in keys)
    # Values that the schema finds fault with count as given.
    parsed = parse_mesh(file)
    missing = missing_keys(parsed, unit_m, up)
    if missing:
        return [
            Finding(path[:-1], f'the key "{key}" is missing: {file.name} does not say it')
            for key in missing
        ]
    finish_mesh(file, parsed, part=part if isinstance(part, str) else None)
    return []


def _check_model(file: FilePath, path: Path, owner: Any, document: Any) -> list[Finding]:
    from scenec.compiler.assets.cache import cached_model, parsed_model
    from scenec.compiler.assets.mesh_file import missing_keys

    unit_m, up, part = (owner.get(key) for key in ("unit_m", "up", "part"))
    missing = missing_keys(parsed_model(file), unit_m, up)
    if missing:
        return [
            Finding(path[:-1], f'the key "{key}" is missing: {file.name} does not say it')
            for key in missing
        ]
    # Values that the schema finds fault with count as not given.
    unit_m = float(unit_m) if isinstance(unit_m, (int, float)) and unit_m > 0 else None
    cached_model(file, unit_m, up if up in tuple(TO_Z_UP) else None, _text(part))
    return []


def _text(value: Any) -> str | None:
    return value if isinstance(value, str) else None


def _with_companions(file: FilePath, digest: str) -> str:
    """A model's digest with those of the files that belong to it, in the model's order."""
    from scenec.compiler.assets.cache import parsed_model

    digests = [digest]
    for path in parsed_model(file).companions:
        with path.open("rb") as stream:
            digests.append(hashlib.file_digest(stream, "sha256").hexdigest())
    if len(digests) == 1:
        return digest
    return hashlib.sha256("\n".join(digests).encode("ascii")).hexdigest()


def _check_poses(file: FilePath, path: Path, owner: Any, document: Any) -> list[Finding]:
    models = owner.get("models")
    read_poses(file, max(len(models), 1) if isinstance(models, list) else 1)
    return []


def _check_image(file: FilePath, path: Path, owner: Any, document: Any) -> list[Finding]:
    with file.open("rb") as stream:
        magic = stream.read(4)
    if magic != _EXR_MAGIC:
        return [Finding(path, f"{file.name}: not an OpenEXR file")]
    import OpenEXR

    try:
        with OpenEXR.File(str(file), header_only=True) as picture:
            # Closing the file empties its header.
            channels = [channel.name for channel in picture.header()["channels"]]
    except (RuntimeError, ValueError, OSError) as error:
        return [Finding(path, f"{file.name}: not a readable OpenEXR file: {error}")]
    missing = [name for name in "RGB" if name not in channels]
    if missing:
        return [
            Finding(
                path,
                f"{file.name}: expected the channels R, G and B, found "
                f"{', '.join(sorted(channels))}",
            )
        ]
    return []


def _check_track(file: FilePath, path: Path, owner: Any, document: Any) -> list[Finding]:
    form, order, rate = (owner.get(key) for key in ("format", "quaternion", "frame_rate_hz"))
    # Values that the schema finds fault with count as not given.
    form = form if isinstance(form, str) and form in FORMATS else "csv"
    order = order if isinstance(order, str) and order in ORDERS else None
    if form == "csv" and order is None and "sampling" not in owner:
        rows = len(read_track(file).time_s)
    else:
        rate = float(rate) if isinstance(rate, (int, float)) and rate > 0 else 1.0
        rows = len(read_stamped(file, form, order, rate).time_s)
    samples = document.get("samples", 1)
    if isinstance(samples, int) and rows < samples and "sampling" not in owner:
        return [
            Finding(
                path,
                f"{file.name}: {rows} poses for {samples} samples: expected a row for each sample",
            )
        ]
    return []


def _check_map(file: FilePath, path: Path, owner: Any, document: Any) -> list[Finding]:
    try:
        read_pixels(file)
    except ValueError as error:
        return [Finding(path, f"{file.name}: {error}")]
    return []


def _check_polyline(file: FilePath, path: Path, owner: Any, document: Any) -> list[Finding]:
    from scenec.compiler.assets.polyline import read_polyline

    read_polyline(file)
    return []


def _check_density(file: FilePath, path: Path, owner: Any, document: Any) -> list[Finding]:
    from scenec.compiler.assets.pictures import read_gray

    read_gray(file)
    return []


def _check_label_map(file: FilePath, path: Path, owner: Any, document: Any) -> list[Finding]:
    from scenec.compiler.cfg.label_maps import code_of, decode

    values = owner.get("values")
    if not isinstance(values, dict) or not values or None in map(code_of, values):
        return []
    decode(file, dict.fromkeys(values, 0))
    return []


_CHECKS: dict[str, Callable[[FilePath, Path, Any, Any], list[Finding]]] = {
    "dem": _check_dem,
    "density": _check_density,
    "image": _check_image,
    "label_map": _check_label_map,
    "map": _check_map,
    "mesh": _check_mesh,
    "model": _check_model,
    "polyline": _check_polyline,
    "poses": _check_poses,
    "track": _check_track,
}
