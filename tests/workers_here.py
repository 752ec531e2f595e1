"""Renders without a process of their own, for tests of what is in a frame and not of who made it.

A worker process costs seconds to start: Python, the libraries, every kernel. With
``SCENEC_WORKERS=0`` units run in the process that asks (``units.LocalExecutor``). Limits, deaths
and replacements are those of a process; what is said of them is tested with one
(``test_worker.py``, ``test_worker_faults.py``, ``test_commands.py``).

A test asks for it with ``pytest.mark.usefixtures("worker_here")``, a module whose fixtures render
with ``pytestmark = pytest.mark.usefixtures("workers_here")``.
"""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager

import pytest

from scenec.backends.run.executors import WORKERS


@contextmanager
def here() -> Iterator[None]:
    """While it lasts, units run in this process."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv(WORKERS, "0")
        yield


@pytest.fixture(scope="module")
def workers_here() -> Iterator[None]:
    """Until the module ends, units run in this process."""
    with here():
        yield


@pytest.fixture
def worker_here() -> Iterator[None]:
    """Until the test ends, units run in this process."""
    with here():
        yield
