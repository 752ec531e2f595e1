"""Renders without a process of their own, for tests of what is in a frame and not of who made it.

A worker process costs seconds to start: Python, the libraries, every kernel. Here its ``Worker``
answers the same requests in this process, as text both ways like through the pipe. Limits, deaths
and replacements are those of a process; what is said of them is tested with one
(``test_worker.py``, ``test_worker_faults.py``, ``test_commands.py``).

A test asks for it with ``pytest.mark.usefixtures("worker_here")``, a module whose fixtures render
with ``pytestmark = pytest.mark.usefixtures("workers_here")``.
"""

from __future__ import annotations

import json
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

import pytest

from scenec.backends.run import supervise as pool


@contextmanager
def here() -> Iterator[None]:
    """While it lasts, every ``WorkerProcess`` answers in this process."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(pool.WorkerProcess, "ask", _ask)
        patch.setattr(pool.WorkerProcess, "close", _close)
        yield


@pytest.fixture(scope="module")
def workers_here() -> Iterator[None]:
    """Until the module ends, every ``WorkerProcess`` answers in this process."""
    with here():
        yield


@pytest.fixture
def worker_here() -> Iterator[None]:
    """Until the test ends, every ``WorkerProcess`` answers in this process."""
    with here():
        yield


def _ask(self: Any, request: dict[str, Any], what: str) -> dict[str, Any]:
    # Imported here: most tests have no worker.
    from scenec.backends.run.worker import Worker

    if not hasattr(self, "here"):
        self.here = Worker()
    answer = self.here.answer(json.loads(json.dumps(request)))
    return pool._checked(json.loads(json.dumps(answer, allow_nan=False)))


def _close(self: Any) -> None:
    if hasattr(self, "here"):
        del self.here
