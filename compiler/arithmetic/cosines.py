"""Transforms of real fields into cosines and sines: SciPy's DCT and DST, along axes.

The compiled part of ``scipy.fft`` is loaded by itself where it is where SciPy 1.18 has it: the
package around it imports special functions and linear algebra for transforms that nobody asks for
here (0.3 CPU s). The bits are the same.
"""

from __future__ import annotations

import importlib.util
from collections.abc import Callable
from functools import cache
from importlib.machinery import PathFinder
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

_Transform = Callable[..., NDArray[np.float64]]
# How the compiled part numbers norms: none, and division by the number of samples.
_PLAIN, _MEAN = 0, 2


def dct(field: NDArray[np.float64], *axes: int, over: bool = False) -> NDArray[np.float64]:
    """DCT-II along axes, of all where none is named.

    Args:
        field: float64.
        axes: Along which.
        over: The field may be overwritten.
    """
    return _transformed("dct", 2, field, axes, over)


def idct(modes: NDArray[np.float64], *axes: int, over: bool = False) -> NDArray[np.float64]:
    """Inverts ``dct``."""
    return _transformed("dct", -2, modes, axes, over)


def dst(field: NDArray[np.float64], axis: int) -> NDArray[np.float64]:
    """DST-I along an axis: between samples that are zero."""
    return _transformed("dst", 1, field, (axis,), False)


def idst(modes: NDArray[np.float64], axis: int) -> NDArray[np.float64]:
    """Inverts ``dst``."""
    return _transformed("dst", -1, modes, (axis,), False)


def _transformed(
    name: str, kind: int, field: NDArray[np.float64], axes: tuple[int, ...], over: bool
) -> NDArray[np.float64]:
    """One transform; kinds below zero are inverse."""
    axes = axes or tuple(range(field.ndim))
    compiled = _compiled()
    if compiled is None:
        import scipy.fft

        front: _Transform = getattr(scipy.fft, f"{'i' * (kind < 0)}{name}n")
        return front(field, type=abs(kind), axes=axes, overwrite_x=over)
    # The inverse of the second kind is the third.
    number, norm = (abs(kind), _PLAIN) if kind > 0 else ({1: 1, 2: 3}[-kind], _MEAN)
    transform: _Transform = getattr(compiled, name)
    return transform(field, number, axes, norm, field if over else None, 1, None)


@cache
def _compiled() -> Any:
    """SciPy's compiled transforms; None where they are not where they were."""
    scipy = importlib.util.find_spec("scipy")
    folders = scipy.submodule_search_locations if scipy else None
    inside = [str(Path(folder, "fft", "_duccfft")) for folder in folders or ()]
    spec = PathFinder.find_spec("pyduccfft", inside)
    if spec is None or spec.loader is None:
        return None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module
