"""Writes the answers of a lidar scan as clouds of points that other programs open.

PLY and PCD hold points in the lidar's frame. LAS holds them in the world, in steps of 0.1 mm, with
what surveyors' tools look for: intensity, returns, classification, GPS time.
"""

from __future__ import annotations

import importlib.util
import io
from collections.abc import Callable, Mapping
from datetime import date
from typing import Final

import numpy as np
from numpy.typing import NDArray

from scenec.schemas.errors import OutputError
from scenec.schemas.records import ScanRecord

#: Meters between neighboring coordinates of a LAS file.
LAS_STEP_M: Final = 1e-4
_PLY_TYPES: Final = {"f": "float", "u": "uint"}


def cloud_table(arrays: Mapping[str, NDArray]) -> NDArray:
    """Returns the answers as records: x, y, z, range, incidence, ids, beam and column.

    Of lidars that tell them also intensity, and the return (from 1) and how many its beam has.
    """
    there = np.isfinite(arrays["range"])
    beam, column = np.nonzero(there)[:2]
    names = [name for name in arrays if name.startswith("label.")]
    fields: list[tuple[str, str, NDArray]] = [
        *((axis, "<f4", arrays["points"][there][:, i]) for i, axis in enumerate("xyz")),
        ("range", "<f4", arrays["range"][there]),
        ("incidence", "<f4", arrays["incidence"][there]),
        *((name.replace(".", "_"), "<u4", arrays[name][there]) for name in (*names, "instance")),
        ("beam", "<u4", beam),
        ("column", "<u4", column),
    ]
    if "intensity" in arrays:
        fields.insert(5, ("intensity", "<f4", arrays["intensity"][there]))
    if there.ndim == 3:
        number = there.cumsum(axis=2)
        many = np.broadcast_to(number[..., -1:], there.shape)
        fields += [("return", "<u4", number[there]), ("returns", "<u4", many[there])]
    table = np.empty(int(there.sum()), [(name, kind) for name, kind, _ in fields])
    for name, _, values in fields:
        table[name] = values
    return table


def as_ply(arrays: Mapping[str, NDArray], record: ScanRecord) -> bytes:
    """Returns the answers as a binary PLY in the lidar's frame."""
    table = cloud_table(arrays)
    head = "ply\nformat binary_little_endian 1.0\ncomment made by scenec\n"
    head += f"element vertex {len(table)}\n"
    head += "".join(f"property {_PLY_TYPES[kind[1]]} {name}\n" for name, kind in table.dtype.descr)
    return f"{head}end_header\n".encode() + table.tobytes()


def as_pcd(arrays: Mapping[str, NDArray], record: ScanRecord) -> bytes:
    """Returns the answers as a binary PCD 0.7 in the lidar's frame; its viewpoint is the pose."""
    from scenec.schemas.quaternions import quaternion

    table = cloud_table(arrays)
    pose = np.array(record.lidar_to_world, np.float64)
    x, y, z, w = quaternion(pose[:3, :3]).tolist()
    place = " ".join(repr(float(value)) for value in (*pose[:3, 3], w, x, y, z))
    kinds = [kind[1].upper() for _, kind in table.dtype.descr]
    lines = {
        "VERSION": "0.7",
        "FIELDS": " ".join(table.dtype.names or ()),
        "SIZE": " ".join("4" for _ in kinds),
        "TYPE": " ".join(kinds),
        "COUNT": " ".join("1" for _ in kinds),
        "WIDTH": len(table),
        "HEIGHT": 1,
        "VIEWPOINT": place,
        "POINTS": len(table),
        "DATA": "binary",
    }
    head = "".join(f"{name} {value}\n" for name, value in lines.items())
    return f"# .PCD v0.7 - made by scenec\n{head}".encode() + table.tobytes()


def as_las(arrays: Mapping[str, NDArray], record: ScanRecord) -> bytes:
    """Returns the answers as LAS 1.4, point format 6, in the world's meters (``LAS_STEP_M``).

    ``intensity`` is 65535 for 1 and above, ``classification`` the label of the first level,
    ``gps_time`` the sample's; instances and labels of all levels are extra bytes.

    Raises:
        OutputError: laspy is missing, or a label does not fit into the 8 bits of a class.
    """
    if importlib.util.find_spec("laspy") is None:
        raise OutputError("clouds of the type las need laspy: pip install 'scenec[las]'")
    import laspy

    table = cloud_table(arrays)
    pose = np.array(record.lidar_to_world, np.float64)
    there = np.isfinite(arrays["range"])
    world = arrays["points"][there].astype(np.float64) @ pose[:3, :3].T + pose[:3, 3]
    header = laspy.LasHeader(point_format=6, version="1.4")
    # The day it is written would be another file each day.
    header.creation_date = date(2000, 1, 1)
    header.generating_software = "scenec"
    header.scales = np.full(3, LAS_STEP_M)
    header.offsets = np.floor(pose[:3, 3])
    labels = [name for name in table.dtype.names or () if name.startswith("label_")]
    extra = ("instance", *labels)
    header.add_extra_dims([laspy.ExtraBytesParams(name, np.uint32) for name in extra])
    las = laspy.LasData(header)
    las.x, las.y, las.z = world.T
    if "intensity" in (table.dtype.names or ()):
        las.intensity = np.rint(65535.0 * np.clip(table["intensity"], 0.0, 1.0)).astype(np.uint16)
    several = "return" in (table.dtype.names or ())
    las.return_number = table["return"] if several else np.ones(len(table), np.uint8)
    las.number_of_returns = table["returns"] if several else np.ones(len(table), np.uint8)
    if labels:
        if (largest := int(table[labels[0]].max(initial=0))) > 255:
            raise OutputError(f"{labels[0]} has the id {largest}, and LAS knows classes up to 255")
        las.classification = table[labels[0]].astype(np.uint8)
    las.gps_time = np.full(len(table), record.time_s or 0.0)
    for name in extra:
        las[name] = table[name]
    file = io.BytesIO()
    las.write(file)
    return file.getvalue()


#: Kinds of clouds, which are their files' endings, and what writes them.
CLOUDS: Final[Mapping[str, Callable[[Mapping[str, NDArray], ScanRecord], bytes]]] = {
    "ply": as_ply,
    "pcd": as_pcd,
    "las": as_las,
}
