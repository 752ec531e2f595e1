"""Packages that add to scenec: the example of docs/plugins.md, installed, and broken ones."""

from __future__ import annotations

import copy
import json
import os
import re
import shutil
import subprocess
import sys
from pathlib import Path
from typing import Any

import declared_kinds
import numpy as np
import pytest
from jsonschema import Draft202012Validator

from scenec.backends.imaging.effects import apply
from scenec.compiler.build import BuildLog, build
from scenec.compiler.cfg.load import load
from scenec.compiler.draw import draw
from scenec.compiler.kinds import schema
from scenec.compiler.kinds.generate import with_forms
from scenec.compiler.light.build import build_light
from scenec.compiler.terrain.grid import Grid
from scenec.schemas import plugins
from scenec.schemas.errors import BackendError, CfgError, ScenecError
from scenec.schemas.frames import read_frame
from scenec.testing.small import small_cfg

EXAMPLE = Path(__file__).resolve().parents[2] / "docs" / "example_plugins"

RELIEF = [
    {"type": "plane"},
    {
        "type": "furrows",
        "depth_m": {"type": "uniform", "min": 0.1, "max": 0.2},
        "spacing_m": 1.0,
        "mask": [{"type": "point", "x_m": 0, "y_m": 0, "max_m": 5}],
    },
]


def cfg() -> dict[str, Any]:
    """A small scene with all that the package adds."""
    bare = {"type": "aspect", "bearing_deg": 90, "max_deg": 60}
    return {
        "version": 1, "name": "farm", "samples": 2, "outputs": ["rgb", "label", "steepness"],
        "labels": {"class": {"soil": 1, "clod": 2}},
        "terrain": {
            "size_m": [16, 16], "spacing_m": 0.1, "relief": copy.deepcopy(RELIEF),
            "ground": [
                {"material": "soil", "labels": {"class": "soil"}},
                {"material": "stubble", "labels": {"class": "soil"}, "where": [bare]},
            ],
        },
        "materials": {
            "soil": {"base_color": [0.2, 0.15, 0.1]},
            "stubble": {
                "base_color": [0.3, 0.25, 0.12],
                "maps": {"procedural": {"type": "stubble", "resolution": 64}},
            },
        },
        "objects": {
            "clods": {
                "type": "rocks", "family": "clod", "crumble": 0.5, "subdivisions": 2, "count": 50,
                "size_m": 0.3, "material": "soil", "labels": {"class": "clod"},
                "density": {"type": "rows", "spacing_m": 2, "width_m": 0.2},
            },
        },
        "light": {
            "sun": {"elevation_deg": 30, "azimuth_deg": 90},
            "sky": {"type": "dusk", "bearing_deg": {"type": "choice", "values": [90, 180]}},
        },
        "rigs": {
            "drone": {
                "pose": {"type": "spiral", "radius_m": 6},
                "sensors": {
                    "eye": {
                        "resolution": [32, 24], "fov_deg": 60,
                        "effects": [{"type": "banding", "strength": 20}],
                    },
                },
            },
        },
    }  # fmt: skip


@pytest.fixture(scope="module")
def site(tmp_path_factory):
    """The package, installed by pip."""
    folder = tmp_path_factory.mktemp("site")
    source = shutil.copytree(EXAMPLE, folder / "source")
    command = [sys.executable, "-m", "pip", "install", "-q", "--no-deps", "--no-build-isolation"]
    command += ["--no-index", "--disable-pip-version-check", "--target", folder / "at", source]
    subprocess.run(command, check=True)
    return folder / "at"


@pytest.fixture
def there(site, monkeypatch):
    """The package, importable here."""
    monkeypatch.syspath_prepend(str(site))
    return site


def scenec(site: Path | None, *arguments: str | Path) -> subprocess.CompletedProcess[str]:
    """The command line, with or without the package."""
    env = os.environ | ({"PYTHONPATH": str(site)} if site else {})
    command = [sys.executable, "-m", "scenec.cli.main", *map(str, arguments)]
    return subprocess.run(command, env=env, capture_output=True, text=True)


def written(folder: Path, document: dict[str, Any]) -> Path:
    """A cfg's file."""
    path = folder / "farm.json"
    path.write_text(json.dumps(document, indent=1))
    return path


def faults(folder: Path, document: dict[str, Any]) -> dict[str, str]:
    """What is wrong with a cfg: message by pointer."""
    with pytest.raises(CfgError) as info:
        load(written(folder, document))
    return {fault.pointer: fault.message for fault in info.value.faults}


def odd_cfg() -> dict[str, Any]:
    """A cfg that names a relief operator which is called odd."""
    document = cfg()
    document["terrain"]["relief"] = [{"type": "plane"}, {"type": "odd"}]
    return document


def test_a_scene_of_all_kinds_compiles_renders_and_repeats(site, tmp_path):
    document = cfg()
    document["rigs"]["drone"]["lidars"] = {"scanner": {"pattern": {"type": "rosette"}}}
    document["outputs"].append("instance")
    path = written(tmp_path, document)
    outs = [tmp_path / "a", tmp_path / "b"]
    for out in outs:
        done = scenec(site, "compile", path, "--seed", "3", "-o", out)
        assert done.returncode == 0, done.stderr
    made = [json.loads((out / "manifest.json").read_text()) for out in outs]
    assert made[0]["files"] == made[1]["files"]
    assert len(made[0]["plugins"]) == 9
    (package,) = set(made[0]["plugins"].values())
    assert package.startswith("scenec-farmland 1.0 (code ")
    done = scenec(site, "render", outs[0], "--backend", "pyrender", "--spp", "4")
    assert done.returncode == 0, done.stderr
    stem = outs[0] / "batch_0000/frames/pyrender/drone_eye/000001"
    frame = read_frame(stem.with_suffix(".json"), ["rgb", "label.class", "steepness"])
    steep = frame.passes["steepness"]
    # Furrows of 0.1 to 0.2 m every meter rise at 17 to 32 degrees; clods stand on some.
    ground = frame.passes["label.class"] == 1
    assert 10.0 < np.nanmax(steep[ground]) < 40.0
    assert (frame.passes["label.class"] == 2).any()
    sidecar = json.loads(stem.with_suffix(".json").read_text())
    assert sidecar["effects"][0]["from"] == package
    done = scenec(site, "render", outs[0], "--backend", "embree", "--spp", "1")
    assert done.returncode == 0, done.stderr
    assert "warning: embree draws no maps" in done.stderr
    done = scenec(site, "check", outs[0], "--backends", "embree")
    assert done.returncode == 0, done.stdout + done.stderr
    dataset = tmp_path / "boxes"
    done = scenec(site, "export", outs[0], "--format", "farmland_boxes", "-o", dataset)
    assert done.returncode == 0, done.stderr
    names = (dataset / "classes.txt").read_text().splitlines()
    (file,) = dataset.glob("boxes/*/*drone_eye_000001.txt")
    boxes = [line.split() for line in file.read_text().splitlines()]
    # Of the pixels themselves: each instance's box, and its class.
    height, width = frame.passes["label.class"].shape
    ids = read_frame(stem.with_suffix(".json"), ["instance"]).passes["instance"]
    expected = []
    for number in np.unique(ids[ids > 0]):
        row, column = np.nonzero(ids == number)
        (label,) = np.unique(frame.passes["label.class"][row, column])
        x, y = (0.5 * (at.min() + at.max() + 1) for at in (column, row))
        wide, high = (np.ptp(at) + 1 for at in (column, row))
        shares = x / width, y / height, wide / width, high / height
        kind = names.index(frame.sidecar.labels["class"][str(label)])
        expected.append([str(kind), *(f"{share:.6f}" for share in shares)])
    assert len(boxes) > 3
    assert boxes == expected


def test_effects_repeat_and_are_of_the_version_that_was_compiled(there):
    package = plugins.origin("scenec.effects", "banding")
    effect = {"type": "banding", "from": package, "key": 5, "strength": 20.0}
    picture = np.full((8, 4, 3), 100, np.uint8)
    one, again, other = (apply(picture, [json.dumps(effect)], sample) for sample in (0, 0, 1))
    assert (one == again).all()
    assert (one != other).any()
    # Rows as a whole, by some 20 codes; what came in stays as it was.
    assert (one == one[:, :1, :1]).all()
    assert 5.0 < one[:, 0, 0].std() < 50.0
    assert (picture == 100).all()
    older = json.dumps(effect | {"from": "scenec-farmland 0.9"})
    with pytest.raises(
        BackendError, match=r"of scenec-farmland 0\.9, and scenec-farmland 1\.0 \(c"
    ):
        apply(picture, [older], 0)


def test_masks_and_distributions_reach_another_packages_operator(there, tmp_path):
    masked = draw(load(written(tmp_path, cfg())), 3, 0).terrain.relief[1]
    grid = Grid.with_spacing((16.0, 16.0), 0.1)
    height, _ = masked.apply(grid, np.zeros(grid.shape))
    x, y = grid.points()
    away = np.hypot(x, y).reshape(grid.shape)
    assert (height[away > 5.01] == 0.0).all()
    depth = masked.operator.depth_m
    assert 0.1 <= depth <= 0.2
    assert np.abs(height).max() == pytest.approx(0.5 * depth, rel=1e-3)


def test_a_sky_of_another_package_is_built_at_every_sample(there, tmp_path):
    document = cfg()
    document["labels"]["class"]["glow"] = 3
    document["light"]["sky"] = {
        "type": "dusk",
        "irradiance": {"type": "uniform", "min": 2, "max": 6},
        "labels": {"class": "glow"},
    }
    plan = draw(load(written(tmp_path, document)), 3, 0)
    assert plan.sky_labels == {"class": 3}
    light = build_light(plan.light, 2, True, True)
    assert light.sky is not None
    assert light.sky.rotation_deg.tolist() == [270.0, 270.0]
    # Luminance on level ground is what is drawn, once a sample; the sun comes on top of it.
    assert light.sun is not None
    of_sun = 0.5 * light.sun.irradiance
    of_sky = light.irradiance - of_sun
    assert of_sky[0] != of_sky[1]
    assert ((of_sky > 2.0) & (of_sky < 6.0)).all()
    document["light"]["clouds"] = {}
    assert "clouds need a sky" in faults(tmp_path, document)["/light/clouds"]


def test_clouds_of_another_package_dim_the_sun_before_ours(there, tmp_path):
    document = cfg()
    document["light"]["sky"] = {"type": "clear", "resolution": 8}
    veil = {"type": "veil", "optical_depth": {"type": "choice", "values": [0.2, 0.4]}}
    document["light"]["clouds"] = {"more": [veil, {"type": "veil"}], "resolution": 8}
    spec = load(written(tmp_path, document))
    assert set(spec.plugins) >= {"scenec.clouds veil"}
    plan = draw(spec, 5, 0).light
    light = build_light(plan, 2, True, False)
    assert light.sun is not None
    # The sun is 30 degrees high: the way through a layer is twice its depth.
    depth = plan.clouds.more[0].optical_depth
    assert set(depth) <= {0.2, 0.4}
    assert light.sun.irradiance == pytest.approx(1000.0 * np.exp(-2.0 * (depth + 0.3)))
    assert light.facts["clouds"]["more"][1]["left"] == pytest.approx([np.exp(-0.6)] * 2)
    document["light"]["clouds"]["more"] = [{"type": "vail"}]
    assert 'did you mean "veil"' in faults(tmp_path, document)["/light/clouds/more/0/type"]


def test_keys_of_another_package_are_checked_like_our_own(there, tmp_path):
    document = cfg()
    document["terrain"]["relief"][1] = {"type": "furrows", "deph_m": 0.1, "spacing_m": -1}
    document["rigs"]["drone"]["pose"]["type"] = "spirale"
    found = faults(tmp_path, document)
    assert 'the key "depth_m" is missing (From crest to bottom)' in found["/terrain/relief/1"]
    assert 'did you mean "depth_m"' in found["/terrain/relief/1/deph_m"]
    assert "expected more than 0 m" in found["/terrain/relief/1/spacing_m"]
    assert 'did you mean "spiral"?' in found["/rigs/drone/pose/type"]


def test_kinds_of_packages_that_are_there_are_listed(there, tmp_path):
    document = cfg()
    document["terrain"]["relief"][1]["type"] = "volcano"
    told = faults(tmp_path, document)["/terrain/relief/1/type"]
    assert told.endswith("of installed ones furrows (scenec doctor)")
    (names,) = plugins.installed().values()
    assert {"relief operator furrows", "pose spiral", "effect banding"} <= set(names)


def test_without_the_package_its_names_are_told(tmp_path):
    found = faults(tmp_path, cfg())
    told = found["/terrain/relief/1/type"]
    assert "expected one of plane, dem" in told
    assert "others come from plug-ins, of installed ones none (scenec doctor)" in told
    effect = "/rigs/drone/sensors/eye/effects/0/type"
    assert found[effect].endswith("expected a name that an installed package offers, and none does")


@pytest.mark.parametrize(
    ("source", "told"),
    [
        ("1 / 0", "cannot be imported: ZeroDivisionError: division by zero (odd.py, line 1)"),
        ("@dataclass\nclass Odd:\n  a: int", "a JSON Schema of its keys, or one whose fields are"),
        ("@dataclass\nclass Odd:\n  a: int = key(forms.COUNT, most=3)", "unexpected keyword"),
        (
            "@dataclass\nclass Odd:\n  a: 'Kind' = key(forms.CHOICE)\n  apply = max",
            "keys: name 'Kind' is not defined",
        ),
        (
            "@dataclass\nclass Odd:\n  a: int = key(forms.COUNT, default=1)",
            "a method apply(grid, height)",
        ),
        (
            "@dataclass\nclass Odd:\n  def apply(self, grid):\n    return grid, {}",
            "a method apply(grid, height)",
        ),
        (
            "@dataclass\nclass Odd:\n  apply = max\n  def check(self, node):\n    return []",
            "expected a static method check(node)",
        ),
        (
            "@dataclass\nclass Odd:\n  a: dict = key(forms.an('od'), default={})\n  apply = max",
            "$defs/od'",
        ),
        ("Odd = 3", "expected a dataclass with a SCHEMA, a JSON Schema of its keys"),
        ("class Odd:\n  SCHEMA = {}", "expected a dataclass with a SCHEMA"),
        ("SCHEMA = []", "expected a dataclass with a SCHEMA"),
        ("SCHEMA = {'properties': {'b': {}}}", 'the class has no field "b"'),
        ("SCHEMA = {'properties': {'a': {'type': 'nmber'}}}", "SCHEMA: 'nmber' is not valid"),
        (
            "SCHEMA = {'properties': {'a': {'$ref': 'forms.schema.json#/$defs/lenght'}}}",
            "SCHEMA: there is no 'lenght'",
        ),
    ],
)
def test_a_broken_package_is_named_at_its_place_in_the_cfg(source, told, tmp_path, monkeypatch):
    if source.startswith("SCHEMA"):
        source = (
            "from dataclasses import dataclass\nfrom typing import ClassVar\n@dataclass\n"
            f"class Odd:\n  a: int\n  SCHEMA: ClassVar = {source.partition(' = ')[2]}\n"
            "  def apply(self, grid, height): ...\n"
        )
    elif source.startswith("@"):
        source = (
            "from dataclasses import dataclass\nfrom scenec.compiler.kinds import forms\n"
            f"from scenec.compiler.kinds.declare import key\n{source}\n"
        )
    offer(source, tmp_path, monkeypatch)
    found = faults(tmp_path, odd_cfg())
    assert told in found["/terrain/relief/1"]
    assert found["/terrain/relief/1"].startswith("relief operator")


def offer(source: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, *points: str) -> None:
    """A package, importable here, whose one module is called odd."""
    info = tmp_path / "site" / "odd-1.0.dist-info"
    info.mkdir(parents=True)
    (info / "METADATA").write_text("Metadata-Version: 2.1\nName: odd\nVersion: 1.0\n")
    lines = points or ("[scenec.relief]", "odd = odd:Odd")
    (info / "entry_points.txt").write_text("\n".join(lines))
    (tmp_path / "site" / "odd.py").write_text(source)
    monkeypatch.syspath_prepend(str(tmp_path / "site"))
    monkeypatch.delitem(sys.modules, "odd", raising=False)
    for found in (plugins.load_kind, schema.kind_schema):
        found.cache_clear()


OPERATOR = """
from dataclasses import dataclass
from scenec.compiler.kinds import forms
from scenec.compiler.kinds.declare import key

@dataclass(frozen=True, kw_only=True)
class Odd:
    a: float = key(forms.CONSTANT, default=1)
    def apply(self, grid, height):
        return height, {}
"""


@pytest.mark.parametrize(
    ("body", "told"),
    [
        ("raise KeyError('soil')", "plug-in odd: KeyError: 'soil' (odd.py, line 13)"),
        ("return 1 / 0", "plug-in odd: ZeroDivisionError: division by zero (odd.py, line 13)"),
        ("yield 'wrong'", "check gave 'wrong': expected what node.fault returns"),
        ("return True", "check gave True: expected what node.fault returns"),
        ("return [node.fault(f'{node.span(\"a\")}')]", "(1.0, 1.0)"),
    ],
)
def test_a_check_that_fails_is_a_fault_at_its_place(body, told, tmp_path, monkeypatch):
    check = f"    @staticmethod\n    def check(node):\n        {body}\n"
    offer(OPERATOR + check, tmp_path, monkeypatch)
    found = faults(tmp_path, odd_cfg())
    assert found["/terrain/relief/1"].endswith(told)


def test_a_finding_on_a_key_that_is_left_out_stands_where_its_object_does(tmp_path, monkeypatch):
    check = "    @staticmethod\n    def check(node):\n        yield node.fault('odd', 'a')\n"
    offer(OPERATOR + check, tmp_path, monkeypatch)
    path = written(tmp_path, odd_cfg())
    with pytest.raises(CfgError) as info:
        load(path)
    (fault,) = [fault for fault in info.value.faults if fault.message == "odd"]
    line = path.read_text().splitlines().index('    "type": "odd"')
    assert (fault.line, fault.pointer) == (line, "/terrain/relief/1/a")


@pytest.mark.parametrize("made", ["None", "3"])
def test_what_an_operator_draws_is_held_against_its_group(made, tmp_path, monkeypatch):
    drawn = f"    def draw(self, context):\n        return {made}\n"
    offer(OPERATOR + drawn, tmp_path, monkeypatch)
    spec = load(written(tmp_path, small_cfg()), ['terrain.relief.1={"type": "odd"}'])
    told = (
        rf'^relief operator "odd" \(odd:Odd of odd\): draw returned {made}: expected a method apply'
    )
    with pytest.raises(ScenecError, match=told):
        draw(spec, 3, 0)


def test_what_does_not_derive_from_its_groups_class_is_told_so(tmp_path, monkeypatch):
    groups = ("conditions", "densities", "surfaces", "skies", "rocks")
    points = [line for of in groups for line in (f"[scenec.{of}]", "odd = odd:Odd")]
    offer(OPERATOR, tmp_path, monkeypatch, *points)
    for group, base in zip(groups, ("Quantity", "Density", "Surface", "Sky", "Shape"), strict=True):
        with pytest.raises(
            ScenecError, match=rf"odd:Odd of odd\): expected a subclass .*\.{base}$"
        ):
            schema.kind_schema(f"scenec.{group}", "odd")


@pytest.mark.parametrize(
    ("group", "kind", "told"),
    [
        ("poses", "Odd:\n    def built(self, context): ...", "an attribute needs_objects"),
        ("poses", "Odd:\n    needs_objects = False", "a method built(context)"),
        ("effects", "Odd:\n    def apply(self, picture): ...", "a method apply(picture, random)"),
        ("surfaces", "Odd(Surface):\n    def paint(self, tile): ...", "an attribute SIZE_M"),
        ("skies", "Odd(Sky):\n    def build(self, sun): ...", "a method build(sun, samples)"),
        ("densities", "Odd(Everywhere):\n    def on(self, a, b): ...", "a method at(x, y)"),
        ("scans", "Odd(ScanPattern):\n    def rays(self, n): ...", "a method rays()"),
    ],
)
def test_what_a_kind_lacks_of_its_group_is_told(group, kind, told, tmp_path, monkeypatch):
    source = (
        "from dataclasses import dataclass\n"
        "from scenec.compiler.cameras.ranging import ScanPattern\n"
        "from scenec.compiler.light.sky import Sky\n"
        "from scenec.compiler.materials.surface import Surface\n"
        "from scenec.compiler.objects.density import Everywhere\n\n"
        f"@dataclass(frozen=True, kw_only=True)\nclass {kind}\n"
    )
    offer(source, tmp_path, monkeypatch, f"[scenec.{group}]", "odd = odd:Odd")
    with pytest.raises(ScenecError, match=rf"odd:Odd of odd\): expected {re.escape(told)}$"):
        schema.kind_schema(f"scenec.{group}", "odd")


def test_a_name_of_scenecs_own_that_a_package_offers_too_is_an_error(tmp_path, monkeypatch):
    offer(OPERATOR, tmp_path, monkeypatch, "[scenec.relief]", "smooth = odd:Odd")
    assert list(faults(tmp_path, small_cfg()).values()) == [
        'several packages offer the relief operator "smooth": scenec, odd:Odd of odd; remove one'
    ]
    del (document := small_cfg())["terrain"]["relief"][2]
    assert load(written(tmp_path, document)).plugins == {}


# Kinds that declare their keys -------------------------------------------------------------------


@pytest.fixture
def declared(tmp_path, monkeypatch):
    """A package whose kinds declare their keys, installed, and a cfg that names all of them."""
    info = tmp_path / "site" / "declared-1.0.dist-info"
    info.mkdir(parents=True)
    (info / "METADATA").write_text("Metadata-Version: 2.1\nName: declared\nVersion: 1.0\n")
    lines = [
        f"[scenec.{group}]\n{name} = declared_kinds:{kind.__name__}\n"
        for group, (name, kind) in declared_kinds.GROUPS.items()
    ]
    lines.append("[scenec.skies]\nbare = declared_kinds:BareSky\n")
    lines.append("[scenec.densities]\nwest = declared_kinds:West\n")
    (info / "entry_points.txt").write_text("\n".join(lines))
    monkeypatch.syspath_prepend(str(tmp_path / "site"))
    document = cfg()
    document["outputs"] = ["rgb", "label"]
    terrain, eye = document["terrain"], document["rigs"]["drone"]["sensors"]["eye"]
    uniform = {"type": "uniform", "min": 0.5, "max": 1}
    mask = [{"type": "east", "min_m": -2, "scale": 2}]
    terrain["relief"] = [{"type": "plane"}, {"type": "lift", "low_m": uniform, "mask": mask}]
    terrain["ground"][1]["where"] = [{"type": "east", "max_m": 0, "softness_m": 1}]
    document["materials"]["stubble"]["maps"]["procedural"] = {"type": "plain", "resolution": 64}
    clods = document["objects"]["clods"]
    clods |= {"family": "ball", "dents": uniform | {"max": 0.6}, "density": {"type": "half"}}
    clods["wear"] = 0.25
    document["light"]["sky"] = {"type": "even", "radiance": {"type": "uniform", "min": 2, "max": 3}}
    del clods["crumble"]
    document["rigs"]["drone"]["pose"] = {"type": "hover", "height_m": 3}
    eye["effects"] = [{"type": "dim"}]
    document["rigs"]["drone"]["lidars"] = {"top": {"pattern": {"type": "fan", "tilt_deg": uniform}}}
    # Other tests' packages may have kinds of these names.
    for found in (plugins.load_kind, schema.kind_schema):
        found.cache_clear()
    yield document
    for found in (plugins.load_kind, schema.kind_schema):
        found.cache_clear()


def test_kinds_of_all_groups_can_declare_their_keys(declared, tmp_path):
    spec = load(written(tmp_path, declared))
    assert len(spec.plugins) == 9
    plan = draw(spec, 3, 0)
    masked = plan.terrain.relief[1]
    lift = masked.operator
    assert 0.5 <= lift.by_m <= 1.0
    assert lift.path == "terrain/relief/1"
    grid = Grid.with_spacing((16.0, 16.0), 0.1)
    heights, _ = masked.apply(grid, np.zeros(grid.shape))
    # East of x = -1 m, where twice x is above -2.
    assert (heights[:, grid.x() < -1.01] == 0.0).all()
    assert heights[:, grid.x() > -0.99] == pytest.approx(lift.by_m)
    (ball, *_) = plan.objects[0].source.shapes
    assert (ball.wear, ball.weights) == (0.25, (1.0, 2.0))
    log = BuildLog()
    scene = build(plan, log)
    assert [step["type"] for step in log.facts["relief"]] == ["plane", "lift"]
    (clods,) = scene.objects
    assert (clods.positions[:, 0] > 0.0).all()
    (rig,) = scene.rigs
    assert rig.times.tolist() == [0.0, 10.0]
    assert rig.to_world[:, 2, 3] == pytest.approx(lift.by_m + 3.0)
    (lidar,) = rig.lidars
    assert lidar.rays.shape == (2, 3, 2)
    assert 0.5 <= lidar.rays[1, 2, 0] <= 1.0
    assert lidar.rays[1, 2, 1] == 5.0
    picture = np.full((2, 2, 3), 100, np.uint8)
    assert (apply(picture, rig.sensors[0].effects, 0) == 50).all()


def test_skies_and_clouds_can_declare_their_keys(declared, tmp_path):
    light = declared["light"]
    declared["labels"]["class"]["glow"] = 3
    light["sky"]["labels"] = {"class": "glow"}
    light["clouds"] = {"more": [{"type": "mist", "hides": {"type": "choice", "values": [0.5]}}]}
    plan = draw(load(written(tmp_path, declared)), 3, 0)
    assert plan.sky_labels == {"class": 3}
    built = build_light(plan.light, 2, True, True)
    assert built.sky is not None
    assert built.sun is not None
    # An even sky of radiance L gives pi L; the sun half of what is left.
    of_sky = (built.irradiance - 250.0) / np.pi
    assert ((of_sky > 1.9) & (of_sky < 3.1)).all()
    assert built.sun.irradiance.tolist() == [500.0, 500.0]


def test_what_is_no_sky_is_told_where_the_cfg_names_it(declared, tmp_path):
    declared["light"] |= {"sky": {"type": "bare"}, "clouds": {"cumulus": {}}}
    found = faults(tmp_path, declared)
    assert list(found) == ["/light/sky"]
    assert found["/light/sky"].endswith("expected a subclass of scenec.compiler.light.sky.Sky")


def test_what_a_class_with_a_schema_calls_as_ours_do_is_its_own_affair(declared, tmp_path):
    declared["objects"]["clods"]["density"] = {"type": "west"}
    (clods,) = build(draw(load(written(tmp_path, declared)), 3, 0), BuildLog()).objects
    assert (clods.positions[:, 0] < 0.0).all()


def test_a_check_that_returns_nothing_finds_nothing(declared, tmp_path, monkeypatch):
    kind = plugins.load_kind("scenec.relief", "lift")
    monkeypatch.setattr(kind, "check", staticmethod(lambda node: None))
    assert load(written(tmp_path, declared)).cfg["terrain"]["relief"][1]["type"] == "lift"


def test_faults_of_declared_keys_read_as_those_of_our_own(declared, tmp_path):
    relief = declared["terrain"]["relief"]
    relief[1] = {"type": "lift", "lowm": 1, "mode": "ruogh"}
    relief.append({"type": "lift", "low_m": 2, "high_m": {"type": "uniform", "min": 1, "max": 3}})
    declared["objects"]["clods"]["dents"] = 1
    declared["rigs"]["drone"]["pose"]["sampling"] = {"times_s": [2, 1]}
    found = faults(tmp_path, declared)
    assert found["/terrain/relief/1"] == 'the key "low_m" is missing (At least)'
    assert 'did you mean "low_m"' in found["/terrain/relief/1/lowm"]
    assert 'did you mean "rough"' in found["/terrain/relief/1/mode"]
    assert found["/terrain/relief/2/high_m"] == "1 m can be below low_m"
    assert found["/objects/clods/dents"] == "nothing is left"
    assert "expected times that rise" in found["/rigs/drone/pose/sampling/times_s/1"]


def test_the_schema_for_editors_and_the_two_forms_say_the_same(there):
    from scenec_farmland import Furrows, Spiral

    length = {"$ref": "forms.schema.json#/$defs/length_per_batch", "exclusiveMinimum": 0}
    for group, kind, first in (("relief", Furrows, "spacing_m"), ("poses", Spiral, "radius_m")):
        made = schema.kind_schema(f"scenec.{group}", kind.__name__.lower())
        keys = made["properties"]
        said = {"description": keys[first]["description"], "default": keys[first]["default"]}
        assert keys[first] == with_forms({**length, **said})
        assert {"mask", "sampling"} & keys.keys()
        assert made["additionalProperties"] is False
    editor = Draft202012Validator(schema.bundled())
    assert editor.schema["$defs"]["pose"]["properties"]["type"]["enum"][-1] == "spiral"
    document = cfg()
    document["light"]["clouds"] = {"more": [{"type": "veil", "optical_depth": 0.5}]}
    assert [error.message for error in editor.iter_errors(document)] == []
    document["terrain"]["relief"][1]["deph_m"] = 1
    document["objects"]["clods"]["crumbel"] = 1
    document["rigs"]["drone"]["sensors"]["eye"]["effects"][0]["strenth"] = 1
    document["light"]["clouds"]["more"][0]["optical_depht"] = 1
    assert len([*editor.iter_errors(document)]) == 4
    partly = Draft202012Validator(schema.bundled(partial=True))
    assert partly.is_valid({"terrain": {"relief": [{"type": "furrows"}]}})
