"""Work in other processes: many calls with their results in order, and one call in the background."""

from __future__ import annotations

import os
import pickle
import signal
from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import AbstractContextManager, nullcontext, suppress
from functools import cached_property, lru_cache
from itertools import islice
from multiprocessing import Pipe
from multiprocessing.connection import Connection
from time import perf_counter
from typing import Any, Generic, TypeVar

from joblib import Parallel, parallel_config, wrap_non_picklable_objects
from joblib.externals.loky.backend import get_context
from joblib.parallel import get_active_backend

from pinposture import kernels
from pinposture._validation import is_whole
from pinposture.errors import InvalidValue

Value = TypeVar("Value")

Progress = Callable[[int, int], object]
"""Called with the number of calls finished so far, and that of all."""

TRIAL_TIME = 1.0
"""Time in this process before the time that is left is estimated [s]."""

START_TIME = 5.0
"""Estimated time left from which processes are started [s]: their start takes 3 to 5 s."""


PORTION = 200
"""Calls sent together to a backend that returns results only when it has all of them, as Ray's does."""


class Shared(Generic[Value]):
    """A value that all calls share: pickled once, and unpickled once in each process.

    Attributes:
        value: the value; in this process the same object.
    """

    def __init__(self, value: Value) -> None:
        self.value = value

    @cached_property
    def _packed(self) -> bytes:
        # Not pickled alone: scripts and notebooks have controllers that other processes cannot import.
        return pickle.dumps(wrap_non_picklable_objects(self.value, keep_wrapper=False))

    def __reduce__(self) -> tuple[Any, ...]:
        return _unpacked, (self._packed,)


@lru_cache(maxsize=1)
def _unpacked(packed: bytes) -> Shared[Any]:
    return Shared(pickle.loads(packed))


def check_jobs(jobs: int) -> None:
    """Raise InvalidValue unless that can be a number of processes."""
    if not (is_whole(jobs) and (jobs >= 1 or jobs == -1)):
        raise InvalidValue("jobs", jobs, "a whole number of at least 1, or -1 for all there can be")


def in_order(tasks: Iterable[Any], jobs: int) -> Iterator[Any]:
    """The results of delayed calls in the order of the calls, each as soon as those before it are there.

    Short calls are sent in bundles. Processes that are started here leave the threads of BLAS out: they would
    be in each other's way.

    Args:
        tasks: calls made with `joblib.delayed`.
        jobs: number of processes; joblib's backends apply, so a cluster serves as well.

    Raises:
        InvalidValue: not a number of processes.
    """
    check_jobs(jobs)
    return _distribute(tasks, jobs)


def collect_results(tasks: Sequence[Any], jobs: int, progress: Progress | None = None) -> list[Any]:
    """Return the results of `in_order`, telling how many there are."""
    results = []
    for result in in_order(tasks, jobs):
        results.append(result)
        if progress is not None:
            progress(len(results), len(tasks))
    return results


def adaptively_in_order(tasks: Sequence[Any], jobs: int | None) -> Iterator[Any]:
    """As `in_order`; without a number of processes, it starts them only where that is quicker.

    Args:
        tasks: calls made with `joblib.delayed`.
        jobs: number of processes. None: what `joblib.parallel_config` says. If it says nothing, this process
            begins, and all there can be take over if there is more to do than it takes to start them.

    Raises:
        InvalidValue: not a number of processes.
    """
    if jobs is not None:
        return in_order(tasks, jobs)
    backend, configured = get_active_backend()
    if configured is not None:
        return _distribute(tasks, configured)
    if backend.nesting_level:  # somebody else has already spread the work
        return in_order(tasks, 1)
    return _run_then_distribute(tasks) if backend.supports_inner_max_num_threads else in_order(tasks, -1)


def _run_then_distribute(tasks: Sequence[Any]) -> Iterator[Any]:
    """Make the calls one by one; once processes are quicker, distribute the calls that are left."""
    began = perf_counter()
    for done, (function, positional, named) in enumerate(tasks):
        spent = perf_counter() - began
        if done and spent > TRIAL_TIME and spent / done * (len(tasks) - done) > START_TIME:
            yield from in_order(tasks[done:], -1)
            return
        yield function(*positional, **named)


def _distribute(tasks: Iterable[Any], jobs: int) -> Iterator[Any]:
    waiting = iter(tasks)
    if jobs != 1 and get_active_backend()[0].supports_inner_max_num_threads:
        # The first call is made here, so that kernels are compiled once and not by each process started here.
        for function, positional, named in islice(waiting, 1):
            yield function(*positional, **named)
    as_they_come = get_active_backend()[0].supports_return_generator
    with _one_thread_each():
        pool = Parallel(n_jobs=jobs, return_as="generator" if as_they_come else "list")
    if as_they_come:
        yield from pool(waiting)
        return
    with pool:  # the same processes for all portions
        while portion := list(islice(waiting, PORTION)):
            yield from pool(portion)


def _one_thread_each() -> AbstractContextManager[object]:
    """Processes started here compute with one thread each, unless somebody said how many."""
    backend, _ = get_active_backend()
    if backend.supports_inner_max_num_threads and backend.inner_max_num_threads is None:
        return parallel_config(backend="loky", inner_max_num_threads=1)  # type: ignore[no-any-return]
    return nullcontext()


# One call at a time, in a process that stays.


class Interrupted(BaseException):
    """A call was interrupted. Handlers of `Exception` do not catch it."""


class BackgroundProcess:
    """A process that makes one call at a time, while this one goes on without a pause.

    It needs some seconds to start, during which calls wait; another one is started if it is ended from
    outside. It ends with this process, and with this object. Calls have to be picklable; `Shared` values are
    unpickled once.
    """

    def __init__(self) -> None:
        self._start()

    def _start(self) -> None:
        self._connection, other = Pipe()
        self._running = False
        # `multiprocessing` by itself would run the script of the user again.
        self._process = get_context("loky").Process(
            target=_answer_calls, args=(other,), daemon=True, env=dict.fromkeys(THREAD_COUNTS, "1")
        )
        self._process.start()
        other.close()

    def submit(self, function: Callable[..., object], *arguments: object) -> None:
        """Start a call; the one before has returned its result."""
        call = pickle.dumps((function, arguments))
        try:
            self._connection.send_bytes(call)
        except OSError:
            self._start()
            self._connection.send_bytes(call)

    def done(self) -> bool:
        """Whether `result` returns at once."""
        return self._connection.poll()

    def interrupt(self) -> None:
        """Interrupt the call if it has begun: its result is then `Interrupted`. Repeat this until it is done.

        The first call of a process cannot be interrupted, nor any call on Windows, which has no SIGUSR1.
        """
        if self._running and INTERRUPT is not None:
            with suppress(OSError):  # it has ended; `result` says so
                os.kill(self._process.pid, INTERRUPT)

    def result(self) -> Any:
        """Return the result, or raise what the call raised.

        Raises:
            EOFError: the process was ended from outside.
            Interrupted: the call was interrupted.
        """
        try:
            value, error = pickle.loads(self._connection.recv_bytes())
        except (EOFError, OSError):
            self._start()
            raise EOFError from None
        self._running = True
        if error is not None:
            raise error
        return value

    def __del__(self) -> None:
        if hasattr(self, "_connection"):
            self._connection.close()


THREAD_COUNTS = ("OPENBLAS_NUM_THREADS", "OMP_NUM_THREADS", "MKL_NUM_THREADS")
"""Variables that set the number of threads of a process."""


INTERRUPT: signal.Signals | None = getattr(signal, "SIGUSR1", None)
"""Signal that interrupts a call; SIGINT goes to all processes of a terminal."""


def _answer_calls(connection: Connection) -> None:
    """Make calls until the other end is closed."""
    busy = False

    def interrupt(*_: object) -> None:
        nonlocal busy
        if busy:  # else the result is on its way
            busy = False
            raise Interrupted

    signal.signal(signal.SIGINT, signal.SIG_IGN)  # the process that sends the calls decides
    if INTERRUPT is not None:
        signal.signal(INTERRUPT, interrupt)
    kernels.load()
    with suppress(EOFError, OSError):
        while True:
            function, arguments = pickle.loads(connection.recv_bytes())
            value: object = None
            error: BaseException | None = None
            try:
                busy = True
                try:
                    value = function(*arguments)
                except Exception as raised:  # `result` raises it
                    error = raised
                busy = False
            except Interrupted as raised:
                value, error = None, raised
            connection.send_bytes(pickle.dumps((value, error)))
