"""What holds for all tests."""

from __future__ import annotations

import gc
import json
import os
import sys
from pathlib import Path

import pytest
from hypothesis import HealthCheck, settings

from scenec.schemas.budget import usable_cores

# No test reads or fills the user's cache; those of the cache name a folder of their own.
os.environ["SCENEC_CACHE"] = ""
# That bytes depend on no number of threads is seen where there is more than one.
if usable_cores() == 1:
    os.environ.setdefault("NUMBA_NUM_THREADS", "2")
# Byte code stays, whatever the environment says (an image of a container often forbids it): without
# it each test process rewrites every test's assertions again, and each of the hundreds of processes
# that tests start compiles the library's source.
os.environ.pop("PYTHONDONTWRITEBYTECODE", None)
sys.dont_write_bytecode = False

# No test fails for a slow moment, of which a shared machine has many.
PATIENT = settings(deadline=None, suppress_health_check=[HealthCheck.too_slow])
# `make test` draws the same few examples each time, `make thorough` others, and more, each time.
settings.register_profile("thorough", PATIENT, max_examples=100)
settings.register_profile("quick", PATIENT, max_examples=25, derandomize=True)
settings.load_profile("quick")

# A room's tests may take what stands beside another's; no two files have one name.
_COMPILER = Path(__file__).with_name("compiler")
sys.path += map(str, [_COMPILER, *sorted(_COMPILER.glob("*/"))])

pytest_plugins = ["workers_here"]

#: Seconds of the files that take long, as lab/benchmarks/durations.py measured them.
SECONDS = json.loads(Path(__file__).with_name("durations.json").read_text(encoding="utf-8"))


# What is collected stays to the end: it is not looked through for garbage again and again.
gc.disable()


def pytest_collection_finish() -> None:
    """What the tests leave is collected as ever."""
    gc.freeze()
    gc.enable()


def pytest_collection_modifyitems(config: pytest.Config, items: list[pytest.Item]) -> None:
    """Files that take long come first, so that no process of several works alone in the end."""
    if hasattr(config, "workerinput"):
        items.sort(key=lambda item: -SECONDS.get(item.nodeid.partition("::")[0], 0))
