"""Cfgs of OAISYS become valid cfgs that compile, and a report says what became of every value."""

from __future__ import annotations

import copy
import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from made_assets import make_assets
from PIL import Image

from scenec.backends.contract import Rays
from scenec.backends.exact import ExactCaster
from scenec.backends.stage.read import read_stage
from scenec.backends.testing.scenes import write_latlong
from scenec.cli.main import main
from scenec.compiler.assets.tracks import read_track
from scenec.compiler.cfg import json_positions
from scenec.compiler.cfg.load import load
from scenec.compiler.compile import compile_cfg
from scenec.compiler.geometry.poses import from_euler
from scenec.importers.oaisys import boxes
from scenec.importers.oaisys.context import Labels
from scenec.importers.oaisys.presets import NOISES, PRESETS, USUAL, WITHOUT_COUNTERPART
from scenec.importers.oaisys.read import import_oaisys
from scenec.importers.output import Imported, check_free, write
from scenec.importers.poses import rotation_of, turns_of
from scenec.schemas.errors import CfgError, OutputError
from scenec.schemas.exr import read_exr

DATA = Path(__file__).parent / "data"
FORMS = ("oaisys_current", "oaisys_2021", "oaisys_listing")


def example(form: str) -> Any:
    return copy.deepcopy(json_positions.parse((DATA / f"{form}.json").read_bytes()).value)


def imported(cfg: Any, tmp_path: Path, *, stand_ins: bool = True) -> Imported:
    file = tmp_path / "theirs.json"
    file.write_text(json.dumps(cfg, indent=1), encoding="utf-8")
    return import_oaisys(file, tmp_path / "ours.json", stand_ins=stand_ins)


def faults(cfg: Any, tmp_path: Path) -> list[str]:
    with pytest.raises(CfgError) as caught:
        imported(cfg, tmp_path)
    return [f"{fault.pointer}: {fault.message}" for fault in caught.value.faults]


def leaves(value: Any, at: str = "") -> list[str]:
    """Pointers of all that is no object or list, and no empty one."""
    items: Any = value.items() if isinstance(value, dict) else enumerate(value)
    found = []
    for key, child in items:
        if isinstance(child, dict | list):
            found += leaves(child, f"{at}/{key}")
        else:
            found.append(f"{at}/{key}")
    return found


@pytest.mark.parametrize("form", FORMS)
def test_the_report_has_a_word_for_every_value(form, tmp_path):
    cfg = example(form)
    told = [entry.pointer for entry in imported(cfg, tmp_path).report.entries if entry.file]
    assert len(told) == len(set(told))
    untold = [leaf for leaf in leaves(cfg) if not any(f"{leaf}/".startswith(f"{p}/") for p in told)]
    assert untold == []


@pytest.mark.parametrize("form", FORMS)
def test_what_is_translated_is_valid_and_says_so_to_the_user(form, tmp_path, capsys):
    out, report = tmp_path / "ours.json", tmp_path / "report.json"
    words = ["import", "oaisys", str(DATA / f"{form}.json"), "-o", str(out), "--stand-ins"]
    assert main([*words, "--report", str(report)]) == 0
    assert load(out).warnings == ()
    shown = capsys.readouterr()
    assert "next: scenec run" in shown.err
    told = json.loads(report.read_text())
    assert sum(told["counts"].values()) == len(told["values"])
    assert all(v["note"] for v in told["values"] if v["fate"] in ("approximated", "dropped"))


def test_numbers_arrive_where_they_belong(tmp_path):
    cfg = imported(example("oaisys_current"), tmp_path).cfg
    assert (cfg["batches"], cfg["samples"]) == (3, 4)
    assert cfg["labels"]["level_0"] == {"red_sand": 10, "id_20": 20, "rock": 40, "sky": 500}
    assert cfg["terrain"]["size_m"] == [40, 40]
    relief = cfg["terrain"]["relief"][1]
    # 40 m for a mesh of 2 units: heights of 0.1 to 0.2, features of 0.3 to 0.5 units.
    assert relief["amplitude_m"] == {"type": "uniform", "min": 2, "max": 4}
    assert relief["scale_m"] == {"type": "uniform", "min": 6, "max": 10}
    assert relief["gain"] == pytest.approx(2.2**-0.95)
    noise = cfg["terrain"]["ground"][1]["noise"]
    assert noise["scale_m"]["max"] == pytest.approx(40 / 3)
    assert noise["octaves"] == {"type": "uniform", "min": 2, "max": 4}
    left, right = cfg["rigs"]["base"]["sensors"].values()
    assert left["intrinsics"] == {"fx": 55, "fy": 55, "cx": 32, "cy": 24}
    # From x right, y up, looking down -z, to x right, y down, z ahead; turned by 45 degrees.
    assert right["mount"] == {"position_m": [0.12, -0.05, 0.02], "rotation_deg": [0, -45, 0]}
    assert set(left["outputs"]) == {"rgb", "label", "instance", "depth"}
    assert right["outputs"] == ["rgb", "label"]
    assert cfg["light"]["sun"]["elevation_deg"] == {"type": "uniform", "min": 20, "max": 70}
    assert cfg["light"]["sky"]["dust_density"] == {"type": "uniform", "min": 0, "max": 5}
    assert cfg["objects"]["rock1"]["count"] == {"type": "uniform", "min": 40, "max": 60}
    assert cfg["objects"]["rock2"]["count"]["values"] == [0, 20]


def test_each_texture_is_as_likely_as_any_other_to_lie_at_the_bottom(tmp_path):
    ground = imported(example("oaisys_current"), tmp_path).cfg["terrain"]["ground"]
    # Three textures, one to three of them merged: the last that covers all counts.
    chances = [layer["coverage"]["weights"][1] for layer in ground[1:3]]
    bottom = [(1 - chances[0]) * (1 - chances[1]), chances[0] * (1 - chances[1]), chances[1]]
    assert bottom == pytest.approx([1 / 3] * 3)
    merged = [layer["coverage"]["weights"][1] for layer in ground[3:]]
    assert sum(merged) == pytest.approx(1.0)


@pytest.mark.parametrize(("current", "center"), [(True, 32.0), (False, 31.5)])
def test_the_generations_count_pixels_from_different_corners(current, center, tmp_path):
    cfg = example("oaisys_current")
    if not current:
        del cfg["SIMULATION_SETUP"]["saveMetaData"]
        cfg["SENSOR_SETUP"]["GENERAL"]["hoverBaseDistance"] = 1.5
    sensor = imported(cfg, tmp_path).cfg["rigs"]["base"]["sensors"]["left"]
    assert sensor["intrinsics"]["cx"] == center


def test_missing_files_are_named_all_at_once(tmp_path):
    with pytest.raises(CfgError) as caught:
        imported(example("oaisys_current"), tmp_path, stand_ins=False)
    text = str(caught.value)
    assert len(caught.value.faults) == 5
    assert 'no folder "textures/red_sand"' in text
    assert 'no file "meshes/rocks.blend"' in text
    assert "--stand-ins puts procedural rocks in its place" in text
    assert all(fault.line > 1 and fault.pointer for fault in caught.value.faults)


def test_a_near_name_of_a_missing_file_is_told(tmp_path):
    (tmp_path / "textures" / "red_sands").mkdir(parents=True)
    with pytest.raises(CfgError, match='did you mean "red_sands"'):
        imported(example("oaisys_current"), tmp_path, stand_ins=False)


def drop(*path: str | int) -> Callable[[Any], None]:
    def change(cfg: Any) -> None:
        for key in path[:-1]:
            cfg = cfg[key]
        del cfg[path[-1]]

    return change


def put(value: Any, *path: str | int) -> Callable[[Any], None]:
    def change(cfg: Any) -> None:
        for key in path[:-1]:
            cfg = cfg[key]
        cfg[path[-1]] = value

    return change


_SENSOR = ("SENSOR_SETUP", "SENSORS", 0, "sensorParams")
_SKY = ("ENVIRONMENT_EFFECTS_SETUP", "ENVIRONMENT_EFFECTS", 0, "environmentEffectsParams")
_STAGE = ("ASSET_SETUP", "STAGES", 0, "stageParams")
FAULTS = [
    (drop("SIMULATION_SETUP"), '/: no key "SIMULATION_SETUP", which is required'),
    (put(0, "SIMULATION_SETUP", "numBatches"), "numBatches: 0: expected a whole number"),
    (put(1.5, "SIMULATION_SETUP", "numBatches"), "1.5: expected a whole number"),
    (put(True, "SIMULATION_SETUP", "numBatches"), "true: expected a whole number"),
    (put({}, "RENDER_SETUP", "RENDER_PASSES"), "RENDER_PASSES: {}: expected a list"),
    (put("SemanticPas", "RENDER_SETUP", "RENDER_PASSES", 1, "type"), 'mean "SemanticPass"'),
    (put([55, 0, 32], *_SENSOR, "KMatrix"), "KMatrix: [55, 0, 32]: expected a list of 9 numbers"),
    (put([0] * 9, *_SENSOR, "KMatrix"), "expected focal lengths above 0"),
    (put([0] * 7, *_SENSOR, "transformation"), "expected a quaternion"),
    (put([70, 20], *_SKY, "SunElevation"), "[70, 20]: expected [a, b] with a up to b"),
    (put([0, 200], *_SKY, "SunElevation"), "expected [a] or [a, b], numbers from -90 to 90"),
    (put("mound", *_STAGE, "stageLandscapePreset"), 'did you mean "mounds"?'),
    (put([1.0], *_STAGE, "landscapeParams", "noise_siz"), 'did you mean "noise_size"?'),
    (put(["ridged_multifractal"], *_STAGE, "landscapeParams", "noise_type"), "ridged_multi_fr"),
    (put("grund", *_STAGE, "assetMaterial"), "no material is called 'grund'"),
    (put("randomEuclidianTarget", "SENSOR_SETUP", "GENERAL", "sensorMovementType"), "randomEucl"),
    (put([1], *_STAGE, "landscapeParams"), "landscapeParams: [1]: expected an object"),
]


@pytest.mark.parametrize(("change", "expected"), FAULTS)
def test_a_fault_says_where_what_and_what_was_meant(change, expected, tmp_path):
    cfg = example("oaisys_current")
    change(cfg)
    found = faults(cfg, tmp_path)
    assert any(expected in fault or expected in f"/{fault}" for fault in found), found


def test_all_faults_are_told_at_once(tmp_path):
    cfg = example("oaisys_current")
    for change, _ in (FAULTS[1], FAULTS[5], FAULTS[9]):
        change(cfg)
    assert len(faults(cfg, tmp_path)) == 3


@pytest.mark.slow
@pytest.mark.parametrize("value", [None, -1e300, "x", [[]], {"a": [1]}])
def test_any_value_in_any_place_is_a_fault_or_translated(value, tmp_path):
    cfg = example("oaisys_current")
    count = 0
    for owner, key in places(cfg):
        kept, owner[key] = owner[key], copy.deepcopy(value)
        lines: list[int] = []
        try:
            imported(cfg, tmp_path)
        except CfgError as error:
            lines = [fault.line for fault in error.faults]
        assert all(line > 0 for line in lines)
        owner[key] = kept
        count += 1
    assert count > 200


def places(value: Any) -> list[tuple[Any, Any]]:
    found = []
    for key, child in list(value.items() if isinstance(value, dict) else enumerate(value)):
        found.append((value, key))
        if isinstance(child, dict | list):
            found += places(child)
    return found


def test_unknown_keys_are_dropped_by_name_with_what_was_meant(tmp_path):
    cfg = example("oaisys_current")
    put([0.5], *_SKY, "DustDensty")(cfg)
    entry = next(e for e in imported(cfg, tmp_path).report.entries if "DustDensty" in e.pointer)
    assert (entry.fate, entry.value) == ("dropped", "[0.5]")
    assert 'did you mean "DustDensity"?' in entry.note


def test_dead_keys_are_named(tmp_path):
    told = {e.pointer: e.note for e in imported(example("oaisys_current"), tmp_path).report.entries}
    for end in ("defaultCfg", "baseMovement", "triggerInterval", "SunStrength", "imageTileX"):
        assert any(p.endswith(end) and "reads it nowhere" in note for p, note in told.items()), end


@pytest.mark.parametrize("noise", NOISES)
def test_every_preset_and_noise_of_the_landscape_generator_is_valid(noise, tmp_path):
    cfg = example("oaisys_current")
    number = list(NOISES).index(noise)
    given = {"noise_type": [noise], "strata_type": ["1"], "height_invert": [True]}
    # Each preset with its own noise, too.
    put(given if number >= len(PRESETS) else {}, *_STAGE, "landscapeParams")(cfg)
    put([*PRESETS, *PRESETS, *PRESETS][number], *_STAGE, "stageLandscapePreset")(cfg)
    write(imported(cfg, tmp_path))


_GENERAL = ("SENSOR_SETUP", "GENERAL")
_MESH = ("ASSET_SETUP", "MESHES", 0, "meshParams")
_HDRI = {
    "selectionOption": 2,
    "HDRIList": [{"filePath": "no.exr", "strength": [1], "labelIDVec": [500]}],
}
_BLEND = {"stageFilePath": "no.blend", "assetMaterial": "ground", "stageDisplacementActive": True,
          "stageDisplacementStrength": 2.0, "stageDisplacementMidLevel": 0.0}  # fmt: skip
OTHERS = [
    [put("randomEuclidean", *_GENERAL, "sensorMovementType"),
     put([0.5, 0, -1.0], *_GENERAL, "randomEuclideanEulerMin"),
     put([1.5, 0, 1.0], *_GENERAL, "randomEuclideanEulerMax")],
    [put("centeredTarget", *_GENERAL, "sensorMovementType"),
     put("rock1", *_GENERAL, "targetObject")],
    [put("deterministic", *_GENERAL, "sensorMovementType"),
     put("no.csv", *_GENERAL, "sensorMovementPose")],
    [put(False, *_GENERAL, "hoverBaseModeEnabled")],
    [put(False, *_GENERAL, "hoverTargetModeEnabled")],
    [put(False, *_GENERAL, "hoverBaseModeEnabled"),
     put(False, *_GENERAL, "hoverTargetModeEnabled")],
    [put("EnvHDRI", *_SKY[:-1], "type"), put(_HDRI, *_SKY)],
    [put([], *_SKY[:-2])],
    [put("BLEND", *_MESH, "densityMapSettings", "densityMap", "noiseType")],
    [put(True, *_MESH, "randomSwitchOnOff")],
    [put(1.0, *_MESH, "rotationOptionFactor")],
    [put("GLOB_Z", *_MESH, "rotationOptionMode")],
    [put("CUSTOM", *_MESH, "meshEmitter")],
    [put([], "ASSET_SETUP", "MESHES")],
    *[[put("StageBlenderObject", *_STAGE[:-1], "type"),
       put({**_BLEND, "stageDisplacementNoiseType": kind}, *_STAGE)]
      for kind in ("CLOUDS", "VORONOI", "BLEND", "MARBLE")],
    [put(0, "RENDER_SETUP", "RENDER_PASSES", 1, "passParams", "numIter")],
    [put("BLENDER_EEVEE", "RENDER_SETUP", "GENERAL", "renderEngine")],
    [put([], "RENDER_POST_PROCESSING_EFFECTS_SETUP", "POST_EFFECTS")],
    [put(1000, *_SKY, "stepInterval")],
    [put([0.5, 2.0], *_SKY, "SunIntensity")],
]  # fmt: skip


@pytest.mark.parametrize("changes", OTHERS)
def test_other_kinds_of_parts_are_valid_with_stand_ins(changes, tmp_path):
    cfg = example("oaisys_current")
    for change in changes:
        change(cfg)
    assert write(imported(cfg, tmp_path)) == []


def test_panoramas_of_different_labels_and_strengths_keep_their_labels(tmp_path):
    for name, level in (("dim.exr", 1.0), ("bright.exr", 5.0), ("third.exr", 2.0)):
        write_latlong(tmp_path / name, np.full((4, 8, 3), level))
    cfg = example("oaisys_current")
    entries = [
        {"filePath": "dim.exr", "strength": [1.0, 1.0], "labelIDVec": [100, 101]},
        {"filePath": "bright.exr", "strength": [5.0, 5.0], "labelIDVec": [200, 101]},
        {"filePath": "third.exr", "strength": [5.0, 5.0], "labelIDVec": [0, 301]},
    ]
    put("EnvHDRI", *_SKY[:-1], "type")(cfg)
    put({"selectionOption": 0, "HDRIList": entries}, *_SKY)(cfg)
    made = imported(cfg, tmp_path)
    write(made)
    levels = {level: {n: name for name, n in names.items()}
              for level, names in made.cfg["labels"].items()}  # fmt: skip
    sky = made.cfg["light"]["sky"]
    assert sky["labels"] == {"level_0": levels["level_0"][100], "level_1": levels["level_1"][101]}
    first, second, third = sky["label_maps"]
    assert first is None
    assert second.keys() == {"level_0"}
    assert second["level_0"]["values"] == {"#000000": levels["level_0"][200]}
    assert third["level_0"]["values"] == {"#000000": None}
    assert third["level_1"]["values"] == {"#000000": levels["level_1"][301]}
    with Image.open(tmp_path / second["level_0"]["file"]) as picture:
        assert (picture.size, picture.convert("RGB").getpixel((0, 0))) == ((1, 1), (0, 0, 0))
    # A cfg has one strength for all of them.
    said = [e for e in made.report.entries if e.pointer.endswith("/strength")]
    assert [e.fate for e in said] == ["approximated"] * 3
    assert "one range for all panoramas" in said[0].note


def test_no_parameter_of_the_landscape_generator_is_both_translated_and_dropped():
    both = set(USUAL) & set(WITHOUT_COUNTERPART)
    assert both == {"edge_falloff", "maximum", "minimum"}


def test_boxes_of_targets_keep_their_distribution():
    points = boxes.offsets((-3.0, -4.0, -2.0), (3.0, 4.0, -1.0))
    rng = np.random.default_rng(0)
    drawn = rng.uniform((-3.0, -4.0), (3.0, 4.0), (200_000, 2))
    found = boxes.distances(points)
    assert isinstance(found, dict)
    counts, _ = np.histogram(np.hypot(*drawn.T), bins=found["edges"])
    assert counts / counts.sum() == pytest.approx(
        np.array(found["weights"]) / sum(found["weights"]), abs=0.006
    )


def test_labels_are_named_for_what_has_them():
    labels = Labels(2)
    first = labels.choice([7, 1], "rock_01")
    second = labels.choice([7, 0], "rock_02")
    labels.choice([9, 1], "tree")
    assert labels.finish() == {"level_0": {"rock": 7, "tree": 9}, "level_1": {"id_1": 1}}
    assert first == {"level_0": "rock", "level_1": "id_1"}
    assert second == {"level_0": "rock"}


def test_rotations_go_to_angles_and_back():
    rng = np.random.default_rng(1)
    for q in [*rng.normal(size=(200, 4)), (1, 0, 0, 0), (0, 1, 0, 0), (0, 0, 1, 0), (0, 0, 0, 1)]:
        r = rotation_of(q)
        assert _of_turns(turns_of(r)) == pytest.approx(r, abs=1e-9)
    locked = _of_turns((20.0, 90.0, 50.0))
    assert _of_turns(turns_of(locked)) == pytest.approx(locked, abs=1e-7)


def _of_turns(degrees: tuple[float, ...]) -> np.ndarray:
    return from_euler((0.0, 0.0, 0.0), degrees)[:3, :3]


def test_nothing_is_written_where_something_is_wrong_or_there_already(tmp_path):
    out = tmp_path / "made" / "ours.json"
    out.parent.mkdir()
    words = ["import", "oaisys", str(DATA / "oaisys_current.json"), "-o", str(out)]
    assert main(words) == 2
    assert main([*words[:2], str(tmp_path / "none.json"), *words[3:]]) == 2
    assert main([*words[:-1], str(out.with_suffix(".txt")), "--stand-ins"]) == 2
    assert list(out.parent.iterdir()) == []
    out.write_text("mine")
    assert main([*words, "--stand-ins"]) == 2
    assert out.read_text() == "mine"
    out.rename(out.with_name("ours_files"))
    with pytest.raises(OutputError, match="is there already"):
        check_free(out)


def test_a_cfg_that_would_not_be_valid_leaves_nothing(tmp_path):
    made = imported(example("oaisys_current"), tmp_path)
    made.make("note.txt", Path.touch)
    made.cfg["samples"] = -1
    with pytest.raises(CfgError, match=r"ours\.json \(not written, .*\).*/samples"):
        write(made)
    assert sorted(path.name for path in tmp_path.iterdir()) == ["theirs.json"]


@pytest.mark.slow
def test_files_of_2021_are_read_and_the_scene_compiles(tmp_path):
    assets = tmp_path / "workspace"
    make_assets(assets)
    made = import_oaisys(DATA / "oaisys_2021.json", tmp_path / "ours.json", folders=[assets])
    assert write(made) == []
    cfg = made.cfg
    assert cfg["terrain"]["size_m"] == [12, 12]
    # Repeats across a stage of 12 m.
    assert cfg["materials"]["sand"]["maps"]["size_m"] == 1.5
    pebbles = cfg["materials"]["pebbles"]["maps"]
    assert pebbles["displacement_m"] == pytest.approx(0.1 * 0.2 * 2.0)
    assert pebbles["normal_convention"] == "directx"
    assert cfg["objects"]["stones"]["parts"] == {"moss": {"labels": {"level_0": "stones_moss"}}}
    assert cfg["labels"]["level_0"]["sky"] == 500
    track = read_track(tmp_path / "ours_files" / "track.csv")
    assert track.position_m.tolist() == [[0, -4, 2], [1, -4, 2]]
    assert track.quaternion[0] == pytest.approx([0.70710678, -0.70710678, 0, 0])
    out = tmp_path / "out"
    compile_cfg(load(tmp_path / "ours.json", ["batches=1"]), seed=0, out=out)
    scene = read_stage(out / "batch_0000" / "stage.usda")
    assert {camera.name for sample in scene.cameras for camera in sample} == {"base_cam"}
    # The hill's top is 1 m over the origin, give or take the displacement of 0.2 m and pebbles.
    down = Rays(np.array([[0.0, 0.0, 50.0]]), np.array([[0.0, 0.0, -1.0]]), (1, 1))
    _, _, distance = ExactCaster(scene).cast(down)
    assert 50.0 - distance[0] == pytest.approx(1.0, abs=0.3)


@pytest.mark.slow
def test_a_frame_of_a_translated_cfg_shows_what_it_labels(tmp_path):
    cfg, out = tmp_path / "ours.json", tmp_path / "out"
    words = ["import", "oaisys", str(DATA / "oaisys_current.json"), "-o", str(cfg)]
    assert main([*words, "--stand-ins", "--report", str(tmp_path / "report.txt")]) == 0
    run = ["run", str(cfg), "--set", "batches=1", "--set", "samples=1", "-o", str(out)]
    assert main([*run, "--backend", "mitsuba", "--spp", "4"]) == 0
    frame = read_exr(out / "batch_0000" / "frames" / "mitsuba" / "base_left" / "000000.exr")
    assert frame["rgb"].shape == (48, 64, 3)
    ids = set(np.unique(frame["label.level_0"]).tolist())
    assert 500 in ids
    assert ids <= {0, 10, 20, 40, 500}
