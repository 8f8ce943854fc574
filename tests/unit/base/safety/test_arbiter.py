import math

import pytest
from hypothesis import given
from hypothesis import strategies as st

from trolley.geometry import Twist2D
from trolley.messages import VelocityCommand
from trolley_base.safety.arbiter import Arbiter, Reject

S = 1_000_000_000
AHEAD = Twist2D(0.3, 0.0, 0.0)
TURN = Twist2D(0.0, 0.0, 1.0)
STAND = Twist2D(0.0, 0.0, 0.0)


def command(stamp_s: float, twist: Twist2D = AHEAD, valid_for: float = 0.3) -> VelocityCommand:
    return VelocityCommand(stamp_ns=round(stamp_s * S), twist=twist, valid_for=valid_for)


@pytest.fixture
def arbiter() -> Arbiter:
    return Arbiter({"teleop": 20, "calibrate": 15, "planner": 10})


def offer(
    arbiter: Arbiter,
    source: str,
    at_s: float,
    twist: Twist2D = AHEAD,
    valid_for: float = 0.3,
    stamp_s: float | None = None,
) -> Reject | None:
    """A command that arrives at `at_s`, stamped then."""
    sent = command(at_s if stamp_s is None else stamp_s, twist, valid_for)
    return arbiter.offer(source, sent, round(at_s * S), round(at_s * S))


def driver(arbiter: Arbiter, at_s: float) -> str | None:
    return arbiter.choose(round(at_s * S)).source


def test_nobody_drives_without_a_command(arbiter: Arbiter) -> None:
    choice = arbiter.choose(0)
    assert choice.source is None
    assert choice.twist.is_zero


def test_the_highest_priority_wins_whoever_came_first(arbiter: Arbiter) -> None:
    offer(arbiter, "teleop", 1.0, TURN)
    offer(arbiter, "planner", 1.1)
    choice = arbiter.choose(round(1.2 * S))
    assert (choice.source, choice.twist) == ("teleop", TURN)


def test_a_zero_command_of_the_highest_wins_too(arbiter: Arbiter) -> None:
    offer(arbiter, "planner", 1.0)
    offer(arbiter, "teleop", 1.0, STAND)
    choice = arbiter.choose(round(1.1 * S))
    assert (choice.source, choice.twist) == ("teleop", STAND)


def test_a_higher_source_takes_over_at_once(arbiter: Arbiter) -> None:
    offer(arbiter, "planner", 1.0)
    assert driver(arbiter, 1.1) == "planner"
    offer(arbiter, "teleop", 1.12)
    assert driver(arbiter, 1.12) == "teleop"


def test_a_lower_source_waits_a_second_after_a_silence(arbiter: Arbiter) -> None:
    offer(arbiter, "teleop", 1.0, valid_for=0.2)
    assert driver(arbiter, 1.1) == "teleop"
    for tenth in range(11, 22):
        offer(arbiter, "planner", tenth / 10)
        assert driver(arbiter, tenth / 10) == ("teleop" if tenth == 11 else None)
    offer(arbiter, "planner", 2.21)
    assert driver(arbiter, 2.21) == "planner"


def test_the_silent_source_itself_and_a_higher_one_need_not_wait(arbiter: Arbiter) -> None:
    offer(arbiter, "calibrate", 1.0, valid_for=0.1)
    assert driver(arbiter, 1.05) == "calibrate"
    assert driver(arbiter, 1.2) is None
    offer(arbiter, "calibrate", 1.3, valid_for=0.1)
    assert driver(arbiter, 1.3) == "calibrate"
    assert driver(arbiter, 1.5) is None
    offer(arbiter, "teleop", 1.6)
    assert driver(arbiter, 1.6) == "teleop"


def test_losing_a_source_is_told_only_if_it_was_moving_the_robot(arbiter: Arbiter) -> None:
    offer(arbiter, "planner", 1.0)
    assert not arbiter.choose(S).lost
    assert arbiter.choose(2 * S).lost
    offer(arbiter, "planner", 3.0, STAND)
    assert not arbiter.choose(3 * S).lost
    assert not arbiter.choose(round(3.9 * S)).lost


@pytest.mark.parametrize(
    ("valid_for", "ends_s"), [(0.2, 0.2), (0.5, 0.5), (60.0, 0.5), (1e300, 0.5)]
)
def test_a_command_is_good_for_half_a_second_at_most(
    arbiter: Arbiter, valid_for: float, ends_s: float
) -> None:
    offer(arbiter, "teleop", 1.0, valid_for=valid_for)
    assert driver(arbiter, 1.0 + ends_s - 0.001) == "teleop"
    assert driver(arbiter, 1.0 + ends_s) is None


@pytest.mark.parametrize("valid_for", [0.0, -1.0, math.nan, math.inf])
def test_a_command_needs_a_time_that_it_is_good_for(arbiter: Arbiter, valid_for: float) -> None:
    assert offer(arbiter, "teleop", 1.0, valid_for=valid_for) is Reject.NOT_VALID
    assert driver(arbiter, 1.0) is None


def test_unknown_sources_and_broken_numbers_are_dropped(arbiter: Arbiter) -> None:
    assert offer(arbiter, "stranger", 1.0) is Reject.UNKNOWN_SOURCE
    assert offer(arbiter, "teleop", 1.0, Twist2D(math.nan, 0.0, 0.0)) is Reject.NOT_FINITE
    assert driver(arbiter, 1.0) is None


def test_a_stamp_may_be_a_second_ahead_and_no_more(arbiter: Arbiter) -> None:
    assert offer(arbiter, "teleop", 1.0, stamp_s=2.0) is None
    assert offer(arbiter, "planner", 1.0, stamp_s=2.001) is Reject.AHEAD


def test_stragglers_are_dropped_but_a_restarted_source_is_heard(arbiter: Arbiter) -> None:
    assert offer(arbiter, "planner", 5.0) is None
    assert offer(arbiter, "planner", 5.1, stamp_s=5.0) is Reject.OLD
    assert offer(arbiter, "planner", 5.9, stamp_s=4.0) is Reject.OLD
    assert offer(arbiter, "teleop", 5.9, stamp_s=4.0) is None, "each source has its own order"
    assert offer(arbiter, "planner", 6.0, stamp_s=4.0) is None


def test_an_old_stamp_does_not_shorten_and_a_future_one_not_prolong(arbiter: Arbiter) -> None:
    offer(arbiter, "teleop", 5.0, stamp_s=1.0)
    assert driver(arbiter, 5.29) == "teleop"
    offer(arbiter, "teleop", 7.0, stamp_s=8.0)
    assert driver(arbiter, 7.31) is None


def test_nothing_that_came_before_forgetting_drives(arbiter: Arbiter) -> None:
    offer(arbiter, "teleop", 1.0)
    arbiter.forget()
    assert driver(arbiter, 1.01) is None
    assert offer(arbiter, "teleop", 1.02, stamp_s=0.9) is Reject.OLD
    assert offer(arbiter, "planner", 1.02) is None
    assert driver(arbiter, 1.02) == "planner"


@given(
    st.lists(
        st.tuples(
            st.sampled_from(["teleop", "calibrate", "planner", "stranger"]),
            st.floats(0.0, 1.5),
            st.floats(-1.0, 2.0),
        ),
        max_size=40,
    )
)
def test_whoever_drives_is_fresh_and_nobody_above_is(
    events: list[tuple[str, float, float]],
) -> None:
    priorities = {"teleop": 20, "calibrate": 15, "planner": 10}
    arbiter = Arbiter(priorities)
    expires: dict[str, float] = {}
    now_s = 0.0
    for source, wait_s, valid_for in events:
        now_s += wait_s
        if offer(arbiter, source, now_s, valid_for=valid_for) is None:
            expires[source] = now_s + min(valid_for, 0.5)
        chosen = driver(arbiter, now_s)
        fresh = [name for name, end in expires.items() if end > now_s + 1e-6]
        if chosen is not None:
            assert expires[chosen] > now_s - 1e-6
            assert all(priorities[name] <= priorities[chosen] for name in fresh)
