"""What holds for all tests."""

from __future__ import annotations

import os
import sys

# No test reads or fills the user's cache; those of the cache name a folder of their own.
os.environ["SCENEC_CACHE"] = ""
# Threads of kernels sleep while they wait for one another: where several test processes share few
# cores, those that spin (the default) keep busy the core that the other thread needs.
os.environ.setdefault("OMP_WAIT_POLICY", "passive")
# That bytes depend on no number of threads is seen where there is more than one.
if os.process_cpu_count() == 1:
    os.environ.setdefault("NUMBA_NUM_THREADS", "2")
# Byte code stays, whatever the environment says (an image of a container often forbids it): without
# it each test process rewrites every test's assertions again, and each of the hundreds of processes
# that tests start compiles the library's source.
os.environ.pop("PYTHONDONTWRITEBYTECODE", None)
sys.dont_write_bytecode = False

pytest_plugins = ["workers_here"]
