"""A stage that is not whole is refused by name, or read with a line about each thing it lacks."""

from __future__ import annotations

import hashlib
import json
import shutil
from contextlib import closing
from pathlib import Path

import pytest
from pxr import Sdf, Usd, UsdGeom, UsdLux, UsdShade

from scenec.backends.check.stage import check_stage
from scenec.backends.run.render import render
from scenec.backends.run.scan import scan_output
from scenec.backends.run.session import Session
from scenec.backends.run.supervise import Supervisor
from scenec.backends.run.units import Opening, OpenStage
from scenec.backends.stage.read import read_stage
from scenec.cli.main import main
from scenec.compiler.compile import compile_cfg
from scenec.schemas import stage as names
from scenec.schemas.errors import OutputError, StageError
from scenec.schemas.frames import FrameKey, read_frame
from scenec.schemas.manifest import find_batches, read_manifest, stage_digest
from scenec.testing.foreign_stages import polygons
from scenec.testing.frame_units import render_to
from scenec.testing.small import small_cfg, write_cfg

ANNOTATION = ("depth", "instance")


@pytest.fixture(scope="module")
def compiled(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("integrity")
    compile_cfg(write_cfg(folder, small_cfg(samples=2, batches=2)), seed=3, out=folder / "out")
    return folder / "out"


@pytest.fixture
def out(compiled: Path, tmp_path: Path) -> Path:
    shutil.copytree(compiled, tmp_path / "out")
    return tmp_path / "out"


def stage_of(out: Path) -> Path:
    return out / "batch_0000" / "stage.usda"


def remove(batch: Path) -> str:
    (batch / "objects" / "rocks.usdc").unlink()
    return "objects/rocks.usdc: is in the manifest.json and not on disk"


def remove_picture(batch: Path) -> str:
    (batch / "textures" / "sky_0001.exr").unlink()
    return "textures/sky_0001.exr: is in the manifest.json and not on disk"


def change(batch: Path) -> str:
    file = batch / "terrain.usdc"
    data = bytearray(file.read_bytes())
    data[len(data) // 2] ^= 4
    file.write_bytes(data)
    return "terrain.usdc: its bytes are not those of the manifest.json"


def truncate(batch: Path) -> str:
    file = batch / "terrain.usdc"
    file.write_bytes(file.read_bytes()[:1000])
    return "terrain.usdc: its bytes are not those of the manifest.json"


def edit(batch: Path) -> str:
    file = batch / "stage.usda"
    file.write_text(file.read_text(encoding="utf-8") + "# mine\n", encoding="utf-8")
    return "stage.usda: its bytes are not those of the manifest.json"


def of_another_batch(batch: Path) -> str:
    shutil.copyfile(batch.with_name("batch_0001") / "cameras.usdc", batch / "cameras.usdc")
    return "cameras.usdc: its bytes are not those of the manifest.json"


FAULTS = (remove, remove_picture, change, truncate, edit, of_another_batch)


@pytest.mark.parametrize("damage", FAULTS)
def test_an_output_is_held_against_its_manifest(out, damage):
    told = damage(out / "batch_0000")
    with pytest.raises(StageError) as caught:
        read_stage(stage_of(out))
    assert told in str(caught.value)
    assert str(stage_of(out)) in str(caught.value)
    # The other batch is whole.
    read_stage(out / "batch_0001" / "stage.usda")


@pytest.mark.parametrize("damage", [remove, remove_picture, edit, of_another_batch])
def test_what_is_there_can_be_read_and_is_another_stage(out, damage):
    whole = read_stage(stage_of(out))
    told = damage(out / "batch_0000")
    part = read_stage(stage_of(out), allow_missing=True)
    assert told in part.losses
    assert whole.losses == ()
    assert part.digest != whole.digest
    assert part.digest == read_stage(stage_of(out), allow_missing=True).digest


def test_a_dome_without_its_picture_gives_no_light(out):
    remove_picture(out / "batch_0000")
    part = read_stage(stage_of(out), allow_missing=True)
    assert [len(lighting.domes) for lighting in part.lighting] == [1, 0]


def test_what_is_read_is_what_the_manifest_lists(compiled, tmp_path):
    manifest = read_manifest(compiled)
    for batch in find_batches(compiled):
        scene = read_stage(batch.stage)
        assert scene.digest == stage_digest(manifest, batch.name)
        assert scene.losses == ()
    # However the way there is spelled, and where single files are links into a store.
    (tmp_path / "link").symlink_to(compiled)
    there = read_stage(stage_of(tmp_path / "link"))
    assert there.digest == stage_digest(manifest, "batch_0000")
    linked = tmp_path / "out"
    shutil.copytree(compiled, linked)
    # But for the root layer: no path of a manifest leads out of its output.
    for file in (linked / "batch_0000").rglob("*.usdc"):
        original = compiled / file.relative_to(linked)
        file.unlink()
        file.symlink_to(original)
    assert read_stage(stage_of(linked)).digest == there.digest
    report = render(linked, "reference", passes=ANNOTATION, samples=[0], batches=[0])
    assert read_frame(report.frames[0]).sidecar.stage_digest == there.digest


@pytest.mark.parametrize("name", ["batch_0000/../../theirs", "batch_0000//etc/passwd"])
def test_a_name_of_the_manifest_that_leads_out_of_its_batch_is_not_followed(out, name):
    (out.parent / "theirs").write_text("theirs", encoding="utf-8")
    manifest = json.loads((out / "manifest.json").read_text(encoding="utf-8"))
    digest = hashlib.sha256(b"theirs").hexdigest()
    manifest["files"][name] = {"sha256": digest, "bytes": 6}
    (out / "manifest.json").write_text(json.dumps(manifest), encoding="utf-8")
    with pytest.raises(StageError, match="lists it, and it is not in the stage's folder"):
        read_stage(stage_of(out))


def test_a_word_that_is_not_utf8_is_refused(tmp_path):
    path = tmp_path / "stage.usdc"
    stage = Usd.Stage.CreateNew(str(path))
    mesh = UsdGeom.Mesh.Define(stage, "/Mesh")
    stage.SetDefaultPrim(mesh.GetPrim())
    table = (names.ATTR_LABEL_NAMES, Sdf.ValueTypeNames.TokenArray, ["a"])
    ids = (names.ATTR_LABEL_IDS, Sdf.ValueTypeNames.UIntArray, [1])
    for name, kind, value in (table, ids):
        mesh.GetPrim().CreateAttribute(name.format(level="class"), kind).Set(value)
    primvar = UsdGeom.PrimvarsAPI(mesh).CreatePrimvar(
        names.label_primvar("class"), Sdf.ValueTypeNames.IntArray
    )
    primvar.Set([1])
    primvar.GetAttr().SetMetadata("interpolation", "XYZ.QQ")
    stage.Save()
    del stage, mesh, primvar
    whole = path.read_bytes()
    assert whole.count(b"XYZ.QQ") == 1
    path.write_bytes(whole.replace(b"XYZ.QQ", b"XY\xe3.QQ"))
    with pytest.raises(StageError, match=r"stage\.usdc: cannot be read: .*0xe3"):
        read_stage(path)
    (finding,) = check_stage(path)
    assert (finding.check, finding.severity) == ("opens", "error")


def test_a_layer_that_the_manifest_does_not_list_is_refused(out):
    batch = out / "batch_0000"
    manifest = json.loads((out / "manifest.json").read_text(encoding="utf-8"))
    del manifest["files"]["batch_0000/lights.usdc"]
    (out / "manifest.json").write_text(json.dumps(manifest), encoding="utf-8")
    with pytest.raises(StageError, match=r"lights.usdc: is read, and is not in the manifest.json"):
        read_stage(stage_of(out))
    # A layer from beyond the batch's folder is no more in it.
    manifest["files"]["batch_0000/lights.usdc"] = {"sha256": "0"}
    (batch / "lights.usdc").rename(out / "lights.usdc")
    (out / "manifest.json").write_text(json.dumps(manifest), encoding="utf-8")
    with pytest.raises(StageError, match=r"lights.usdc: is in the manifest.json and not on disk"):
        read_stage(stage_of(out))


@pytest.mark.parametrize("entry", [3, {"bytes": 3}, None])
def test_a_manifest_without_digests_is_none(out, entry):
    manifest = json.loads((out / "manifest.json").read_text(encoding="utf-8"))
    manifest["files"]["batch_0000/lights.usdc"] = entry
    (out / "manifest.json").write_text(json.dumps(manifest), encoding="utf-8")
    with pytest.raises(OutputError, match=r"manifest.json: is no scenec manifest"):
        render(out, "reference")


@pytest.mark.usefixtures("worker_here")
def test_frames_of_a_part_are_never_taken_for_those_of_the_whole(out, capsys):
    batch = out / "batch_0000"
    rocks = (batch / "objects" / "rocks.usdc").read_bytes()
    told = remove(batch)
    command = ["render", str(out), "--backend", "reference", "--passes", "depth,instance"]
    command += ["--batches", "0"]
    assert main(command) == 2
    assert told in capsys.readouterr().err
    assert not (batch / "frames").exists()
    assert main([*command, "--allow-missing"]) == 0
    assert f"warning: {told}" in capsys.readouterr().err
    sidecars = sorted((batch / "frames").glob("*/*/*.json"))
    parts = [json.loads(path.read_text(encoding="utf-8")) for path in sidecars]
    assert len(parts) == 2
    assert all(told in part["losses"] for part in parts)
    assert main([*command, "--allow-missing"]) == 0
    assert "2 were there already" in capsys.readouterr().err
    # Without the flag nothing of it is taken as done.
    assert main(command) == 2
    (batch / "objects" / "rocks.usdc").write_bytes(rocks)
    assert main(command) == 0
    assert "2 frames rendered" in capsys.readouterr().err
    for path in sidecars:
        assert json.loads(path.read_text(encoding="utf-8"))["losses"] == []


@pytest.mark.parametrize("command", ["scan", "check", "explain", "converge"])
def test_every_reader_of_an_output_says_what_is_missing(out, capsys, command):
    told = remove(out / "batch_0000")
    options = {"converge": ["--backends", "pyrender", "--spp", "1"]}
    status = main([command, str(out), *options.get(command, [])])
    said = capsys.readouterr()
    assert told in said.out + said.err
    assert status == (1 if command == "check" else 2)


def test_a_check_that_allows_it_warns_of_what_is_missing(out, capsys):
    told = remove(out / "batch_0000")
    assert main(["check", str(out), "--allow-missing"]) == 0
    said = capsys.readouterr().out
    assert f"warning: stage.usda: {told} [unread]" in said
    assert "\n0 errors," in said


def test_scans_of_a_part_say_so(tmp_path):
    cfg = small_cfg(samples=1)
    cfg["rigs"]["rover"]["lidars"] = {"top": {"beams": 4, "elevation_deg": [-20, 0],
                                              "azimuths": 12, "range_m": [0.1, 50]}}  # fmt: skip
    out = compile_cfg(write_cfg(tmp_path, cfg), seed=3, out=tmp_path / "out").out
    told = remove(out / "batch_0000")
    with pytest.raises(StageError, match=r"rocks\.usdc"):
        scan_output(out)
    report = scan_output(out, allow_missing=True)
    assert told in report.warnings
    sidecar = json.loads(report.scans[0].with_suffix(".json").read_text(encoding="utf-8"))
    assert told in sidecar["losses"]


# Stages of others: nothing is known of them but what they name themselves.


def foreign(folder: Path) -> Usd.Stage:
    stage = Usd.Stage.CreateNew(str(folder / "foreign.usda"))
    UsdGeom.SetStageUpAxis(stage, UsdGeom.Tokens.z)
    stage.SetDefaultPrim(UsdGeom.Xform.Define(stage, "/World").GetPrim())
    UsdGeom.Camera.Define(stage, "/World/Camera")
    polygons(stage, "/World/Floor", [(0, 0, 0), (1, 0, 0), (0, 1, 0)], [3], [0, 1, 2])
    return stage


def nothing(folder: Path) -> None:
    (folder / "there.usda").write_text('#usda 1.0\n(\n defaultPrim = "A"\n)\ndef Xform "A" {\n}\n')


def broken(folder: Path) -> None:
    (folder / "there.usda").write_text('#usda 1.0\ndef Xform "A" {\n    int x = "text"\n}\n')


def sublayer(stage: Usd.Stage, folder: Path) -> str:
    stage.GetRootLayer().subLayerPaths.append("./gone.usda")
    return "foreign.usda: its sublayer gone.usda does not exist"


def reference(stage: Usd.Stage, folder: Path) -> str:
    stage.DefinePrim("/World/A").GetReferences().AddReference("./gone.usda")
    return "/World/A: its reference to gone.usda does not exist"


def payload(stage: Usd.Stage, folder: Path) -> str:
    stage.DefinePrim("/World/A").GetPayloads().AddPayload("./gone.usdc")
    return "/World/A: its payload to gone.usdc does not exist"


def within_a_reference(stage: Usd.Stage, folder: Path) -> str:
    inner = Usd.Stage.CreateNew(str(folder / "inner.usda"))
    inner.SetDefaultPrim(inner.DefinePrim("/Root"))
    inner.DefinePrim("/Root/part").GetReferences().AddReference("./deeper.usda")
    inner.Save()
    for name in ("A", "B"):
        prim = stage.DefinePrim(f"/World/{name}")
        prim.GetReferences().AddReference("./inner.usda")
        prim.SetInstanceable(True)
    return "part: its reference to deeper.usda does not exist"


def many(stage: Usd.Stage, folder: Path) -> str:
    for i in range(40):
        stage.DefinePrim(f"/World/A{i}").GetReferences().AddReference("./gone.usda")
    return "its reference to gone.usda does not exist (and so of 39 more)"


def no_such_prim(stage: Usd.Stage, folder: Path) -> str:
    nothing(folder)
    stage.DefinePrim("/World/A").GetReferences().AddReference("./there.usda", "/B")
    return "/World/A: its reference to there.usda finds no prim /B there"


def no_such_prim_here(stage: Usd.Stage, folder: Path) -> str:
    stage.DefinePrim("/World/A").GetReferences().AddInternalReference("/Nowhere")
    return "/World/A: its reference to foreign.usda finds no prim /Nowhere there"


def not_usd(stage: Usd.Stage, folder: Path) -> str:
    broken(folder)
    stage.DefinePrim("/World/A").GetReferences().AddReference("./there.usda")
    return "/World/A: its reference to there.usda cannot be read: "


def sublayer_not_usd(stage: Usd.Stage, folder: Path) -> str:
    broken(folder)
    stage.GetRootLayer().subLayerPaths.append("./there.usda")
    return "there.usda:3:"


def crate_cut_short(stage: Usd.Stage, folder: Path) -> str:
    (folder / "there.usdc").write_bytes(b"PXR-USDC" + bytes(200))
    stage.GetRootLayer().subLayerPaths.append("./there.usdc")
    return "its sublayer there.usdc cannot be read: "


def value_clip(stage: Usd.Stage, folder: Path) -> str:
    nothing(folder)
    prim = stage.GetPrimAtPath("/World")
    clips = Usd.ClipsAPI(prim)
    clips.SetClipPrimPath("/A")
    clips.SetClipAssetPaths([Sdf.AssetPath("./there.usda"), Sdf.AssetPath("./later.usda")])
    clips.SetClipActive([(0, 0), (1, 1)])
    clips.SetClipTimes([(0, 0), (1, 1)])
    return "/World: its value clip ./later.usda does not exist"


def picture_of_a_dome(stage: Usd.Stage, folder: Path) -> str:
    dome = UsdLux.DomeLight.Define(stage, "/World/Dome")
    dome.CreateTextureFileAttr(Sdf.AssetPath("./sky.exr"))
    return "/World/Dome.inputs:texture:file: ./sky.exr does not exist"


def texture(stage: Usd.Stage, folder: Path) -> str:
    material = UsdShade.Material.Define(stage, "/World/Look")
    surface = UsdShade.Shader.Define(stage, "/World/Look/Surface")
    surface.CreateIdAttr("UsdPreviewSurface")
    image = UsdShade.Shader.Define(stage, "/World/Look/Image")
    image.CreateIdAttr("UsdUVTexture")
    # There is one of this name, but not where the stage looks for it.
    image.CreateInput("file", Sdf.ValueTypeNames.Asset).Set(Sdf.AssetPath("./pyproject.toml"))
    image.CreateOutput("rgb", Sdf.ValueTypeNames.Float3)
    surface.CreateInput("diffuseColor", Sdf.ValueTypeNames.Color3f).ConnectToSource(
        image.ConnectableAPI(), "rgb"
    )
    material.CreateSurfaceOutput().ConnectToSource(surface.ConnectableAPI(), "surface")
    UsdShade.MaterialBindingAPI.Apply(stage.GetPrimAtPath("/World/Floor")).Bind(material)
    return "/World/Look/Image.inputs:file: ./pyproject.toml does not exist"


@pytest.mark.parametrize(
    "lack",
    [
        sublayer, reference, payload, within_a_reference, many, no_such_prim, no_such_prim_here,
        not_usd, sublayer_not_usd, crate_cut_short, value_clip, picture_of_a_dome, texture,
    ],
)  # fmt: skip
def test_what_a_stage_names_and_does_not_hold_is_said(tmp_path, lack):
    stage = foreign(tmp_path)
    stage.Save()
    whole = read_stage(tmp_path / "foreign.usda")
    assert whole.losses == ()
    told = lack(stage, tmp_path)
    stage.Save()
    del stage
    with pytest.raises(StageError) as caught:
        read_stage(tmp_path / "foreign.usda")
    assert told in str(caught.value)
    assert "foreign.usda: is not whole" in str(caught.value)
    part = read_stage(tmp_path / "foreign.usda", allow_missing=True)
    assert any(told in line for line in part.losses)
    assert len(part.losses) <= 2
    assert part.digest != whole.digest
    assert len(part.meshes) == 1


def test_what_comes_back_makes_the_stage_another(tmp_path):
    stage = foreign(tmp_path)
    stage.DefinePrim("/World/A").GetReferences().AddReference("./there.usda")
    stage.Save()
    part = read_stage(tmp_path / "foreign.usda", allow_missing=True)
    nothing(tmp_path)
    stage.Reload()
    del stage
    whole = read_stage(tmp_path / "foreign.usda", allow_missing=True)
    assert whole.losses == ()
    assert whole.digest != part.digest


def test_a_manifest_of_something_else_is_not_asked(tmp_path):
    folder = tmp_path / "stages"
    folder.mkdir()
    foreign(folder).Save()
    (tmp_path / "manifest.json").write_text('{"name": "an extension of a browser"}')
    assert read_stage(folder / "foreign.usda").losses == ()


def test_value_clips_and_packages_are_in_the_digest(tmp_path):
    stage = foreign(tmp_path)
    value_clip(stage, tmp_path)
    shutil.copyfile(tmp_path / "there.usda", tmp_path / "later.usda")
    stage.Save()
    del stage
    before = read_stage(tmp_path / "foreign.usda").digest
    with (tmp_path / "later.usda").open("a", encoding="utf-8") as file:
        file.write("# changed\n")
    assert read_stage(tmp_path / "foreign.usda").digest != before


def test_a_syntax_error_is_said_with_its_line(tmp_path):
    path = tmp_path / "typo.usda"
    path.write_text('#usda 1.0\ndef Xform "A" {\n    int x = "text"\n}\n', encoding="utf-8")
    with pytest.raises(StageError, match=r"typo\.usda:3:\d+: not a USD stage: "):
        read_stage(path)
    assert [finding.check for finding in check_stage(path)] == ["opens"]


def test_a_stage_that_changed_while_it_was_rendered_is_no_stage_of_its_frames(out, tmp_path):
    session = Session.open(stage_of(out), "reference")
    key = FrameKey("0" * 64, ("depth",), 0, 0, "reference", "")
    with pytest.raises(StageError, match="has changed since rendering began"):
        render_to(session, tmp_path / "frame", 0, key)
    assert not list(tmp_path.glob("frame*"))


@pytest.mark.parametrize("kind", ["text", "type"])
def test_bad_input_costs_a_worker_one_try(tmp_path, kind):
    stage = foreign(tmp_path)
    stage.GetPrimAtPath("/World/Floor").GetAttribute("points").Clear()
    spec = stage.GetRootLayer().GetPrimAtPath("/World/Floor").attributes["points"]
    del spec.owner.properties["points"]
    Sdf.AttributeSpec(stage.GetRootLayer().GetPrimAtPath("/World/Floor"), "points",
                      Sdf.ValueTypeNames.String).default = "text"  # fmt: skip
    stage.Save()
    if kind == "text":
        (tmp_path / "foreign.usda").write_text("#usda 1.0\ndef {\n", encoding="utf-8")
    told = "is of type string, expected" if kind == "type" else "foreign.usda:2:"
    with closing(Supervisor()) as worker:
        outcome = worker.do(OpenStage(Opening(str(tmp_path / "foreign.usda"), "annotation")))
    assert outcome.deaths == 0
    with pytest.raises(StageError, match=told):
        outcome.result()


def test_a_crash_while_a_stage_is_read_is_said_after_one_try(tmp_path, monkeypatch):
    # Stands for a file that USD does not survive: this process does not survive its reader.
    (tmp_path / "site").mkdir()
    (tmp_path / "site" / "sitecustomize.py").write_text(
        "import os, signal, sys\n"
        "def audit(event, arguments):\n"
        "    if event == 'import' and arguments[0] == 'scenec.backends.stage.read':\n"
        f"        open({str(tmp_path / 'tries')!r}, 'a').write('x')\n"
        "        os.kill(os.getpid(), signal.SIGSEGV)\n"
        "sys.addaudithook(audit)\n",
        encoding="utf-8",
    )
    monkeypatch.setenv("PYTHONPATH", str(tmp_path / "site"))
    foreign(tmp_path).Save()
    path = tmp_path / "foreign.usda"
    with pytest.raises(StageError) as caught:
        render(path, "reference")
    told = f"{path}: the library that reads it crashed, the worker process died (signal SIGSEGV"
    assert str(caught.value).startswith(told)
    assert (tmp_path / "tries").read_text(encoding="utf-8") == "x"
    assert main(["render", str(path), "--backend", "reference"]) == 2
