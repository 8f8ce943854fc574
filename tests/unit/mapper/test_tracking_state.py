"""Whether a pose is believed, scan by scan."""

from trolley_mapper.slam.scan_matcher import MatchQuality
from trolley_mapper.slam.tracking_state import PARAMS, TrackingState

GOOD = MatchQuality(match=0.95, explained=0.9, is_good=True)
NEW = MatchQuality(match=0.5, explained=0.1, is_good=False, is_new=True)
BAD = MatchQuality(match=0.3, explained=0.3, is_good=False)
LOST_AFTER_S = 1.5


def after(state: TrackingState, *scans: MatchQuality, distance_m: float = 0.05) -> TrackingState:
    """The state after scans that are 0.1 s apart."""
    for quality in scans:
        state = state.after(quality, 0.1, distance_m, LOST_AFTER_S)
    return state


def test_a_robot_that_maps_is_unsure_at_a_bad_match_and_maps_on_at_the_next_good_one() -> None:
    state = after(TrackingState(), BAD)
    assert (state.name, bool(state.message)) == ("unsure", True)
    state = after(state, GOOD)
    assert (state.name, state.message) == ("mapping", "")


def test_bad_matches_for_long_enough_lose_it() -> None:
    states = [after(TrackingState(), *[BAD] * count).name for count in (14, 16)]
    assert states == ["unsure", "lost"]


def test_a_pause_of_the_lidar_alone_does_not_lose_it() -> None:
    assert TrackingState().after(BAD, 60.0, 0.0, LOST_AFTER_S).name == "unsure"


def test_what_was_not_seen_before_is_no_bad_match_where_the_pose_is_believed() -> None:
    assert after(TrackingState(), *[NEW] * 50).name == "mapping"
    assert after(TrackingState.unproven(), NEW).name == "lost"


def test_a_pose_that_was_given_is_proven_by_driving() -> None:
    count = round(PARAMS.proof_m / 0.1)
    assert after(TrackingState.unproven(), *[GOOD] * (count - 1), distance_m=0.1).name == "unsure"
    assert after(TrackingState.unproven(), *[GOOD] * (count + 1), distance_m=0.1).name == "mapping"
    assert after(TrackingState.unproven(), *[GOOD] * 50, distance_m=0.0).name == "unsure"


def test_a_pose_that_was_found_and_fails_at_once_was_the_wrong_one() -> None:
    assert after(TrackingState.unproven(), BAD).is_lost


def test_a_scan_a_metre_loses_it_by_distance() -> None:
    states = [after(TrackingState(), *[BAD] * count, distance_m=1.0) for count in (1, 2)]
    assert [state.name for state in states] == ["unsure", "lost"]
    assert states[-1].breaks


def test_a_lost_robot_maps_on_and_is_not_found_by_a_match_with_its_own_part() -> None:
    state = after(TrackingState.lost(), *[GOOD] * 50, NEW, NEW)
    assert (state.name, state.breaks) == ("lost", False)


def test_a_loose_part_that_is_contradicted_ends_as_the_map_would() -> None:
    assert after(TrackingState.lost(), *[BAD] * 16).breaks
    assert not after(TrackingState.lost(), *[BAD] * 14).breaks
