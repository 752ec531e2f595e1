"""Measures a rung's cost: seconds of the processor, and bytes of what is really written."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path

from scenec.schemas.files import tree
from scenec.schemas.scratch import scratch_folder

#: Less than so many seconds of the processor are no reading: what takes less is repeated.
ENOUGH_S = 0.3
#: A first call of less than so many times that may be one of loading, and does not count.
_FIRST = 3.0
#: Repetitions at most: the clock ticks in hundredths of a second on some systems, and so much
#: work that hardly needs the processor waits for something else.
_MOST = 100


@dataclass
class Clock:
    """Seconds of the processor, all threads together."""

    seconds: float = 0.0

    @contextmanager
    def running(self) -> Iterator[None]:
        """Adds the time of a ``with`` block."""
        start = time.process_time()
        yield
        self.seconds += time.process_time() - start

    def mean[T](self, work: Callable[[], T]) -> T:
        """Adds what a call takes, and returns what it returned first.

        A call of less than three times ``ENOUGH_S`` only loads and fills what later ones find: it
        is repeated until ``ENOUGH_S`` has been used, or a hundred times, and the repetitions' mean
        counts. A longer one is a single reading.

        Args:
            work: Gives the same each time.
        """
        start = time.process_time()
        found = work()
        took = time.process_time() - start
        if took < _FIRST * ENOUGH_S:
            start, count = time.process_time(), 0
            while count < _MOST and (count == 0 or time.process_time() - start < ENOUGH_S):
                work()
                count += 1
            took = (time.process_time() - start) / count
        self.seconds += took
        return found


def written(write: Callable[[Path], object]) -> int:
    """Bytes of the files that a call writes into an empty folder, which is then removed."""
    with scratch_folder() as name:
        folder = Path(name)
        write(folder)
        return sum((folder / path).stat().st_size for path in tree(folder))
