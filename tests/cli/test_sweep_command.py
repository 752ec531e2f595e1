"""A sweep is what single compilations of its points are."""

from __future__ import annotations

import csv
import json
from pathlib import Path

import pytest

from scenec.cli.main import main
from scenec.compiler.compile import compile_cfg
from scenec.compiler.sweep import points, split
from scenec.schemas.errors import ScenecError
from scenec.schemas.files import tree
from scenec.testing.processes import output_of
from scenec.testing.small import small_cfg, write_cfg


def tiny(folder: Path) -> Path:
    cfg = small_cfg(samples=1)
    cfg["terrain"]["spacing_m"] = 0.5
    cfg["objects"]["rocks"]["count"] = 20
    cfg["rigs"]["rover"]["sensors"]["front"]["resolution"] = [32, 24]
    return write_cfg(folder, cfg)


def names(lists: list[str], seeds: range = range(1), *, in_step: bool = False) -> list[str]:
    return [point.name for point in points(lists, seeds, in_step=in_step)]


def test_the_grid_is_each_with_each_and_the_seed_changes_fastest():
    swept = points(["a.b=1,2", "c=x", "d[0]=3,4"], range(5, 7))
    assert [point.settings for point in swept[::2]] == [
        (f"a.b={b}", "c=x", f"d[0]={d}") for b in (1, 2) for d in (3, 4)
    ]
    assert [point.seed for point in swept] == [5, 6] * 4
    assert [point.name for point in swept[:3]] == [
        "b=1_0=3_seed=5", "b=1_0=3_seed=6", "b=1_0=4_seed=5",
    ]  # fmt: skip


def test_lists_in_step_go_together():
    swept = points(["a=1,2", "b=3,4", "c=5"], range(1), in_step=True)
    assert [point.settings for point in swept] == [
        ("a=1", "b=3", "c=5"), ("a=2", "b=4", "c=5")
    ]  # fmt: skip
    with pytest.raises(ScenecError, match="2 of a, 3 of b"):
        points(["a=1,2", "b=3,4,5"], range(1), in_step=True)


def test_folders_are_named_for_what_differs():
    assert names([]) == ["seed=0"]
    assert names(["a=1"], range(2)) == ["seed=0", "seed=1"]
    assert names(["a.x=1,2", "b.x=-1,1e3"])[0] == "a.x=1_b.x=-1"
    assert names(['a={"type": "none"},{"type": "clear"}']) == ["a=type_none", "a=type_clear"]
    # What a name cannot hold must not make two points one.
    assert names(["a=x/y,x y"]) == ["a=x_y.0", "a=x_y.1"]
    long = names([f"{'k' * 99}{i}=1,2" for i in range(3)])
    assert len(set(long)) == 8
    assert all(len(name) < 140 for name in long)


def test_commas_inside_of_values_do_not_part_them():
    given = ["[1, 2]", '{"a": [3, 4], "b": "x,]\\","}', "word", "-1e3"]
    assert split(",".join(given)) == given


@pytest.mark.parametrize(("lists", "part"), [(["a"], "path=value"), (["a=1", "a=2"], "twice")])
def test_lists_that_say_nothing_are_told(lists, part):
    with pytest.raises(ScenecError, match=part):
        points(lists, range(1))


def test_every_point_is_what_compiling_it_alone_makes_and_is_made_once(tmp_path, capsys):
    file, out = tiny(tmp_path), tmp_path / "out"
    words = ["sweep", str(file), "--set", "terrain.spacing_m=0.5,0.8", "--seeds", "3:5"]
    words += ["-o", str(out), "--compile-only", "--no-cache", "--workers", "0", "--json"]
    said = json.loads(output_of(capsys, words).out)
    assert said == json.loads((out / "sweep.json").read_text())
    assert {point["state"] for point in said["points"]} == {"compiled"}
    assert [point["terrain.spacing_m"] for point in said["points"]] == [0.5, 0.5, 0.8, 0.8]
    with (out / "sweep.csv").open(encoding="utf-8") as table:
        rows = list(csv.DictReader(table))
    assert [(row["folder"], row["terrain.spacing_m"], row["seed"]) for row in rows] == [
        (f"spacing_m={spacing}_seed={seed}", spacing, str(seed))
        for spacing in ("0.5", "0.8")
        for seed in (3, 4)
    ]
    cfg = json.loads(file.read_text())
    cfg["terrain"]["spacing_m"] = 0.8
    (tmp_path / "edited").mkdir()
    compile_cfg(write_cfg(tmp_path / "edited", cfg), seed=4, out=tmp_path / "alone")
    ours = out / "spacing_m=0.8_seed=4" / "batch_0000"
    theirs = tmp_path / "alone" / "batch_0000"
    assert tree(ours) == tree(theirs)
    assert all((ours / path).read_bytes() == (theirs / path).read_bytes() for path in tree(ours))

    # A point that lost a file is made again, and no other.
    (ours / "stage.usda").unlink()
    assert "3 of 4 points are compiled already" in output_of(capsys, words).err
    assert (ours / "stage.usda").read_bytes() == (theirs / "stage.usda").read_bytes()


def test_a_fault_of_one_point_is_told_once_and_before_anything_is_made(tmp_path, capsys):
    out = tmp_path / "out"
    words = ["sweep", str(tiny(tmp_path)), "--set", "terrain.spacing_m=0.5,-1", "--seeds", "0:3"]
    assert main([*words, "-o", str(out)]) == 2
    fault = "--set terrain.spacing_m=-1: /terrain/spacing_m: -1: expected more than 0 m\n"
    assert capsys.readouterr().err == fault
    assert not out.exists()


def test_a_point_that_cannot_be_built_does_not_stop_the_others(tmp_path, capsys):
    file, out = tiny(tmp_path), tmp_path / "out"
    cfg = json.loads(file.read_text())
    center = {"type": "object", "object": "rocks"}
    cfg["rigs"]["rover"]["pose"] = {"type": "orbit", "center": center, "radius_m": 5}
    file.write_text(json.dumps(cfg))
    words = ["sweep", str(file), "--set", "objects.rocks.count=0,5", "-o", str(out)]
    assert main([*words, "--compile-only", "--workers", "0", "--json"]) == 1
    states = [point["state"] for point in json.loads(capsys.readouterr().out)["points"]]
    assert states[0].startswith("failed: rigs/rover/pose: there is no object of the class rocks")
    assert states[1] == "compiled"


def test_a_folder_of_something_else_is_left_alone(tmp_path, capsys):
    file, out = tiny(tmp_path), tmp_path / "out"
    words = ["sweep", str(file), "-o", str(out), "--compile-only", "--workers", "0"]
    assert main(words) == 0
    cfg = json.loads(file.read_text())
    cfg["terrain"]["spacing_m"] = 0.7
    file.write_text(json.dumps(cfg))
    assert "seed=0: holds batches of another cfg; --replace" in output_of(capsys, words, 2).err
    assert main([*words, "--replace"]) == 0
    assert (
        "no sweep"
        in output_of(
            capsys, ["sweep", str(file), "-o", str(out / "seed=0"), "--compile-only"], 2
        ).err
    )


@pytest.mark.usefixtures("worker_here")
def test_points_are_rendered_and_not_rendered_again(tmp_path, capsys):
    out = tmp_path / "out"
    words = ["sweep", str(tiny(tmp_path)), "--set", "light.sun.elevation_deg=20,40"]
    words += ["-o", str(out), "--passes", "label,depth", "--workers", "0"]
    assert main(words) == 0
    frames = sorted(out.rglob("000000.exr"))
    assert len(frames) == 2
    when = [frame.stat().st_mtime_ns for frame in frames]
    capsys.readouterr()
    assert main([*words, "--json"]) == 0
    states = [point["state"] for point in json.loads(capsys.readouterr().out)["points"]]
    assert states == ["rendered", "rendered"]
    assert [frame.stat().st_mtime_ns for frame in frames] == when
