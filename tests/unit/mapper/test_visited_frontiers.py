"""A place is not tried for ever."""

from trolley_mapper.explore.visited_frontiers import (
    MAX_ARRIVALS,
    MAX_BARREN,
    MAX_FAILURES,
    REGION_M,
    SAME_M,
    VisitedFrontiers,
)


def test_frontiers_near_each_other_are_one_place() -> None:
    visited = VisitedFrontiers()
    visited.find_or_add(1.0, 1.0).failures += 1
    assert visited.find_or_add(1.0 + 0.9 * SAME_M, 1.0).failures == 1
    assert visited.find(1.0 + 1.1 * SAME_M, 1.0) is None
    assert len(visited) == 1


def test_a_place_is_given_up_after_so_many_tries() -> None:
    visited = VisitedFrontiers()
    looked_at, unreached = visited.find_or_add(0.0, 0.0), visited.find_or_add(5.0, 0.0)
    looked_at.arrivals, unreached.failures = MAX_ARRIVALS - 1, MAX_FAILURES - 1
    assert not looked_at.is_given_up(is_squeezed=False)
    assert not unreached.is_given_up(is_squeezed=False)
    looked_at.arrivals, unreached.failures = MAX_ARRIVALS, MAX_FAILURES
    assert looked_at.is_given_up(is_squeezed=False)
    assert unreached.is_given_up(is_squeezed=False)


def test_a_place_that_was_reached_once_does_not_count_as_failed() -> None:
    visited = VisitedFrontiers()
    reached, unreached = visited.find_or_add(0.0, 0.0), visited.find_or_add(5.0, 0.0)
    reached.arrivals, reached.failures, unreached.failures = 1, 1, 1
    assert visited.num_failed == 1


def test_a_region_where_goals_add_nothing_is_dropped_though_its_frontiers_move_on() -> None:
    visited = VisitedFrontiers()
    for number in range(MAX_BARREN):
        assert not visited.is_barren(1.0, 1.0, is_squeezed=False)
        visited.add_barren(1.0, 1.0 + 0.9 * REGION_M * (number % 2))
    assert visited.is_barren(1.0, 1.0, is_squeezed=False)
    assert not visited.is_barren(1.0 - 1.1 * REGION_M, 1.0, is_squeezed=False)
