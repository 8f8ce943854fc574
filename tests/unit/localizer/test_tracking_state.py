"""When an estimate is believed, doubted, and lost."""

import pytest

from trolley.config.localizer import LocalizerConfig
from trolley_localizer.tracking.tracking_state import Evidence, TrackingMonitor

CONFIG = LocalizerConfig()


def watch(monitor: TrackingMonitor, support: float, seconds: float, blind: bool = False) -> str:
    for _ in range(round(seconds * 10)):
        monitor.update(Evidence(support, 0.05, blind), 0.1)
    return monitor.state


@pytest.fixture
def monitor() -> TrackingMonitor:
    return TrackingMonitor(CONFIG)


def test_three_good_scans_are_needed(monitor: TrackingMonitor) -> None:
    assert watch(monitor, 0.9, 0.2) == "unsure"
    assert watch(monitor, 0.9, 0.1) == "localized"


def test_a_mediocre_match_is_not_believed(monitor: TrackingMonitor) -> None:
    assert watch(monitor, 0.5, 5.0) == "unsure"
    assert monitor.doubts


def test_little_support_for_long_is_lost(monitor: TrackingMonitor) -> None:
    watch(monitor, 0.9, 1.0)
    assert watch(monitor, 0.1, 1.0) == "unsure"
    assert watch(monitor, 0.1, 3.0) == "lost"


def test_somebody_walking_by_is_no_reason_to_doubt(monitor: TrackingMonitor) -> None:
    watch(monitor, 0.9, 1.0)
    assert watch(monitor, 0.3, 0.1) == "localized"
    assert watch(monitor, 0.9, 0.5) == "localized"
    assert not monitor.doubts


def test_a_gap_of_seconds_counts_as_one_scan(monitor: TrackingMonitor) -> None:
    watch(monitor, 0.9, 1.0)
    assert monitor.update(Evidence(0.2, 0.05, False), 30.0) != "lost"


def test_a_sudden_drop_is_doubted_though_it_is_high(monitor: TrackingMonitor) -> None:
    watch(monitor, 0.95, 20.0)
    watch(monitor, 0.65, 2.0)
    assert monitor.doubts


def test_what_changes_slowly_becomes_usual(monitor: TrackingMonitor) -> None:
    for hundredths in range(90, 64, -1):  # into a room with more furniture, say
        watch(monitor, 0.01 * hundredths, 2.0)
        assert not monitor.doubts
    watch(monitor, 0.95, 40.0)
    watch(monitor, 0.65, 2.0)
    assert monitor.doubts, "the same support, all at once"


def test_a_search_that_found_nothing_better_vouches_for_a_while(monitor: TrackingMonitor) -> None:
    watch(monitor, 0.9, 1.0)
    watch(monitor, 0.45, 1.5)
    monitor.vouch(0.45)
    assert watch(monitor, 0.45, 2.0) == "localized"
    assert not monitor.doubts
    assert watch(monitor, 0.45, 12.0) == "unsure"


def test_what_is_vouched_for_may_not_fall_much_further(monitor: TrackingMonitor) -> None:
    monitor.vouch(0.58)
    watch(monitor, 0.58, 1.0)
    assert watch(monitor, 0.42, 2.0) == "unsure"


def test_blind_scans_make_unsure_but_never_lost(monitor: TrackingMonitor) -> None:
    watch(monitor, 0.9, 1.0)
    assert watch(monitor, 0.0, 0.5, blind=True) == "localized"
    assert watch(monitor, 0.0, 60.0, blind=True) == "unsure"


def test_spread_hypotheses_are_not_believed(monitor: TrackingMonitor) -> None:
    for _ in range(20):
        state = monitor.update(Evidence(0.95, 2.0, False), 0.1)
    assert state == "unsure"


def test_what_was_believed_stays_so_while_it_is_checked(monitor: TrackingMonitor) -> None:
    watch(monitor, 0.9, 1.0)
    assert watch(monitor, 0.55, 1.2) == "localized"
    assert monitor.doubts
    assert watch(monitor, 0.55, 1.0) == "unsure"


def test_where_the_map_knows_little_little_speaks_against_the_estimate(
    monitor: TrackingMonitor,
) -> None:
    watch(monitor, 0.9, 1.0)
    for _ in range(50):
        state = monitor.update(Evidence(0.1, 0.05, False, known=0.6), 0.1)
    assert state == "unsure"


def test_what_is_to_be_proven_is_not_believed(monitor: TrackingMonitor) -> None:
    for _ in range(20):
        state = monitor.update(Evidence(0.95, 0.05, False, is_open=True), 0.1)
    assert state == "unsure"
