"""Of what is asked, the latest request counts: none is lost, errors are delivered, and no thread is left."""

from __future__ import annotations

import logging
import operator
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from threading import Event

import pytest
from hypothesis import given
from hypothesis import strategies as st

from pinposture.errors import InvalidValue
from pinposture.motion.latest import Done, Latest, Outdated

PATIENCE = 30.0
NAME = "pinposture-test"


class Bench:
    """A worker whose requests begin when they are let go, and what becomes of them.

    A request of "fail" raises an error, one of "give up" looks at its flag until it is outdated.
    """

    def __init__(self, **named: object) -> None:
        self.begun: list[object] = []
        self.done: list[Done[object, object]] = []
        self.overlaps = 0
        self._inside = threading.Lock()
        self._started = threading.Semaphore(0)
        self._gate = threading.Semaphore(0)
        self.latest: Latest[object, object] = Latest(self._work, NAME, deliver=self.done.append, **named)

    def _work(self, request: object, outdated: Event) -> object:
        if not self._inside.acquire(blocking=False):
            self.overlaps += 1
            return None
        try:
            self.begun.append(request)
            self._started.release()
            if request == "give up":
                assert outdated.wait(PATIENCE)
                raise Outdated
            assert self._gate.acquire(timeout=PATIENCE)
            if request == "fail":
                raise InvalidValue("request", request, "another one")
            return [request]
        finally:
            self._inside.release()

    def wait_for_begin(self) -> None:
        assert self._started.acquire(timeout=PATIENCE)

    def let_go(self, count: int = 1) -> None:
        self._gate.release(count)

    @property
    def delivered(self) -> list[object]:
        return [done.request for done in self.done]


@contextmanager
def bench(**named: object) -> Iterator[Bench]:
    made = Bench(**named)
    try:
        yield made
    finally:
        made.let_go(1000)
        made.latest.close(PATIENCE)
    assert made.overlaps == 0
    assert NAME not in [each.name for each in threading.enumerate()]


def test_of_requests_that_wait_the_newest_is_worked_on() -> None:
    with bench() as made:
        made.latest.ask(0)
        made.wait_for_begin()
        for request in range(1, 10):
            made.latest.ask(request)
        made.let_go(2)
        assert made.latest.finish(PATIENCE)
        assert made.begun == made.delivered == [0, 9]
        assert [done.answer for done in made.done] == [[0], [9]]
        assert made.latest.done is made.done[-1]


def test_none_may_be_a_request() -> None:
    with bench() as made:
        made.let_go()
        made.latest.ask(None)
        assert made.latest.finish(PATIENCE)
        assert made.delivered == [None]


def test_requests_that_are_merged_are_all_worked_on_in_their_order() -> None:
    with bench(merge=operator.add) as made:
        made.latest.ask((0,))
        made.wait_for_begin()
        for request in range(1, 5):
            made.latest.ask((request,))
        made.let_go(2)
        assert made.latest.finish(PATIENCE)
        assert made.begun == [(0,), (1, 2, 3, 4)]


@pytest.mark.parametrize("how", ["a newer request", "cancel", "close"])
def test_a_worker_that_looks_at_its_flag_gives_up(how: str) -> None:
    with bench() as made:
        made.let_go()
        made.latest.ask("give up")
        made.wait_for_begin()
        assert made.latest.working
        if how == "a newer request":
            made.latest.ask("newer")
        elif how == "cancel":
            made.latest.cancel()
        else:
            made.latest.close(PATIENCE)
        assert made.latest.working == (how == "a newer request") or made.latest.finish(PATIENCE)
        assert made.latest.finish(PATIENCE)
        assert made.delivered == ["newer"] * (how == "a newer request")


def test_an_error_is_delivered_and_the_next_request_worked_on() -> None:
    with bench() as made:
        made.let_go(2)
        made.latest.ask("fail")
        assert made.latest.finish(PATIENCE)
        made.latest.ask("go on")
        assert made.latest.finish(PATIENCE)
        first, second = made.done
        assert isinstance(first.error, InvalidValue)
        assert first.answer is None
        assert (second.answer, second.error) == (["go on"], None)


@pytest.mark.parametrize(
    "error, logged", [(InvalidValue("a", 1, "2"), False), (RuntimeError(), True), (SystemExit(), True)]
)
def test_only_what_no_request_may_cause_is_logged(
    error: BaseException, logged: bool, caplog: pytest.LogCaptureFixture
) -> None:
    def fail(*_: object) -> None:
        raise error

    latest: Latest[int, None] = Latest(fail, NAME)
    with caplog.at_level(logging.ERROR):
        latest.ask(1)
        assert latest.finish(PATIENCE)
    assert latest.done is not None
    assert latest.done.error is error
    assert bool(caplog.records) == logged
    latest.close()


def test_a_delivery_that_fails_does_not_stop_the_next(caplog: pytest.LogCaptureFixture) -> None:
    def refuse(done: Done[int, int]) -> None:
        if done.request == 1:
            raise RuntimeError("nobody at home")
        delivered.append(done)

    delivered: list[Done[int, int]] = []
    latest: Latest[int, int] = Latest(lambda request, _: request, NAME, deliver=refuse)
    for request in (1, 2):
        latest.ask(request)
        assert latest.finish(PATIENCE)
    assert [done.request for done in delivered] == [2]
    assert "could not deliver" in caplog.text
    latest.close()


def test_what_is_the_same_as_the_last_is_not_asked_again_unless_that_was_cancelled() -> None:
    with bench(same=operator.eq) as made:
        made.let_go(100)
        for request in (1, 1, 2, 1):
            made.latest.ask(request)
            assert made.latest.finish(PATIENCE)
        assert made.begun == [1, 2, 1]
        made.latest.cancel()
        made.latest.ask(1)
        assert made.latest.finish(PATIENCE)
        assert made.begun == [1, 2, 1, 1]


def test_who_waits_for_the_end_does_not_wait_for_the_period() -> None:
    with bench(period=1e6) as made:
        made.let_go(100)
        made.latest.ask(1)
        assert made.latest.finish(PATIENCE)
        made.latest.ask(2)
        made.latest.ask(3)
        assert made.latest.working
        assert made.begun == [1]
        assert made.latest.finish(PATIENCE)
        assert made.begun == [1, 3]
        made.latest.ask(4)  # dropped by closing, which does not wait for the period either


def test_nothing_is_begun_after_closing() -> None:
    with bench() as made:
        made.latest.close()
        made.latest.ask(1)
        assert not made.latest.working
        assert made.latest.finish(PATIENCE)
        assert made.begun == []


def test_patience_has_an_end() -> None:
    with bench() as made:
        made.latest.ask(1)
        made.wait_for_begin()
        assert not made.latest.finish(0.0)


STEPS = st.lists(st.sampled_from(["ask", "give up", "fail", "let go", "cancel", "finish"]), max_size=30)


@given(STEPS, st.booleans())
def test_any_order_of_calls_keeps_the_newest_and_loses_nothing(steps: list[str], merged: bool) -> None:
    def join(before: object, now: object) -> object:
        return now if isinstance(before, str) or isinstance(now, str) else (*before, *now)  # type: ignore[misc]

    with bench(merge=join if merged else None) as made:
        asked: list[object] = []
        cancelled = 0  # how many were asked before the last was cancelled
        for number, step in enumerate(steps):
            if step in ("ask", "give up", "fail"):
                request: object = (number,) if step == "ask" else step
                asked.append(request)
                made.latest.ask(request)
            elif step == "let go":
                made.let_go()
            elif step == "cancel":
                made.latest.cancel()
                cancelled = len(asked)
            else:
                made.let_go(100)
                if asked[-1:] != ["give up"] or cancelled == len(asked):
                    assert made.latest.finish(PATIENCE)
        made.let_go(100)
        last = asked[-1] if asked[cancelled:] else None
        if last == "give up":
            made.latest.cancel()
        assert made.latest.finish(PATIENCE)
        assert not made.latest.working
        # Each that was begun is delivered in its order, but for those that were given up.
        assert made.delivered == [each for each in made.begun if each != "give up"]
        assert all((done.request == "fail") == (done.error is not None) for done in made.done)
        if isinstance(last, tuple):
            newest = made.begun[-1]
            assert isinstance(newest, tuple)
            assert newest[-1:] == last
        if merged and not cancelled and all(isinstance(each, tuple) for each in asked):
            assert [n for each in made.begun for n in each] == [n for each in asked for n in each]  # type: ignore[attr-defined]


def test_requests_of_many_threads_are_all_worked_on_when_merged() -> None:
    taken: list[int] = []
    latest: Latest[tuple[int, ...], None] = Latest(
        lambda requests, _: taken.extend(requests), NAME, merge=operator.add
    )
    hands = 8
    together = threading.Barrier(hands)

    def ask(hand: int) -> None:
        together.wait(PATIENCE)
        for number in range(50):
            latest.ask((100 * hand + number,))

    threads = [threading.Thread(target=ask, args=(hand,)) for hand in range(hands)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join(PATIENCE)
    assert latest.finish(PATIENCE)
    assert sorted(taken) == sorted(100 * hand + number for hand in range(hands) for number in range(50))
    for hand in range(hands):
        assert [each for each in taken if each // 100 == hand] == [100 * hand + n for n in range(50)]
    latest.close()
