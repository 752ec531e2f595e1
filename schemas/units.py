"""Units of work, and who runs them: what compiling, rendering, scanning and exporting agree on.

All long work is cut into units: small, frozen descriptions that can be pickled. A unit can be run
again (it renames what it makes into place), in any process that sees the same files. A schedule
gives them out, and an executor runs them: this process (``LocalExecutor``), several, or a cluster
(``backends.run.executors``).
"""

from __future__ import annotations

import time
from collections import deque
from collections.abc import Callable, Generator, Hashable, Iterable
from contextlib import closing
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Protocol, Self, TypeVar

from scenec.schemas.errors import ScenecError
from scenec.schemas.lock import BusyError, Lock
from scenec.schemas.memory import available
from scenec.schemas.plugins import blaming

T = TypeVar("T")
#: Called with a line worth showing.
type Say = Callable[[str], None]
#: Called as ``progress(done, total, text)`` after each step.
type Progress = Callable[[int, int, str], None]

#: Seconds between two looks at what another process is making.
_LOOK_S = 0.1


@dataclass(frozen=True)
class Rest[T]:
    """Holds what remains of a unit when it needs no more of what its worker holds alone.

    Attributes:
        do: Does it, and returns what the unit would; called once, in whichever thread.
    """

    do: Callable[[], T]


class Keeper:
    """Holds one thing from one unit to the next in a worker, such as a stage that was read.

    Attributes:
        say: Told lines that a user should see.
        step: Told when a step of a unit begins; None: nobody listens.
        overlaps: Whether a worker does the rest of a unit while it runs the next.
    """

    def __init__(
        self, say: Say | None = None, step: Say | None = None, overlaps: bool = False
    ) -> None:
        self._name: Hashable = None
        self._kept: Any = None
        self._notes: list[str] = []
        self.say, self.step = say or self._notes.append, step
        self.overlaps = overlaps

    def notes(self) -> list[str]:
        """Returns lines that were said since the last call, where nobody listens."""
        said, self._notes[:] = list(self._notes), []
        return said

    def finish(self, rest: Callable[[], T]) -> T | Rest[T]:
        """Does the rest of a unit, or returns it for a worker that does it beside the next."""
        return Rest(rest) if self.overlaps else rest()

    def keep(self, name: Hashable, make: Callable[[], T]) -> T:
        """Returns what is held under a name, made if need be; what another name held is let go."""
        if self._name != name or self._kept is None:
            self._name = self._kept = None
            self._kept = make()
            self._name = name
        held: T = self._kept
        return held


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
        """Returns the name of what a worker must hold (``Keeper.keep``); None for nothing."""
        ...

    def run(self, keeper: Keeper) -> Any:
        """Do it; returns something that can be pickled.

        Raises:
            ScenecError: It cannot be done, however often it is tried.
        """
        ...


@dataclass
class Outcome:
    """Reports the outcome of a unit.

    Attributes:
        value: What it returned.
        error: Why there is none, or None.
        deaths: Workers that died, or were ended, over it.
        replaced: Workers that were replaced before it, as they had grown.
        warnings: A line for each death after which it was tried again.
        notes: A line for each replacement, and those that the unit said.
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
        """Takes units and runs them, until there are none; of those cut short nothing half is left.

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


class LocalExecutor:
    """Runs units in this process, one after the other: nothing to start, nothing to survive.

    A renderer's crash is this process's. For tests, and for programs that want no other process.

    Args:
        keeper: What is kept already, and who listens; None: nothing and nobody.
    """

    def __init__(self, keeper: Keeper | None = None) -> None:
        self._keeper = keeper or Keeper()

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self._keeper = Keeper()

    def prepare(self, folder: Path, device: str = "auto", backend: str = "") -> None:
        """See ``Executor``: this process sees what it sees."""

    def room(self, units: int) -> tuple[int, int]:
        """See ``Executor``."""
        return available(), 1

    def work(self, take: Take) -> Generator[tuple[Unit, Outcome]]:
        """See ``Executor``."""
        holds = None
        while (unit := take(holds)) is not None:
            outcome = Outcome()
            try:
                with blaming(unit.what):
                    outcome.value = unit.run(self._keeper)
            except ScenecError as error:
                outcome.error = error
            except BaseException:
                clean(unit)
                raise
            outcome.notes = self._keeper.notes()
            holds = unit.holds
            yield unit, outcome


def clean(unit: Unit) -> None:
    """Removes what a worker that died over a unit left half written."""
    getattr(unit, "clean", lambda: None)()


class Schedule:
    """Units that wait, given out so that workers rarely change what they keep.

    A worker is given a unit of what it keeps; else one of what no worker has kept yet; else one of
    what has most units waiting.

    Args:
        units: The first to wait.
        most: How many may be given out and not yet let go; None: any number.
        waiting: Told who runs a claimed unit that is waited for.
    """

    def __init__(
        self,
        units: Iterable[Unit] = (),
        most: int | None = None,
        waiting: Callable[[Any, str], None] = lambda _unit, _who: None,
    ) -> None:
        self._groups: dict[Hashable, deque[Unit]] = {}
        self._begun: set[Hashable] = set()
        self._claimed: list[Any] = []
        self._most, self._out = most, 0
        self._waiting = waiting
        self.add(*units)

    def add(self, *units: Unit) -> None:
        """Adds units to those that wait."""
        for unit in units:
            self._groups.setdefault(unit.holds, deque()).append(unit)

    def add_claimed(self, unit: Any) -> None:
        """Adds a unit that another process is running: it waits until all others have ended.

        Its ``claim`` is the lock file of who runs it.
        """
        self._claimed.append(unit)

    def withdraw(self, holds: Hashable, which: Callable[[Unit], bool]) -> list[Unit]:
        """Takes back units of one group that have not been given out; returns them."""
        found = [unit for unit in self._groups.get(holds, ()) if which(unit)]
        for unit in found:
            self._groups[holds].remove(unit)
        return found

    def release(self) -> None:
        """Lets go of a unit that has ended; whoever runs a schedule calls it once for each."""
        self._out -= 1

    def take(self, holds: Hashable) -> Unit | None:
        """Gives out a unit to a worker that keeps something; see ``Take``."""
        if self._most is not None and self._out >= self._most:
            return None
        group = self._groups.get(holds)
        if not group:
            fresh = (of for name, of in self._groups.items() if of and name not in self._begun)
            group = next(fresh, None) or max(self._groups.values(), key=len, default=None)
        if group:
            unit = group.popleft()
        elif self._claimed and not self._out:
            unit = self._wait()
        else:
            return None
        self._begun.add(unit.holds)
        self._out += 1
        return unit

    def _wait(self) -> Unit:
        """Returns the first unit that no other process is running any more."""
        while True:
            for unit in self._claimed:
                try:
                    with Lock(unit.claim, what=unit.what):
                        pass
                except BusyError as error:
                    self._waiting(unit, str(error))
                    continue
                self._claimed.remove(unit)
                return unit
            time.sleep(_LOOK_S)


def run_all(
    executor: Executor | None,
    units: Iterable[Unit],
    *,
    in_order: bool = False,
    ahead: int | None = None,
    ended: Callable[[Unit, Outcome], None] = lambda _unit, _outcome: None,
) -> Generator[tuple[Unit, Outcome]]:
    """Runs units that wait for nothing.

    Args:
        executor: Who runs them; None: this process.
        units: In the order in which they are given out.
        in_order: Whether to yield them in that order, not as they end.
        ahead: In order, how many may be given out and not yet yielded; None: any number. Such units
            all hold the same, as others are not given out in their order.
        ended: Called with each as it ends.

    Yields:
        Each unit and what came of it.

    Raises:
        ScenecError: Workers cannot be had.
    """
    units = list(units)
    assert ahead is None or len({unit.holds for unit in units}) <= 1
    schedule = Schedule(units, ahead)
    ready: dict[int, Outcome] = {}
    following = 0
    with closing((executor or LocalExecutor()).work(schedule.take)) as outcomes:
        for unit, outcome in outcomes:
            ended(unit, outcome)
            if not in_order:
                schedule.release()
                yield unit, outcome
                continue
            ready[id(unit)] = outcome
            while following < len(units) and id(units[following]) in ready:
                each = units[following]
                following += 1
                schedule.release()
                yield each, ready.pop(id(each))
