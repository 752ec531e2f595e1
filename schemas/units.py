"""Units of work, and who runs them: what compiling, rendering, scanning and exporting agree on.

All long work is cut into units: small, frozen descriptions that can be pickled. A unit can be run
again (it renames what it makes into place), in any process that sees the same files. An executor
runs them: here, in several processes, or on a cluster (``backends.run.executors``).
It takes units as it has hands free, and tells what came of each in the order in which they end.
"""

from __future__ import annotations

from collections.abc import Callable, Generator, Hashable, Iterable
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Protocol, Self, TypeVar

from scenec.schemas.errors import ScenecError
from scenec.schemas.plugins import blaming

T = TypeVar("T")


class Keeper:
    """What a worker keeps from one unit to the next: one thing, such as a stage that was read."""

    def __init__(self) -> None:
        self._name: Hashable = None
        self._kept: Any = None

    def keep(self, name: Hashable, make: Callable[[], T]) -> T:
        """What is kept under a name, made if it is not; what was kept under another is let go."""
        if self._name != name or self._kept is None:
            self._name = self._kept = None
            self._kept = make()
            self._name = name
        kept: T = self._kept
        return kept


class Unit(Protocol):
    """One piece of work. Implementations are frozen dataclasses of plain values.

    One may have a method ``clean``, which removes what a worker that died over it left half
    written; it is called on the worker's machine.
    """

    @property
    def what(self) -> str:
        """Its name in messages, such as ``batch_0000/rover_front/000003``."""
        ...

    @property
    def holds(self) -> Hashable:
        """What it needs a worker to keep (``Keeper.keep``'s name); None for nothing."""
        ...

    def run(self, keeper: Keeper) -> Any:
        """Do it; returns something that can be pickled.

        Raises:
            ScenecError: It cannot be done, however often it is tried.
        """
        ...


@dataclass
class Outcome:
    """What came of a unit.

    Attributes:
        value: What it returned.
        error: Why there is none, or None.
        deaths: Workers that died, or were ended, over it.
        replaced: Workers that were replaced before it, as they had grown.
        warnings: A line for each death after which it was tried again.
        notes: A line for each replacement.
    """

    value: Any = None
    error: ScenecError | None = None
    deaths: int = 0
    replaced: int = 0
    warnings: list[str] = field(default_factory=list)
    notes: list[str] = field(default_factory=list)

    def result(self) -> Any:
        """The value.

        Raises:
            ScenecError: There is none.
        """
        if self.error is not None:
            raise self.error
        return self.value


#: Gives out a unit to a worker that keeps something (``Unit.holds``); None: none is ready. It is
#: asked again after every outcome, and where nothing is under way there is none any more.
Take = Callable[[Hashable], Unit | None]


class Executor(Protocol):
    """Runs units. Used in a ``with``, at whose end no worker is left that it started."""

    def prepare(self, folder: Path, device: str = "auto", backend: str = "") -> None:
        """Make sure that workers can do what will be asked, before any work.

        Args:
            folder: They see it, and write there.
            device: They have it.
            backend: They have it, in the same version; "": none is needed.

        Raises:
            BackendError: One cannot; says which and why.
        """
        ...

    def room(self, units: int) -> tuple[int, int]:
        """Bytes that each worker may take, and how many work at once, of so many units.

        Raises:
            BackendError: Workers cannot be asked.
        """
        ...

    def work(self, take: Take) -> Generator[tuple[Unit, Outcome]]:
        """Take units and run them, until there are none.

        Args:
            take: Gives them out.

        Yields:
            Each unit that ended and what came of it. What is yielded may let others be given out.

        Raises:
            ScenecError: Workers cannot be had.
        """
        ...

    def __enter__(self) -> Self: ...

    def __exit__(self, *_: object) -> None: ...


def run_unit(unit: Unit, keeper: Keeper) -> Any:
    """Runs a unit in this process; returns what it returns.

    Raises:
        ScenecError: It cannot be done; ``PluginError`` where another package's code fails.
    """
    with blaming(unit.what):
        return unit.run(keeper)


def run_all(executor: Executor, units: Iterable[Unit]) -> Generator[tuple[Unit, Outcome]]:
    """As ``Executor.work``, of units that wait for nothing."""
    left = iter(units)
    return executor.work(lambda _holds: next(left, None))
