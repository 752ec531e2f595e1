"""The files that a cfg names: that they are there, are what they must be, and what they hold."""

from __future__ import annotations

import hashlib
import zipfile
import zlib
from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING

from scenec.compiler.cfg.resources import ResourceError, find_file
from scenec.compiler.kinds import Finding, InputFile, Node
from scenec.compiler.kinds.schema import Field
from scenec.compiler.kinds.table import loaded
from scenec.schemas.errors import CfgError, Fault, SceneError
from scenec.schemas.files import sha256
from scenec.schemas.spelling import nearest, shown

if TYPE_CHECKING:
    from scenec.compiler.assets.dem_file import Zeros
    from scenec.compiler.assets.model import MeshModel
    from scenec.compiler.assets.raster_window import RasterWindow
    from scenec.compiler.assets.shells import ParsedModel

_EXR_MAGIC = b"\x76\x2f\x31\x01"


def check_files(
    fields: Iterable[Field], cfg: Node, folder: Path
) -> tuple[dict[str, InputFile], list[Finding]]:
    """Finds, checks and hashes all files.

    Args:
        fields: All places of the cfg; the keyword "x-file" says of a string what it must name.

    Returns:
        Those that are sound, by their path in the cfg; findings on the others, and warnings.
    """
    files: dict[str, InputFile] = {}
    digest_of: dict[Path, str] = {}
    findings: list[Finding] = []
    for field in fields:
        kind = field.keywords.get("x-file")
        if kind is None:
            continue
        owner = cfg.at(*field.path[:-1])
        name = owner[field.path[-1]]
        if not name:
            continue
        try:
            path = find_file(name, folder, "folder" if kind == "texture_set" else "file")
            found = list(_CHECKS[kind](path, owner, cfg) or ())
            if all(finding.is_warning for finding in found):
                named = _MEMBERS[kind](path, owner) if kind in _MEMBERS else [("", path)]
                digests = [_digest(file, digest_of) for _, file in named]
                members = tuple(zip((file for _, file in named), digests, strict=True))
                alone = len(named) == 1 and not named[0][0]
                lines = [
                    f"{what} {one}".strip() for (what, _), one in zip(named, digests, strict=True)
                ]
                digest = lines[0] if alone else _joined(lines)
                files["/".join(map(str, field.path))] = InputFile(path, digest, name, members)
        except (ResourceError, SceneError) as error:
            found = [Finding(field.path, str(error))]
        except OSError as error:
            found = [Finding(field.path, f"{shown(name)}: {error.strerror or error}")]
        findings += found
    return files, findings


def require_unchanged(files: Mapping[str, InputFile], cfg: Path) -> None:
    """Refuses files that are no more what they were when they were checked: all are read again.

    Args:
        files: By their path in the cfg.
        cfg: Of which they are.

    Raises:
        CfgError: Some were changed, or have gone.
    """
    faults = []
    digests: dict[Path, str] = {}
    for pointer, file in files.items():
        for path, digest in file.members:
            try:
                now = _digest(path, digests)
            except OSError:
                now = ""
            if now != digest:
                what = "has changed" if now else "has gone"
                text = f"{shown(file.reference)}: {path.name} {what} since it was read; run again"
                faults.append(Fault(str(cfg), 0, 0, f"/{pointer}", text))
    if faults:
        raise CfgError(faults)


def _digest(file: Path, digests: dict[Path, str]) -> str:
    """Reads a file's digest once: many models may be of one file."""
    if file not in digests:
        digests[file] = sha256(file)
    return digests[file]


def _joined(lines: list[str]) -> str:
    return hashlib.sha256("\n".join(lines).encode("ascii")).hexdigest()


def _check_texture_set(folder: Path, owner: Node, cfg: Node) -> Iterator[Finding]:
    files = _texture_set(folder, owner)
    material = cfg.at(*owner.path[:-1])
    for key, given, why in (
        ("base_color", material, "no base_color is given"),
        ("displacement", owner, "displacement_m is given"),
    ):
        needed = key == "base_color" or owner["displacement_m"]
        if needed and key not in files and key not in owner and key not in given:
            raise SceneError(
                f"{shown(owner['folder'])}: no picture of {key}, and {why}: found "
                f"{', '.join(files.values())}"
            )
    for kind, name in files.items():
        check = _CHECKS["heights" if kind == "displacement" else "map"]
        try:
            check(folder / name, owner, cfg)
        except SceneError as error:
            yield owner.fault(str(error), "folder")


def _texture_set(folder: Path, owner: Node) -> dict[str, str]:
    from scenec.compiler.assets.texture_set import TextureSetError, read_texture_set

    try:
        return read_texture_set(folder, frozenset(owner.entries)).files
    except TextureSetError as error:
        raise SceneError(f"{shown(owner['folder'])}: {error}") from error


def _members_of_texture_set(folder: Path, owner: Node) -> list[tuple[str, Path]]:
    """Lists the pictures that are used, by kind."""
    return [(kind, folder / name) for kind, name in _texture_set(folder, owner).items()]


def _check_dem(file: Path, owner: Node, cfg: Node) -> Iterator[Finding]:
    from scenec.compiler.assets.dem_file import read_dem

    member = owner["array"]
    try:
        if member is not None and zipfile.is_zipfile(file):
            with zipfile.ZipFile(file) as archive:
                members = [name.removesuffix(".npy") for name in archive.namelist()]
            if member not in members:
                hint = nearest(member, members)
                yield owner.fault(f"no array {shown(member)} in {file.name}{hint}", "array")
                return
        span = (0.0, 1.0) if "height_range_m" in owner else None
        part = _window(owner, cfg)
        if "window" in owner and part is None:
            # What is wrong with it has been said.
            return
        dem = read_dem(file, member, owner["nodata"], span, owner["band"], owner["unit_m"], part)
    except (zipfile.BadZipFile, zlib.error, NotImplementedError) as error:
        raise SceneError(f"{file.name}: a broken file: {error or type(error).__name__}") from error
    except MemoryError as error:
        raise SceneError(f"{file.name}: its heights do not fit into memory: {error}") from error
    if dem.void is not None and not ("nodata" in owner and owner["nodata"] is None):
        sample, share = dem.void
        yield owner.fault(
            f"{100.0 * share:.2g} % of the samples of {file.name} are {sample:.17g}, which no "
            "other height is near: it marks holes, and the file does not say so: say "
            f'"nodata": {sample:.17g} (and "holes": "fill" where they are under the terrain), or '
            '"nodata": null if they are heights'
        )
    elif dem.beyond is not None and not ("nodata" in owner and owner["nodata"] is None):
        assert dem.frame is not None
        height, share = dem.beyond
        yield owner.fault(
            f"{100.0 * share:.2g} % of the samples of {file.name} are heights that the body "
            f"({dem.frame.body}) does not have, as far as {height:.6g} m: say what they are with "
            'unit_m, which value marks holes with nodata, or "nodata": null if they are heights'
        )
    if dem.zeros is not None and not ("nodata" in owner and owner["nodata"] is None):
        yield replace(owner.fault(_zeros(file, owner, dem.zeros), "file"), is_warning=True)
    sized = dem.frame is not None and (dem.frame.geographic or dem.frame.pixel_m() is not None)
    if "pixel_m" not in owner and not sized:
        where = ""
        if dem.frame is not None and dem.frame.crs:
            where = ": its coordinates are of an unknown unit: say how large a pixel is"
        yield owner.fault(
            f'the key "pixel_m" is missing: {file.name} does not give its pixels in meters{where}'
        )


def _window(owner: Node, cfg: Node) -> RasterWindow | None:
    """The part of a raster that a DEM's window takes; None without a sound one."""
    from scenec.compiler.assets.raster_window import RasterWindow

    if "window" not in owner:
        return None
    window, size = owner.at("window"), owner["pixel_m"]
    if isinstance(size, float | int):
        size = size, size
    # Drawn later: what is read then is near enough.
    pixel = None if size is None or isinstance(size, dict) else (float(size[0]), float(size[1]))
    spacing = cfg.at("terrain")["spacing_m"] if owner.path[:2] == ("terrain", "relief") else 0.0
    lat, lon, x, y = (window[n] for n in ("latitude_deg", "longitude_deg", "x_m", "y_m"))
    whole = (None not in (lat, lon)) != (None not in (x, y))
    if window["size_m"] is None or not whole:
        return None
    wide, high = window["size_m"]
    finest = spacing if isinstance(spacing, float | int) else 0.0
    return RasterWindow(lat, lon, x, y, (wide, high), pixel, finest)


def _members_of_dem(file: Path, owner: Node) -> list[tuple[str, Path]]:
    """Lists a DEM's file, and those that it names."""
    from scenec.compiler.assets.raster import ALONE, DRIVERS, files_of

    suffix = file.suffix.lower()
    if suffix not in DRIVERS or suffix in ALONE:
        return [("", file)]
    return [("", path) for path in files_of(file, owner["array"])]


def _zeros(file: Path, owner: Node, zeros: Zeros) -> str:
    """Warns of samples of 0 that may mark holes."""
    others = f"between {zeros.low:.6g} and {zeros.high:.6g}"
    if zeros.low == zeros.high:
        others = f"{zeros.low:.6g}"
    count = f"{zeros.count:,} {'sample' if zeros.count == 1 else 'samples'}"
    mend = (
        'say "nodata": 0 (and "holes": "fill" where they are under the terrain), or '
        '"nodata": null if they are heights'
    )
    if owner["nodata"] is not None:
        mend = f'if so, make them {owner["nodata"]:.17g} in the file, which "nodata" says'
    return (
        f"{file.name}: {count} ({100.0 * zeros.share:.2g} %) of 0, as stored, far from all others, "
        f"which are {others}: taken for heights, and they may mark holes: {mend}"
    )


def _check_mesh(file: Path, owner: Node, cfg: Node) -> Iterator[Finding]:
    from scenec.compiler.assets.model import finish_model
    from scenec.compiler.assets.parse import parse_model

    parsed = parse_model(file, looks=False)
    missing = _missing(file, owner, parsed)
    yield from missing
    if not missing:
        # Its unit may be drawn, and is of no account here.
        yield from _warnings(file, owner, finish_model(file, parsed, part=owner["part"]).warnings)


def _check_model(file: Path, owner: Node, cfg: Node) -> Iterator[Finding]:
    from scenec.compiler.assets import model
    from scenec.compiler.assets.looks import OF_COLORS, OPACITY

    missing = _missing(file, owner, model.parsed_model(file))
    yield from missing
    if not missing:
        made = model.cached_model(
            file, owner["unit_m"], owner["up"], owner["part"], model.origin_of(owner["origin"])
        )
        model.require_near_origin(file, made)
        objects = cfg.at(*owner.path[:-2])
        plain = objects["material"] is not None
        lines = [line for line in made.warnings if not (plain and line.endswith(OF_COLORS))]
        lines += [f"material {name!r}: {OPACITY}" for name in _unmasked(made, objects)]
        yield from _warnings(file, owner, lines)


def _unmasked(made: MeshModel, objects: Node) -> Iterator[str]:
    """Yields materials with a mask that give way, on some faces, to one of the cfg's, without."""
    from scenec.compiler.assets.parts import is_of

    parts = objects.at("parts")
    anew = [name for name in parts.entries if parts.at(name)["material"] is not None]
    of_part = [any(is_of(path, name) for name in anew) for path in made.parts]
    for index, material in enumerate(made.materials):
        if material.cutout is None:
            continue
        on = set(made.part_of_face[made.material_of_face == index].tolist())
        if (
            objects["material"] is not None
            or any(is_of(material.name, name) for name in anew)
            or any(of_part[part] for part in on)
        ):
            yield material.name


def _missing(file: Path, owner: Node, parsed: ParsedModel) -> list[Finding]:
    """Findings on keys that neither the cfg nor the file gives."""
    return [
        owner.fault(f'the key "{key}" is missing: {file.name} does not say it')
        for key in parsed.missing(owner["unit_m"], owner["up"])
        if key not in owner
    ]


def _warnings(file: Path, owner: Node, lines: Iterable[str]) -> Iterator[Finding]:
    for line in lines:
        yield replace(owner.fault(f"{file.name}: {line}", "file"), is_warning=True)


def _members_of_mesh(file: Path, owner: Node) -> list[tuple[str, Path]]:
    """Lists a mesh's file, and the buffers beside it."""
    from scenec.compiler.assets.parse import GLTF, parse_model

    if file.suffix.lower() not in GLTF:
        return [("", file)]
    return [("", path) for path in (file, *parse_model(file, looks=False).companions)]


def _members_of_model(file: Path, owner: Node) -> list[tuple[str, Path]]:
    """Lists a model's file, and the files that belong to it in its order."""
    from scenec.compiler.assets.model import parsed_model

    return [("", path) for path in (file, *parsed_model(file).companions)]


def _check_poses(file: Path, owner: Node, cfg: Node) -> None:
    from scenec.compiler.assets.pose_table import read_poses

    read_poses(file, max(len(owner.at("models").entries), 1))


def _check_image(file: Path, owner: Node, cfg: Node) -> None:
    with file.open("rb") as stream:
        if stream.read(4) != _EXR_MAGIC:
            raise SceneError(f"{file.name}: not an OpenEXR file")
    import OpenEXR

    try:
        with OpenEXR.File(str(file), header_only=True) as picture:
            # Closing the file empties its header.
            channels = [channel.name for channel in picture.header()["channels"]]
    except (RuntimeError, ValueError, OSError) as error:
        raise SceneError(f"{file.name}: not a readable OpenEXR file: {error}") from error
    if not set("RGB") <= set(channels):
        raise SceneError(
            f"{file.name}: expected the channels R, G and B, found {', '.join(sorted(channels))}"
        )


def _check_track(file: Path, owner: Node, cfg: Node) -> None:
    from scenec.compiler.assets.tracks import read_stamped, read_track

    form, order, samples = owner["format"] or "csv", owner["quaternion"], cfg["samples"]
    if form == "csv" and order is None and "sampling" not in owner:
        rows = len(read_track(file).time_s)
    else:
        rows = len(read_stamped(file, form, order, owner["frame_rate_hz"] or 1.0).time_s)
    if samples is not None and rows < samples and "sampling" not in owner:
        raise SceneError(
            f"{file.name}: {rows} poses for {samples} samples: expected a row for each sample"
        )


def _check_map(file: Path, owner: Node, cfg: Node) -> None:
    from scenec.schemas.maps import read_pixels

    try:
        read_pixels(file)
    except ValueError as error:
        raise SceneError(f"{file.name}: {error}") from error


def _readable(place: str) -> Callable[[Path, Node, Node], None]:
    """A check whether a file can be read by a function of the compiler, ``module:name``."""

    def check(file: Path, _owner: Node, _cfg: Node) -> None:
        loaded(place)(file)

    return check


def _check_label_map(file: Path, owner: Node, cfg: Node) -> None:
    from scenec.compiler.assets.label_maps import code_of, decode

    values = owner.at("values").entries
    if values and None not in map(code_of, values):
        decode(file, dict.fromkeys(values, 0))


#: What a file must be, by the keyword "x-file"; a SceneError speaks of the file itself.
_CHECKS: dict[str, Callable[[Path, Node, Node], Iterable[Finding] | None]] = {
    "dem": _check_dem,
    "density": _readable("assets.pictures:read_gray"),
    "heights": _readable("assets.pictures:read_heights"),
    "image": _check_image,
    "label_map": _check_label_map,
    "map": _check_map,
    "mesh": _check_mesh,
    "model": _check_model,
    "polyline": _readable("assets.polyline:read_polyline"),
    "poses": _check_poses,
    "texture_set": _check_texture_set,
    "track": _check_track,
}
#: What is more than the file itself: files, and what each is called in the digest.
_MEMBERS: dict[str, Callable[[Path, Node], list[tuple[str, Path]]]] = {
    "dem": _members_of_dem,
    "mesh": _members_of_mesh,
    "model": _members_of_model,
    "texture_set": _members_of_texture_set,
}
