"""Reads files with faults of every kind: each ends in what it holds, or in one error naming it.

    python lab/robustness/fuzz.py [--mutants N] [--kinds stage,model,...] [--seed S]
                                      [--keep FOLDER] [--fast] [-o FOLDER]

Of each kind of file that scenec reads, a sound one is made, and mutants of it: bits and bytes
changed, cut, doubled, words and numbers in each other's places. Each is read in a process of its
own. It is a fault if that ends in a traceback, dies (but of native code, where it is known over
which file), takes 20 s of the processor or 2 GiB, writes anything, raises an error that does not
name the file, or takes bytes that a digest vouches for and that have changed.
"""

from __future__ import annotations

import gc
import json
import os
import shutil
import subprocess
import sys
import tempfile
import time
import traceback
import warnings
from collections import Counter
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any
from unittest import mock

import numpy as np

from scenec.lab.runner import Page, names, run
from scenec.schemas.errors import OutputError, ScenecError
from scenec.schemas.files import sha256, tree
from scenec.testing import exports, models
from scenec.testing.made_output import make_output
from scenec.testing.mutants import Outcome, mutant, tried
from scenec.testing.small import small_cfg, write_cfg

#: Faults that are shown.
SHOWN = 10
#: First words of kinds that are of one group.
GROUPS = {"cfg", "stage", "model", "heights", "texture", "sky", "track", "export"}


@dataclass(frozen=True)
class Kind:
    """A kind of file.

    Attributes:
        write: Writes a sound file, and what belongs to it, into a folder.
        file: Which it is: a pattern of paths below the folder.
        read: Takes the path of a mutant.
        text: Whether it is made of words.
        vouched: Whether a digest elsewhere says what its bytes are.
        together: Whether all files of the pattern are damaged at once.
        load: Called in the process that forks those that read.
        said_of: What an error names, where that is not the file.
        damage: Makes a fault of its own kind beside the file; returns what it is, and whether it
            has to be refused.
    """

    write: Callable[[Path], object]
    file: str
    read: Callable[[Path], object]
    text: bool = False
    vouched: bool = False
    together: bool = False
    load: Callable[[], object] = dict
    said_of: str | None = None
    damage: Callable[[Path, np.random.Generator], tuple[str, bool]] | None = None


def _kinds() -> dict[str, Kind]:
    found = {**_cfgs(), **_stages(), **_models(), **_pictures(), **_tables(), **_outputs()}
    found |= {
        f"export {name}": Kind(
            exports.write,
            exports.FILE,
            read,
            load=exports.warm,
            said_of="000000",
            damage=exports.damage,
        )
        for name, read in exports.readers().items()
    }
    # Behind all others, which fork no process that has loaded Blender.
    return found | _blends()


def _cfgs() -> dict[str, Kind]:
    from scenec.compiler.cfg.load import load

    def as_yaml() -> str:
        from ruamel.yaml import YAML
        from ruamel.yaml.compat import StringIO

        stream = StringIO()
        YAML(typ="safe").dump(small_cfg(), stream)
        return str(stream.getvalue())

    texts: dict[str, Callable[[], str]] = {
        "json": lambda: json.dumps(small_cfg(), indent=1),
        "jsonc": lambda: "// A remark.\n" + json.dumps(small_cfg(), indent=1),
        "yaml": as_yaml,
    }
    return {
        f"cfg {suffix}": Kind(_text(f"scene.{suffix}", text), "scene.*", load, text=True)
        for suffix, text in texts.items()
    }


def _text(name: str, text: Callable[[], str]) -> Callable[[Path], object]:
    return lambda folder: (folder / name).write_text(text(), encoding="utf-8")


def _stages() -> dict[str, Kind]:
    def read(path: Path) -> None:
        from scenec.backends.annotation.annotate import annotate
        from scenec.backends.exact import ExactCaster
        from scenec.backends.stage.read import read_stage

        scene = read_stage(path)
        if scene.cameras and scene.cameras[0]:
            annotate(scene, ExactCaster(scene), scene.cameras[0][0], ["depth", "instance"], 0)

    def writer(suffix: str) -> Callable[[Path], object]:
        return lambda folder: _stage(folder, suffix)

    return {
        f"stage {suffix}": Kind(writer(suffix), f"**/scene.{suffix}", read, text=suffix == "usda")
        for suffix in ("usda", "usdc", "usdz")
    }


def _tiny_cfg() -> dict[str, Any]:
    cfg = small_cfg()
    cfg["terrain"]["spacing_m"] = 1.0
    cfg["objects"]["rocks"] |= {"count": 30, "prototypes": 2, "subdivisions": 1}
    cfg["rigs"]["rover"]["sensors"]["front"]["resolution"] = [16, 12]
    return cfg


def _stage(folder: Path, suffix: str) -> None:
    from pxr import Sdf, Usd, UsdUtils

    from scenec.compiler.compile import compile_cfg

    compile_cfg(write_cfg(folder, _tiny_cfg()), seed=1, out=folder / "out")
    flat = Usd.Stage.Open(str(folder / "out" / "batch_0000" / "stage.usda")).Flatten()
    if suffix != "usdz":
        flat.Export(str(folder / "out" / "batch_0000" / f"scene.{suffix}"))
        return
    # No pictures are read out of packages.
    opened = Usd.Stage.Open(flat)
    opened.RemovePrim("/World/Lights/Dome")
    flat.Export(str(folder / "inside.usdc"))
    inside = Sdf.AssetPath(str(folder / "inside.usdc"))
    UsdUtils.CreateNewUsdzPackage(inside, str(folder / "scene.usdz"))


def _models() -> dict[str, Kind]:
    from scenec.compiler.assets.model import read_model

    def read(path: Path) -> None:
        read_model(path, unit_m=1.0, up="z")

    def read_obj(path: Path) -> None:
        read(path.with_name("box.obj"))

    def by_trimesh(suffix: str) -> Callable[[Path], object]:
        import trimesh

        return lambda folder: trimesh.creation.icosphere(2).export(folder / f"box.{suffix}")

    def own(suffix: str) -> Callable[[Path], object]:
        return lambda folder: models.write(folder / f"box.{suffix}")

    found = {
        f"model {suffix}": Kind(
            own(suffix), f"box.{suffix}", read, suffix in ("obj", "gltf", "usda")
        )
        for suffix in models.MODELS
    }
    found |= {
        f"model {suffix}": Kind(by_trimesh(suffix), f"box.{suffix}", read, suffix == "off")
        for suffix in ("ply", "stl", "off")
    }
    found["model mtl"] = Kind(own("obj"), "box.mtl", read_obj, text=True, said_of="box")
    return found


def _blends() -> dict[str, Kind]:
    from scenec.compiler.assets.model import read_model

    def read(path: Path) -> None:
        with mock.patch.object(subprocess, "Popen", _Forked):
            read_model(path, unit_m=1.0, up="z")

    return {"model blend": Kind(_blend, "box.blend", read, load=_load_blender)}


def _load_blender() -> None:
    # On one core it has no threads that work, without which a fork would wait for ever.
    cores = os.sched_getaffinity(0)
    os.sched_setaffinity(0, {min(cores)})
    import bpy  # noqa: F401

    os.sched_setaffinity(0, cores)
    warnings.simplefilter("ignore", DeprecationWarning)
    time.sleep(1.0)


def _blend(folder: Path) -> None:
    import bpy

    bpy.ops.wm.save_as_mainfile(filepath=str(folder / "box.blend"), compress=False)


class _Forked:
    """Takes the place of ``Popen`` of a Blender: a fork of this process, which has loaded it.

    To start one takes eight times as long as to read a file.
    """

    def __init__(self, words: list[str], *, stdout: Any, cwd: Path, env: Any, **_: Any) -> None:
        from scenec.compiler.assets.blend_worker import main as work

        self.returncode: int | None = None
        self.pid = os.fork()
        if self.pid:
            return
        status = 1
        try:
            os.dup2(stdout.fileno(), 1)
            os.dup2(stdout.fileno(), 2)
            os.environ |= env
            os.chdir(cwd)
            work(Path(words[-2]), Path(words[-1]))
            status = 0
        except BaseException:  # noqa: BLE001 (as an interpreter that ends)
            traceback.print_exc()
            sys.stderr.flush()
        os._exit(status)

    def poll(self) -> int | None:
        if self.returncode is None:
            found, status = os.waitpid(self.pid, os.WNOHANG)
            if found:
                self.returncode = os.waitstatus_to_exitcode(status)
        return self.returncode

    def wait(self, timeout: float = 1e9) -> int:
        end = time.monotonic() + timeout
        while (code := self.poll()) is None:
            if time.monotonic() > end:
                raise subprocess.TimeoutExpired([], timeout)
            time.sleep(0.005)
        return code

    def kill(self) -> None:
        os.kill(self.pid, 9)


def _pictures() -> dict[str, Kind]:
    from scenec.backends.picture.sky import load_picture
    from scenec.compiler.assets.dem_file import read_dem
    from scenec.compiler.light.latlong import read_picture
    from scenec.schemas.exr import write_exr

    rng = np.random.default_rng(1)
    pixels = rng.integers(0, 256, (24, 32, 3), np.uint8)
    heights = rng.normal(size=(20, 30))

    def saved(suffix: str, picture: np.ndarray) -> Callable[[Path], object]:
        from PIL import Image

        return lambda folder: Image.fromarray(picture).save(folder / f"picture.{suffix}")

    def as_heights(path: Path) -> None:
        read_dem(path, height_range_m=(0.0, 1.0))

    deep = (heights * 1000 + 9000).astype(np.uint16)
    made: dict[str, tuple[str, Callable[[Path], object], Callable[[Path], object]]] = {
        "heights png": ("png", saved("png", deep), as_heights),
        "heights jpg": ("jpg", saved("jpg", pixels[..., 0]), as_heights),
        "heights tif": ("tif", saved("tif", heights.astype(np.float32)), read_dem),
        "heights npy": ("npy", lambda folder: np.save(folder / "picture.npy", heights), read_dem),
        "heights npz": (
            "npz",
            lambda folder: np.savez_compressed(folder / "picture.npz", heights=heights),
            read_dem,
        ),
        "texture png": ("png", saved("png", pixels), _as_texture),
        "texture jpg": ("jpg", saved("jpg", pixels), _as_texture),
        "sky exr": (
            "exr",
            lambda folder: write_exr(folder / "picture.exr", {"rgb": pixels.astype(np.float32)}),
            read_picture,
        ),
        "sky png": ("png", saved("png", pixels), load_picture),
    }
    return {
        name: Kind(write, f"picture.{suffix}", read) for name, (suffix, write, read) in made.items()
    }


def _as_texture(path: Path) -> None:
    from scenec.compiler.assets.parts import MeshFileError
    from scenec.compiler.assets.pictures import pixels_of
    from scenec.schemas.errors import SceneError

    # Callers name the model that refers to it.
    try:
        pixels_of(path, path.name)
    except MeshFileError as error:
        raise SceneError(str(error)) from error


def _tables() -> dict[str, Kind]:
    from scenec.compiler.assets.polyline import read_polyline
    from scenec.compiler.assets.pose_table import read_poses
    from scenec.compiler.assets.tracks import read_stamped, read_track

    poses = [[0.1 * i, i, 2.0, 0.5 * i, 1, 0, 0, 0] for i in range(20)]
    comma = "\n".join(",".join(map(str, row)) for row in poses)
    blank = "\n".join(" ".join(map(str, [*row[:4], 0, 0, 0, 1])) for row in poses)
    line = "\n".join(f"{i},{i * i}" for i in range(20))
    made: dict[str, tuple[str, Callable[[Path], object]]] = {
        "track csv": ("time_s,x_m,y_m,z_m,qw,qx,qy,qz\n" + comma, read_track),
        "track tum": ("# time x y z q\n" + blank, lambda path: read_stamped(path, "tum")),
        "poses csv": ("time_s,x_m,y_m,z_m,qw,qx,qy,qz\n" + comma, read_poses),
        "line csv": ("x_m,y_m\n" + line, read_polyline),
    }
    return {
        name: Kind(_text("table.csv", lambda text=text: text + "\n"), "table.csv", read, text=True)  # type: ignore[misc]
        for name, (text, read) in made.items()
    }


def _outputs() -> dict[str, Kind]:
    from scenec.backends.check.files import check_files
    from scenec.schemas.amodal import Amodal, read_amodal, write_amodal
    from scenec.schemas.frames import read_frame
    from scenec.schemas.instances import read_frame_table, read_table
    from scenec.schemas.manifest import find_batches, read_manifest
    from scenec.schemas.scans import read_scan

    def write(folder: Path) -> None:
        make_output(folder / "out", batches=1, samples=1)

    def masks(folder: Path) -> None:
        runs, starts = np.array([50, 3, 43, 0, 96]), np.array([0, 3, 5])
        write_amodal(folder / "000000.amodal.npz", Amodal((8, 12), np.array([5, 9]), runs, starts))

    def manifest(path: Path) -> None:
        find_batches(path.parent)
        list(check_files(path.parent, read_manifest(path.parent)))

    def listed(path: Path) -> None:
        out = path.parents[1]
        if any(found.severity == "error" for found in check_files(out, read_manifest(out))):
            raise OutputError(f"{path}: is not what the manifest says")

    return {
        "manifest": Kind(write, "out/manifest.json", manifest, text=True),
        # Of a frame of which they say something else an error names either.
        "sidecar": Kind(write, "out/**/0*.json", read_frame, text=True, said_of="000000"),
        "frame exr": Kind(write, "out/**/0*.exr", read_frame, vouched=True),
        "frame's masks": Kind(masks, "*.npz", read_amodal),
        "instances": Kind(_seen, "out/**/instances.npz", read_table),
        "scan": Kind(_seen, "out/**/000000.npz", read_scan, vouched=True),
        "scan's sidecar": Kind(
            _seen, "out/**/scans/**/000000.json", read_scan, text=True, said_of="000000"
        ),
        "frame table": Kind(write, "out/**/*.instances.csv", read_frame_table, text=True),
        "stage file": Kind(write, "out/**/stage.usda", listed, text=True, vouched=True),
        "cache entry": Kind(_cached, "steps/steps/*/*.step", _recompiled, together=True),
    }


def _seen(folder: Path) -> None:
    """An output with a frame's table of instances and a scan."""
    from scenec.backends.run.render import render
    from scenec.backends.run.scan import scan_output
    from scenec.compiler.compile import compile_cfg
    from scenec.schemas.units import LocalExecutor

    cfg = _tiny_cfg() | {"samples": 1}
    beams = {"beams": 3, "elevation_deg": [-20, 0], "azimuths": 8}
    cfg["rigs"]["rover"]["lidars"] = {"top": beams}
    out = compile_cfg(write_cfg(folder, cfg), seed=1, out=folder / "out").out
    render(out, "annotation", passes=("instance",), executor=LocalExecutor())
    scan_output(out, executor=LocalExecutor())


def _compiled(folder: Path) -> dict[str, str]:
    """Digests of the layers of a stage."""
    from scenec.compiler.compile import compile_cfg

    with tempfile.TemporaryDirectory(dir=folder) as out:
        cache = folder / "steps"
        compile_cfg(folder / "small.json", seed=1, out=Path(out) / "out", cache=cache)
        batch = Path(out) / "out" / "batch_0000"
        layers = [path for path in tree(batch) if path.suffix in (".usda", ".usdc")]
        return {str(path): sha256(batch / path) for path in layers}


def _cached(folder: Path) -> None:
    """All steps that a compilation keeps are to be damaged."""
    write_cfg(folder, _tiny_cfg())
    (folder / "whole.json").write_text(json.dumps(_compiled(folder)), encoding="utf-8")


def _recompiled(path: Path) -> None:
    folder = path.parents[3]
    if _compiled(folder) != json.loads((folder / "whole.json").read_text(encoding="utf-8")):
        raise AssertionError(f"{path}: other bytes")


def written(kind: Kind, folder: Path) -> list[Path]:
    """Path of a sound file, or those of all that are damaged together.

    They are made in a process of its own: OpenUSD's threads outlive no fork.
    """
    folder.mkdir()
    if not (child := os.fork()):
        try:
            kind.write(folder)
            os._exit(0)
        finally:
            traceback.print_exc()
            os._exit(1)
    if os.waitpid(child, 0)[1]:
        raise ScenecError(f"{folder.name}: no sound file could be made")
    found = sorted(folder.glob(kind.file))
    return found if kind.together else found[:1]


def outcomes(
    kind: Kind, files: list[Path], count: int, seed: int, jail: Path, kept: Path | None
) -> Iterator[Outcome]:
    """What mutants come to; the first is the sound file itself.

    Args:
        kind: Of file.
        files: The sound ones; damaged ones stand in their places.
        count: Of mutants, of each file.
        seed: Other ones.
        jail: Does not exist; for what reading might write.
        kept: Folder for mutants that end in a fault.
    """
    sound = {file: file.read_bytes() for file in files}
    rng = np.random.default_rng(seed)
    file = files[0]
    said_of = kind.said_of or file.name
    yield tried(lambda: kind.read(file), said_of, jail)
    for number in range(count):
        fault, must = kind.damage(file, rng) if kind.damage else ("", kind.vouched)
        for each, whole in sound.items() if not kind.damage else ():
            while (data := mutant(whole, kind.text, rng)) == whole:
                pass
            each.write_bytes(data)
        found = tried(lambda: kind.read(file), said_of, jail)
        if must and found.kind == "taken":
            found = Outcome("unnoticed", "", found.seconds, found.peak)
        if fault:
            found = replace(found, text=f"{fault}: {found.text}")
        if found.fault and kept is not None:
            kept.mkdir(parents=True, exist_ok=True)
            for each in files:
                shutil.copy(each, kept / f"{found.kind}_{number}_{each.name}")
        yield found
    for each, whole in sound.items():
        each.write_bytes(whole)


def grouped(rows: list[list[Any]]) -> Iterator[list[Any]]:
    """Adds up the rows of kinds with the same first word; what a command writes is "output"."""
    groups: dict[str, list[list[Any]]] = {}
    for row in rows:
        group, _, name = row[0].rpartition(" ")
        group = group if group in GROUPS else "output"
        groups.setdefault(group, []).append([name if group != "output" else row[0], *row[1:6]])
    for group, of in groups.items():
        kinds, *numbers = zip(*of, strict=True)
        yield [f"{group}: {', '.join(kinds)}", *map(sum, numbers)]


def main(page: Page) -> None:
    """Refreshes the page's row of each group of kinds; prints a row a kind, and the faults."""
    kept = page.options.keep
    count = 20 if page.fast else page.options.mutants
    wanted = page.options.kinds
    rows, faults, total = [], [], Counter[str]()
    header = ["kind", "mutants", "taken", "refused", "crash told", "faults", "s at most", "MiB"]
    for name, kind in _kinds().items():
        if wanted is not None and not {name, name.split()[0]} & {*wanted}:
            continue
        kind.load()
        files = written(kind, page.scratch / name.replace(" ", "_"))
        gc.collect()
        gc.freeze()
        times = -(-count // len(files))
        jail = page.scratch / "jail"
        sound, *found = outcomes(kind, files, times, page.options.seed, jail, kept)
        if sound.kind != "taken":
            faults.append(f"{name}: the sound file: {sound.kind}: {sound.text}")
        of = Counter({k: n * len(files) for k, n in Counter(e.kind for e in found).items()})
        total += of
        bad = [each for each in found if each.fault]
        faults += [f"{name}: {each.kind}: {each.text.strip()[:300]}" for each in bad]
        cells = [of["taken"], of["refused"], of["crash told"], len(bad)]
        slowest = max(each.seconds for each in found)
        most = max(each.peak for each in found) / 2**20
        rows.append([name, times * len(files), *cells, slowest, most])
        print(" ".join(map(str, rows[-1])), flush=True)
    page.table(header, rows)
    page.say(f"{sum(total.values()):,} mutants: {dict(total)}")
    if page.whole:
        told = f"{sum(total.values()):,} mutants of {len(rows)} kinds"
        page.value("fuzzed", told)
        page.value("fuzz_faults", str(sum(row[5] for row in rows)))
        page.block("fuzz", header[:6], grouped(rows))
        page.refresh((), ())
    for fault, times in Counter(faults).most_common(SHOWN * len(rows)):
        page.say(f"- {times} x {fault}")


if __name__ == "__main__":
    run(main, page="robustness", mutants=20, kinds=names, seed=0, keep=Path)
