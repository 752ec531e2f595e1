"""What holds for all tests."""

from __future__ import annotations

import os
import sys

from hypothesis import HealthCheck, settings

# No test reads or fills the user's cache; those of the cache name a folder of their own.
os.environ["SCENEC_CACHE"] = ""
# That bytes depend on no number of threads is seen where there is more than one.
if os.process_cpu_count() == 1:
    os.environ.setdefault("NUMBA_NUM_THREADS", "2")
# Byte code stays, whatever the environment says (an image of a container often forbids it): without
# it each test process rewrites every test's assertions again, and each of the hundreds of processes
# that tests start compiles the library's source.
os.environ.pop("PYTHONDONTWRITEBYTECODE", None)
sys.dont_write_bytecode = False

# No test fails for a slow moment, of which a shared machine has many.
settings.register_profile("patient", deadline=None, suppress_health_check=[HealthCheck.too_slow])
settings.load_profile("patient")

pytest_plugins = ["workers_here"]
