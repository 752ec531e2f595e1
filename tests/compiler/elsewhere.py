"""A module's ``digest()`` by another process, in all circumstances that bytes do not depend on."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

HERE = Path(__file__).parent
#: All at once: each run compiles or loads every kernel anew.
CHANGE = {
    "PYTHONPATH": os.pathsep.join([str(HERE), str(HERE.parent)]),
    "NUMBA_NUM_THREADS": "1",
    "NUMBA_CPU_NAME": "generic",
    "GLIBC_TUNABLES": "glibc.cpu.hwcaps=-AVX2,-FMA,-FMA4,-AVX512F",
    "NPY_DISABLE_CPU_FEATURES": "AVX2 FMA3 AVX512F",
}


def digest_elsewhere(module: str) -> str:
    """What ``module.digest()`` returns on one thread, without the CPU's extras.

    Args:
        module: Of this folder.
    """
    code = f"import {module}; print({module}.digest())"
    run = subprocess.run(
        [sys.executable, "-W", "ignore", "-c", code],
        env=os.environ | CHANGE, capture_output=True, text=True, check=True,
    )  # fmt: skip
    return run.stdout.strip()
