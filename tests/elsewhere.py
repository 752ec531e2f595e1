"""The same work in another process, in all circumstances that bytes do not depend on."""

from __future__ import annotations

import contextlib
import io
import json
import os
import subprocess
import sys
from functools import cache
from pathlib import Path
from unittest import mock

HERE = Path(__file__).parent
CIRCUMSTANCES = {
    "as it is": {},
    "another hash seed": {"PYTHONHASHSEED": "4711"},
    "one thread": {"NUMBA_NUM_THREADS": "1", "OMP_NUM_THREADS": "1", "PXR_WORK_THREAD_LIMIT": "1"},
    "another locale": {"LC_ALL": "tr_TR.UTF-8", "LANG": "tr_TR.UTF-8", "TZ": "Asia/Kathmandu"},
    "NumPy without AVX": {
        "NPY_DISABLE_CPU_FEATURES": "AVX512F AVX512CD AVX512_SKX AVX512_CLX AVX512_CNL AVX512_ICL "
        "AVX512_SPR AVX2 FMA3 X86_V3 X86_V4"
    },
    "glibc without FMA": {
        "GLIBC_TUNABLES": "glibc.cpu.hwcaps=-AVX2,-FMA,-FMA4,-AVX512F,-AVX2_Usable,-FMA_Usable"
    },
    "another BLAS kernel": {"OPENBLAS_CORETYPE": "Prescott"},
    "numba for a generic CPU": {"NUMBA_CPU_NAME": "generic", "NUMBA_CPU_FEATURES": ""},
    # A folder that cannot be made: nothing is found there, nothing kept.
    "kernels compiled anew": {"NUMBA_CACHE_DIR": "/dev/null/kernels"},
}
#: All but the last in one run; what fails there is taken apart by ``make thorough``
#: (``test_compile.py``).
ALL_AT_ONCE = {
    key: value for change in list(CIRCUMSTANCES.values())[:-1] for key, value in change.items()
}

COMPILE = """
import sys
from scenec.compiler.compile import compile_cfg
compile_cfg(sys.argv[1], seed=11, out=sys.argv[2])
"""

#: A line with code and arguments comes in, one with what the code printed goes out. An error ends
#: the process, which says it to standard error.
_SERVER = """
import contextlib, io, json, sys
replies, sys.stdout = sys.stdout, sys.stderr
for line in sys.stdin:
    code, sys.argv = json.loads(line)
    said = io.StringIO()
    with contextlib.redirect_stdout(said):
        exec(code, {"__name__": "elsewhere"})
    print(json.dumps(said.getvalue()), file=replies, flush=True)
"""


def printed_elsewhere(code: str, *arguments: object) -> str:
    """What a program prints in another process, in all circumstances at once.

    One process serves all tests: to start it, and to load or compile every kernel for another CPU,
    takes longer than what most of them ask of it. It sees modules of the compiler's tests.

    Args:
        code: The program; it finds its arguments in ``sys.argv[1:]``.
        arguments: Of the program, made text.
    """
    server = _server()
    assert server.stdin is not None
    assert server.stdout is not None
    # One that ended over an earlier program is replaced.
    if server.poll() is not None:
        _server.cache_clear()
        return printed_elsewhere(code, *arguments)
    server.stdin.write(json.dumps([code, ["", *map(str, arguments)]]) + "\n")
    server.stdin.flush()
    line = server.stdout.readline()
    assert line, f"the process elsewhere ended with status {server.wait()}; see its standard error"
    said: str = json.loads(line)
    return said


def printed_here(code: str, *arguments: object) -> str:
    """What a program prints in this process."""
    said = io.StringIO()
    argv = ["", *map(str, arguments)]
    with mock.patch.object(sys, "argv", argv), contextlib.redirect_stdout(said):
        exec(code, {"__name__": "here"})
    return said.getvalue()


def digest_elsewhere(module: str) -> str:
    """What ``module.digest()`` returns in all circumstances at once.

    Args:
        module: Of the compiler's tests.
    """
    return printed_elsewhere(f"import {module}; print({module}.digest())").strip()


@cache
def _server() -> subprocess.Popen[str]:
    rooms = HERE / "compiler"
    paths = os.pathsep.join(map(str, [HERE, rooms, *rooms.glob("*/")]))
    # It ends with this process, when its standard input does.
    return subprocess.Popen(
        [sys.executable, "-W", "ignore", "-c", _SERVER],
        env=os.environ | ALL_AT_ONCE | {"PYTHONPATH": paths},
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        text=True,
        encoding="utf-8",
    )
