"""Takes steps from the cache where their inputs are the same.

A step is a pure function with ``@memoized("name")``. Without a memo it is just called. Within
``memoizing(memo)`` its key is computed from all its arguments; what is kept under the key comes
back, or the function is called and what it returns is kept.

What a step returns, and what it is given, nobody changes afterwards: keys trust that. Arrays can be
written to nevertheless (for numba, read-only ones would be other types, and all kernels compiled
twice); ``Memo.changed`` says which were, and a test holds that none is.
"""

from __future__ import annotations

import functools
import hashlib
import inspect
import logging
from collections import Counter
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from contextvars import ContextVar
from pathlib import Path
from threading import Lock
from typing import Any, Concatenate

import numpy as np

from scenec.compiler.cache.digests import Digests
from scenec.compiler.cache.entry import packed, restored
from scenec.compiler.cache.fingerprint import fingerprint
from scenec.compiler.cache.store import FAULTS, Store
from scenec.compiler.cache.structure import Describer, NotPlainError, name_of_function, text_of
from scenec.schemas.files import Stamp, stamp

_log = logging.getLogger("scenec.incremental")
_current: ContextVar[Memo | None] = ContextVar("memo", default=None)


class Memo:
    """Caches the steps of one batch, and counts which were computed.

    Attributes:
        made: How often each step was made, by name.
        taken: How often it was taken from the cache.
    """

    def __init__(self, store: Store, hold: bool = False) -> None:
        """Takes the entries of a store.

        Args:
            store: The entries.
            hold: See ``Digests``.
        """
        self.made: Counter[str] = Counter()
        self.taken: Counter[str] = Counter()
        self._store = store
        self._digests = Digests(hold)
        self._files: dict[tuple[Path, Stamp], str] = {}
        # Steps of a batch are called by several threads.
        self._counting = Lock()

    def _count(self, counts: Counter[str], name: str) -> None:
        with self._counting:
            counts[name] += 1

    def call(
        self, name: str, function: Callable[..., Any], arguments: dict[str, Any]
    ) -> tuple[Any, bool]:
        """Returns a function's result, and whether it came from the cache.

        Args:
            name: Of the step, to be counted by.
            arguments: By name.
        """
        describer = Describer(self._digests, self._files)
        try:
            key = self.key(function, arguments, describer)
        except (NotPlainError, OSError) as error:
            _log.debug("%s: made each time: %s", name, error)
            self._count(self.made, name)
            return function(**arguments), False
        entry = self._store.find(key)
        if entry is not None:
            try:
                value = restored(entry, describer.files, self._digests)
            except FAULTS as error:
                self._store.drop(key, str(error))
            else:
                self._count(self.taken, name)
                return value, True
        self._count(self.made, name)
        value = function(**arguments)
        self._keep(name, key, value, describer)
        return value, False

    def key(
        self, function: Callable[..., Any], arguments: dict[str, Any], describer: Describer
    ) -> str:
        """SHA-256 of the code, the function and its arguments, in hexadecimal.

        Raises:
            NotPlainError: An argument is no plain data.
            OSError: A file among them cannot be read.
        """
        structure = describer.describe(arguments)
        text = f"{fingerprint()}\n{name_of_function(function)}\n{text_of(structure)}"
        return hashlib.sha256(text.encode()).hexdigest()

    def _keep(self, name: str, key: str, value: Any, describer: Describer) -> None:
        try:
            kept = packed(value, describer)
            changed = [p.name for p in describer.files.values() if (p, stamp(p)) not in self._files]
        except (NotPlainError, OSError) as error:
            _log.debug("%s: not kept: %s", name, error)
            return
        if changed:
            # The key is that of what they were.
            _log.debug("%s: not kept: %s has changed", name, changed[0])
            return
        self._store.put(key, kept)

    def changed(self) -> list[str]:
        """Arrays of steps that were changed after all: see ``Digests.changed``."""
        return self._digests.changed()


@contextmanager
def memoizing(memo: Memo | None) -> Iterator[None]:
    """Steps called in the block are taken from a memo; None: none is."""
    token = _current.set(memo)
    try:
        yield
    finally:
        _current.reset(token)


def memoized[**P, T](
    step: str, of: Callable[..., str] | None = None
) -> Callable[[Callable[P, T]], Callable[P, T]]:
    """Makes a pure function a step.

    Args:
        step: Its name, to be counted by.
        of: From the arguments by name, what comes after the name: "objects/rocks".
    """

    def decorated(function: Callable[P, T]) -> Callable[P, T]:
        signature = inspect.signature(function)

        @functools.wraps(function)
        def called(*args: P.args, **kwargs: P.kwargs) -> T:
            memo = _current.get()
            if memo is None:
                return function(*args, **kwargs)
            bound = signature.bind(*args, **kwargs)
            bound.apply_defaults()
            name = step if of is None else f"{step}/{of(**bound.arguments)}"
            value: T = memo.call(name, function, dict(bound.arguments))[0]
            return value

        return called

    return decorated


def memoized_file[**P](
    step: str,
) -> Callable[[Callable[Concatenate[Path, P], None]], Callable[Concatenate[Path, P], None]]:
    """Makes a function that writes one file a step; its bytes are kept.

    The function takes the file's path first, of which only the name may decide what it writes.

    Args:
        step: Its name; what it is counted by ends with the file's.
    """

    def decorated(
        function: Callable[Concatenate[Path, P], None],
    ) -> Callable[Concatenate[Path, P], None]:
        signature = inspect.signature(function)
        first = next(iter(signature.parameters))

        def called(path: Path, /, *args: P.args, **kwargs: P.kwargs) -> None:
            memo = _current.get()
            if memo is None:
                function(path, *args, **kwargs)
                return
            bound = signature.bind(path, *args, **kwargs)
            bound.apply_defaults()
            given = {name: value for name, value in bound.arguments.items() if name != first}

            @functools.wraps(function)
            def written(**_given: Any) -> Any:
                function(path, *args, **kwargs)
                return np.fromfile(path, np.uint8)

            arguments = {"": path.name, **given}
            content, taken = memo.call(f"{step}/{path.name}", written, arguments)
            if taken:
                path.parent.mkdir(parents=True, exist_ok=True)
                content.tofile(path)

        functools.update_wrapper(called, function)
        return called

    return decorated
