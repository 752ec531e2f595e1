"""``scenec explain --why``: the answers agree with the stage and with what cameras really see."""

from __future__ import annotations

import json
import shutil
from pathlib import Path

import numpy as np
import pytest
from pxr import Usd, UsdGeom

from scenec.api.explain.sight import nearest_camera
from scenec.api.explain.why import why
from scenec.backends.camera.rays import camera_rays
from scenec.backends.exact import ExactCaster
from scenec.backends.stage.read import read_stage
from scenec.compiler.compile import compile_cfg
from scenec.compiler.views.needed import Keep
from scenec.schemas.errors import OutputError, StageError
from scenec.schemas.left_out import Reason, read_left_out
from scenec.testing.processes import output_of
from scenec.testing.small import small_cfg, write_cfg


def made(folder: Path, outputs: list[str], keep: Keep = Keep.SEEN) -> Path:
    """Two classes of rocks on a terrain of which cameras see a part."""
    folder.mkdir(parents=True)
    cfg = small_cfg(samples=2, batches=2, outputs=outputs)
    cfg["terrain"] |= {"size_m": [60, 60], "spacing_m": 1.0}
    cfg["terrain"]["relief"][1]["amplitude_m"] = 3
    cfg["objects"]["rocks"]["count"] = 150
    cfg["objects"]["stones"] = cfg["objects"]["rocks"] | {"count": 60}
    compile_cfg(write_cfg(folder, cfg), seed=3, out=folder / "out", keep=keep)
    return folder / "out"


@pytest.fixture(scope="module")
def output(tmp_path_factory):
    return made(tmp_path_factory.mktemp("why") / "a", ["label", "instance", "depth"])


def instancer(out: Path, name: str, batch: int = 0) -> UsdGeom.PointInstancer:
    stage = Usd.Stage.Open(str(out / f"batch_{batch:04d}" / "stage.usda"))
    # The caller needs the stage to live as long.
    _STAGES.append(stage)
    return UsdGeom.PointInstancer(stage.GetPrimAtPath(f"/World/Objects/{name}"))


_STAGES: list[Usd.Stage] = []


def test_answers_are_those_of_the_stage_for_every_rock_of_both_classes(output):
    record = read_left_out(output / "batch_0000")
    assert record is not None
    for name, count in (("rocks", 150), ("stones", 60)):
        prim = instancer(output, name)
        kept = list(prim.GetIdsAttr().Get()) if prim else []
        some = sorted({*kept[:4], *range(1, count + 1, count // 7), count})
        for local_id in some:
            found = why(output, f"{name}/{local_id}")
            assert found.in_stage == (local_id in kept)
            assert found.reason == str(record.classes[name].of(local_id))
            assert found.id == local_id + (150 if name == "stones" else 0)
            if not found.in_stage:
                assert found.position is None
                continue
            at = kept.index(local_id)
            assert found.position == tuple(prim.GetPositionsAttr().Get()[at])
            targets = prim.GetPrototypesRel().GetTargets()
            assert found.level.mesh == targets[prim.GetProtoIndicesAttr().Get()[at]].name
            again = why(output, str(found.id))
            assert again == found


def test_what_a_camera_shows_is_said_to_be_seen(output):
    scene = read_stage(output / "batch_0000" / "stage.usda")
    caster = ExactCaster(scene)
    shown: set[int] = set()
    for cameras in scene.cameras:
        row, _, _ = caster.cast(camera_rays(cameras[0]))
        shown |= set(scene.rows.instance_id[row[row >= 0]].tolist()) - {0}
    assert len(shown) > 1
    for number in sorted(shown):
        found = why(output, str(number))
        assert found.in_stage
        assert found.reason == "seen"


def test_a_whole_class_is_counted_by_reason(output):
    record = read_left_out(output / "batch_0000")
    found = why(output, "rocks")
    assert found.counts == {str(r): n for r, n in record.classes["rocks"].counts().items()}
    assert sum(found.counts.values()) == 150
    assert why(output, "/World/Objects/rocks") == found


def test_levels_have_the_errors_of_the_report(output):
    report = json.loads((output / "batch_0000" / "report.json").read_text())["objects"]["rocks"]
    prim = instancer(output, "rocks")
    errors = []
    for at, local_id in enumerate(list(prim.GetIdsAttr().Get())[:12]):
        level = why(output, f"rocks/{local_id}").level
        scale = max(prim.GetScalesAttr().Get()[at])
        known = report["levels"][level.mesh]
        assert level.triangles == known["triangles"]
        assert level.error_m == pytest.approx(known["error"] * scale, rel=1e-6)
        # The view that is nearest shows no more than was asked for, were it in it.
        assert level.error_m <= report["lod_error_max_m"] * (1 + 1e-6)
        errors.append(level.error_m)
    assert max(errors) > 0.0


def test_the_nearest_camera_is_found_among_all_samples(output):
    scene = read_stage(output / "batch_0000" / "stage.usda")
    point = (3.0, -2.0, 1.0)
    found = nearest_camera(output / "batch_0000" / "stage.usda", point)
    away = [np.linalg.norm(cameras[0].camera_to_world[:3, 3] - point) for cameras in scene.cameras]
    assert found.sample == int(np.argmin(away))
    assert found.distance_m == pytest.approx(min(away))
    focal = scene.cameras[0][0].intrinsics[0, 0]
    assert found.pixels_per_m == pytest.approx(focal / min(away))


def test_without_ids_in_the_stage_the_record_says_which_rock_is_which(output, tmp_path):
    bare = made(tmp_path / "b", ["depth"])
    prim = instancer(bare, "rocks")
    assert prim.GetIdsAttr().Get() is None
    record = read_left_out(bare / "batch_0000")
    kept = [i for i in range(1, 151) if record.classes["rocks"].of(i).kept]
    assert len(kept) == len(prim.GetPositionsAttr().Get())
    for at in (0, len(kept) // 2, len(kept) - 1):
        found = why(bare, f"rocks/{kept[at]}")
        assert found.position == tuple(prim.GetPositionsAttr().Get()[at])
        assert found.id is None
    with pytest.raises(OutputError, match="no instance ids"):
        why(bare, "17")


def test_where_nothing_was_left_out_everything_is_there(tmp_path):
    whole = made(tmp_path / "c", ["instance"], Keep.UNPRUNED)
    assert read_left_out(whole / "batch_0000") is None
    for question in ("rocks/1", "rocks/150", "210", "stones"):
        found = why(whole, question)
        assert found.in_stage
        assert "nothing is missing" in found.why
    assert why(whole, "210").what == "stones/60"


def test_tiles_and_other_prims_are_answered_for(output, tmp_path):
    record = read_left_out(output / "batch_0000")
    scene = Usd.Stage.Open(str(output / "batch_0000/stage.usda"))
    tiles = [p.GetName() for p in scene.GetPrimAtPath("/World/Terrain").GetChildren()]
    found = why(output, f"/World/Terrain/{tiles[0]}")
    counts = UsdGeom.Mesh(scene.GetPrimAtPath(f"/World/Terrain/{tiles[0]}"))
    assert found.triangles == len(counts.GetFaceVertexCountsAttr().Get())
    for name, reason in record.tiles.items():
        assert why(output, f"/World/Terrain/{name}").reason == str(reason)
    assert why(output, "/World/Rigs/rover/front").in_stage


@pytest.mark.parametrize(
    ("question", "words"),
    [
        ("rock/3", "no class 'rock'; did you mean \"rocks\"?"),
        ("xyz", "no class 'xyz'; known: rocks, stones"),
        ("rocks/0", "rocks has the numbers 1 to 150, not 0"),
        ("rocks/151", "rocks has the numbers 1 to 150, not 151"),
        ("rocks/-1", "'-1' is no number"),
        ("rocks/²", "is no number"),
        ("rocks/", "is no number"),
        ("0", "0 is no instance"),
        ("4711", "no instance 4711: ids go from 1 to 210 (rocks 1 to 150, stones 151 to 210)"),
        ("/World/Terrain/tile_00_000", 'did you mean "tile_000_000"?'),
        ("/World/Rigs/rover/fornt", 'did you mean "/World/Rigs/rover/front"?'),
        ("/World/Objects/rokcs/Prototypes", 'did you mean "rocks"?'),
        ("/", "no prim"),
        ("", "no class"),
        ("/Wörld/ß", "no prim"),
    ],
)
def test_what_cannot_be_answered_ends_in_one_clear_line(output, question, words, capsys):
    said = output_of(capsys, ["explain", str(output), "--why", question], 2)
    assert said.out == ""
    assert len(said.err.splitlines()) == 1
    assert words in said.err


def test_a_batch_is_chosen_by_its_number(output, capsys):
    found = json.loads(
        output_of(
            capsys, ["explain", str(output), "--why", "rocks/5", "--batch", "1", "--json"]
        ).out
    )
    assert found["batch"] == "batch_0001"
    record = read_left_out(output / "batch_0001")
    assert found["reason"] == str(record.classes["rocks"].of(5))
    with pytest.raises(StageError, match="batch 9"):
        why(output, "rocks/5", batch=9)


def test_the_answer_is_printed_for_people(output, capsys):
    record = read_left_out(output / "batch_0000")
    seen = int(record.classes["rocks"].where(Reason.SEEN)[0])
    gone = next(i for i in range(1, 151) if not record.classes["rocks"].of(i).kept)
    text = output_of(capsys, ["explain", str(output), "--why", f"rocks/{seen}"]).out
    assert f"rocks/{seen} is in the stage of batch_0000: a camera may see it" in text
    assert "stands at       x " in text
    assert "level           rock_0" in text
    text = output_of(capsys, ["explain", str(output), "--why", f"rocks/{gone}"]).out
    assert f"rocks/{gone} is not in the stage of batch_0000: " in text
    assert record.classes["rocks"].of(gone).text in " ".join(text.split())
    assert max(map(len, text.splitlines())) <= 100


def test_a_stage_and_a_record_that_differ_are_said(output, tmp_path):
    out = tmp_path / "out"
    shutil.copytree(output, out)
    path = out / "batch_0000" / "left_out.json"
    other = out / "batch_0001" / "left_out.json"
    path.write_bytes(other.read_bytes())
    kept = set(instancer(output, "rocks").GetIdsAttr().Get())
    record = read_left_out(out / "batch_0000")
    wrong = next(i for i in range(1, 151) if record.classes["rocks"].of(i).kept != (i in kept))
    with pytest.raises(OutputError, match="differ"):
        why(out, f"rocks/{wrong}")
    path.write_text("{}")
    with pytest.raises(OutputError, match=r"left_out\.json"):
        why(out, "rocks/1")


@pytest.fixture(scope="module")
def emptied(tmp_path_factory):
    """Two classes of rocks, and a camera that looks up: nothing of either is in the stage."""
    folder = tmp_path_factory.mktemp("emptied")
    cfg = small_cfg(samples=1, batches=1, outputs=["label", "instance", "depth"])
    cfg["terrain"]["spacing_m"] = 1.0
    cfg["objects"]["rocks"]["count"] = 40
    cfg["objects"]["stones"] = cfg["objects"]["rocks"] | {"count": 7}
    rover = cfg["rigs"]["rover"]
    rover["pose"]["target"] = {"distance_m": 1, "bearing_deg": 0, "height_m": 500}
    rover["sensors"]["front"] |= {"resolution": [24, 16], "fov_deg": 30}
    compile_cfg(write_cfg(folder, cfg), seed=3, out=folder / "out")
    return folder / "out"


def test_ids_of_classes_that_were_pruned_whole_are_those_they_had(emptied, capsys):
    stage = Usd.Stage.Open(str(emptied / "batch_0000" / "stage.usda"))
    assert not stage.GetPrimAtPath("/World/Objects/rocks")
    assert not stage.GetPrimAtPath("/World/Objects/stones")
    for question, what, number in (("rocks/40", "rocks/40", 40), ("41", "stones/1", 41),
                                   ("stones/7", "stones/7", 47), ("1", "rocks/1", 1)):  # fmt: skip
        found = why(emptied, question)
        assert (found.what, found.id, found.in_stage) == (what, number, False)
        assert found.reason == str(Reason.OUT_OF_VIEW)
        assert found.position is None
    whole = why(emptied, "stones")
    assert not whole.in_stage
    assert whole.counts == {str(Reason.OUT_OF_VIEW): 7}
    assert why(emptied, "/World/Objects/stones/instance_7") == why(emptied, "stones/7")
    assert why(emptied, "/World/Objects/stones/Prototypes/rock_0") == whole
    assert (
        "rocks 1 to 40, stones 41 to 47"
        in output_of(capsys, ["explain", str(emptied), "--why", "48"], 2).err
    )
