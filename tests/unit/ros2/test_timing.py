from trolley_ros2.timing import MAX_WANDER_NS, MOST_SENDERS, Delays, RosClock

SECOND = 1_000_000_000
UNIX_NS = 1_700_000_000 * SECOND
LIMIT_NS = 300_000_000
GID = b"g" * 16


def test_stamps_keep_their_distances_while_the_clocks_are_followed() -> None:
    clock = RosClock()
    first = clock.stamp(2 * SECOND, 3 * SECOND, UNIX_NS)
    assert first == UNIX_NS - SECOND
    wandered = UNIX_NS + SECOND + MAX_WANDER_NS // 2
    assert clock.stamp(3 * SECOND, 4 * SECOND, wandered) == first + SECOND


def test_stamps_follow_a_clock_that_was_set() -> None:
    clock = RosClock()
    clock.stamp(2 * SECOND, 3 * SECOND, UNIX_NS)
    assert clock.stamp(3 * SECOND, 3 * SECOND, UNIX_NS + SECOND) == UNIX_NS + SECOND


def test_what_has_no_stamp_is_of_now() -> None:
    clock = RosClock()
    assert clock.stamp(0, 5, UNIX_NS) == UNIX_NS
    assert clock.stamp(5, None, UNIX_NS) == UNIX_NS


def test_a_burst_after_a_stall_is_late_until_it_has_passed() -> None:
    delays = Delays()
    arrived = UNIX_NS
    assert not delays.is_late(GID, 0, arrived, LIMIT_NS)
    late = [
        delays.is_late(GID, i * SECOND // 10, arrived + 5 * SECOND + i, LIMIT_NS)
        for i in range(1, 51)
    ]
    assert late[:45] == [True] * 45
    assert not late[-1]
    assert not delays.is_late(GID, 6 * SECOND, arrived + 6 * SECOND, LIMIT_NS)


def test_clocks_need_not_agree_and_may_drift() -> None:
    delays = Delays()
    for i in range(36_000):  # an hour at 10 Hz, 100 millionths apart
        source = i * SECOND // 10
        assert not delays.is_late(GID, source, UNIX_NS + source + source // 10_000, LIMIT_NS)


def test_a_senders_clock_that_was_set_back_is_understood_after_a_second() -> None:
    delays = Delays()
    assert not delays.is_late(GID, 10 * SECOND, UNIX_NS, LIMIT_NS)
    late = [
        delays.is_late(GID, i * SECOND // 10, UNIX_NS + i * SECOND // 10, LIMIT_NS)
        for i in range(1, 30)
    ]
    assert late == [True] * 11 + [False] * 18


def test_strangers_cannot_make_it_remember_everybody() -> None:
    delays = Delays()
    for i in range(1000):
        assert not delays.is_late(i.to_bytes(16, "little"), 0, UNIX_NS + i, LIMIT_NS)
    assert len(delays._senders) == MOST_SENDERS
