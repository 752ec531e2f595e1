"""Selects Mitsuba's variant on this machine: of CUDA, or of LLVM."""

from __future__ import annotations

import ctypes.util
import importlib
import importlib.metadata
import importlib.util
import os
from pathlib import Path
from typing import Any

from scenec.schemas import system_libraries
from scenec.schemas.budget import thread_budget
from scenec.schemas.errors import BackendError
from scenec.schemas.extras import install

#: Environment variable that names a variant, for those who want another one.
VARIANT_VARIABLE = "SCENEC_MITSUBA_VARIANT"
LLVM_VARIABLE = "DRJIT_LIBLLVM_PATH"
GPU = "cuda_ad_rgb"
FAST = "llvm_ad_rgb"
MEND = "Mend it with: pip install llvm-nanobind"
#: 14 and 15 abort on rendering, 19 and 21 work (measured); between them nobody has tried, and a
#: wrong guess ends the process.
MIN_LLVM = 19


def wheel_llvm() -> Path | None:
    """The libLLVM inside the ``llvm-nanobind`` wheel, found without importing the package."""
    try:
        files = importlib.metadata.files("llvm-nanobind") or []
    except importlib.metadata.PackageNotFoundError:
        return None
    for file in sorted(files, key=str):
        if "libLLVM" in file.name:
            path = Path(str(file.locate()))
            if path.is_file():
                return path
    return None


def load_mitsuba(device: str = "auto") -> Any:
    """Import Mitsuba with the fastest variant that works here, and set it.

    A process has one variant; the second call returns what the first one set.

    Args:
        device: "cpu", "cuda" (which traces with OptiX), or "auto": cuda where there is a driver for
            it and it works, cpu otherwise.

    Raises:
        BackendError: Mitsuba is not installed, or the variant or device asked for does not work.
    """
    # Dr.Jit reads the variable when a JIT variant is first set, so it has to stand before that.
    if not os.environ.get(LLVM_VARIABLE):
        library = wheel_llvm()
        if library is not None:
            os.environ[LLVM_VARIABLE] = str(library)
    try:
        mi = importlib.import_module("mitsuba")
    # Dr.Jit's own words for a library that is missing end in a NameError.
    except (ImportError, NameError) as error:
        absent = system_libraries.missing(system_libraries.OF_MITSUBA)
        raise BackendError(
            f"Mitsuba cannot be imported: {system_libraries.mend(absent)}"
            if absent and importlib.util.find_spec("mitsuba")
            else f"Mitsuba cannot be imported ({error}). Mend it with: {install('mitsuba')}"
        ) from error
    wanted = os.environ.get(VARIANT_VARIABLE)
    if mi.variant() is not None:
        if device != "auto" and mi.variant().startswith("cuda") != (device == "cuda"):
            raise BackendError(
                f"this process already runs Mitsuba as {mi.variant()}; it has no second device"
            )
        return mi
    choices = [wanted] if wanted else _choices(device)
    for variant in choices:
        try:
            if not variant.startswith(("llvm", "cuda")):
                raise RuntimeError("it takes a variant of LLVM or CUDA")
            mi.set_variant(variant)
            _probe(mi)
            _bound_threads()
        except (ImportError, RuntimeError) as error:
            if variant == choices[-1]:
                why = f" ({VARIANT_VARIABLE})" if wanted else f" (device {device})"
                mend = "" if wanted or variant == GPU else f". {MEND}"
                raise BackendError(
                    f"Mitsuba cannot run as {variant}{why}: {_first_line(error)}{mend}"
                ) from error
            continue
        return mi
    raise AssertionError("there is always a variant to try")


def _bound_threads() -> None:
    threads = thread_budget()
    if threads is not None:
        # All of Mitsuba works in Dr.Jit's pool of threads.
        importlib.import_module("drjit").set_thread_count(threads)


def _choices(device: str) -> list[str]:
    if device == "cuda":
        return [GPU]
    # Dr.Jit's first touch of a missing driver costs nothing, but prints; so it is looked for.
    gpu = [GPU] if device == "auto" and ctypes.util.find_library("cuda") else []
    return [*gpu, FAST]


def _probe(mi: Any) -> None:
    """Run a kernel: a missing LLVM shows only when something is compiled.

    An unsuitable one does not even raise: it ends the process amid a compilation ("Cannot select
    ... fminimum", versions 14 and 15), so its version is asked first.

    Raises:
        RuntimeError: LLVM is too old, or compiles nothing.
    """
    import drjit as dr

    if mi.variant().startswith("llvm"):
        version = dr.detail.llvm_version()
        if version[0] < MIN_LLVM:
            raise RuntimeError(f"LLVM {version[0]} is too old, it takes {MIN_LLVM}")
    x = dr.minimum(mi.Float(1.0, 2.0), dr.opaque(mi.Float, 1.5))
    dr.eval(x)


def _first_line(error: BaseException) -> str:
    return str(error).strip().splitlines()[0] if str(error).strip() else type(error).__name__
