"""When an estimate is believed, doubted, and lost."""

import pytest

from trolley.config.localizer import LocalizerConfig
from trolley_localizer.tracking_state import Evidence, TrackingMonitor

CONFIG = LocalizerConfig()


def look(judge: TrackingMonitor, support: float, seconds: float, blind: bool = False) -> str:
    for _ in range(round(seconds * 10)):
        judge.look(Evidence(support, 0.05, blind), 0.1)
    return judge.state


@pytest.fixture
def judge() -> TrackingMonitor:
    return TrackingMonitor(CONFIG)


def test_three_good_scans_are_needed(judge: TrackingMonitor) -> None:
    assert look(judge, 0.9, 0.2) == "unsure"
    assert look(judge, 0.9, 0.1) == "localized"


def test_a_mediocre_match_is_not_believed(judge: TrackingMonitor) -> None:
    assert look(judge, 0.5, 5.0) == "unsure"
    assert judge.doubts


def test_little_support_for_long_is_lost(judge: TrackingMonitor) -> None:
    look(judge, 0.9, 1.0)
    assert look(judge, 0.1, 1.0) == "unsure"
    assert look(judge, 0.1, 3.0) == "lost"


def test_somebody_walking_by_is_no_reason_to_doubt(judge: TrackingMonitor) -> None:
    look(judge, 0.9, 1.0)
    assert look(judge, 0.3, 0.1) == "localized"
    assert look(judge, 0.9, 0.5) == "localized"
    assert not judge.doubts


def test_a_gap_of_seconds_counts_as_one_scan(judge: TrackingMonitor) -> None:
    look(judge, 0.9, 1.0)
    assert judge.look(Evidence(0.2, 0.05, False), 30.0) != "lost"


def test_a_sudden_drop_is_doubted_though_it_is_high(judge: TrackingMonitor) -> None:
    look(judge, 0.95, 20.0)
    look(judge, 0.65, 2.0)
    assert judge.doubts


def test_a_search_that_found_nothing_better_vouches_for_a_while(judge: TrackingMonitor) -> None:
    look(judge, 0.9, 1.0)
    look(judge, 0.45, 1.5)
    judge.vouch(0.45)
    assert look(judge, 0.45, 2.0) == "localized"
    assert not judge.doubts
    assert look(judge, 0.45, 12.0) == "unsure"


def test_what_is_vouched_for_may_not_fall_much_further(judge: TrackingMonitor) -> None:
    judge.vouch(0.58)
    look(judge, 0.58, 1.0)
    assert look(judge, 0.42, 2.0) == "unsure"


def test_blind_scans_make_unsure_but_never_lost(judge: TrackingMonitor) -> None:
    look(judge, 0.9, 1.0)
    assert look(judge, 0.0, 0.5, blind=True) == "localized"
    assert look(judge, 0.0, 60.0, blind=True) == "unsure"


def test_spread_hypotheses_are_not_believed(judge: TrackingMonitor) -> None:
    for _ in range(20):
        state = judge.look(Evidence(0.95, 2.0, False), 0.1)
    assert state == "unsure"


def test_what_was_believed_stays_so_while_it_is_checked(judge: TrackingMonitor) -> None:
    look(judge, 0.9, 1.0)
    assert look(judge, 0.55, 1.2) == "localized"
    assert judge.doubts
    assert look(judge, 0.55, 1.0) == "unsure"
