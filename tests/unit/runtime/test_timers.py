"""Periods and deadlines, with clocks that the test sets."""

from trolley.messages import Clock as ClockMessage
from trolley.runtime.robot_time import FollowedTime
from trolley.runtime.timers import Timers

MS = 1_000_000


class Clock:
    """Local and robot time."""

    def __init__(self, rate: float = 1.0) -> None:
        self.local_ns = 0
        self.rate = rate
        self.epoch = 0
        self.offset_ns: int | None = 0

    def monotonic_ns(self) -> int:
        return self.local_ns

    def now(self, monotonic_ns: int) -> int | None:
        return None if self.offset_ns is None else self.offset_ns + round(self.rate * monotonic_ns)


def advance(timers: Timers, clock: Clock, until_ms: int) -> int:
    """Step as a runtime does, from one thing due to the next; how many steps it took."""
    steps = 0
    while clock.local_ns < until_ms * MS:
        timers.run(clock.monotonic_ns, clock)
        due_ns = timers.next_due_ns(clock.local_ns, clock)
        clock.local_ns = min(max(due_ns, clock.local_ns + 1), until_ms * MS)
        steps += 1
    timers.run(clock.monotonic_ns, clock)
    return steps


def test_a_slow_method_skips_periods_and_keeps_its_beat():
    timers, clock, ticks = Timers(), Clock(), list[int]()

    def slow() -> None:
        ticks.append(clock.local_ns // MS)
        if len(ticks) == 2:
            clock.local_ns += 250 * MS  # it takes two periods and a half

    timers.every(0.1, slow, is_local=False)
    advance(timers, clock, 600)
    # The one missed last is made up for once; after it the old beat goes on.
    assert ticks == [0, 100, 350, 400, 500, 600]


def test_a_slow_method_does_not_starve_the_others():
    timers, clock, ticks = Timers(), Clock(), list[int]()

    def hog() -> None:
        clock.local_ns += 30 * MS

    timers.every(0.01, hog, is_local=True)
    timers.every(0.1, lambda: ticks.append(clock.local_ns), is_local=True)
    timers.at(50 * MS, lambda: ticks.append(-1))
    advance(timers, clock, 1000)
    assert -1 in ticks
    assert len(ticks) >= 10


def test_deadlines_come_in_order_and_once():
    timers, clock, done = Timers(), Clock(), list[str]()
    timers.at(20 * MS, lambda: done.append("later"))
    timers.at(10 * MS, lambda: done.append("first"))
    timers.at(10 * MS, lambda: done.append("second"))
    timers.at(10 * MS, lambda: timers.at(15 * MS, lambda: done.append("nested")))
    assert timers.next_due_ns(0, clock) == 10 * MS
    advance(timers, clock, 50)
    assert done == ["first", "second", "nested", "later"]


def test_deadlines_do_not_wait_for_robot_time():
    timers, clock, done = Timers(), Clock(), list[str]()
    clock.offset_ns = None
    timers.every(0.1, lambda: done.append("robot"), is_local=False)
    timers.at(10 * MS, lambda: done.append("deadline"))
    advance(timers, clock, 300)
    assert done == ["deadline"]


def test_it_is_not_asked_more_often_than_something_is_due():
    for rate in (0.1, 0.3, 1.0, 3.0, 7.0):
        timers, clock, ticks = Timers(), Clock(rate), list[int]()
        timers.every(0.1, lambda ticks=ticks: ticks.append(1), is_local=False)
        steps = advance(timers, clock, 10_000)
        assert len(ticks) == int(100 * rate) + 1
        assert steps <= len(ticks) + 11  # and once a second


def test_a_clock_that_stands_is_not_a_busy_wait():
    """As a simulation's between two steps."""
    timers, clock, ticks = Timers(), Clock(), list[int]()
    clock.rate = 1e-9
    timers.every(0.1, lambda: ticks.append(1), is_local=False)
    assert advance(timers, clock, 1000) < 50
    assert len(ticks) == 1


def test_a_clock_that_went_back_ticks_again_at_once():
    timers, clock, ticks = Timers(), Clock(), list[int]()
    clock.offset_ns = 10**18
    timers.every(0.1, lambda: ticks.append(1), is_local=False)
    advance(timers, clock, 250)
    clock.offset_ns = 0
    advance(timers, clock, 500)
    assert len(ticks) == 6


def test_a_deadline_is_put_off_given_up_and_set_again():
    timers, clock, calls = Timers(), Clock(), list[int]()
    deadline = timers.deadline(clock.monotonic_ns, lambda: calls.append(clock.local_ns // MS))
    advance(timers, clock, 100)
    deadline.set(0.05)
    advance(timers, clock, 120)
    deadline.set(0.05)
    advance(timers, clock, 300)
    deadline.set(0.05)
    deadline.clear()
    advance(timers, clock, 500)
    assert calls == [170]


def test_a_deadline_that_repeats_keeps_its_pace_and_skips_what_it_missed():
    timers, clock, calls = Timers(), Clock(), list[int]()

    def call() -> None:
        calls.append(clock.local_ns // MS)
        clock.local_ns += (170 if len(calls) == 3 else 3) * MS
        deadline.repeat(0.05)

    deadline = timers.deadline(clock.monotonic_ns, call)
    advance(timers, clock, 100)
    deadline.set(0.0)
    advance(timers, clock, 500)
    assert calls == [100, 150, 200, 400, 450, 500]


def test_periods_of_one_length_begin_together_and_wake_together():
    timers, clock = Timers(), Clock()

    def busy() -> None:
        clock.local_ns += 1000

    timers.every(0.1, busy, is_local=True)
    timers.every(0.1, busy, is_local=True)
    assert advance(timers, clock, 1000) <= 11 + 1


def followed_time() -> FollowedTime:
    """Robot time that goes with the local clock, heard of at 0."""
    time = FollowedTime()
    time.update(ClockMessage(stamp_ns=0, rate=1.0, epoch=0), 0)
    return time


def test_what_is_set_between_two_looks_is_not_missed() -> None:
    timers, clock, done = Timers(), Clock(), list[str]()
    time = followed_time()
    deadline = timers.deadline(clock.monotonic_ns, lambda: done.append("deadline"))
    timers.every(0.5, lambda: done.append("period"), is_local=False)
    timers.run(clock.monotonic_ns, time)
    assert timers.next_due_ns(0, time) == 500 * MS
    deadline.set(0.010)
    timers.at(20 * MS, lambda: done.append("once"))
    for clock.local_ns in (9 * MS, 10 * MS, 19 * MS, 20 * MS):
        timers.run(clock.monotonic_ns, time)
    assert done == ["period", "deadline", "once"]


def test_a_clock_that_moves_makes_a_period_due_at_once() -> None:
    timers, clock, done = Timers(), Clock(), list[str]()
    time = followed_time()
    timers.every(0.5, lambda: done.append("period"), is_local=False)
    timers.run(clock.monotonic_ns, time)
    timers.next_due_ns(0, time)
    clock.local_ns = 10 * MS
    time.update(ClockMessage(stamp_ns=600 * MS, rate=1.0, epoch=0), clock.local_ns)
    timers.look_again()
    assert timers.run(clock.monotonic_ns, time)
    assert done == ["period", "period"]


def test_a_period_rests_where_the_clock_has_fallen_silent_between_two_looks() -> None:
    timers, clock, done = Timers(), Clock(), list[int]()
    time = followed_time()
    timers.every(0.7, lambda: done.append(clock.local_ns // MS), is_local=False)
    for clock.local_ns in (0, 900 * MS, 1300 * MS):
        timers.run(clock.monotonic_ns, time)
        timers.next_due_ns(clock.local_ns, time)
    clock.local_ns = 1390 * MS
    time.update(ClockMessage(stamp_ns=1390 * MS, rate=1.0, epoch=0), clock.local_ns)
    timers.look_again()
    timers.run(clock.monotonic_ns, time)
    assert done == [0, 900, 1390]  # as soon as its clock runs again


def test_a_period_is_neither_due_nor_called_while_it_is_not_wanted():
    timers, clock, ticks, is_wanted = Timers(), Clock(), list[int](), False
    timers.every(
        0.1, lambda: ticks.append(clock.local_ns // MS), is_local=True, when=lambda: is_wanted
    )
    assert advance(timers, clock, 1000) == 1
    is_wanted = True
    advance(timers, clock, 1200)
    assert ticks == [1100, 1200]
