"""Reads how many threads a process may work with, if a caller has limited them."""

from __future__ import annotations

import os

#: What libraries that count threads themselves go by: numba, OpenMP, OpenBLAS, OpenUSD, Mesa. Our
#: kernels and the renderers go by the first.
THREADS = (
    *("NUMBA_NUM_THREADS", "OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS"),
    *("PXR_WORK_THREAD_LIMIT", "LP_NUM_THREADS"),
)


def thread_budget() -> int | None:
    """Threads by ``$NUMBA_NUM_THREADS``, which several workers are given; None: all cores."""
    text = os.environ.get(THREADS[0], "")
    return int(text) if text.isdecimal() and int(text) > 0 else None
