"""Reads ``.blend`` files through Blender in a process of its own with all scripts off.

What is shown in the file's scene is taken, with its modifiers; parts are objects, under the names
of their parents. Blender computes modifiers with its own arithmetic: unlike all else that the
compiler reads, their last bits may change with the CPU.
"""

from __future__ import annotations

import importlib.util
import json
import os
import subprocess
import sys
import time
import zipfile
from pathlib import Path
from typing import Any

import numpy as np
import psutil

from scenec.compiler.arithmetic import elementary
from scenec.compiler.assets.looks import SAME_UV, FileLook, Slot, UvMap, reflectance
from scenec.compiler.assets.parts import MeshFileError
from scenec.compiler.assets.pictures import companion, embedded
from scenec.compiler.assets.shells import ParsedModel, Shell, placed
from scenec.compiler.geometry import affine
from scenec.schemas.extras import install
from scenec.schemas.files import once_per_file
from scenec.schemas.scratch import scratch_folder

#: What the process may take; a file that needs more is refused.
SECONDS = 300.0
MEMORY_SHARE = 0.5
_USER_VARIABLES = ("BLENDER_", "OCIO", "CYCLES_", "PYTHONSTARTUP")
#: Plain files, and those compressed by zstd or gzip.
_MAGIC = (b"BLENDER", b"\x28\xb5\x2f\xfd", b"\x1f\x8b")


def read_blend(file: Path, looks: bool) -> ParsedModel:
    """Reads a ``.blend`` file and the pictures beside it.

    Raises:
        MeshFileError: Blender is not installed, cannot read it, takes too long or too much memory,
            or ends at it; or a picture is missing.
    """
    with file.open("rb") as stream:
        if not stream.read(7).startswith(_MAGIC):
            raise MeshFileError("not a Blender file: it does not begin with 'BLENDER'")
    if importlib.util.find_spec("bpy") is None:
        raise MeshFileError(f"reading .blend needs the extra 'cycles': {install('cycles')}")
    document, arrays = _evaluated(file.resolve())
    pictures: list[Path] = []
    notes = tuple(document["notes"])
    materials = tuple(_look(file, values, arrays, pictures) for values in document["looks"])
    shells = tuple(_shell(values, arrays) for values in document["shells"])
    unit = float(document["unit_m"])
    return ParsedModel(shells, materials, unit, "z", tuple(dict.fromkeys(pictures)), notes)


@once_per_file(most=2)
def _evaluated(file: Path) -> tuple[dict[str, Any], dict[str, np.ndarray]]:
    """Returns the document and the arrays that the worker makes of a file."""
    with scratch_folder() as folder:
        out = Path(folder) / "model.npz"
        _run(file, out, Path(folder))
        fault = out.with_suffix(".fault")
        if fault.is_file():
            raise MeshFileError(fault.read_text(encoding="utf-8"))
        try:
            with np.load(out, allow_pickle=False) as stored:
                arrays = {name: stored[name] for name in stored.files}
        except (OSError, ValueError, zipfile.BadZipFile) as error:
            raise MeshFileError("Blender ended without an answer") from error
    return json.loads(str(arrays.pop("document"))), arrays


def _run(file: Path, out: Path, folder: Path) -> None:
    # No preferences, add-ons, color tables or start-up files of a user's.
    kept = {k: v for k, v in os.environ.items() if not k.startswith(_USER_VARIABLES)}
    with (folder / "log").open("w+b") as log:
        process = subprocess.Popen(
            [sys.executable, "-m", "scenec.compiler.assets.blend_worker", str(file), str(out)],
            stdin=subprocess.DEVNULL,
            stdout=log,
            stderr=log,
            cwd=folder,
            env={
                **kept,
                "BLENDER_USER_RESOURCES": str(folder / "user"),
                # Thumbnails of what failed, and what it leaves open when it ends.
                "XDG_CACHE_HOME": str(folder / "user"),
                "TMPDIR": str(folder),
            },
        )
        try:
            code = _watched(process)
        finally:
            if process.poll() is None:
                process.kill()
                process.wait()
        log.seek(0)
        last = log.read().decode("utf-8", errors="replace").strip().splitlines()[-1:]
    if code < 0:
        raise MeshFileError(f"Blender crashed at it (signal {-code})")
    if code > 0:
        raise MeshFileError(f"Blender failed at it: {' '.join(last)[:160]}")


def _watched(process: subprocess.Popen[bytes]) -> int:
    """The exit status of a process that keeps within its limits."""
    limit = MEMORY_SHARE * psutil.virtual_memory().total
    end = time.monotonic() + SECONDS
    while True:
        try:
            return process.wait(timeout=0.05)
        except subprocess.TimeoutExpired:
            pass
        if time.monotonic() > end:
            raise MeshFileError(f"Blender takes longer than {SECONDS:g} s over it")
        try:
            memory = psutil.Process(process.pid).memory_info().rss
        except psutil.Error:
            continue
        if memory > limit:
            raise MeshFileError(f"Blender takes more than {limit / 1e9:.1f} GB over it")


def _shell(values: dict[str, Any], arrays: dict[str, np.ndarray]) -> Shell:
    shell = Shell(
        values["path"],
        arrays[values["points"]].astype(np.float64),
        arrays[values["faces"]].astype(np.int64),
        {name: arrays[key] for name, key in values["uv"].items()},
        arrays[values["normals"]],
        None,
        arrays[values["material"]].astype(np.int64),
    )
    return placed(shell, np.array(values["matrix"], np.float64)).compact()


def _look(
    file: Path, values: dict[str, Any], arrays: dict[str, np.ndarray], pictures: list[Path]
) -> FileLook:
    slots: dict[str, Slot] = {}
    for kind, slot in values["slots"].items():
        label = slot["label"]
        if "packed" in slot:
            source: Any = embedded(arrays[slot["packed"]].tobytes())
        else:
            # Two slashes are Blender's sign for the file's own folder.
            name = slot["file"]
            source = companion(file, name[2:] if name.startswith("//") else name, "picture")
            pictures.append(source)
        slots[kind] = Slot(source, label, slot["channel"], 1.0, 0.0, slot["uv_set"], _uv_map(slot))
    red, green, blue = values["base_color"]
    return FileLook(
        values["name"],
        (red, green, blue),
        values["roughness"],
        values["metallic"],
        # Half is where the index of refraction alone counts.
        2.0 * values["specular_level"] * reflectance(values["ior"]),
        slots,
        tuple(dict.fromkeys(values["notes"])),
        all(slot["repeats"] for slot in values["slots"].values()),
    )


def _uv_map(slot: dict[str, Any]) -> UvMap:
    """A Mapping node of the type Point: scale, rotation, location, in this order."""
    (x, y), (wide, high) = slot["location"], slot["scale"]
    if (x, y, wide, high, slot["angle"]) == (0, 0, 1, 1, 0):
        return SAME_UV
    s, c = affine.sin_cos(slot["angle"] * (180.0 / elementary.PI))
    return (c * wide, -s * high, x, s * wide, c * high, y)
