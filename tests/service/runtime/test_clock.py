"""Words about robot time that cannot be true move nobody's."""

from typing import Any

import pytest
from support.samples import make_clock

from trolley import topics
from trolley.messages import Clock
from trolley.runtime.lockstep import Lockstep
from trolley.runtime.service import Service, every

SECOND = 1_000_000_000
UNIX = 1_790_000_000 * SECOND
FAR = 2**62


class Base(Service):
    """Publishes the clock; its host's own may be moved."""

    name = "base"

    def __init__(self, epoch: int = UNIX, rate: float = 1.0) -> None:
        self.epoch, self.rate, self.moved_ns = epoch, rate, 0
        self.own_time = self

    def now(self, monotonic_ns: int) -> int:
        return self.epoch + self.moved_ns + round(self.rate * monotonic_ns)

    @every(0.1, clock="local")
    def publish_clock(self) -> None:
        self.publish(topics.CLOCK, make_clock(self.stamp_ns, self.epoch, self.rate))


class Follower(Service):
    """Counts ticks of robot time and new epochs."""

    name = "planner"

    def __init__(self) -> None:
        self.ticks, self.epochs = 0, 0

    @every(0.1)
    def tick(self) -> None:
        self.ticks += 1

    def epoch_began(self) -> None:
        self.epochs += 1


class Onlooker(Follower):
    """Follows the clocks of all robots."""

    name = "viz"
    all_robots = True


def truth_ns(lockstep: Lockstep, base: Base) -> int:
    return base.now(lockstep.now_ns)


WRONG: dict[str, Any] = {
    "far ahead in this run": lambda now: Clock(stamp_ns=FAR, rate=1.0, epoch=UNIX),
    "three seconds ahead": lambda now: Clock(stamp_ns=now + 3 * SECOND, rate=1.0, epoch=UNIX),
    "two minutes behind": lambda now: Clock(stamp_ns=now - 120 * SECOND, rate=1.0, epoch=UNIX),
    "a run of the far future": lambda now: Clock(stamp_ns=FAR, rate=1.0, epoch=FAR),
    "a run that began now": lambda now: Clock(stamp_ns=now, rate=1.0, epoch=now),
    "an earlier run": lambda now: Clock(stamp_ns=5, rate=1.0, epoch=0),
    "a clock gone wild": lambda now: Clock(stamp_ns=now, rate=1e4, epoch=UNIX),
    "a clock that stands": lambda now: Clock(stamp_ns=now, rate=1e-300, epoch=UNIX),
}


@pytest.mark.parametrize("what", WRONG)
def test_one_wrong_message_moves_nobodys_time(lockstep: Lockstep, what: str):
    base, follower = lockstep.add(Base()), lockstep.add(Follower())
    onlooker = lockstep.add(Onlooker())
    lockstep.run(1.05)
    for service in (follower, onlooker):
        assert (service.epochs, service.now_ns) == (1, truth_ns(lockstep, base))
    lockstep.publish(topics.CLOCK, WRONG[what](truth_ns(lockstep, base)))
    for _ in range(20):
        lockstep.run(0.1)
        for service in (follower, onlooker):
            assert service.now_ns == truth_ns(lockstep, base)
    assert follower.epochs == onlooker.epochs == 1
    assert 28 <= follower.ticks <= 33
    assert lockstep.counters("planner") == {"clock/implausible": 1}
    assert lockstep.counters("viz") == {"clock/implausible": 1}


def test_a_flood_of_wrong_messages_costs_base_ten_questions_a_second(lockstep: Lockstep):
    base, follower = lockstep.add(Base()), lockstep.add(Follower())
    lockstep.run(1.0)
    asked: list[object] = []
    counter = lockstep.bus.serve("trolley/trolley/clock", lambda query: _note(asked, query))
    for number in range(1000):
        lockstep.publish(topics.CLOCK, make_clock(FAR + number, UNIX))
        lockstep.run(0.002)
        assert follower.now_ns == truth_ns(lockstep, base)
    counter.close()
    assert lockstep.counters("planner")["clock/implausible"] == 1000
    assert len(asked) <= 21


def _note(asked: list[object], query: Any) -> None:
    asked.append(query)
    query.finish()


def test_a_restarted_base_is_followed_from_its_first_word(lockstep: Lockstep):
    lockstep.add(Base())
    follower = lockstep.add(Follower())
    lockstep.run(1.0)
    lockstep.kill("base")
    lockstep.run(0.3)
    base = lockstep.add(Base(epoch=UNIX + 200 * SECOND))
    lockstep.run(0.01)
    assert (follower.epochs, follower.now_ns) == (2, truth_ns(lockstep, base))
    assert follower.epoch_ns == base.epoch
    assert "clock/implausible" not in lockstep.counters("planner")


def test_a_base_whose_rate_changes_is_followed(lockstep: Lockstep):
    base, follower = lockstep.add(Base()), lockstep.add(Follower())
    lockstep.run(1.05)
    base.moved_ns, base.rate = round(-3.0 * lockstep.now_ns), 4.0
    lockstep.run(1.0)
    assert follower.now_ns == truth_ns(lockstep, base)
    assert (follower.epochs, lockstep.counters("planner")) == (1, {})


def test_a_computer_that_slept_for_an_hour_finds_the_time_again(lockstep: Lockstep):
    """Its monotonic clock stood; base's did not."""
    base, follower = lockstep.add(Base()), lockstep.add(Follower())
    lockstep.run(1.05)
    base.moved_ns = 3600 * SECOND
    lockstep.run(0.1)
    assert follower.now_ns == truth_ns(lockstep, base)
    assert follower.epochs == 1


def test_what_a_stranger_said_before_base_was_there_is_forgotten(lockstep: Lockstep):
    follower = lockstep.add(Follower())
    lockstep.publish(topics.CLOCK, make_clock(FAR, UNIX))
    lockstep.run(0.5)
    base = lockstep.add(Base())
    lockstep.run(0.15)
    assert follower.now_ns == truth_ns(lockstep, base)
    assert follower.epochs == 2
    before = follower.ticks
    lockstep.run(1.0)
    assert follower.ticks >= before + 9


def test_without_a_base_that_answers_a_clock_is_followed_as_long_as_it_runs_on(lockstep: Lockstep):
    """A program that stands in for base, without answering."""
    follower = lockstep.add(Follower())
    for tenth in range(10):
        lockstep.publish(topics.CLOCK, make_clock(UNIX + tenth * SECOND // 10, UNIX))
        lockstep.run(0.1)
    lockstep.publish(topics.CLOCK, make_clock(FAR, UNIX))
    assert follower.now_ns == UNIX + SECOND
    lockstep.run(1.5)
    lockstep.publish(topics.CLOCK, make_clock(UNIX + 9 * SECOND, UNIX))
    assert follower.now_ns == UNIX + 9 * SECOND, "after a second of silence it may be anything"
