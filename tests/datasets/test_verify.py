"""A dataset is proved whole, and two are proved to have the same annotation, or not."""

from __future__ import annotations

import hashlib
import json
import re
import shutil
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from PIL import Image
from tiny_format import contents

from scenec.backends.run.render import render
from scenec.cli.main import main
from scenec.compiler.compile import compile_cfg
from scenec.datasets.export import Choice, export
from scenec.datasets.filters import make_filters
from scenec.datasets.verify import compare, is_dataset, verify
from scenec.schemas.errors import OutputError
from scenec.testing.made_output import make_output, some_passes
from scenec.testing.processes import output_of
from scenec.testing.small import small_cfg, write_cfg

FRAME = "batch_0001/rover_left/000001"


@pytest.fixture
def copy(dataset, tmp_path):
    shutil.copytree(dataset, tmp_path / "ds")
    return tmp_path / "ds"


def test_a_dataset_as_it_was_written_has_no_flaw(dataset, output):
    assert is_dataset(dataset)
    assert not is_dataset(output)
    assert verify(dataset) == []


def rewrite(name: str, change: Callable[[str], str]) -> Callable[[Path], None]:
    def apply(folder: Path) -> None:
        path = folder / name
        path.write_text(change(path.read_text(encoding="utf-8")), encoding="utf-8")

    return apply


def resum(folder: Path, *names: str) -> None:
    """Sums that fit what was changed: only its content can tell."""
    path = folder / "SHA256SUMS"
    lines = path.read_text(encoding="utf-8").splitlines()
    for name in names:
        digest = hashlib.sha256((folder / name).read_bytes()).hexdigest()
        lines = [f"{digest}  {name}" if line[66:] == name else line for line in lines]
    path.write_text("".join(f"{line}\n" for line in lines), encoding="utf-8")


def without_last_line(text: str) -> str:
    return "".join(text.splitlines(keepends=True)[:-1])


FLAWS = {
    "a changed file": (rewrite("all.json", lambda t: t + " "), "all.json", "was changed"),
    "a missing file": (lambda f: (f / "all.json").unlink(), "all.json", "is missing"),
    "an extra file": (lambda f: (f / "notes.txt").touch(), "notes.txt", "no part of the dataset"),
    "a changed card": (rewrite("README.md", str.upper), "README.md", "was changed"),
    "no sums": (lambda f: (f / "SHA256SUMS").unlink(), "SHA256SUMS", "is missing"),
    "broken sums": (
        rewrite("SHA256SUMS", lambda t: "nonsense\n" + t), "SHA256SUMS:1", "no line of sha256sum"
    ),
    "a sum of a file elsewhere": (
        rewrite("SHA256SUMS", lambda t: t + "0" * 64 + "  ../../secret\n"),
        "SHA256SUMS:", "no line of sha256sum",
    ),
}  # fmt: skip


@pytest.mark.parametrize("name", list(FLAWS))
def test_each_flaw_is_named(name, copy, capsys):
    change, where, words = FLAWS[name]
    change(copy)
    found = [f for f in verify(copy) if f.where.startswith(where) and words in f.message]
    assert found, verify(copy)
    assert str(found[0]) in output_of(capsys, ["check", str(copy)], 1).out


CONTRADICTIONS = {
    "a frame less": (rewrite("frames.csv", without_last_line), "says 8 frames"),
    "another split": (
        rewrite("frames.csv", lambda t: t.replace(",all,", ",test,", 1)), "more than one split"
    ),
    "a frame twice": (
        rewrite("frames.csv", lambda t: t + t.splitlines()[-1] + "\n"), "2 times"
    ),
}  # fmt: skip


@pytest.mark.parametrize("name", list(CONTRADICTIONS))
def test_an_index_that_contradicts_the_counts_is_found_though_its_sum_fits(name, copy):
    change, words = CONTRADICTIONS[name]
    change(copy)
    resum(copy, "frames.csv")
    messages = [flaw.message for flaw in verify(copy)]
    assert any(words in message for message in messages), messages
    assert any("digest of all annotation" in message for message in messages) or "split" in name


def test_what_is_no_dataset_or_of_another_version_is_refused(copy, tmp_path, capsys):
    with pytest.raises(OutputError, match=r"no export\.json"):
        verify(tmp_path)
    for text in ("", "[]", "{}", '{"export": 1, "splits": {}, "frames": "x"}'):
        (copy / "export.json").write_text(text)
        with pytest.raises(OutputError, match=r"is no export\.json of scenec"):
            verify(copy)
    assert "is no export.json" in output_of(capsys, ["check", str(copy)], 2).err
    summary = {"export": 99, "splits": {}, "frames": 0, "digest": {"annotation": ""}}
    (copy / "export.json").write_text(json.dumps(summary))
    with pytest.raises(OutputError, match="of version 99"):
        verify(copy)


def test_a_dataset_holds_what_the_frames_that_it_was_made_of_do(output, dataset, tmp_path, plugin):
    export(output, "tiny", tmp_path / "other", Choice(filters=make_filters(["id>0"])))
    for other in (tmp_path / "other", output):
        found = compare(dataset, other)
        assert found.same, found.held
        assert (found.frames, found.pictures_same, found.pictures_differing) == (8, 8, 0)


def test_datasets_of_the_same_frames_with_other_instances_are_not_the_same(
    output, dataset, tmp_path, plugin, capsys
):
    export(output, "tiny", tmp_path / "few", Choice(filters=make_filters(["id<100"])))
    for other in (dataset, output):
        found = compare(other, tmp_path / "few")
        assert not found.same
        assert not found.differing
        assert found.held[0] == "batch_0000/rover_left/000000: 3 against 1 instances"
        assert sum("instances" in line for line in found.held) == found.frames == 8
    out = output_of(capsys, ["check", str(dataset), "--against", str(tmp_path / "few")], 1).out
    assert "error: batch_0000/rover_left/000000: 3 against 1 instances [holds other things]" in out
    assert 'error: keep: [] against ["id<100"] [holds other things]' in out
    assert out.endswith("not the same dataset\n")


def test_an_option_that_changes_files_makes_a_dataset_another(output, dataset, tmp_path, plugin):
    export(output, "tiny", tmp_path / "other", Choice(options={"ending": "txt"}))
    assert compare(dataset, tmp_path / "other").held == ["option ending: its default against txt"]
    for how in ("link", "copy"):
        export(output, "coco", tmp_path / how, Choice(options={"images": how}))
    assert compare(tmp_path / "link", tmp_path / "copy").same


@pytest.mark.parametrize(
    ("change", "told"),
    [
        (lambda a: a.pop(), r"000001\.png: 3 against 2 annotations"),
        (lambda a: a[-1].update(area=7), r"annotation of instance \d+: area \d+ against 7"),
        (lambda a: a[-1].update(iscrowd=1), r"annotation of instance \d+: iscrowd 0 against 1"),
        (
            lambda a: a[-1]["segmentation"].update(counts="0"),
            r"annotation of instance \d+: another segmentation",
        ),
    ],
)
def test_one_other_annotation_of_a_coco_file_is_named(output, tmp_path, change, told):
    export(output, "coco", tmp_path / "a")
    shutil.copytree(tmp_path / "a", tmp_path / "b")
    path = tmp_path / "b/annotations/instances_all.json"
    document = json.loads(path.read_bytes())
    change(document["annotations"])
    path.write_text(json.dumps(document), encoding="utf-8")
    found = compare(tmp_path / "a", tmp_path / "b")
    assert not found.same
    assert len(found.held) == 1
    assert re.search(told, found.held[0])


def test_images_keep_their_ids_whatever_is_missing_or_asked_for(output, tmp_path):
    def ids(folder: Path, out: Path, **choice: object) -> dict[str, int]:
        export(out, "coco", folder, Choice(**choice))  # type: ignore[arg-type]
        document = json.loads((folder / "annotations/instances_all.json").read_bytes())
        found = {one["file_name"]: one["id"] for one in document["images"]}
        assert len(set(found.values())) == len(found)
        assert {one["image_id"] for one in document["annotations"]} == set(found.values())
        return found

    whole = ids(tmp_path / "whole", output)
    assert sorted(whole.values()) == list(range(1, 9))
    shutil.copytree(output, tmp_path / "out")
    (tmp_path / "out/batch_0000/frames/annotation/rover_left/000000.json").unlink()
    parts = [
        ids(tmp_path / "gap", tmp_path / "out", faults="skip"),
        ids(tmp_path / "batch", output, batches=[1]),
        ids(tmp_path / "camera", output, cameras=["rover_right"]),
        ids(tmp_path / "sample", output, samples=[1]),
    ]
    assert [len(part) for part in parts] == [7, 4, 4, 4]
    for part in parts:
        assert part.items() <= whole.items()


def test_a_frame_with_one_other_pixel_is_named(dataset, tmp_path, capsys):
    def tampered(number: int) -> dict:
        passes = some_passes(number)
        if number == 5:
            passes["depth"][-1, -1] = np.nextafter(passes["depth"][-1, -1], np.float32(0))
        return passes

    other = make_output(tmp_path / "out", tampered)
    found = compare(dataset, other)
    assert (found.differing, found.same) == ([FRAME], False)
    out = output_of(capsys, ["check", str(dataset), "--against", str(other)], 1).out
    assert f"error: {FRAME} [annotation differs]" in out
    assert "the same in 7 of 8 common frames" in out
    assert "not the same dataset" in out


def test_missing_and_unreadable_frames_are_named(dataset, output, tmp_path):
    shutil.copytree(output, tmp_path / "out")
    frames = tmp_path / "out/batch_0000/frames/annotation"
    (frames / "rover_right/000000.json").unlink()
    (frames / "rover_left/000001.exr").write_bytes(b"\0")
    found = compare(dataset, tmp_path / "out")
    assert found.only_first == ["batch_0000/rover_right/000000"]
    assert [text.split(":")[0] for text in found.unreadable] == ["batch_0000/rover_left/000001"]
    assert not found.same
    turned = compare(tmp_path / "out", dataset)
    assert turned.only_second == found.only_first


def test_pictures_with_other_noise_do_not_make_a_dataset_another(dataset, output, tmp_path, plugin):
    """The tiny format holds no pictures: only two outputs have them at hand."""
    shutil.copytree(output, tmp_path / "out")
    path = tmp_path / "out/batch_0000/frames/annotation/rover_left/000000.png"
    pixels = np.asarray(Image.open(path)).copy()
    changed = np.where(pixels < 128, pixels + 2, pixels - 2)
    Image.fromarray(changed).save(path)
    found = compare(output, tmp_path / "out")
    assert found.same
    assert (found.pictures_same, found.pictures_differing) == (7, 1)
    assert found.mean_difference == [2.0]
    a = pixels.astype(np.float64)
    expected = np.mean(4.0 / (a * a + 0.01 * a.mean() ** 2))
    assert found.relative_mse == [pytest.approx(expected)]
    unknown = compare(dataset, tmp_path / "out")
    assert (unknown.pictures_differing, unknown.mean_difference) == (1, [])


def test_nothing_in_common_is_not_the_same(tmp_path, dataset):
    other = make_output(tmp_path / "out", batches=1, cameras=("mast",))
    found = compare(dataset, other)
    assert found.frames == 0
    assert not found.same


def test_questions_that_make_no_sense_end_in_one_line(dataset, tmp_path, capsys):
    assert main(["check", str(dataset), "--exact"]) == 2
    error = output_of(
        capsys, ["check", str(dataset), "--against", str(tmp_path)], 2
    ).err.splitlines()
    assert len(error) == 2
    assert "neither a dataset of scenec" in error[1]


@pytest.mark.usefixtures("worker_here")
def test_a_dataset_made_again_from_its_card_is_the_same_to_the_byte(tmp_path, plugin, capsys):
    cfg = small_cfg(samples=1)
    cfg["objects"]["rocks"] |= {"count": 30, "subdivisions": 1}
    cfg["terrain"] |= {"spacing_m": 0.5}
    first = tmp_path / "first"
    first.mkdir()
    compile_cfg(write_cfg(first, cfg), seed=5, out=first / "OUT")
    passes = ("label", "instance", "depth")
    render(first / "OUT", "reference", passes=passes)
    export(first / "OUT", "tiny", first / "ds")

    card = (first / "ds/README.md").read_text(encoding="utf-8")
    again = tmp_path / "again"
    again.mkdir()
    text = card.split("<summary>cfg.json</summary>")[1].split("```json\n")[1].split("\n```")[0]
    (again / "cfg.json").write_text(text, encoding="utf-8")
    commands = card.split("```sh\n")[1].split("```")[0].splitlines()
    places = {"cfg.json": again / "cfg.json", "OUT": again / "OUT", "AGAIN": again / "ds",
              "DATASET": first / "ds"}  # fmt: skip
    for command in commands:
        words = [str(places.get(word, word)) for word in command.split()]
        assert words[0] == "scenec"
        extra = ["--workers", "1"] if words[1] == "export" else []
        assert main(words[1:] + extra) == 0, command
    assert "the same dataset" in capsys.readouterr().out.splitlines()
    theirs, ours = contents(again / "ds"), contents(first / "ds")
    # The cfg's text came out of a block of Markdown: but for its last line end it is the same.
    assert {n for n in ours if ours[n] != theirs.get(n)} <= {"export.json", "SHA256SUMS"}
