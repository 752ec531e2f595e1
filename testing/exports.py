"""Makes faults in what exporters read: passes, tables, sidecars, masks, and missing files.

Most are vouched for by their digests, as those of a renderer that writes nonsense are; the others
are bits and bytes of files, which digests find.
"""

from __future__ import annotations

import json
import shutil
import tempfile
from collections.abc import Callable
from dataclasses import dataclass, field
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np

from scenec.datasets.export import Choice, export
from scenec.datasets.formats.registry import format_names
from scenec.datasets.verify import verify
from scenec.schemas.errors import OutputError, ScenecError
from scenec.schemas.files import sha256
from scenec.schemas.instances import frame_table_path, read_frame_table, write_frame_table
from scenec.testing.mutants import mutant

FILE = "out/manifest.json"
#: Options with which a format looks at all that it can.
OPTIONS = {
    "kitti": {"depth": "yes", "flow": "visible", "disparity": "visible"},
    "cityscapes": {"depth": "depth", "levels": "all"},
    "parquet": {"depth": "png"},
    "webdataset": {"radiance": "yes"},
    "hdf5": {"rgb": "both"},
    "nerfstudio": {"depth": "yes"},
    "coco": {"segmentation": "polygon", "categories": "all"},
}
_NAMES = (
    "", " ", "a,b", 'a"b', "a\nb", "a\tb", "a/b", "../up", "=1+1", "x" * 5000,
    "\u202e\u0436\u4e16\U0001f30d", "null", "[", "{0}", "%s", "\\",
)  # fmt: skip
_NUMBERS: tuple[Any, ...] = (
    0.0, -1.0, 1e-320, 1e300, 1.7e308, float("nan"), float("inf"), 2**31, 2**63, None, "1", [],
)  # fmt: skip


def write(folder: Path) -> None:
    """Writes an output that every format can hold: a stereo pair, two samples, motion, masks."""
    from scenec.testing.made_frames import LEFT, RIGHT, make_out, rewrite

    sensors = [
        type(LEFT)(one.name, one.prim, one.offset, size=(24, 18), focal=18.0)
        for one in (LEFT, RIGHT)
    ]
    made = make_out(folder / "out", sensors, 2)
    for (camera, sample), passes in made.passes.items():
        height, width = passes["depth"].shape
        with np.errstate(divide="ignore"):
            apart = (18.0 * 0.25 / passes["depth"]).astype(np.float32)
        passes["flow"] = np.full((height, width, 2), 1.5, np.float32)
        passes["occlusion"] = np.zeros((height, width), np.uint32)
        passes["disparity"] = apart if camera == LEFT.name else -apart
        passes["disparity_occlusion"] = np.zeros((height, width), np.uint32)
        other = RIGHT.name if camera == LEFT.name else LEFT.name
        stem = made.out / f"batch_0000/frames/mitsuba/{camera}/{sample:06d}"
        rewrite(stem, passes, partner=other)


@cache
def warm() -> None:
    """Loads what most exports need, once, so that the processes forked for each mutant need not."""
    with tempfile.TemporaryDirectory() as scratch:
        write(Path(scratch))
        for name in ("bop", "coco", "kitti", "panoptic"):
            export(Path(scratch) / "out", name, choice=Choice(options=OPTIONS.get(name, {})))


def readers() -> dict[str, Callable[[Path], object]]:
    """Maps each format to a function that exports the output of a manifest."""

    def reader(name: str) -> Callable[[Path], object]:
        return lambda file: _export(file.parent, name)

    return {name: reader(name) for name in format_names()}


def _export(out: Path, name: str) -> None:
    """Exports, and checks the files afterwards against what an export promises."""
    target = Path.cwd() / "dataset"
    try:
        export(out, name, target, Choice(options=OPTIONS.get(name, {})))
    except ScenecError as error:
        if target.exists():
            raise AssertionError("a dataset was left by an export that was refused") from None
        if not any(part in str(error) for part in ("0000", "manifest.json", f"format {name}")):
            raise
        raise OutputError(f"000000: {error}") from error
    finally:
        shutil.rmtree(target.with_name(".dataset.partial"), ignore_errors=True)
    flaws = verify(target)
    shutil.rmtree(target)
    if flaws:
        raise AssertionError(f"{name}: {flaws[0]}")


@dataclass
class Frame:
    """Damages a frame, and writes it again with digests that vouch for it."""

    stem: Path
    rng: np.random.Generator
    sidecar: dict[str, Any] = field(default_factory=dict)

    def passes(self, change: Callable[[dict[str, np.ndarray]], object]) -> None:
        """Changes its passes."""
        from scenec.schemas.exr import read_exr, write_exr

        exr = self.stem.with_suffix(".exr")
        arrays = read_exr(exr)
        change(arrays)
        write_exr(exr, arrays)
        self.told(exr={"bytes": exr.stat().st_size, "sha256": sha256(exr)})

    def table(self, change: Callable[[dict[str, np.ndarray]], object]) -> None:
        """Changes its table of instances."""
        path = frame_table_path(self.stem)
        columns = read_frame_table(path)
        change(columns)
        write_frame_table(path, columns)
        self.told(instance_table={"bytes": path.stat().st_size, "sha256": sha256(path)})

    def told(self, **values: Any) -> None:
        """Changes its sidecar."""
        path = self.stem.with_suffix(".json")
        path.write_text(json.dumps(json.loads(path.read_bytes()) | values), encoding="utf-8")

    def one(self, some: Any) -> Any:
        """Picks any of some."""
        return some[int(self.rng.integers(len(some)))]


def damage(file: Path, rng: np.random.Generator) -> tuple[str, bool]:
    """Makes one fault in an output folder, after it is made whole again.

    Args:
        file: The output's manifest.
        rng: Which fault.

    Returns:
        What it is, and whether every format has to refuse it.
    """
    out = file.parent
    sound = out.with_name("sound")
    if not sound.exists():
        shutil.copytree(out, sound)
    shutil.rmtree(out)
    shutil.copytree(sound, out)
    if rng.random() < 0.4:
        return _bytes(out, rng), False
    stems = sorted(path.with_suffix("") for path in out.glob("batch_*/frames/*/*/*.json"))
    frame = Frame(stems[int(rng.integers(len(stems)))], rng)
    name = str(rng.choice(list(FAULTS)))
    FAULTS[name](frame)
    return name, name in REFUSED


def _bytes(out: Path, rng: np.random.Generator) -> str:
    paths = [path for path in sorted(out.rglob("*")) if path.is_file() and path.stat().st_size]
    path = paths[int(rng.integers(len(paths)))]
    whole = path.read_bytes()
    text = path.suffix in (".json", ".csv")
    while (data := mutant(whole, text, rng)) == whole:
        pass
    path.write_bytes(data)
    return f"bytes of {''.join(path.suffixes)}"


def _put(name: str, values: tuple[float, ...]) -> Callable[[Frame], None]:
    """Puts a value at a pixel, or all over a pass."""

    def change(frame: Frame) -> None:
        def apply(arrays: dict[str, np.ndarray]) -> None:
            array = arrays[name]
            place = (
                np.s_[:]
                if frame.rng.random() < 0.3
                else tuple(int(frame.rng.integers(size)) for size in array.shape[:2])
            )
            array[place] = frame.one(values)

        frame.passes(apply)

    return change


def _renamed(frame: Frame) -> None:
    """Renames a label, in every frame's sidecar and table."""
    name, old = frame.one(_NAMES), "rock"
    number = frame.one(("3", "70000", "4294967295"))
    for path in frame.stem.parents[1].glob("*/*.json"):
        other = Frame(path.with_suffix(""), frame.rng)
        table = {"1": "sky", "2": "ground", number: name, "4": "lander"}
        other.told(labels={"class": table})
        other.table(
            lambda c: c.update(
                {"label.class": np.where(c["label.class"] == old, name, c["label.class"])}
            )
        )
        if number != "3":
            other.passes(lambda a: a["label.class"].__setitem__(a["label.class"] == 3, int(number)))


def _renumbered(frame: Frame) -> None:
    """Changes an instance's id, the largest of a frame, in its pass and its table."""
    number = frame.one((2**16, 2**31 - 1, 2**31, 2**32 - 1))

    def passes(arrays: dict[str, np.ndarray]) -> None:
        ids = arrays["instance"]
        ids[ids == ids.max()] = number

    def table(columns: dict[str, np.ndarray]) -> None:
        if len(columns["id"]):
            columns["id"][-1] = number

    frame.passes(passes)
    frame.table(table)


def _emptied(frame: Frame) -> None:
    """Removes all instances, consistently."""
    frame.passes(lambda arrays: arrays["instance"].fill(0))
    frame.table(lambda columns: columns.update({k: v[:0] for k, v in columns.items()}))
    frame.told(amodal=None)


def _row(name: str, values: tuple[Any, ...]) -> Callable[[Frame], None]:
    """Puts a value into a line of the table."""

    def apply(columns: dict[str, np.ndarray], value: Any) -> None:
        if len(columns["id"]):
            columns[name] = columns[name].astype(object if isinstance(value, str) else float)
            columns[name][0] = value

    return lambda frame: frame.table(lambda columns: apply(columns, frame.one(values)))


def _pose(*factors: np.ndarray) -> Callable[[Frame], None]:
    def change(frame: Frame) -> None:
        pose = np.array(json.loads(frame.stem.with_suffix(".json").read_bytes())["camera_to_world"])
        frame.told(camera_to_world=(pose @ frame.one(factors)).tolist())

    return change


def _value(key: str, values: tuple[Any, ...]) -> Callable[[Frame], None]:
    return lambda frame: frame.told(**{key: frame.one(values)})


def _gone(suffix: str) -> Callable[[Frame], None]:
    return lambda frame: frame.stem.with_name(frame.stem.name + suffix).unlink()


_NAN, _INF = float("nan"), float("inf")
_K = [[18.0, 0.0, 12.0], [0.0, 18.0, 9.0], [0.0, 0.0, 1.0]]
FAULTS: dict[str, Callable[[Frame], None]] = {
    "depth: NaN": _put("depth", (_NAN,)),
    "depth: 0 or less": _put("depth", (0.0, -1.0, -_INF)),
    "depth: extreme": _put("depth", (1e-38, 1e38)),
    "rgb": _put("rgb", (_NAN, _INF, -1.0, 1e38)),
    "flow": _put("flow", (_NAN, _INF, 1e38, -1e6)),
    "disparity": _put("disparity", (_NAN, _INF, -5.0, 1e38)),
    "codes": _put("occlusion", (99, 2**32 - 1)),
    "label without a name": _put("label.class", (99, 2**16, 2**32 - 1)),
    "instance without a line": _put("instance", (77, 2**32 - 1)),
    "pass gone": lambda f: f.passes(lambda a: a.pop(f.one(list(a)))),
    "pass cut": lambda f: f.passes(lambda a: a.update({k: v[:-1] for k, v in a.items()})),
    "label renamed": _renamed,
    "instance renumbered": _renumbered,
    "empty frame": _emptied,
    "line twice": lambda f: f.table(
        lambda c: c.update({k: np.concatenate([v, v]) for k, v in c.items()})
    ),
    "line gone": lambda f: f.table(lambda c: c.update({k: v[1:] for k, v in c.items()})),
    "column gone": lambda f: f.table(lambda c: c.pop(f.one(list(c)))),
    "column more": lambda f: f.table(lambda c: c.update({"more": c["pixels"]})),
    "class renamed": _row("class", _NAMES),
    "label unknown": _row("label.class", ("nothing", "Rock")),
    "pixels": _row("pixels", (0, 1e6)),
    "quaternion": _row("cam_qw", (0.0, 2.0, 1e200)),
    "size below 0": _row("size_y", (-1.0,)),
    "place": _row("cam_x", (1e300, -1e300)),
    "time": _value("time_s", _NUMBERS),
    "exposure": _value("exposure_ev", _NUMBERS),
    "resolution": _value("resolution", ([1, 1], [24, 19], [0, 0], [1e9, 1], "x")),
    "K": _value(
        "intrinsics",
        (
            [[0.0] * 3] * 3, [[1e300, 0.0, 1e300], *_K[1:]], [[-1.0, 0, 0], *_K[1:]],
            [*_K[:2], [1.0, 1.0, 1.0]],
        ),
    ),
    "K: skew": _value("intrinsics", ([[18.0, 3.0, 12.0], *_K[1:]],)),
    "pose: mirrored": _pose(np.diag([-1.0, 1, 1, 1]), np.diag([-1.0, -1, -1, 1])),
    "pose: none": _pose(np.zeros((4, 4)), np.diag([1.0, 2, 1, 1]), np.diag([1.0, 1, 1, 2])),
    "pose: far": lambda f: f.told(
        camera_to_world=[[1.0, 0, 0, 1e300], [0, 1, 0, 0], [0, 0, 1, 0], [0, 0, 0, 1]]
    ),
    "partner": _value("partner", (None, "nobody", "rover_left", "", 3)),
    "trigger": _value("trigger", ([2, 0], [1, 7], [0, 0], "x", None)),
    "lens": _value("lens", ({"model": "brown_conrady", "coefficients": [0.1] * 8}, {"model": "x"})),
    "stage": _value("stage_digest", ("0" * 64, "", None)),
    "camera": _value("camera", ("rover_middle", "", None)),
    "sample": _value("sample", (7, -1, None)),
    "labels": _value("labels", ({}, {"class": {}}, {"class": {"x": "y"}}, None)),
    "sky": _value("sky_labels", ({"class": 99}, {"nothing": 1}, {}, None, 3)),
    "passes": _value("passes", (["depth"], [], ["rgb", "nothing"], None)),
    "no picture": _value("png", (False, None)),
    "sidecar gone": _gone(".json"),
    "exr gone": _gone(".exr"),
    "picture gone": _gone(".png"),
    "table gone": _gone(".instances.csv"),
    "masks gone": _gone(".amodal.npz"),
}  # fmt: skip
#: Of these nothing right can be made by any format.
REFUSED = {
    "depth: NaN", "depth: 0 or less", "label without a name", "instance without a line",
    "pass gone", "pass cut", "line twice", "line gone", "label unknown", "pixels", "quaternion",
    "size below 0", "K", "resolution", "pose: mirrored", "pose: none", "pose: far", "stage",
    "camera", "sample", "sidecar gone", "exr gone", "picture gone", "table gone",
    "masks gone",
}  # fmt: skip
