from trolley.messages import Clock
from trolley.runtime.robot_time import FollowedTime
from trolley_base.robot_clock import Beat, RobotClock

S = 1_000_000_000
MS = 1_000_000
EPOCH = 1_764_000_000 * S
STEP = 20 * MS


def test_there_is_no_time_before_it_begins() -> None:
    assert RobotClock().now(5 * S) is None


def test_real_hardware_runs_with_the_monotonic_clock() -> None:
    clock = RobotClock()
    clock.begin(EPOCH, 7 * S)
    assert clock.epoch == EPOCH
    assert clock.now(7 * S) == EPOCH
    assert clock.now(10_000 * S + 1) == EPOCH + 9993 * S + 1


def test_a_simulation_is_never_more_than_a_step_ahead_of_what_was_reached() -> None:
    clock = RobotClock()
    clock.begin(EPOCH, 0, rate=2.0, step_ns=STEP)
    assert clock.now(5 * MS) == EPOCH + 10 * MS
    assert clock.now(10 * MS) == EPOCH + STEP
    assert clock.now(1 * S) == EPOCH + STEP
    clock.reached(EPOCH + STEP, 10 * MS)
    assert clock.now(15 * MS) == EPOCH + 30 * MS


def run(clock: RobotClock, cost_ns: int, until_ns: int, monotonic_ns: int) -> int:
    """Steps as a runtime calls them, each of which takes `cost_ns`; returns the local time."""
    while monotonic_ns < until_ns:
        before_ns = clock.now(monotonic_ns)
        assert before_ns is not None
        if before_ns >= clock._reached_ns + STEP:
            monotonic_ns += cost_ns
            clock.reached(before_ns, monotonic_ns)
        else:
            monotonic_ns += 1 * MS
        after_ns = clock.now(monotonic_ns)
        assert after_ns is not None
        assert before_ns <= after_ns <= before_ns + STEP, "steps are neither skipped nor undone"
    return monotonic_ns


def test_a_machine_that_keeps_up_keeps_the_rate() -> None:
    clock = RobotClock()
    clock.begin(0, 0, rate=5.0, step_ns=STEP)
    end_ns = run(clock, 1 * MS, 10 * S, 0)
    now_ns = clock.now(end_ns)
    assert clock.rate == 5.0
    assert now_ns is not None
    assert abs(now_ns - 5 * end_ns) < 2 * STEP


def test_a_machine_that_cannot_keep_up_lowers_the_rate_and_skips_nothing() -> None:
    clock = RobotClock()
    clock.begin(0, 0, rate=10.0, step_ns=STEP)
    run(clock, 5 * MS, 5 * S, 0)  # 20 ms in 5 ms: 4 is possible
    assert 3.0 < clock.rate < 4.0
    assert clock.is_slowed


def test_the_rate_comes_back_when_the_machine_is_free_again() -> None:
    clock = RobotClock()
    clock.begin(0, 0, rate=10.0, step_ns=STEP)
    now_ns = run(clock, 5 * MS, 5 * S, 0)
    run(clock, 1 * MS, 150 * S, now_ns)
    assert clock.rate == 10.0
    assert not clock.is_slowed


def test_the_rate_is_soon_back_after_a_machine_was_very_busy() -> None:
    clock = RobotClock()
    clock.begin(0, 0, rate=1.0, step_ns=STEP)
    now_ns = run(clock, 500 * MS, 5 * S, 0)  # 20 ms in 500 ms
    assert clock.rate < 0.05
    run(clock, 1 * MS, now_ns + 60 * S, now_ns)
    assert clock.rate == 1.0


def test_a_pause_is_made_up_for_at_the_same_rate() -> None:
    clock = RobotClock()
    clock.begin(0, 0, rate=1.0, step_ns=STEP)
    monotonic_ns = run(clock, 1 * MS, 2 * S, 0)
    monotonic_ns = run(clock, 1 * MS, 10 * S, monotonic_ns + 3 * S)
    now_ns = clock.now(monotonic_ns)
    assert clock.rate == 1.0
    assert now_ns is not None
    assert abs(now_ns - monotonic_ns) < 2 * STEP


def test_who_follows_the_clock_is_not_ahead_of_the_foremost_while_steps_are_late() -> None:
    clock, followed = RobotClock(), FollowedTime()
    clock.begin(EPOCH, 0, rate=10.0, step_ns=STEP)
    monotonic_ns, heard_ns = 0, 0
    while monotonic_ns < 5 * S:
        reached_ns = clock.now(monotonic_ns)
        assert reached_ns is not None
        if monotonic_ns >= heard_ns:
            said = Clock(stamp_ns=reached_ns, rate=clock.rate, epoch=EPOCH)
            followed.update(said, monotonic_ns)
            heard_ns = monotonic_ns + 100 * MS
        monotonic_ns += 10 * MS  # 20 ms in 10 ms: 2 is possible, not 10
        if clock.reached(reached_ns, monotonic_ns):
            heard_ns = monotonic_ns
        believed_ns = followed.now(monotonic_ns)
        assert believed_ns is not None
        assert believed_ns <= clock.foremost(monotonic_ns) + 1
    assert clock.is_slowed


def test_a_beat_is_due_at_once_and_then_keeps_its_phase() -> None:
    beat = Beat(0.05)
    due = [now for now in range(0, 401, 20) if beat.is_due(EPOCH + now * MS)]
    assert due == [0, 60, 100, 160, 200, 260, 300, 360, 400]


def test_a_beat_that_was_missed_is_not_made_up_for() -> None:
    beat = Beat(0.1)
    assert beat.is_due(0)
    assert beat.is_due(1 * S + 30 * MS)
    assert not beat.is_due(1 * S + 90 * MS)
    assert beat.is_due(1 * S + 100 * MS)
