"""Blender as a library: imported apart from its user's set-up, silent, one kind of device."""

from __future__ import annotations

import contextlib
import importlib
import importlib.util
import os
import sys
from collections.abc import Callable, Iterator
from functools import lru_cache
from pathlib import Path
from typing import Any

from scenec.schemas.errors import BackendError
from scenec.schemas.extras import install
from scenec.schemas.notice import waiting_for
from scenec.schemas.scratch import scratch_folder
from scenec.schemas.system_libraries import OF_BLENDER, mend, missing

#: Cycles' names of the devices there are beside the CPU, fastest first.
GPU_KINDS = {"optix": "OPTIX", "cuda": "CUDA"}
#: Variables that lead Blender to files of its user's: preferences, start-up scripts, color tables.
_USER_VARIABLES = ("BLENDER_", "OCIO", "CYCLES_")
#: Everything that this package makes in Blender's data.
_KINDS = ("scenes", "collections", "objects", "meshes", "cameras", "lights", "worlds", "materials",
          "node_groups", "images")  # fmt: skip


@lru_cache(maxsize=1)
def load_bpy() -> Any:
    """Import Blender and empty it: factory settings, no scripts, no add-ons but Cycles itself.

    Raises:
        BackendError: It is not installed.
    """
    with _no_user_files(), quiet():
        try:
            bpy = importlib.import_module("bpy")
        except ImportError as error:
            other, absent = _foreign_tbb(), missing(OF_BLENDER)
            if absent and not other and importlib.util.find_spec("bpy"):
                raise BackendError(f"Blender cannot be imported: {mend(absent)}") from error
            what = (
                f"this process has loaded {other}, and Blender's libraries have a newer TBB of "
                "their own: load Blender before OpenCV, numba's parallel=True or whatever took it"
                if other
                else f"mend it with: {install('cycles')}"
            )
            raise BackendError(f"Blender cannot be imported ({error}); {what}") from error
        bpy.ops.wm.read_factory_settings(use_empty=True)
    # Blender makes a folder for its session, and removes it only where the process ends in good
    # order, which workers do not. Nothing here uses it, and it comes back when it is needed.
    with contextlib.suppress(OSError):
        Path(bpy.app.tempdir).rmdir()
    preferences = bpy.context.preferences
    preferences.filepaths.use_scripts_auto_execute = False
    preferences.edit.use_global_undo = False
    # The choice of a sampling pattern is among the options for developers.
    preferences.view.show_developer_ui = True
    preferences.experimental.use_cycles_debug = True
    return bpy


def _foreign_tbb() -> str | None:
    """The file of a TBB in this process that is not Blender's; None where that is not known."""
    try:
        lines = Path("/proc/self/maps").read_text(encoding="utf-8", errors="replace").splitlines()
    except OSError:
        return None
    files = {line.split(maxsplit=5)[-1] for line in lines if "/libtbb.so" in line}
    return next((name for name in sorted(files) if "/bpy/" not in name), None)


def choose_device(bpy: Any, device: str, works: Callable[[str], bool]) -> str:
    """Set the device in the preferences that this process holds; returns its name.

    Args:
        bpy: Blender.
        device: "auto" (a GPU that Cycles finds and that works, else the CPU), "cpu", "cuda" or
            "optix".
        works: Tries a device that has been set.

    Raises:
        BackendError: The device asked for is not there, or does not work.
    """
    preferences = bpy.context.preferences.addons["cycles"].preferences
    for name in GPU_KINDS if device == "auto" else [device]:
        if name == "cpu" or not _select(preferences, GPU_KINDS[name]):
            continue
        what = (
            f"cycles: waits for Blender's kernels for {name}; where it brings none for the GPU, "
            "its driver compiles them, once: some ten minutes of one core"
        )
        with contextlib.nullcontext() if name == "cpu" else waiting_for(what):
            fine = works(name)
        if fine:
            return name
        if device != "auto":
            raise BackendError(
                f"cycles: the {device} device is there but cannot render; update its driver, or "
                "use --device cpu"
            )
    if device in ("auto", "cpu"):
        return "cpu"
    raise BackendError(
        f"cycles: no {device} device here; it needs an NVIDIA GPU and its driver. "
        "Use --device auto or --device cpu"
    )


def _select(preferences: Any, kind: str) -> bool:
    """Use all GPUs of a kind, and nothing else; whether there are any."""
    with quiet():
        try:
            found = [d for d in preferences.get_devices_for_type(kind) if d.type == kind]
            if found:
                preferences.compute_device_type = kind
        except (TypeError, ValueError, RuntimeError):
            # Not among the kinds that this build of Blender knows.
            return False
    for entry in preferences.devices:
        entry.use = entry.type == kind
    return bool(found)


def everything(bpy: Any) -> set[tuple[str, str]]:
    """Kind and name of all of Blender's data that this package has a hand in."""
    return {(kind, block.name) for kind in _KINDS for block in getattr(bpy.data, kind)}


def remove(bpy: Any, names: list[tuple[str, str]]) -> None:
    """Remove data by kind and name; what is gone already is none of our business."""
    found = [getattr(bpy.data, kind).get(name) for kind, name in names]
    bpy.data.batch_remove([block for block in found if block is not None])


@contextlib.contextmanager
def passing_file() -> Iterator[Path]:
    """A path for Blender to write and for us to read, gone afterwards.

    In memory and without a name where the system has such files: as fast as a RAM disk, without its
    limit, and nothing is left of it however the process ends.
    """
    descriptors = Path("/proc/self/fd")
    if hasattr(os, "memfd_create") and descriptors.is_dir():
        number = os.memfd_create("scenec")
        try:
            yield descriptors / str(number)
        finally:
            os.close(number)
    else:
        with scratch_folder() as folder:
            yield Path(folder, "picture.exr")


@contextlib.contextmanager
def quiet() -> Iterator[None]:
    """Keep off standard output what Blender says while it works."""
    sys.stdout.flush()
    kept = os.dup(1)
    sink = os.open(os.devnull, os.O_WRONLY)
    try:
        os.dup2(sink, 1)
        yield
    finally:
        os.dup2(kept, 1)
        os.close(kept)
        os.close(sink)


@contextlib.contextmanager
def _no_user_files() -> Iterator[None]:
    """An environment in which Blender finds no preferences, scripts or color tables of a user's."""
    kept = {k: v for k, v in os.environ.items() if k.startswith(_USER_VARIABLES)}
    for name in kept:
        del os.environ[name]
    with scratch_folder() as empty:
        os.environ["BLENDER_USER_RESOURCES"] = empty
        try:
            yield
        finally:
            del os.environ["BLENDER_USER_RESOURCES"]
            os.environ.update(kept)
