"""Which Mitsuba runs here: the vectorized LLVM variant, or the scalar one as a last resort."""

from __future__ import annotations

import importlib
import importlib.metadata
import os
from pathlib import Path
from typing import Any

from scenec.schemas.errors import BackendError

#: Environment variable that names a variant, for those who want another one.
VARIANT_VARIABLE = "SCENEC_MITSUBA_VARIANT"
LLVM_VARIABLE = "DRJIT_LIBLLVM_PATH"
FAST = "llvm_ad_rgb"
SLOW = "scalar_rgb"

#: Measured on two cores, 640x480, 64 samples a pixel, 310,000 triangles, sun and sky.
SCALAR_WARNING = (
    "Mitsuba runs as scalar_rgb, about {factor} times slower than llvm_ad_rgb: no LLVM library was "
    "found. Mend it with: pip install llvm-nanobind"
)
SCALAR_FACTOR = 6


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


def load_mitsuba() -> Any:
    """Import Mitsuba with the fastest variant that works here, and set it.

    A process has one variant; the second call returns what the first one set.

    Raises:
        BackendError: Mitsuba is not installed, or the variant asked for does not work.
    """
    # Dr.Jit reads the variable when a JIT variant is first set, so it has to stand before that.
    if not os.environ.get(LLVM_VARIABLE):
        library = wheel_llvm()
        if library is not None:
            os.environ[LLVM_VARIABLE] = str(library)
    try:
        mi = importlib.import_module("mitsuba")
    except ImportError as error:
        raise BackendError(
            f"Mitsuba cannot be imported ({error}). Mend it with: pip install 'scenec[mitsuba]'"
        ) from error
    if mi.variant() is not None:
        return mi
    wanted = os.environ.get(VARIANT_VARIABLE)
    for variant in [wanted] if wanted else [FAST, SLOW]:
        try:
            mi.set_variant(variant)
            if variant != SLOW:
                _probe(mi)
        except (ImportError, RuntimeError) as error:
            if wanted:
                raise BackendError(
                    f"Mitsuba cannot run as {wanted} ({VARIANT_VARIABLE}): {_first_line(error)}"
                ) from error
            continue
        return mi
    raise BackendError("no variant of Mitsuba works here: neither llvm_ad_rgb nor scalar_rgb")


def scalar_warning() -> str:
    """The line a user should see when rendering falls back to ``scalar_rgb``."""
    return SCALAR_WARNING.format(factor=SCALAR_FACTOR)


def _probe(mi: Any) -> None:
    """Run a kernel: a missing or unsuitable LLVM shows only when something is compiled."""
    import drjit as dr

    x = dr.minimum(mi.Float(1.0, 2.0), dr.opaque(mi.Float, 1.5))
    dr.eval(x)


def _first_line(error: BaseException) -> str:
    return str(error).strip().splitlines()[0] if str(error).strip() else type(error).__name__
