"""docs/datasets.md names every field of every format: those of real exports, by their readers."""

from __future__ import annotations

import json
import re
import tarfile
from pathlib import Path

import h5py
import pyarrow.parquet as pq
import pytest

from scenec.datasets.export import Choice, export
from scenec.datasets.formats.nuscenes import TABLES
from scenec.testing.exports import OPTIONS
from scenec.testing.made_frames import LEFT, RIGHT, made_rigs, make_out

PAGE = (Path(__file__).resolve().parents[2] / "docs/datasets.md").read_text()
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
        elif path.name == "sequences.csv":
            found |= set(path.read_text().splitlines()[0].split(","))
    return found


@pytest.mark.parametrize(
    "name",
    ["bop", "cityscapes", "coco", "euroc", "hdf5", "kitti", "nerfstudio", "panoptic", "parquet",
     "tum", "webdataset"],
)  # fmt: skip
def test_the_page_names_each_field_that_an_export_has(out, tmp_path, name):
    options = {} if name in ("kitti", "coco") else OPTIONS.get(name, {})
    choice = Choice(options=options, rigs=lambda _stage: made_rigs(2))
    found = written(export(out, name, tmp_path / "d", choice).folder)
    names = {"rover_left", "rover_right", "class", "all", "all-000000.tar"}
    assert found - names - fields_of(name) == set()


def test_the_page_names_each_field_of_nuscenes_tables():
    assert {name for fields in TABLES.values() for name in (*fields,)} - fields_of(
        "nuscenes"
    ) == set()
    assert set(TABLES) <= fields_of("nuscenes")
