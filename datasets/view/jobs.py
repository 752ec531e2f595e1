"""The page's frames as units of work (``schemas.units``), handed on in order."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator
from contextlib import closing
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from scenec.datasets.source import FrameRef, Source, kind_of
from scenec.datasets.view.layers import Fineness
from scenec.datasets.view.record import Record, record
from scenec.schemas.errors import FrameError
from scenec.schemas.units import Executor, Keeper, LocalExecutor, run_all

#: Frames in work for each process: results wait for their turn, memory stays bounded.
_AHEAD = 4


@dataclass(frozen=True)
class Fault:
    """A frame that cannot be shown: ``damaged`` or ``foreign``, and why."""

    kind: str
    message: str


@dataclass(frozen=True)
class Task:
    """A frame to be stored.

    Attributes:
        source: Which of the sources it is in.
        ref: Which frame.
        fineness: How fine.
    """

    source: int
    ref: FrameRef
    fineness: Fineness


@dataclass(frozen=True)
class SourceNames:
    """Names the sources of a page, which a worker holds."""

    out: Path
    backends: tuple[str | None, ...]

    def open(self) -> list[Source]:
        """Looks for the frames."""
        return [Source(self.out, backend) for backend in self.backends]


@dataclass(frozen=True)
class _Apply:
    """Calls a function of the sources and an item; returns what it returns."""

    holds: SourceNames
    what: str
    function: Callable[[list[Source], Any], Any]
    item: Any

    def run(self, keeper: Keeper) -> Any:
        """Calls it."""
        return self.function(keeper.keep(self.holds, self.holds.open), self.item)


class Pool:
    """Stores frames by an executor, and knows their files.

    Args:
        names: Of the sources.
        executor: Who works; None: this process.
    """

    def __init__(self, names: SourceNames, executor: Executor | None) -> None:
        self._names, self._executor = names, executor or LocalExecutor()

    def records(self, tasks: Iterable[Task]) -> Iterator[Record | Fault]:
        """Yields what became of each task, in order.

        Raises:
            BackendError: Processes died over one, again and again.
        """
        return self.over(_make, tasks, lambda task: task.ref.name)

    def over[A, B](
        self,
        function: Callable[[list[Source], A], B],
        items: Iterable[A],
        name: Callable[[A], str] = str,
    ) -> Iterator[B]:
        """Yields ``function`` of the sources and each item, in order; a few are in work at a time.

        Raises:
            BackendError: Processes died over one, again and again.
        """
        units = [_Apply(self._names, name(item), function, item) for item in items]
        ahead = _AHEAD * max(1, self._executor.room(max(1, len(units)))[1])
        with closing(run_all(self._executor, units, in_order=True, ahead=ahead)) as ended:
            for _, outcome in ended:
                yield outcome.result()


def _make(sources: list[Source], task: Task) -> Record | Fault:
    try:
        # The picture is the PNG's: radiance need not be decoded, which is half of reading.
        frame = sources[task.source].load(task.ref, unused=("rgb",))
        return record(frame, task.fineness)
    except FrameError as error:
        return Fault(kind_of(error), str(error))
