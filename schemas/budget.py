"""Reads how many cores a process may use, and how many threads, if a caller has limited them."""

from __future__ import annotations

import os
import sys

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


def usable_cores() -> int:
    """Counts the cores that the process may use (its affinity)."""
    if sys.version_info >= (3, 13):
        return os.process_cpu_count() or 1
    return len(os.sched_getaffinity(0))
