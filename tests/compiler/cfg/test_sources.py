"""What a cfg says in all, whatever it is written in and spread over."""

from __future__ import annotations

import copy
import json
from pathlib import Path

import pytest
import yaml
from hypothesis import given
from hypothesis import strategies as st
from small_cfg import DELETE, changed, minimal

from scenec.compiler.cfg.load import load
from scenec.compiler.cfg.sources import read
from scenec.compiler.compile import compile_cfg
from scenec.schemas.errors import CfgError, Fault
from scenec.schemas.files import tree

ROOT = Path(__file__).resolve().parents[3]
TRACK = "x_m,y_m\n-4,0\n4,0\n"


@pytest.fixture(scope="module")
def small_file(tmp_path_factory):
    return write(tmp_path_factory.mktemp("small") / "cfg.json", minimal())


def write(file: Path, value: object) -> Path:
    file.parent.mkdir(parents=True, exist_ok=True)
    file.write_text(value if isinstance(value, str) else json.dumps(value, indent=2))
    return file


def told(file: Path, *settings: str) -> list[str]:
    """The faults of a cfg as they are printed, without its folder."""
    with pytest.raises(CfgError) as caught:
        load(file, settings)
    return str(caught.value).replace(f"{file.parent}/", "").splitlines()


def stage_of(out: Path) -> dict[str, bytes]:
    """Every byte of the first batch."""
    batch = out / "batch_0000"
    return {path.as_posix(): (batch / path).read_bytes() for path in tree(batch)}


def jsonc(value: object) -> str:
    """The same with comments and trailing commas."""
    text = json.dumps(value, indent=2).replace("\n}", ",\n}").replace("\n]", ",\n]")
    return "// a cfg\n" + text.replace("{\n", "{ /* an object */\n", 1)


def with_sensor(**keys: object) -> dict:
    """A cfg's sensor, and nothing else of it."""
    return {"rigs": {"rover": {"sensors": {"front": keys}}}}


def test_an_object_is_replaced_whole(tmp_path):
    base = write(tmp_path / "base.json", minimal())
    name, rocks = next(iter(minimal()["objects"].items()))
    anew = {**rocks, "count": 3}
    base.write_text(json.dumps({**minimal(), "objects": {name: {**rocks, "embed": 0.3}}}))
    over = {"extends": "base.json", "objects": {name: anew}}
    merged = read(write(tmp_path / "over.json", over)).document.value["objects"][name]
    assert merged == {**anew, "embed": 0.3}
    over["replaces"] = [f"objects.{name}"]
    assert load(write(tmp_path / "over.json", over)).cfg["objects"][name]["count"] == 3
    joined = read(tmp_path / "over.json").document.value
    assert joined == {**minimal(), "objects": {**minimal()["objects"], name: anew}}


@pytest.mark.parametrize(
    ("replaces", "place", "expected"),
    [
        ("objects.rocks", "/replaces", "expected a list of paths, as in objects.rocks"),
        (["a b"], "/replaces/0", "expected a path, as in objects.rocks"),
        ([3], "/replaces/0", "expected a path, as in objects.rocks"),
        (["light.sum"], "/replaces/0", "the file it extends has no object 'sum' there; did you"),
        (["light.sun"], "/replaces/0", "this file has no object 'light' there"),
        (["samples"], "/replaces/0", "the file it extends has no object 'samples' there"),
    ],
)
def test_what_replaces_nothing_is_a_fault(tmp_path, replaces, place, expected):
    base = {**minimal(), "light": {"sun": {"elevation_deg": 30}}}
    write(tmp_path / "base.json", base)
    (fault,) = told(write(tmp_path / "o.json", {"extends": "base.json", "replaces": replaces}))
    assert f": {place}: " in fault, fault
    assert expected in fault.replace('"', "'"), fault
    (fault,) = told(write(tmp_path / "o.json", {**base, "replaces": ["light.sun"]}))
    assert "/replaces: expected the key extends beside it" in fault


def test_a_calibration_is_of_one_file(tmp_path):
    base = changed({"/rigs/rover/sensors/front/fov_deg": DELETE})
    sensor = base["rigs"]["rover"]["sensors"]["front"]
    sensor["lens"] = {"type": "brown_conrady", "k1": 0.2, "k2": 0.01, "k3": 0.3, "k6": 0.02}
    width, height = sensor["resolution"]
    k = {"fx": width, "fy": width, "cx": 0.5 * width, "cy": 0.5 * height}
    sensor["intrinsics"] = {**k, "skew": 0.5}
    write(tmp_path / "base.json", base)

    def extended(**keys: object) -> Path:
        return write(tmp_path / "over.json", {"extends": "base.json", **with_sensor(**keys)})

    lens = {"type": "brown_conrady", "k1": -0.171, "k2": 0.0245, "p1": 0.0005, "p2": -0.0003}
    (fault,) = told(extended(lens=lens))
    assert fault.startswith("over.json:7:19: ")
    assert "/rigs/rover/sensors/front/lens: k3, k6 would stay from base.json, another" in fault
    (fault,) = told(extended(intrinsics=k))
    assert "/rigs/rover/sensors/front/intrinsics: skew would stay from base.json" in fault
    # Whole, by null or by number; or single values, which are somebody's wish.
    whole = load(extended(lens={**lens, "k3": None, "k6": None})).cfg
    assert whole["rigs"]["rover"]["sensors"]["front"]["lens"] == {
        **lens, "k3": 0, "k4": 0, "k5": 0, "k6": 0,
    }  # fmt: skip
    load(extended(lens={**lens, "k3": 0.1, "k6": 0}, intrinsics={**k, "skew": 0}))
    assert load(extended(lens={"k1": 0.1}, intrinsics={"cx": k["cx"] + 1})).warnings == ()
    # Of several values, or another size, nobody knows: it is told.
    (told_of_lens,) = load(extended(lens={"k1": -0.171, "k2": 0.0245})).warnings
    assert "/rigs/rover/sensors/front/lens: k3, k6 stay from" in str(told_of_lens)
    (told_of_size,) = load(extended(resolution=[2 * width, 2 * height])).warnings
    assert "front/resolution: the intrinsics of" in str(told_of_size)
    at = "rigs.rover.sensors.front.lens"
    load(tmp_path / "base.json", [f"{at}.k1=0.1", f"{at}.type=brown_conrady"])
    other = {"type": "kannala_brandt", "k1": 0.01}
    kept = load(extended(lens=other)).cfg["rigs"]["rover"]["sensors"]["front"]["lens"]
    assert kept["k2"] == 0


def test_the_syntax_makes_no_difference_to_a_stage(tmp_path):
    cfg = changed({"/terrain/spacing_m": 1, "/objects": DELETE, "/materials/basalt": DELETE,
                   "/labels/class/rock": DELETE})  # fmt: skip
    files = {
        "json": write(tmp_path / "cfg.json", cfg),
        "jsonc": write(tmp_path / "cfg.jsonc", jsonc(cfg)),
        "yaml": write(tmp_path / "cfg.yaml", yaml.safe_dump(cfg, sort_keys=False)),
    }
    made = {}
    for name, file in files.items():
        compile_cfg(file, seed=3, out=tmp_path / name)
        made[name] = stage_of(tmp_path / name)
        assert json.loads((tmp_path / name / "cfg.json").read_text()) == cfg
    assert made["jsonc"] == made["json"]
    assert made["yaml"] == made["json"]


def test_the_cfg_of_an_output_is_the_files_own_bytes_where_these_are_all_of_it(tmp_path):
    file = write(tmp_path / "cfg.json", json.dumps(minimal(), indent=7))
    assert load(file).text == file.read_bytes()
    assert load(file).is_verbatim
    assert not load(file, ["samples=1"]).is_verbatim


def test_extending_is_as_the_merged_file(tmp_path):
    write(tmp_path / "base.json", minimal())
    write(tmp_path / "middle.yaml", "extends: base.json\nterrain: {spacing_m: 0.25}\n")
    over = {
        "$schema": "x",
        "extends": "middle.yaml",
        "name": "over",
        "terrain": {"relief": [{"type": "plane", "slope": [0.1, 0]}]},
        "objects": {"rocks": {"count": None, "per_m2": 0.1}},
        "light": {"sun": None},
    }
    merged = minimal()
    merged["name"] = "over"
    merged["terrain"] |= {"spacing_m": 0.25, "relief": [{"type": "plane", "slope": [0.1, 0]}]}
    del merged["objects"]["rocks"]["count"]
    merged["objects"]["rocks"]["per_m2"] = 0.1
    merged["light"]["sun"] = None
    spec = load(write(tmp_path / "over.json", over))
    assert json.loads(spec.text) == merged
    assert spec.digest == load(write(tmp_path / "merged.json", merged)).digest
    # What an output keeps says the same alone.
    assert spec.digest == load(write(tmp_path / "alone.json", spec.text.decode())).digest


def test_an_object_of_another_type_is_another_object(tmp_path):
    sky = {"type": "atmosphere", "planet": "mars"}
    write(tmp_path / "base.json", changed({"/light/sky": sky, "/labels/class/sky": DELETE}))
    over = {"extends": "base.json", "light": {"sky": {"type": "none"}}}
    assert load(write(tmp_path / "over.json", over)).cfg["light"]["sky"]["type"] == "none"


def test_faults_name_the_file_and_line_that_a_value_came_from(tmp_path):
    write(tmp_path / "base.json", changed({"/samples": 0, "/terrain/spacing_m": -1}))
    over = '{\n "extends": "base.json",\n "samples": 3,\n "batches": 0,\n "light": {"sum": 1}}'
    base = (tmp_path / "base.json").read_text().splitlines()
    line = 1 + next(i for i, text in enumerate(base) if '"spacing_m"' in text)
    assert told(write(tmp_path / "over.json", over)) == [
        f"base.json:{line}:18: /terrain/spacing_m: -1: expected more than 0 m",
        "over.json:4:13: /batches: 0: expected at least 1",
        'over.json:5:12: /light/sum: unknown key "sum"; did you mean "sun"?',
    ]


def test_a_base_that_cannot_be_had_is_a_fault_where_it_is_named(tmp_path):
    write(tmp_path / "a.json", '{"extends": "b.json"}')
    write(tmp_path / "b.json", '{"extends": "sub/../a.json"}')
    (tmp_path / "sub").mkdir()
    ((where, _, message),) = (text.split(": ", 2) for text in told(tmp_path / "a.json"))
    assert where == "b.json:1:13"
    assert message == "a cfg cannot extend itself: a.json extends b.json extends a.json"
    cases = {
        '"c.json"': "did you mean",
        '"package:configs/mars_yrd"': "no file",
        '"package:configs/../x.json"': "plain path below the package",
        "3": "expected a string",
        '"."': "is a folder",
    }
    for reference, part in cases.items():
        (fault,) = told(write(tmp_path / "c_.json", f'{{"extends": {reference}}}'))
        assert fault.startswith("c_.json:1:13: /extends: "), fault
        assert part in fault
    write(tmp_path / "list.json", "[1]")
    (fault,) = told(write(tmp_path / "d.json", '{"extends": "list.json"}'))
    assert fault == "list.json:1:1: /: [1]: expected an object"
    write(tmp_path / "broken.yaml", "a: [1")
    (fault,) = told(write(tmp_path / "d.json", '{"extends": "broken.yaml"}'))
    assert fault.startswith("broken.yaml:1:6: /: not YAML")


def test_files_that_a_base_names_lie_beside_the_base(tmp_path):
    write(tmp_path / "far" / "track.csv", TRACK)
    tracks = [{"type": "plane"}, {"type": "tracks", "file": "track.csv"}]
    base = write(tmp_path / "far" / "base.json", changed({"/terrain/relief": tracks}))
    over = write(tmp_path / "near" / "over.json", {"extends": "../far/base.json"})
    spec = load(over)
    assert spec.cfg["terrain"]["relief"][1]["file"] == "../far/track.csv"
    key = "terrain/relief/1/file"
    assert spec.files[key].sha256 == load(base).files[key].sha256
    # One of its own lies beside itself.
    write(tmp_path / "near" / "track.csv", TRACK)
    own = {"extends": "../far/base.json", "terrain": {"relief": tracks}}
    assert load(write(over, own)).cfg["terrain"]["relief"][1]["file"] == "track.csv"


def test_what_ships_can_be_extended_from_anywhere(tmp_path):
    over = write(tmp_path / "over.json", {"extends": "package:configs/mars_yard", "samples": 2})
    spec = load(over)
    assert spec.cfg["samples"] == 2
    references = {file.reference for file in spec.files.values()}
    assert "package:assets/mars_yard_track.csv" in references
    assert all(reference.startswith("package:") for reference in references)
    shipped = load("package:configs/mars_yard")
    assert shipped.digest == load(ROOT / "configs" / "mars_yard.json").digest
    with pytest.raises(CfgError, match="no file"):
        load("package:configs/mars_yrd")


SETTINGS = {
    "samples=3": {"/samples": 3},
    "terrain.size_m[1]=12": {"/terrain/size_m/1": 12},
    "terrain.size_m.1=12": {"/terrain/size_m/1": 12},
    "terrain.relief[0].slope=[0.1, 0]": {"/terrain/relief/0/slope": [0.1, 0]},
    "terrain.relief.plane.height_m=0.1": {"/terrain/relief/0/height_m": 0.1},
    "terrain.ground.sand.labels={}": {"/terrain/ground/0/labels": {}, "/labels": {"class": {
        "rock": 2, "sky": 3}}},
    "rigs.rover.sensors.front.fov_deg=70": {"/rigs/rover/sensors/front/fov_deg": 70},
    "light.sun.elevation_deg=20": {"/light/sun": {"elevation_deg": 20}},
    "light.sun=null": {"/light/sun": None},
    "light.sky.type=none": {"/light/sky/type": "none"},
    "objects.rocks.labels=null": {"/objects/rocks/labels": DELETE, "/labels": {"class": {
        "ground": 1, "sky": 3}}},
    'objects.rocks.size_m={"type": "uniform", "min": 0.1, "max": 0.2}': {
        "/objects/rocks/size_m": {"type": "uniform", "min": 0.1, "max": 0.2}
    },
    "description=12": {"/description": "12"},
    "objects.rocks.orientation=upright": {"/objects/rocks/orientation": "upright"},
    "rigs.rover.sensors.front.exposure.per=batch": {
        "/rigs/rover/sensors/front/exposure": {"type": "auto", "per": "batch"}
    },
}  # fmt: skip


@pytest.mark.parametrize("setting", SETTINGS)
def test_a_setting_is_as_the_edited_file(tmp_path, setting):
    edits = SETTINGS[setting]
    base = minimal()
    if "/labels" in edits:
        # Both without the label that nothing uses then.
        base["labels"] = copy.deepcopy(edits["/labels"])
    spec = load(write(tmp_path / "cfg.json", base), [setting])
    assert spec.digest == load(write(tmp_path / "edited.json", changed(edits))).digest
    assert spec.settings == (setting,)


@pytest.mark.parametrize(
    ("setting", "where", "part"),
    [
        ("terrain.spacing_m=0", "/terrain/spacing_m", "0: expected more than 0 m"),
        ("terrain.spacin_m=1", "/terrain/spacin_m", 'did you mean "spacing_m"?'),
        ("terain.spacing_m=1", "/terain", 'no key "terain"; did you mean "terrain"?'),
        ("rigs.rovr.pose={}", "/rigs/rovr", 'did you mean "rover"?'),
        ("objects.rokcs=null", "/objects/rokcs", 'to take away; did you mean "rocks"?'),
        ("terrain.relief[3].slope=1", "/terrain/relief/3", "an index from 0 to 0"),
        ("terrain.relief.plan.slope=1", "/terrain/relief/plan", 'did you mean "plane"?'),
        ("name.x=1", "/name", "expected an object or a list"),
        ("samples=many", "/samples", '"many": expected a whole number'),
        ("samples=[1,", "/", "expected a value"),
        ("samples", "/", "expected path=value"),
        ("extends=x.json", "/extends", "stands in its file"),
        ("=3", "/", "expected path=value"),
        ("a..b=3", "/", "expected path=value"),
        ("rigs.rover.pose={}", "/rigs/rover/pose", '"type" is missing'),
    ],
)
def test_a_faulty_setting_is_told_as_it_was_given(tmp_path, setting, where, part):
    (fault,) = told(write(tmp_path / "cfg.json", minimal()), setting)
    assert fault.startswith(f"--set {setting}: {where}: ")
    assert part in fault


_KEYS = "terrain spacing_m relief 0 ground labels objects rocks size_m light sun sky type x"
_WORDS = st.sampled_from(_KEYS.split())
_PATHS = st.lists(_WORDS, min_size=1, max_size=5).map(".".join) | st.text(".[]0ax=", max_size=6)
_VALUES = st.sampled_from(
    ["null", "1", "x", "{}", "[]", "[1", '{"type": "none"}', "true", "1e400", "", "\ud800", "//"]
)


@given(st.lists(st.tuples(_PATHS, _VALUES).map("=".join), min_size=1, max_size=4))
def test_whatever_is_set_is_read_or_told(small_file, settings):
    faults: tuple[Fault, ...] = ()
    try:
        source = read(small_file, settings)
    except CfgError as error:
        faults = error.faults
    else:
        assert json.loads(source.text) == source.document.value
    assert all("\n" not in str(fault) for fault in faults)


_TREES = st.recursive(
    st.sampled_from([None, 1, "x"]),
    lambda below: st.dictionaries(st.sampled_from(["type", "a", "light", "sun"]), below),
    max_leaves=8,
)


def merged(base, over):
    """JSON Merge Patch (RFC 7396), but that another type replaces."""
    if not isinstance(over, dict):
        return over
    result = dict(base) if isinstance(base, dict) else {}
    if result.get("type", over.get("type")) != over.get("type", result.get("type")):
        result = {}
    for key, value in over.items():
        if value is None:
            result.pop(key, None)
        else:
            result[key] = merged(result.get(key), value)
    return result


def without_null(value):
    if not isinstance(value, dict):
        return value
    return {key: without_null(entry) for key, entry in value.items() if entry is not None}


@given(st.dictionaries(st.sampled_from(["a", "b"]), _TREES), _TREES)
def test_extending_is_merging_as_json_merge_patch_does(small_file, base, over):
    base = without_null(base)
    file = small_file.with_name("over.json")
    write(small_file.with_name("under.json"), base)
    write(file, {"extends": "under.json", "a": over})
    # Null that takes nothing away stays, to be told; and so does an object of nulls.
    got = without_null(read(file).document.value)
    assert got == without_null(merged(base, {"a": over}))


def test_settings_are_in_the_manifest_and_the_cfg_of_the_output(tmp_path):
    cfg = changed({"/terrain/spacing_m": 1, "/objects": DELETE, "/materials/basalt": DELETE,
                   "/labels/class/rock": DELETE})  # fmt: skip
    file = write(tmp_path / "cfg.json", cfg)
    spec = load(file, ["terrain.spacing_m=2"])
    compile_cfg(spec, seed=1, out=tmp_path / "set")
    manifest = json.loads((tmp_path / "set" / "manifest.json").read_text())
    assert manifest["cfg"]["settings"] == ["terrain.spacing_m=2"]
    cfg["terrain"]["spacing_m"] = 2
    compile_cfg(write(tmp_path / "edited.json", cfg), seed=1, out=tmp_path / "edited")
    assert stage_of(tmp_path / "set") == stage_of(tmp_path / "edited")
    assert load(tmp_path / "set" / "cfg.json").digest == spec.digest
