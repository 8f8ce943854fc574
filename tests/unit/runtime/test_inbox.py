"""The queue between Zenoh's threads and the one that calls a service's methods."""

import threading
import time

import pytest
from support.waiting import PATIENCE_S

from trolley.runtime import inbox as inbox_module
from trolley.runtime.inbox import Inbox


class Clock:
    """A clock that the test sets."""

    def __init__(self) -> None:
        self.now_ns = 0

    def __call__(self) -> int:
        return self.now_ns


def drain(inbox: Inbox) -> list[int]:
    """Run everything that waits; the times of arrival."""
    times: list[int] = []
    while (entry := inbox.pop()) is not None:
        entry[0](entry[1])
        times.append(entry[1])
    return times


def test_arrivals_keep_their_order_and_their_time():
    clock, done = Clock(), list[str]()
    inbox = Inbox(clock)
    for i, word in enumerate("abc"):
        clock.now_ns = i
        inbox.push(lambda _, word=word: done.append(word))
    assert drain(inbox) == [0, 1, 2]
    assert done == ["a", "b", "c"]
    assert inbox.is_empty


def test_the_newest_of_a_slot_takes_the_place_of_the_one_that_waits():
    clock, done = Clock(), list[str]()
    inbox = Inbox(clock)
    for i, (word, slot) in enumerate([("a1", "a"), ("b1", "b"), ("a2", "a"), ("c", None)]):
        clock.now_ns = i
        inbox.push(lambda _, word=word: done.append(word), slot)
    assert drain(inbox) == [2, 1, 3]
    assert done == ["a2", "b1", "c"]
    assert inbox.replaced == 1
    inbox.push(lambda _: done.append("a3"), "a")  # the slot is free again
    drain(inbox)
    assert done[-1] == "a3"


def test_urgent_arrivals_go_first_in_their_order():
    done: list[str] = []
    inbox = Inbox(Clock())
    for word, urgent in [("a", False), ("u", True), ("b", False), ("v", True)]:
        inbox.push(lambda _, word=word: done.append(word), urgent=urgent)
    drain(inbox)
    assert done == ["u", "v", "a", "b"]


def test_what_is_too_much_is_dropped_and_counted(monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setattr(inbox_module, "MAX_WAITING", 3)
    done: list[int] = []
    inbox = Inbox(Clock())
    taken = [inbox.push(lambda _, i=i: done.append(i)) for i in range(5)]
    assert taken == [True, True, True, False, False]
    assert inbox.push(lambda _: done.append(100), own=True)
    assert inbox.push(lambda _: done.append(200), urgent=True)
    drain(inbox)
    assert done == [200, 0, 1, 2, 100]
    assert inbox.dropped == 2


def test_what_weighs_too_much_is_dropped(monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setattr(inbox_module, "MAX_WAITING_BYTES", 100)
    inbox = Inbox(Clock())

    def push(size: int, slot: str | None = None) -> bool:
        return inbox.push(lambda _: None, slot, size=size)

    assert push(500)  # one alone is always taken
    assert not push(1)
    assert push(0)
    drain(inbox)
    assert push(60, "a")
    assert push(90, "a")  # in place of the other
    assert not push(20)
    assert push(10)
    drain(inbox)
    assert push(100)


def test_a_wake_before_the_wait_is_not_lost():
    inbox = Inbox(time.monotonic_ns)
    inbox.wake()
    before_s = time.monotonic()
    inbox.wait(PATIENCE_S)
    assert time.monotonic() - before_s < PATIENCE_S


def test_an_arrival_ends_the_wait():
    inbox = Inbox(time.monotonic_ns)
    threading.Timer(0.05, lambda: inbox.push(lambda _: None)).start()
    before_s = time.monotonic()
    inbox.wait(PATIENCE_S)
    assert time.monotonic() - before_s < PATIENCE_S
    assert not inbox.is_empty


def test_nothing_is_lost_between_many_threads():
    inbox, done = Inbox(time.monotonic_ns), list[int]()

    def fill(start: int) -> None:
        for i in range(500):
            inbox.push(lambda _, i=i: done.append(start + i))

    threads = [threading.Thread(target=fill, args=(1000 * i,)) for i in range(4)]
    for thread in threads:
        thread.start()
    while any(thread.is_alive() for thread in threads) or not inbox.is_empty:
        inbox.wait(0.01)
        drain(inbox)
    assert sorted(done) == [1000 * i + j for i in range(4) for j in range(500)]
    for i in range(4):  # each thread's in its order
        assert [n for n in done if n // 1000 == i] == sorted(n for n in done if n // 1000 == i)


def test_what_nobody_waits_for_is_there_at_the_next_wake_in_its_place():
    clock, done = Clock(), list[str]()
    inbox = Inbox(clock)
    for i, (word, wakes) in enumerate([("a", False), ("b", True), ("c", False)]):
        clock.now_ns = i
        inbox.push(lambda _, word=word: done.append(word), wakes=wakes)
    assert drain(inbox) == [0, 1, 2]
    assert done == ["a", "b", "c"]


def test_what_nobody_waits_for_does_not_end_a_wait():
    inbox = Inbox(time.monotonic_ns)
    quiet = threading.Timer(0.05, lambda: inbox.push(lambda _: None, wakes=False))
    quiet.start()
    inbox.wait(0.3)
    quiet.join()
    assert not inbox.is_empty
    before_s = time.monotonic()
    inbox.wait(PATIENCE_S)  # but nothing waits longer than for the next look
    assert time.monotonic() - before_s < PATIENCE_S


def test_much_that_nobody_waits_for_ends_the_wait():
    inbox = Inbox(time.monotonic_ns)

    def fill() -> None:
        for _ in range(inbox_module.MOST_QUIET):
            inbox.push(lambda _: None, wakes=False)

    threading.Timer(0.05, fill).start()
    before_s = time.monotonic()
    inbox.wait(PATIENCE_S)
    assert time.monotonic() - before_s < PATIENCE_S
