"""Stages with every fault that a file can have, and what reading each of them comes to.

Each is read in a process forked for it: what USD does not survive is an outcome like others.
"""

from __future__ import annotations

import json
import os
import subprocess
import sys
from collections.abc import Iterator, Sequence
from pathlib import Path

import numpy as np
from pxr import Gf, Sdf, Usd, Vt

READ, REFUSED = "read", "refused"

_T = Sdf.ValueTypeNames
_NAN = float("nan")
#: Values that hardly any attribute can have: type and value; None is an opinion without a value.
WRONG = {
    "string": (_T.String, "wrong"), "float": (_T.Float, 1.5), "negative": (_T.Int, -3),
    "huge": (_T.Int64, 2**62), "nan": (_T.Double, _NAN), "infinite": (_T.Float, float("inf")),
    "bool": (_T.Bool, True), "token[]": (_T.TokenArray, Vt.TokenArray(["a", "b"])),
    "int[]": (_T.IntArray, Vt.IntArray([7, -1, 2**31 - 1])),
    "empty": (_T.FloatArray, Vt.FloatArray()),
    "nan[]": (_T.DoubleArray, Vt.DoubleArray([_NAN, 1.0])),
    "nan3[]": (_T.Vector3fArray, Vt.Vec3fArray([Gf.Vec3f(_NAN, 0.0, 1.0)])),
    "nan3": (_T.Float3, Gf.Vec3f(1.0, _NAN, 0.0)), "double2[]": (_T.Double2Array, Vt.Vec2dArray(3)),
    "matrix": (_T.Matrix4d, Gf.Matrix4d(_NAN)), "quath[]": (_T.QuathArray, Vt.QuathArray(2)),
    "asset": (_T.Asset, Sdf.AssetPath("./nowhere.png")),
    "timecode": (_T.TimeCode, Sdf.TimeCode(1.0)),
}  # fmt: skip


def attributes(stage: Path) -> list[str]:
    """Paths of attributes, one of each name and type of prim: authored ones, and the schemas'."""
    found: dict[tuple[str, str], str] = {}
    opened = Usd.Stage.Open(str(stage))
    for prim in Usd.PrimRange.Stage(opened, Usd.PrimAllPrimsPredicate):
        for attribute in prim.GetAttributes():
            found.setdefault(
                (str(prim.GetTypeName()), attribute.GetName()), str(attribute.GetPath())
            )
    return sorted(found.values())


def over(stage: Path, out: Path) -> Sdf.Layer:
    """A layer of which a stage is the one sublayer, with the same metadata."""
    layer = Sdf.Layer.CreateNew(str(out))
    base = Sdf.Layer.FindOrOpen(str(stage))
    for name in base.pseudoRoot.ListInfoKeys():
        if name not in ("subLayers", "subLayerOffsets"):
            layer.pseudoRoot.SetInfo(name, base.pseudoRoot.GetInfo(name))
    layer.subLayerPaths.append("./" + os.path.relpath(stage, out.parent))
    return layer


def with_value(stage: Path, path: str, kind: str, out: Path) -> Path:
    """A layer over a stage in which an attribute is something else, at its times, too."""
    layer = over(stage, out)
    place = Sdf.Path(path)
    prim = Sdf.CreatePrimInLayer(layer, place.GetPrimPath())
    value_type, value = WRONG[kind]
    spec = Sdf.AttributeSpec(prim, place.name, value_type)
    spec.default = value
    layer.SetTimeSample(place, layer.startTimeCode, value)
    layer.Save()
    return out


def flipped(data: bytes, rng: np.random.Generator) -> bytes:
    """The bytes of a file with a bit turned, or cut off, or with a stretch of zeros or noise."""
    kind = rng.integers(0, 8)
    at = int(rng.integers(0, len(data)))
    if kind == 0:
        return data[:at]
    if kind == 1:
        return data[:at] + bytes(min(64, len(data) - at)) + data[at + 64 :]
    if kind == 2:
        return data[:at] + rng.bytes(min(16, len(data) - at)) + data[at + 16 :]
    if kind == 3:
        # The table of contents and the sections' heads lie at the end.
        at = len(data) - 1 - int(rng.integers(0, min(600, len(data))))
    if kind == 4:
        at = int(rng.integers(0, min(88, len(data))))
    turned = data[at] ^ (1 << int(rng.integers(0, 8)))
    return data[:at] + bytes([turned]) + data[at + 1 :]


def rewritten(text: str, rng: np.random.Generator) -> str:
    """Text with a few characters lost, doubled, exchanged or put in."""
    for _ in range(int(rng.integers(1, 4))):
        at = int(rng.integers(0, len(text)))
        kind = rng.integers(0, 5)
        if kind == 0:
            text = text[:at] + text[at + int(rng.integers(1, 30)) :]
        elif kind == 1:
            text = text[:at] + '"(){}[]@<>=#,.:-\n0aé\0'[int(rng.integers(0, 21))] + text[at:]
        elif kind == 2:
            lines = text.splitlines(keepends=True)
            line = int(rng.integers(0, len(lines)))
            del lines[line]
            text = "".join(lines)
        elif kind == 3:
            words = ["nan", "inf", "1e999", "-1", "99999999999", "None", "true", '"x"', "[]", "()"]
            digits = [i for i, character in enumerate(text) if character.isdigit()]
            if digits:
                at = digits[int(rng.integers(0, len(digits)))]
                text = text[:at] + words[int(rng.integers(0, len(words)))] + text[at + 1 :]
        else:
            other = int(rng.integers(0, len(text)))
            text = text[:at] + text[other : other + 20] + text[at:]
    return text


def outcomes(stages: Sequence[Path], allow_missing: bool = False) -> Iterator[tuple[str, str]]:
    """``READ``, ``REFUSED``, or what else came of each; and what was said."""
    request = json.dumps([allow_missing, [str(stage) for stage in stages]])
    done = subprocess.run(
        [sys.executable, __file__], input=request, capture_output=True, text=True, check=False
    )
    assert done.returncode == 0, done.stderr
    for line in done.stdout.splitlines():
        outcome, text = json.loads(line)
        yield outcome, text


def _child(path: str, allow_missing: bool, pipe: int) -> None:
    from scenec.backends.stage.read import read_stage
    from scenec.schemas.errors import StageError

    try:
        scene = read_stage(path, allow_missing=allow_missing)
        assert np.isfinite(scene.rows.to_world).all()
        found = [READ, "; ".join(scene.losses)]
    except StageError as error:
        found = [REFUSED, str(error)]
    except BaseException as error:  # noqa: BLE001 - what it is, is the answer
        import traceback

        last = traceback.extract_tb(error.__traceback__)[-1]
        where = [f for f in traceback.extract_tb(error.__traceback__) if "reader" in f.filename]
        last = where[-1] if where else last
        found = [f"{type(error).__name__}", f"{Path(last.filename).name}:{last.lineno}: {error}"]
    os.write(pipe, json.dumps(found)[:60_000].encode())


def _serve() -> None:
    from scenec.backends.stage import placing

    placing.rotations(np.zeros((1, 4)))
    allow_missing, paths = json.loads(sys.stdin.read())
    for path in paths:
        read, write = os.pipe()
        pid = os.fork()
        if pid == 0:
            # A damaged file can state sizes beyond all bounds.
            import resource

            resource.setrlimit(resource.RLIMIT_AS, (6 << 30, 6 << 30))
            resource.setrlimit(resource.RLIMIT_CPU, (60, 60))
            resource.setrlimit(resource.RLIMIT_CORE, (0, 0))
            _child(path, allow_missing, write)
            os._exit(0)
        os.close(write)
        with os.fdopen(read, "rb") as pipe:
            text = pipe.read()
        status = os.waitpid(pid, 0)[1]
        died = os.waitstatus_to_exitcode(status)
        print(text.decode() if text and died == 0 else json.dumps([f"died {died}", ""]))


if __name__ == "__main__":
    _serve()
