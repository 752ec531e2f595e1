"""docs/datasets.md names every field of every format: those of real exports, by their readers."""

from __future__ import annotations

import json
import re
import tarfile
from pathlib import Path

import h5py
import pyarrow.parquet as pq
import pytest
from rosbags.rosbag2 import Reader

from scenec.datasets.export import Choice, export
from scenec.testing.exports import OPTIONS, write
from scenec.testing.made_frames import LEFT, RIGHT, made_rigs, make_out

PAGE = (Path(__file__).resolve().parents[2] / "docs/datasets.md").read_text()
_COCO = """info description version licenses images id file_name width height annotations image_id
    category_id bbox area iscrowd categories name supercategory"""
#: Fields of the documents that the page names, for frames without lenses, of a pair.
DOCUMENTED = {
    "coco": f"{_COCO} segmentation size counts",
    "panoptic": f"{_COCO} segments_info isthing color",
    "cityscapes": "intrinsic fx fy u0 v0 extrinsic baseline pitch roll yaw x y z",
    "bop": """cam_K depth_scale cam_R_w2c cam_t_w2c obj_id cam_R_m2c cam_t_m2c bbox_obj bbox_visib
        px_count_all px_count_valid px_count_visib visib_fract diameter min_x min_y min_z size_x
        size_y size_z""",
    "nerfstudio": """camera_model applied_scale frames file_path w h fl_x fl_y cx cy
        transform_matrix depth_file_path""",
}
#: Folders of a tree of MPI Sintel.
SINTEL = {"final", "clean", "flow", "occlusions", "invalid"}
#: Of every dataset, described in a section of their own.
COMMON = {"export.json", "statistics.json"}


@pytest.fixture(scope="module")
def out(tmp_path_factory):
    return make_out(tmp_path_factory.mktemp("out") / "made", (LEFT, RIGHT), 2).out


def fields_of(name: str) -> set[str]:
    """What the page's row of a format puts between backticks, numbered names without numbers."""
    (row,) = re.findall(rf"^\| \*\*{name}\*\* \|.*$", PAGE, re.MULTILINE)
    found = set(re.findall(r"`([^`]+)`", row))
    if "the columns below" in row:
        (shared,) = re.findall(r"^\| \*\*columns\*\* .*$", PAGE, re.MULTILINE)
        columns = re.findall(r"`([^`]+)`", shared)
        found |= {f"{place}{column}" for place in ("", "instances/") for column in columns}
    return found


def keys(value) -> set[str]:
    """Keys of objects within a JSON value, but for those that are data: numbers, names."""
    if isinstance(value, dict):
        own = {key for key in value if not key.isdigit()}
        return own.union(*map(keys, value.values()))
    return set().union(*map(keys, value)) if isinstance(value, list) else set()


def leaves(schema) -> set[str]:
    return {name for field in schema for name in [field.name, *_inner(field.type)]}


def _inner(kind):
    for at in range(kind.num_fields):
        field = kind.field(at)
        if field.name not in ("element", "item", "bytes", "path"):
            yield field.name
        yield from _inner(field.type)


def written(folder: Path) -> set[str]:
    found: set[str] = set()
    for path in folder.rglob("*"):
        if path.suffix == ".json" and path.name not in COMMON:
            found |= keys(json.loads(path.read_bytes()))
        elif path.suffix == ".h5":
            with h5py.File(path) as file:
                file.visit(found.add)
        elif path.suffix == ".parquet":
            found |= leaves(pq.read_schema(path))
        elif path.suffix == ".tar":
            with tarfile.open(path) as tar:
                for member in tar.getmembers():
                    found.add(member.name.partition(".")[2])
                    if member.name.endswith(".json"):
                        found |= keys(json.load(tar.extractfile(member)))
        elif path.suffix == ".mcap":
            with Reader(path.parent) as bag:
                found |= {one.msgtype.rpartition("/")[2] for one in bag.connections}
        elif path.suffix in (".flo", ".exr", ".png"):
            found |= {part for part in path.parts if part in SINTEL}
            found |= set(re.findall("_(rgb|[a-z]+_label|[a-z]+_depth)_[0-9]+[.]", path.name))
    return found


@pytest.fixture(scope="module")
def moving(tmp_path_factory):
    folder = tmp_path_factory.mktemp("moving")
    write(folder)
    return folder / "out"


@pytest.mark.parametrize(
    ("name", "least"), [("sintel", 5), ("oaisys", 10), ("rosbag2", 8)]
)  # fmt: skip
def test_the_page_names_what_trees_and_bags_hold(moving, tmp_path, name, least):
    choice = Choice(rigs=lambda _stage: made_rigs(2))
    found = written(export(moving, name, tmp_path / "d", choice).folder) - {"class"}
    assert len(found) >= least
    assert found - fields_of(name) == set()


@pytest.mark.parametrize(
    "name",
    ["bop", "cityscapes", "coco", "hdf5", "nerfstudio", "panoptic", "parquet", "webdataset"],
)
def test_the_page_names_each_field_that_an_export_has_beside_the_document_s(out, tmp_path, name):
    options = {} if name in ("kitti", "coco") else OPTIONS.get(name, {})
    choice = Choice(options=options, rigs=lambda _stage: made_rigs(2))
    found = written(export(out, name, tmp_path / "d", choice).folder)
    names = {"rover_left", "rover_right", "class", "all", "all-000000.tar"}
    documented = set(DOCUMENTED.get(name, "").split())
    assert documented <= found
    assert found - names - documented - fields_of(name) == set()
