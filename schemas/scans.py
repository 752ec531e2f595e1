"""Lidar scans on disk: OUT/batch_0000/scans/<rig>_<lidar>/000000.{npz,json}; clouds on request.

The npz holds a row a beam and a column an azimuth, from the first of each:

=================  ==================  ==========================================================
``points``         float32 [b, a, 3]   where the answer says the point is, lidar's frame, meters;
                                       NaN without an answer
``range``          float32 [b, a]      the answer, meters, noise included; +inf without one
``range_true``     float64 [b, a]      without noise; +inf without an answer
``incidence``      float32 [b, a]      cosine of the angle between beam and surface's normal; 0
``label.<level>``  uint32 [b, a]       of the face that answered; 0 without an answer
``instance``       uint32 [b, a]       likewise
``intensity``      float32 [b, a]      if the lidar tells it, ``schemas.lidar``; 0 without an answer
``elevation_deg``  float64 [b]         of each beam
``azimuth_deg``    float64 [a]         of each column, counterclockwise from above
=================  ==================  ==========================================================

Where a pattern says where each ray goes, both angles are [b, a] (version 1.1), and columns are a
beam's rays in their order.

A lidar whose beams have a width and that tells several returns has [b, a, n] in place of [b, a] in
all but the angles (version 1.2): returns of a beam, nearest first. There ``range_true`` is without
noise what ``range`` is, and ids and incidence are those where the ray nearest to the axis ends.

The lidar's frame is x ahead, y left, z up. The JSON sidecar, written last, holds the pose and what
the scan was made from.
"""

from __future__ import annotations

import hashlib
from collections.abc import Collection, Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from scenec.schemas.clouds import CLOUDS
from scenec.schemas.codec import encode, read_record
from scenec.schemas.errors import FrameError
from scenec.schemas.files import NUMPY_FAULTS, atomic, sha256, write_json
from scenec.schemas.records import FileDigest, ScanRecord

#: In each batch's folder.
SCANS = "scans"
_WHAT = "sidecar of a scan"
#: Version of a scan's shape; of one that holds both angles of each ray; of one with an axis more.
SCAN_VERSION, RAYS_VERSION, RETURNS_VERSION = "1.0", "1.1", "1.2"

CONVENTIONS = {
    "frame": "x ahead, y left, z up, meters; lidar_to_world: 4x4, row-major, column vectors",
    "azimuth": "degrees counterclockwise from above, 0 ahead; elevation: degrees upward",
    "order": "rows are beams, columns azimuths",
    "time": "a scan is taken at one instant",
    "range_true": "of the ray that was cast, which angular noise turns away from the one told",
}


@dataclass(frozen=True)
class Scan:
    """A scan read back.

    Attributes:
        path: Of the sidecar.
        arrays: By name, as the module says.
        sidecar: What its sidecar holds.
    """

    path: Path
    arrays: dict[str, NDArray]
    sidecar: ScanRecord


def scan_stem(folder: Path, lidar: str, sample: int) -> Path:
    """Path of a scan without its suffix, in a batch's folder."""
    return folder / SCANS / lidar / f"{sample:06d}"


def scan_key(stage_digest: str, scenec: str) -> str:
    """Returns the key of all that decides a scan, apart from its place: sha256, hex."""
    text = f"{SCAN_VERSION} {scenec} {stage_digest}"
    return hashlib.sha256(text.encode()).hexdigest()


def is_scanned(stem: Path, key: str, clouds: Collection[str] = ()) -> bool:
    """Whether a scan is there, whole as far as its size tells, and made with this key.

    Args:
        stem: See ``scan_stem``.
        key: See ``scan_key``.
        clouds: Which of ``CLOUDS`` have to be there, too.
    """
    try:
        record = read_record(stem.with_suffix(".json"), ScanRecord, FrameError, _WHAT)
        size = stem.with_suffix(".npz").stat().st_size
        whole = record.resume_key == key and record.npz.bytes == size
        return whole and all(stem.with_suffix(f".{kind}").is_file() for kind in clouds)
    except (OSError, FrameError):
        return False


def write_scan(
    stem: Path, arrays: Mapping[str, NDArray], record: ScanRecord, clouds: Collection[str] = ()
) -> None:
    """Write a scan, each file by atomic rename, the sidecar last; the same scan, the same bytes.

    Args:
        stem: See ``scan_stem``.
        arrays: By name.
        record: What there is to say of it but for its files.
        clouds: Which of ``CLOUDS`` to write as well.

    Raises:
        OutputError: A file cannot be written.
    """
    stem.with_suffix(".json").unlink(missing_ok=True)
    # Clouds of an earlier scan do not belong to this one.
    for kind in CLOUDS:
        stem.with_suffix(f".{kind}").unlink(missing_ok=True)
    path = stem.with_suffix(".npz")
    with atomic(path) as temporary, temporary.open("wb") as file:
        contents: dict[str, Any] = dict(arrays)
        np.savez(file, **contents)
    for kind in sorted(clouds):
        with atomic(stem.with_suffix(f".{kind}")) as temporary:
            temporary.write_bytes(CLOUDS[kind](arrays, record))
    record = replace(
        record,
        npz=FileDigest(bytes=path.stat().st_size, sha256=sha256(path)),
        ply="ply" in clouds,
    )
    version, order = SCAN_VERSION, CONVENTIONS["order"]
    if np.ndim(arrays.get("elevation_deg", ())) == 2:
        order = "rows are beams, columns their rays in turn; both angles are of each ray"
        version = RAYS_VERSION
    if np.ndim(arrays.get("range", ())) == 3:
        order += "; the last axis is that of returns, nearest first"
        version = RETURNS_VERSION
    record = replace(record, version=version, conventions=CONVENTIONS | {"order": order})
    write_json(stem.with_suffix(".json"), encode(record))


def read_scan(path: Path) -> Scan:
    """Read a scan and check it against its sidecar.

    Args:
        path: Any of its files, or its stem.

    Raises:
        FrameError: Something is missing, changed since, or no scan.
    """
    stem = path.with_suffix("") if path.suffix[1:] in ("npz", "json", *CLOUDS) else path
    json_path, npz_path = stem.with_suffix(".json"), stem.with_suffix(".npz")
    try:
        sidecar = read_record(json_path, ScanRecord, FrameError, _WHAT)
    except FileNotFoundError as error:
        raise FrameError(f"{json_path}: no such scan (the sidecar is missing)") from error
    try:
        if sha256(npz_path) != sidecar.npz.sha256:
            raise FrameError(f"{npz_path}: damaged or changed since it was written; scan again")
        with np.load(npz_path) as stored:
            return Scan(json_path, {name: stored[name] for name in stored.files}, sidecar)
    except NUMPY_FAULTS as error:
        raise FrameError(f"{npz_path}: cannot be read: {error}") from error
