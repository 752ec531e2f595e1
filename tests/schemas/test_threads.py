"""Work on all threads: everything is done once, whatever happens on the way."""

from __future__ import annotations

import os
import subprocess
import sys
from concurrent.futures import CancelledError, ThreadPoolExecutor
from contextvars import ContextVar
from threading import Event, Lock, get_ident

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.typing import NDArray

from scenec.schemas.threads import ALL, at_most, on_threads, over_threads, run_graph


@given(count=st.integers(0, 300), threads=st.integers(1, ALL))
def test_every_number_is_done_once(count: int, threads: int) -> None:
    done = np.zeros(count, np.int64)

    def kernel(first: int, last: int, done: NDArray[np.int64]) -> None:
        assert 0 <= first <= last <= count
        done[first:last] += 1

    with at_most(threads):
        over_threads(kernel, count, done)
    assert (done == 1).all()


def test_one_thread_is_the_callers_own() -> None:
    seen = set()
    with at_most(1):
        over_threads(lambda first, last: seen.add(get_ident()), 100)
    assert seen == {get_ident()}


def test_what_a_kernel_raises_is_raised() -> None:
    def kernel(first: int, last: int) -> None:
        if first <= 17 < last:
            raise ZeroDivisionError

    with pytest.raises(ZeroDivisionError):
        over_threads(kernel, 100)


def test_kernels_may_call_one_another_from_any_thread() -> None:
    counted, lock = [0], Lock()

    def inner(first: int, last: int) -> None:
        with lock:
            counted[0] += last - first

    def outer(first: int, last: int) -> None:
        for _ in range(first, last):
            over_threads(inner, 10)

    with ThreadPoolExecutor(4) as pool:
        for future in [pool.submit(over_threads, outer, 20) for _ in range(8)]:
            future.result()
    assert counted[0] == 8 * 20 * 10


_FOUR = """
import sys, threading, time
import numpy as np
from scenec.schemas.threads import over_threads

at_work = []

def kernel(first, last, wait):
    if first == last:
        return
    at_work.append(first)
    time.sleep(wait)
    if first == 0:
        raise ZeroDivisionError
    time.sleep(wait)
    at_work.remove(first)

try:
    over_threads(kernel, 400, 0.05)
except ZeroDivisionError:
    print(at_work, sys._getframe() is not None)

def late():
    time.sleep(0.3)
    done = np.zeros(100, int)
    def count(first, last):
        done[first:last] += 1
    over_threads(count, 100)
    print((done == 1).all())

threading.Thread(target=late).start()
"""


def test_what_one_raises_ends_the_others_and_nothing_writes_after_it() -> None:
    environment = {**os.environ, "NUMBA_NUM_THREADS": "4"}
    done = subprocess.run(
        [sys.executable, "-c", _FOUR], env=environment, capture_output=True, text=True
    )
    # Of four at work that which raised alone did not end; a thread that outlives the main one
    # works by itself.
    assert done.stdout.split() == ["[0]", "True", "True"], done.stderr


def test_few_numbers_are_not_worth_a_thread() -> None:
    seen: set[int] = set()
    over_threads(lambda first, last: seen.add(get_ident()), 100, least=100)
    assert seen == {get_ident()}


@pytest.fixture
def three_threads(monkeypatch):
    monkeypatch.setattr("scenec.schemas.threads.ALL", 3)
    with at_most(3):
        yield


@given(data=st.data())
def test_a_task_begins_once_those_it_needs_are_taken(data) -> None:
    count = data.draw(st.integers(0, 12))
    needs = [data.draw(st.sets(st.integers(0, n - 1))) if n else set() for n in range(count)]
    taken: list[int] = []

    def run(number: int) -> int:
        assert needs[number] <= {*taken}
        return number * number

    def take(number: int, result: int) -> None:
        assert result == number * number
        taken.append(number)

    run_graph(needs, run, take)
    assert sorted(taken) == list(range(count))


def test_tasks_run_beside_each_other_and_know_the_callers_context(three_threads) -> None:
    known = ContextVar("known", default="nothing")
    known.set("the caller's")
    begun = [Event(), Event()]

    def run(number: int) -> str:
        found = known.get()
        known.set("a task's")
        begun[number].set()
        begun[1 - number].wait()
        return found

    assert on_threads(run, range(2)) == ["the caller's"] * 2
    assert known.get() == "the caller's"


def test_tasks_before_one_that_fails_are_run_and_none_after_it_is_begun(three_threads) -> None:
    ended = Event()
    begun: list[int] = []

    def run(number: int) -> None:
        begun.append(number)
        if number == 2:
            ended.set()
            raise ZeroDivisionError
        if number == 0:
            ended.wait()
        if number == 1:
            raise KeyError(number)

    with at_most(2), pytest.raises(KeyError):
        run_graph([(), (0,), (), (2,), (1,), ()], run, lambda *_: None)
    assert sorted(begun) == [0, 1, 2]


def test_kernels_of_tasks_that_nobody_waits_for_any_more_end(three_threads) -> None:
    last = Event()

    def run(number: int) -> None:
        try:
            while number:
                over_threads(lambda first, last: None, 100)
        except CancelledError:
            last.set()
            raise

    def take(number: int, _result: None) -> None:
        raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        run_graph([(), ()], run, take)
    assert last.is_set()
