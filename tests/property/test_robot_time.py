"""Robot time never goes back in an epoch, and follows the clock as closely as messages arrive."""

from typing import Any

import pytest
from hypothesis import example, given
from hypothesis import strategies as st
from support.strategies import instances_of

from trolley.messages import Clock
from trolley.runtime import codec
from trolley.runtime.robot_time import FollowedTime

SECOND = 1_000_000_000
UNIX = 1_790_000_000 * SECOND

DELAYS = st.lists(st.integers(0, SECOND // 2), min_size=1, max_size=150)
RATES = st.sampled_from([0.1, 0.5, 1.0, 2.0, 7.5])


@given(
    steps=st.lists(
        st.one_of(
            st.tuples(st.just("tick"), st.integers(0, SECOND // 5), RATES),
            st.tuples(st.just("wait"), st.integers(0, 2 * SECOND), RATES),
        ),
        max_size=60,
    ),
    start=st.integers(UNIX, 2 * UNIX),
)
def test_it_never_goes_back_within_an_epoch(
    steps: list[tuple[str, int, float]], start: int
) -> None:
    """Whatever the delays are, and when `base` changes its rate."""
    followed, local, robot, last = FollowedTime(), 5 * SECOND, start, None
    for what, number, rate in steps:
        if what == "tick":
            robot += int(rate * SECOND / 10)
            followed.update(Clock(stamp_ns=robot, rate=rate, epoch=start), local + number)
            local += number
        else:
            local += number
        now = followed.now(local)
        assert now is None or last is None or now >= last
        last = now if now is not None else last


@given(delays=DELAYS, rate=RATES)
@example(delays=[0, 1], rate=1.0)
def test_it_is_exact_after_the_quickest_message_of_ten_seconds(
    delays: list[int], rate: float
) -> None:
    """It is behind by the smallest delay of the last 10 s, to the nanosecond, and never ahead."""
    followed = FollowedTime()
    period = SECOND // 10
    arrivals: list[tuple[int, int, int]] = []
    for i, delay in enumerate(delays):
        sent = i * period
        arrivals.append((sent + delay, UNIX + round(rate * sent), sent))
    arrivals.sort()
    for arrived, stamp, _ in arrivals:
        followed.update(Clock(stamp_ns=stamp, rate=rate, epoch=UNIX), arrived)
    end = arrivals[-1][0]
    now = followed.now(end)
    truth = UNIX + round(rate * end)
    recent = [arrived - sent for arrived, _, sent in arrivals if end - arrived <= 10 * SECOND]
    assert now is not None
    assert -2 <= truth - now - rate * min(recent) <= 2


@given(gap=st.integers(1, 3 * SECOND))
def test_there_is_none_a_second_after_the_last_message(gap: int) -> None:
    followed = FollowedTime()
    assert followed.now(0) is None
    followed.update(Clock(stamp_ns=UNIX, rate=1.0, epoch=UNIX), SECOND)
    assert (followed.now(SECOND + gap) is None) == (gap > SECOND)


@given(jump=st.integers(-UNIX // 2, UNIX // 2).filter(bool))
def test_a_new_epoch_starts_afresh_but_is_not_believed_by_itself(jump: int) -> None:
    followed = FollowedTime()
    assert followed.update(Clock(stamp_ns=UNIX + 5, rate=1.0, epoch=UNIX), SECOND)
    assert not followed.update(Clock(stamp_ns=UNIX + 6, rate=1.0, epoch=UNIX), SECOND + 1)
    restarted = Clock(stamp_ns=UNIX + jump, rate=1.0, epoch=UNIX + jump)
    assert not followed.follows(restarted, 2 * SECOND)
    assert followed.update(restarted, 2 * SECOND)
    assert followed.epoch == UNIX + jump
    assert followed.now(2 * SECOND) == UNIX + jump


@given(delays=DELAYS, rate=RATES, wrong=st.lists(st.integers(0, 2**63 - 1), max_size=20))
def test_what_follows_is_believed_and_no_leap_is(
    delays: list[int], rate: float, wrong: list[int]
) -> None:
    """Robot time stays within two seconds of the truth, whatever is said in between."""
    followed = FollowedTime()
    followed.update(Clock(stamp_ns=UNIX, rate=rate, epoch=UNIX), 0)
    for i, delay in enumerate(delays):
        sent = i * SECOND // 10
        said = Clock(stamp_ns=UNIX + round(rate * sent), rate=rate, epoch=UNIX)
        assert followed.follows(said, sent + delay)
        followed.update(said, sent + delay)
        arrived = sent + SECOND // 2
        for stamp in wrong:
            leap = Clock(stamp_ns=stamp, rate=rate, epoch=UNIX)
            if followed.follows(leap, arrived):
                followed.update(leap, arrived)
        now, truth = followed.now(arrived), UNIX + round(rate * arrived)
        assert now is not None
        assert abs(now - truth) <= (len(wrong) + 1) * 2 * SECOND * max(1.0, rate)


@given(wrong=instances_of(Clock))
def test_who_cannot_ask_believes_what_comes_twice(wrong: Any) -> None:
    """As for a recording: no single message moves its time, and a restart of base does."""
    followed = FollowedTime()
    for tenth in range(20):
        local, stamp = tenth * SECOND // 10, UNIX + tenth * SECOND // 10
        followed.hear(Clock(stamp_ns=stamp, rate=1.0, epoch=UNIX), local)
        if tenth == 10:
            followed.hear(wrong, local + 1)
        now = followed.now(local + 2)
        assert now is not None
        assert abs(now - stamp) <= 2 * SECOND + 2
    for tenth in range(2):
        stamp = 2 * UNIX + tenth * SECOND // 10
        followed.hear(
            Clock(stamp_ns=stamp, rate=1.0, epoch=2 * UNIX), 2 * SECOND + tenth * SECOND // 10
        )
    assert followed.now(2 * SECOND + SECOND // 10) == 2 * UNIX + SECOND // 10


@given(clock=instances_of(Clock), later=st.integers(0, SECOND))
def test_whatever_clock_is_valid_it_has_a_time(clock: Any, later: int) -> None:
    followed = FollowedTime()
    followed.update(clock, 5)
    assert followed.now(5 + later) is not None


@pytest.mark.parametrize("rate", [0.0, -1.0, 1e5, 1e308, float("nan"), float("inf")])
def test_a_rate_that_is_none_is_refused(rate: float) -> None:
    payload = codec.encode(Clock(stamp_ns=1, rate=rate, epoch=0), "msgpack")
    with pytest.raises(codec.BadPayload):
        codec.decode(Clock, payload)
