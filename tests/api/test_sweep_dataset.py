"""A whole sweep as one dataset: each point's frames, under names of their own, with settings."""

from __future__ import annotations

import csv
import json
import shutil
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
from PIL import Image

import scenec
from scenec.datasets.sheet import write_sheet
from scenec.datasets.source import Source
from scenec.schemas.errors import FrameError, OutputError, StageError
from scenec.testing.small import small_cfg

SUNS = (10, 60.5)
SEEDS = (1, 2)
#: Settings of the points in their order: the last list changes fastest.
POINTS = [(sun, seed) for sun in SUNS for seed in SEEDS]
PATH = "light.sun.elevation_deg"
SAMPLES = 2


@pytest.fixture(scope="module")
def swept(tmp_path_factory: pytest.TempPathFactory) -> Path:
    out = tmp_path_factory.mktemp("swept") / "sweep"
    cfg = small_cfg(samples=SAMPLES, outputs=["depth", "label", "instance"])
    cfg["terrain"]["spacing_m"] = 0.5
    cfg["rigs"]["rover"]["sensors"]["front"]["resolution"] = [32, 24]
    scenec.sweep(cfg, out, values={PATH: SUNS}, seeds=SEEDS, backend="annotation", workers=0)
    return out


@pytest.fixture
def broken(swept: Path, tmp_path: Path) -> Iterator[Path]:
    """The sweep, with its second point gone."""
    out = tmp_path / "sweep"
    shutil.copytree(swept, out)
    shutil.rmtree(out / listed(out)[1]["folder"])
    return out


def listed(out: Path) -> list[dict[str, Any]]:
    return json.loads((out / "sweep.json").read_text())["points"]


def rows_of(path: Path) -> list[dict[str, str]]:
    with path.open(newline="", encoding="utf-8") as file:
        return list(csv.DictReader(file))


def export(out: Path, form: str, folder: Path, **options: Any) -> Any:
    return scenec.export(out, form, folder=folder, workers=0, **options)


def test_frames_have_names_of_their_own_and_the_annotation_of_their_points(swept, tmp_path):
    report = export(swept, "coco", tmp_path / "coco")
    assert report.frames == len(POINTS) * SAMPLES
    rows = rows_of(tmp_path / "coco" / "frames.csv")
    assert len({row["frame"] for row in rows}) == len(rows)
    for number, point in enumerate(listed(swept)):
        export(swept / point["folder"], "coco", tmp_path / f"{number}")
        alone = {row["frame"]: row for row in rows_of(tmp_path / f"{number}" / "frames.csv")}
        together = {
            row["frame"].removeprefix(f"point_{number:04d}_"): row
            for row in rows
            if row["frame"].startswith(f"point_{number:04d}_")
        }
        assert together.keys() == alone.keys()
        for frame, row in together.items():
            assert row["annotation_sha256"] == alone[frame]["annotation_sha256"]
    assert scenec.check(tmp_path / "coco").sound
    assert scenec.check(tmp_path / "coco", against=swept).sound


def test_settings_stand_in_tables_and_records(swept, tmp_path):
    export(swept, "coco", tmp_path / "coco")
    points = rows_of(tmp_path / "coco" / "points.csv")
    assert [(float(row[PATH]), int(row["seed"])) for row in points] == POINTS
    assert [row["folder"] for row in points] == [point["folder"] for point in listed(swept)]
    batches = {row["batch"] for row in rows_of(tmp_path / "coco" / "frames.csv")}
    assert batches == {row["batch"] for row in points}
    summary = json.loads((tmp_path / "coco" / "export.json").read_text())
    assert [(one[PATH], one["seed"]) for one in summary["source"]["sweep"]] == POINTS
    card = (tmp_path / "coco" / "README.md").read_text()
    assert f"{len(POINTS)} points" in card
    assert "`points.csv`" in card
    (file,) = (tmp_path / "coco").rglob("*instances*.json")
    images = json.loads(file.read_text())["images"]
    assert len({image["id"] for image in images}) == len(POINTS) * SAMPLES
    found = [(image["settings"][PATH], image["settings"]["seed"]) for image in images]
    assert found == [point for point in POINTS for _ in range(SAMPLES)]


def test_settings_are_columns_of_parquet(swept, tmp_path):
    parquet = pytest.importorskip("pyarrow.parquet")
    export(swept, "parquet", tmp_path / "table")
    (file,) = (tmp_path / "table" / "data").glob("*.parquet")
    table = parquet.read_table(file)
    assert table.schema.field(f"settings.{PATH}").type == "double"
    assert table.schema.field("settings.seed").type == "int64"
    columns = (table.column(f"settings.{name}").to_pylist() for name in (PATH, "seed"))
    assert list(zip(*columns, strict=True)) == [p for p in POINTS for _ in range(SAMPLES)]


@pytest.mark.parametrize("form", ["hdf5", "webdataset", "panoptic", "bop"])
def test_formats_with_a_file_or_group_a_frame_hold_all(swept, tmp_path, form):
    report = export(swept, form, tmp_path / form)
    assert report.frames == len(POINTS) * SAMPLES
    assert not report.faults
    assert scenec.check(tmp_path / form).sound


def test_shares_keep_a_seeds_terrain_in_one_split_and_ranges_do_as_told(swept, tmp_path):
    export(swept, "coco", tmp_path / "shares", split="train=0.5,val=0.5")
    seeds: dict[str, set[str]] = {}
    for row in rows_of(tmp_path / "shares" / "points.csv"):
        seeds.setdefault(row["split"], set()).add(row["seed"])
    assert sorted(map(sorted, seeds.values())) == [["1"], ["2"]]
    export(swept, "coco", tmp_path / "ranges", split="low=0:2,high=2:4")
    found = rows_of(tmp_path / "ranges" / "points.csv")
    assert [row["split"] for row in found] == ["low", "low", "high", "high"]
    assert "may have the same terrain" in (tmp_path / "ranges" / "README.md").read_text()
    with pytest.raises(OutputError, match="or give ranges of batches"):
        export(swept, "coco", tmp_path / "three", split="a=0.4,b=0.3,c=0.3")


def test_a_range_of_batches_goes_through_the_points(swept):
    chosen = Source(swept, batches=[1, 2]).frames
    assert {ref.settings["point"] for ref in chosen} == {"point_0001", "point_0002"}
    every = {ref.name: ref.index for ref in Source(swept).frames}
    assert all(every[ref.name] == ref.index for ref in chosen)
    with pytest.raises(StageError, match="does not hold batch 4"):
        Source(swept, batches=[4])


@pytest.mark.parametrize("form", ["gltf", "map", "tapvid"])
def test_formats_of_stages_take_one_point(swept, tmp_path, form):
    with pytest.raises(OutputError, match=r"is a sweep.* takes the output of one point"):
        export(swept, form, tmp_path / form)


def test_other_settings_make_another_dataset(swept, tmp_path):
    out = tmp_path / "sweep"
    shutil.copytree(swept, out)
    export(out, "coco", tmp_path / "coco")
    assert export(out, "coco", tmp_path / "coco").there
    found = json.loads((out / "sweep.json").read_text())
    found["points"][0][PATH] = 11
    (out / "sweep.json").write_text(json.dumps(found))
    with pytest.raises(OutputError, match="holds another dataset"):
        export(out, "coco", tmp_path / "coco")


def test_a_point_that_is_not_there_is_named(broken, tmp_path):
    gone = listed(broken)[1]["folder"]
    with pytest.raises(FrameError, match=f"{gone}: no such point"):
        export(broken, "coco", tmp_path / "coco")
    report = export(broken, "coco", tmp_path / "coco", faults="skip")
    assert [fault.name for fault in report.faults] == ["point_0001"]
    assert report.frames == (len(POINTS) - 1) * SAMPLES
    # The others keep their names and numbers.
    names = [row["point"] for row in rows_of(tmp_path / "coco" / "points.csv")]
    assert names == ["point_0000", "point_0002", "point_0003"]
    shown = {ref.batch for ref in Source(broken).frames}
    assert shown == {0, 2, 3}


def test_a_folder_outside_of_the_sweep_is_refused(swept, tmp_path):
    found = json.loads((swept / "sweep.json").read_text())
    found["points"][0]["folder"] = "../elsewhere"
    (tmp_path / "sweep.json").write_text(json.dumps(found))
    with pytest.raises(OutputError, match="/points/0/folder"):
        Source(tmp_path)


def test_the_sheet_shows_each_point_first(swept, tmp_path):
    sheet = write_sheet(swept, tmp_path / "sheet.png", count=len(POINTS))
    assert sheet.frames == tuple(f"point_{k:04d}_batch_0000/rover_front/000000" for k in range(4))
    with Image.open(sheet.path) as picture:
        assert picture.height > 4 * 300
    few = write_sheet(swept, tmp_path / "few.png", count=2)
    assert [name[:10] for name in few.frames] == ["point_0000", "point_0001"]


def test_the_view_names_points_by_their_folders(swept, tmp_path):
    report = scenec.view(swept, page=tmp_path / "view.html", no_ground=True, workers=1)
    assert report.frames == len(POINTS) * SAMPLES
    assert not report.faults
    text = report.path.read_text(encoding="utf-8")
    for point in listed(swept):
        assert f'"{point["folder"]}/batch_0000"' in text
    # Filters: each setting that differs, with the value of each batch.
    columns = zip(*((str(sun), str(seed)) for sun, seed in POINTS), strict=True)
    settings = dict(zip((PATH, "seed"), map(list, columns), strict=True))
    index = json.loads(text.split('<template id="index">')[1].split("</template>")[0])
    assert dict(index["settings"]) == settings
