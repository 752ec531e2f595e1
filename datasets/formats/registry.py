"""Lists the formats: ours, and those of packages that offer one (``scenec.exporters``)."""

from __future__ import annotations

import importlib
from typing import TYPE_CHECKING

from scenec.schemas.errors import OutputError
from scenec.schemas.plugins import entry_points_of, load_offered, names_of, origin
from scenec.schemas.spelling import nearest

if TYPE_CHECKING:
    # The names alone are wanted without NumPy, by the shell's completion.
    from scenec.datasets.formats.contract import Format

#: Entry points of other packages: name -> a ``Format``.
GROUP = "scenec.exporters"

_OURS = {
    "bop": "scenec.datasets.formats.bop:Bop",
    "cityscapes": "scenec.datasets.formats.cityscapes:Cityscapes",
    "coco": "scenec.datasets.formats.coco:Coco",
    "colmap": "scenec.datasets.formats.colmap:Colmap",
    "euroc": "scenec.datasets.formats.euroc:Euroc",
    "hdf5": "scenec.datasets.formats.hdf5:Hdf5",
    "kitti": "scenec.datasets.formats.kitti:Kitti",
    "nerfstudio": "scenec.datasets.formats.nerfstudio:Nerfstudio",
    "nuscenes": "scenec.datasets.formats.nuscenes:Nuscenes",
    "oaisys": "scenec.datasets.formats.oaisys:Oaisys",
    "panoptic": "scenec.datasets.formats.panoptic:Panoptic",
    "parquet": "scenec.datasets.formats.parquet:Parquet",
    "rosbag2": "scenec.datasets.formats.rosbag2:Rosbag2",
    "sintel": "scenec.datasets.formats.sintel:Sintel",
    "tum": "scenec.datasets.formats.tum:Tum",
    "webdataset": "scenec.datasets.formats.webdataset:WebDataset",
    "yolo": "scenec.datasets.formats.yolo:Yolo",
}


def format_names() -> list[str]:
    """All names, sorted."""
    return sorted({*_OURS, *names_of(GROUP)})


def find_format(name: str) -> type[Format]:
    """A format by its name.

    Raises:
        OutputError: There is none; says the nearest name. Or another package's cannot be loaded.
    """
    if name in _OURS:
        module, _, attribute = _OURS[name].partition(":")
        format_class: type[Format] = getattr(importlib.import_module(module), attribute)
        return format_class
    from scenec.datasets.formats import contract

    if not entry_points_of(GROUP, name):
        raise OutputError(f"no format {name!r}{nearest(name, format_names())}")
    loaded, who = load_offered(GROUP, name, f"format {name!r}", OutputError)
    if isinstance(loaded, type) and issubclass(loaded, contract.Format):
        return loaded
    raise OutputError(f"{who}: is no scenec.datasets format")


def origin_of(name: str) -> str | None:
    """Returns package, version and code of another package's format; None of ours."""
    return None if name in _OURS else origin(GROUP, name)
