import math

import pytest
from hypothesis import given
from hypothesis import strategies as st

from trolley.geometry import Twist2D
from trolley.messages import Clock, VelocityCommand
from trolley.runtime.robot_time import FollowedTime
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


def test_a_stamp_may_be_a_fifth_of_a_second_ahead_and_no_more(arbiter: Arbiter) -> None:
    assert offer(arbiter, "teleop", 1.0, stamp_s=1.2) is None
    assert offer(arbiter, "planner", 1.0, stamp_s=1.201) is Reject.AHEAD
    assert driver(arbiter, 1.01) == "teleop"


def test_a_stamp_may_be_half_a_second_old_and_no_more(arbiter: Arbiter) -> None:
    assert offer(arbiter, "teleop", 5.0, stamp_s=4.5) is None
    assert offer(arbiter, "planner", 5.0, stamp_s=4.499) is Reject.OLD
    assert offer(arbiter, "calibrate", 5.0, stamp_s=1.0) is Reject.OLD
    assert driver(arbiter, 5.01) == "teleop"


def test_what_was_said_before_is_not_followed_again(arbiter: Arbiter) -> None:
    assert offer(arbiter, "planner", 5.0) is None
    assert offer(arbiter, "planner", 5.01, stamp_s=5.0) is Reject.REPEATED
    assert offer(arbiter, "planner", 5.1, TURN, stamp_s=5.0) is Reject.OUT_OF_ORDER
    assert offer(arbiter, "planner", 5.2, stamp_s=4.9) is Reject.OUT_OF_ORDER
    assert offer(arbiter, "teleop", 5.2, stamp_s=4.9) is None, "each source has its own order"
    assert offer(arbiter, "planner", 9.0, stamp_s=5.0) is Reject.REPEATED, "however late"


def test_a_hand_that_holds_still_is_followed(arbiter: Arbiter) -> None:
    """What it says is the same each time, except for the stamp."""
    for number in range(40):
        at_s = 5.0 + 0.05 * number
        assert offer(arbiter, "teleop", at_s, valid_for=0.25) is None
        assert driver(arbiter, at_s + 0.04) == "teleop"


def test_a_source_that_was_restarted_is_heard_at_once(arbiter: Arbiter) -> None:
    """Even if its clock was as far ahead before as it may be."""
    assert offer(arbiter, "planner", 5.0, stamp_s=5.2) is None
    assert offer(arbiter, "planner", 5.21) is None


@pytest.mark.parametrize("valid_for", [1e-9, 0.001, 0.019])
def test_a_command_holds_for_one_decision_however_short_it_is_valid(
    arbiter: Arbiter, valid_for: float
) -> None:
    offer(arbiter, "teleop", 1.0, valid_for=valid_for)
    assert driver(arbiter, 1.02) == "teleop"
    assert driver(arbiter, 1.04) is None
    offer(arbiter, "teleop", 2.0, valid_for=valid_for)
    assert driver(arbiter, 2.5) is None, "a decision that comes late is another matter"


def test_a_short_command_below_another_holds_for_the_same_decision_only(arbiter: Arbiter) -> None:
    offer(arbiter, "teleop", 1.0, valid_for=0.01)
    offer(arbiter, "planner", 1.0, valid_for=0.01)
    assert driver(arbiter, 1.02) == "teleop"
    assert driver(arbiter, 1.04) is None


@given(
    st.lists(st.tuples(st.floats(0.0, 0.3), st.floats(0.0, 0.3)), min_size=30, max_size=120),
    st.sampled_from([0.5, 1.0, 2.0]),
)
def test_no_word_of_a_lawful_sender_is_refused_over_a_poor_radio(
    delays: list[tuple[float, float]], rate: float
) -> None:
    """A sender that follows the clock at 10 Hz and commands at 20 Hz, each word up to 0.3 s late.

    Its robot time lags by the smallest delay of the clock, and its commands take their own time: at
    a rate of 1 the two together stay below half a second as soon as one word came quickly.
    """
    arbiter = Arbiter({"teleop": 20})
    followed, sent, refused = FollowedTime(), list[tuple[int, VelocityCommand]](), list[Reject]()
    words: list[tuple[int, int]] = [(0, 0)]  # one that came quickly
    for i, (clock_s, _) in enumerate(delays):
        at = round(i * 0.1 / rate * S)
        words.append((at + round(clock_s / rate * S), round(rate * at)))
    words.sort()
    for i, (_, command_s) in enumerate(delays):
        at = round((i * 0.05 + 0.001) / rate * S)
        for arrived, stamp in [word for word in words if word[0] <= at]:
            followed.update(Clock(stamp_ns=stamp, rate=rate, epoch=0), arrived)
        words = [word for word in words if word[0] > at]
        stamp_ns = followed.now(at)
        if stamp_ns is not None:
            stamp_ns = max(stamp_ns, sent[-1][1].stamp_ns + 1 if sent else 0)
            said = VelocityCommand(stamp_ns=stamp_ns, twist=AHEAD, valid_for=0.25)
            arrives = max(at + round(command_s / rate * S), sent[-1][0] if sent else 0)
            sent.append((arrives, said))
    for arrived, said in sent:
        now_ns = round(rate * arrived)
        verdict = arbiter.offer("teleop", said, now_ns, now_ns)
        refused += [] if verdict is None else [verdict]
    assert refused == []


def test_nothing_that_came_before_forgetting_drives(arbiter: Arbiter) -> None:
    offer(arbiter, "teleop", 1.0)
    arbiter.forget()
    assert driver(arbiter, 1.01) is None
    assert offer(arbiter, "teleop", 1.02, stamp_s=0.9) is Reject.OUT_OF_ORDER
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
