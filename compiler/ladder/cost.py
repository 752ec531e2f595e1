"""What a rung costs: seconds of the processor, and bytes of what is really written."""

from __future__ import annotations

import tempfile
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path

from scenec.schemas.files import tree


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


def written(write: Callable[[Path], object]) -> int:
    """Bytes of the files that a call writes into an empty folder, which is then removed."""
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        write(folder)
        return sum((folder / path).stat().st_size for path in tree(folder))
