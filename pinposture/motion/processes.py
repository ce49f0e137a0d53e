"""Calls in other processes: many calls with results in order, and single calls in the background."""

from __future__ import annotations

import atexit
import logging
import os
import pickle
import signal
import sys
from collections.abc import Callable, Iterable, Iterator, Sequence
from concurrent.futures import Future
from contextlib import AbstractContextManager, nullcontext, suppress
from functools import cache, cached_property, lru_cache
from itertools import chain, islice
from multiprocessing import Pipe, parent_process
from multiprocessing.connection import Connection
from multiprocessing.util import Finalize
from pathlib import Path
from queue import Empty, SimpleQueue
from threading import Event, RLock, Thread
from time import perf_counter
from traceback import format_exception
from typing import Any, Generic, NamedTuple, TypeAlias, TypeVar

from joblib import Parallel, parallel_config, wrap_non_picklable_objects
from joblib.externals.loky import reusable_executor
from joblib.externals.loky.backend import get_context
from joblib.externals.loky.process_executor import TerminatedWorkerError
from joblib.parallel import get_active_backend

from pinposture import kernels
from pinposture._validation import is_whole
from pinposture.errors import InvalidValue, ProcessError, no_warnings

logger = logging.getLogger(__name__)

Value = TypeVar("Value")

Call: TypeAlias = tuple[Callable[..., object], tuple[object, ...]]
"""A function and its arguments."""

Progress = Callable[[int, int], object]
"""Called with the number of finished calls and the total number."""


class ProcessSettings(NamedTuple):
    """When calls go to other processes, and when they are given up."""

    trial_time: float = 1.0
    """Time in this process before the remaining time is estimated [s]."""

    start_time: float = 5.0
    """Estimated remaining time above which processes are started [s], which takes 3 to 5 s."""

    most_endings: int = 3
    """How often processes may be ended from outside before calls are given up."""

    portion: int = 200
    """Number of calls sent together to a backend that returns results only all at once, such as Ray's."""

    watch_interval: float = 0.5
    """How often a thread looks whether an idle process has ended [s]."""


PROCESSES = ProcessSettings()


MOST_JOBS = 10_000
"""Most processes that can be asked for."""


class Shared(Generic[Value]):
    """A value common to all calls, pickled once, and unpickled once per process."""

    def __init__(self, value: Value) -> None:
        self.value = value

    @cached_property
    def packed(self) -> bytes:
        """The value, pickled; raises InvalidValue if it cannot be."""
        # Wrapped for cloudpickle: other processes cannot import controllers from scripts and notebooks.
        try:
            return pickle.dumps(wrap_non_picklable_objects(self.value, keep_wrapper=False))
        except Exception as error:  # anything, as objects of the user pickle themselves
            allowed = f"objects that can be pickled ({type(error).__name__}: {error})"
            raise InvalidValue("arguments for other processes", self.value, allowed) from error

    def __reduce__(self) -> tuple[Any, ...]:
        return _unpacked, (self.packed,)


@lru_cache(maxsize=4)
def _unpacked(packed: bytes) -> Shared[Any]:
    return Shared(pickle.loads(packed))


def check_jobs(jobs: int) -> None:
    """Raise InvalidValue unless a value is a number of processes."""
    if not (is_whole(jobs) and (1 <= jobs <= MOST_JOBS or jobs == -1)):
        raise InvalidValue(
            "jobs", jobs, f"a whole number from 1 to {MOST_JOBS}, or -1 for as many as possible"
        )


def in_order(tasks: Iterable[Any], jobs: int) -> Iterator[Any]:
    """Return the results of delayed calls in order, each as soon as the previous ones are available.

    Short calls are sent in batches. Processes started here run BLAS with one thread each.

    Args:
        tasks: calls from `joblib.delayed`.
        jobs: number of processes, on the active backend of joblib.

    Raises:
        InvalidValue: not a number of processes.
    """
    check_jobs(jobs)
    return _distribute(tasks, jobs)


def adaptively_in_order(tasks: Sequence[Any], jobs: int | None) -> Iterator[Any]:
    """Return results as `in_order` does; if `jobs` is None, start processes only if that is faster.

    Args:
        tasks: calls from `joblib.delayed`.
        jobs: number of processes. None: as in `joblib.parallel_config`; without one, this process starts, and
            as many as possible take over once the remaining work outweighs their start.

    Raises:
        InvalidValue: not a number of processes.
    """
    if jobs is not None:
        return in_order(tasks, jobs)
    backend, configured = get_active_backend()
    if configured is not None:
        return _distribute(tasks, configured)
    if backend.nesting_level:  # the caller already runs in parallel
        return in_order(tasks, 1)
    return _run_then_distribute(tasks) if backend.supports_inner_max_num_threads else in_order(tasks, -1)


def _run_then_distribute(tasks: Sequence[Any]) -> Iterator[Any]:
    """Make the calls one by one; once processes are faster, distribute the remaining calls."""
    began = perf_counter()
    for done, (function, positional, named) in enumerate(tasks):
        spent = perf_counter() - began
        remaining = spent / done * (len(tasks) - done) if done else 0.0
        if spent > PROCESSES.trial_time and remaining > PROCESSES.start_time:
            yield from in_order(tasks[done:], -1)
            return
        yield function(*positional, **named)


def _distribute(tasks: Iterable[Any], jobs: int) -> Iterator[Any]:
    """Return results in order; calls that are lost with a process are made again.

    Raises:
        ProcessError: processes are ended again and again before the next result.
    """
    listed = list(tasks)
    done = 0
    ended = 0
    while True:
        try:
            # So that a call that ends its process takes no other with it.
            alone = ended == PROCESSES.most_endings
            for result in _distribute_once(listed[done:], jobs, first_here=not ended, alone=alone):
                done += 1
                yield result
            return
        except TerminatedWorkerError as error:
            ended += 1
            if ended > PROCESSES.most_endings:
                raise ProcessError(done, len(listed) - done) from error
            logger.warning("a process was ended; calls from %d of %d on are made again", done, len(listed))
        except Exception as error:  # interrupted while processes start, joblib fails in various ways
            if not _comes_of_interruption(error):
                raise
            raise KeyboardInterrupt from error


def _comes_of_interruption(error: BaseException | None) -> bool:
    """Whether an error came up while a KeyboardInterrupt was handled."""
    while error is not None and not isinstance(error, KeyboardInterrupt):
        error = error.__context__
    return error is not None


def _distribute_once(tasks: Sequence[Any], jobs: int, first_here: bool, alone: bool) -> Iterator[Any]:
    waiting = iter(tasks)
    if first_here and jobs != 1 and get_active_backend()[0].supports_inner_max_num_threads:
        # The first call is made here, so that kernels are compiled once and not by each process.
        for function, positional, named in islice(waiting, 1):
            yield function(*positional, **named)
    if parent_process() is not None:
        _end_pool_with(os.getpid())
    if jobs != 1 and get_active_backend()[0].supports_inner_max_num_threads:  # they are sent to processes
        for each in chain.from_iterable(positional for _, positional, _ in tasks[:1]):
            if isinstance(each, Shared):
                _ = each.packed  # joblib would not say what cannot be pickled
    _open_streams()
    as_they_come = get_active_backend()[0].supports_return_generator
    with _one_thread_each():
        pool = Parallel(
            n_jobs=jobs,
            return_as="generator" if as_they_come else "list",
            pre_dispatch=1 if alone else "2 * n_jobs",
            batch_size=1 if alone else "auto",
        )
    if as_they_come:
        yield from pool(waiting)
        return
    with pool:  # the same processes for all portions
        while portion := list(islice(waiting, PROCESSES.portion)):
            yield from pool(portion)


def _open_streams() -> None:
    """Open standard streams that lead nowhere in a process that has none: starting another flushes them."""
    for name in ("stdout", "stderr"):
        if getattr(sys, name) is None:
            setattr(sys, name, Path(os.devnull).open("w", encoding="utf-8"))  # noqa: SIM115


def _forget_pool() -> None:
    """Let a process that was forked start processes of its own: those of its parent do not answer it."""
    reusable_executor._executor = None
    reusable_executor._executor_lock = RLock()


@cache
def _end_pool_with(process: int) -> None:
    """Have the processes of a process that others started end with it, which waits for them else."""
    Finalize(None, _end_pool, exitpriority=100)


def _end_pool() -> None:
    if reusable_executor._executor is not None:
        reusable_executor._executor.shutdown(wait=True, kill_workers=True)


if hasattr(os, "register_at_fork"):
    os.register_at_fork(after_in_child=_forget_pool)


def _one_thread_each() -> AbstractContextManager[object]:
    """Return a context in which processes compute with one thread each, unless configured otherwise."""
    backend, _ = get_active_backend()
    if backend.supports_inner_max_num_threads and backend.inner_max_num_threads is None:
        return parallel_config(backend="loky", inner_max_num_threads=1)  # type: ignore[no-any-return]
    return nullcontext()


# Calls in the background.


class Interrupted(BaseException):
    """A call was interrupted. Handlers of `Exception` do not catch it."""


class RemoteTraceback(Exception):
    """The traceback of an exception in another process, as text; the cause of that exception here."""

    def __str__(self) -> str:
        return f"in another process\n{self.args[0]}"


_EXITING = Event()
"""Set when this process ends, and with it those that it has started: no other ones start then."""

atexit.register(_EXITING.set)


class _Line:
    """A process and the connection to it, used by the thread that talks to it.

    Args:
        prepare: called in each new process before it answers.
    """

    def __init__(self, prepare: Callable[[], object]) -> None:
        self.requests: SimpleQueue[tuple[Call, Future[Any]] | None] = SimpleQueue()
        self.ready = Event()
        self.interruptible = False
        self.failure: Exception | None = None
        self._prepare = prepare
        self._start()

    def _start(self) -> None:
        self.interruptible = False
        self._connection, other = Pipe()
        _open_streams()
        # `multiprocessing` by itself would run the script of the user again.
        single = dict.fromkeys(("OPENBLAS_NUM_THREADS", "OMP_NUM_THREADS", "MKL_NUM_THREADS"), "1")
        self.process = get_context("loky").Process(
            target=_answer_calls, args=(other,), daemon=True, env=single
        )
        self.process.start()
        other.close()

    def serve(self) -> None:
        """Make calls until there is None instead; start another process when this one has ended."""
        try:
            self._make((self._prepare, ()))
        except EOFError:  # another process starts for the first call
            pass
        except Exception as error:  # the constructor raises it
            self.failure = error
        self.ready.set()
        while True:
            try:
                request = self.requests.get(timeout=PROCESSES.watch_interval)
            except Empty:
                if not self.process.is_alive():
                    self._restart()
                continue
            if request is None:
                self._connection.close()
                return
            call, future = request
            try:
                future.set_result(self._make(call))
            except BaseException as error:  # `BackgroundProcess.result` raises it
                if isinstance(error, EOFError):
                    self._restart()
                future.set_exception(error)

    def _restart(self) -> None:
        if _EXITING.is_set():
            return
        logger.warning("a process was ended from outside; another one starts")
        with suppress(OSError):
            self._connection.close()
        self._start()
        with suppress(Exception):
            self._make((self._prepare, ()))

    def _make(self, call: Call) -> Any:
        sent = pickle.dumps(call)
        try:
            self._connection.send_bytes(sent)
            received = self._connection.recv_bytes()
        except (EOFError, OSError):
            raise EOFError from None
        self.interruptible = True
        value, error, trace = pickle.loads(received)
        if error is not None:
            raise error from RemoteTraceback(trace)
        return value


class BackgroundProcess:
    """A persistent process that makes one call at a time in the background.

    It takes some seconds to start, which the constructor waits for. If it is terminated, another one is
    started; a thread waits for that. It ends with this object. Calls must be picklable; `Shared` values are
    unpickled once.

    Args:
        prepare: called in each new process before it makes calls; picklable. What it raises in the first one,
            the constructor raises.
    """

    def __init__(self, prepare: Callable[[], object] = int) -> None:
        self._line = _Line(prepare)
        self._pending: Future[Any] = Future()
        # The thread must not hold this object, which would then never be deleted.
        Thread(target=self._line.serve, name="pinposture-planner", daemon=True).start()
        self._line.ready.wait()
        if self._line.failure is not None:
            raise self._line.failure

    @property
    def pid(self) -> int:
        """Number of the process."""
        return int(self._line.process.pid)

    def submit(self, function: Callable[..., object], *arguments: object) -> None:
        """Start a call, without waiting; the result of the previous one must have been returned."""
        self._pending = Future()
        self._line.requests.put(((function, arguments), self._pending))

    def done(self) -> bool:
        """Whether `result` returns at once."""
        return self._pending.done()

    def interrupt(self) -> None:
        """Interrupt the call if it has begun: its result is then `Interrupted`. Repeat this until it is done.

        The first call of a process cannot be interrupted, nor any call on Windows, which has no SIGUSR1.
        """
        if self._line.interruptible and INTERRUPT is not None:
            with suppress(OSError):  # it has ended; `result` says so
                os.kill(self.pid, INTERRUPT)

    def result(self) -> Any:
        """Return the result, or raise the exception of the call.

        Raises:
            EOFError: the process was terminated.
            Interrupted: the call was interrupted.
        """
        return self._pending.result()

    def __del__(self) -> None:
        if hasattr(self, "_line"):
            self._line.requests.put(None)


INTERRUPT: signal.Signals | None = getattr(signal, "SIGUSR1", None)
"""Signal that interrupts a call; SIGINT goes to all processes of a terminal."""


def _answer_calls(connection: Connection) -> None:
    """Make calls until the other end of the connection is closed."""
    busy = False

    def interrupt(*_: object) -> None:
        nonlocal busy
        if busy:  # else the result is on its way
            busy = False
            raise Interrupted

    signal.signal(signal.SIGINT, signal.SIG_IGN)  # Ctrl-C is handled by the parent
    if INTERRUPT is not None:
        signal.signal(INTERRUPT, interrupt)
    kernels.load()
    with suppress(EOFError, OSError), no_warnings():  # the caller has given them
        while True:
            received = connection.recv_bytes()
            value: object = None
            error: BaseException | None = None
            try:
                busy = True
                try:
                    function, arguments = pickle.loads(received)
                    value = function(*arguments)
                except (Exception, SystemExit) as raised:  # `result` raises it
                    error = raised
                busy = False
            except Interrupted as raised:
                value = None
                error = raised
            connection.send_bytes(_packed_answer(value, error))


def _packed_answer(value: object, error: BaseException | None) -> bytes:
    """Return a result, or an exception and its traceback, pickled; in words if they cannot be."""
    trace = "" if error is None else "".join(format_exception(error))
    try:
        answer = pickle.dumps((value, error, trace))
        if error is not None:
            pickle.loads(answer)  # some exceptions can be pickled, and not made again
    except Exception as raised:
        what = f"{type(value).__qualname__} cannot be sent ({raised})" if error is None else repr(error)
        answer = pickle.dumps((None, RuntimeError(what), trace))
    return answer
