"""A place is not tried for ever."""

from trolley.geometry import Pose2D
from trolley_mapper.explore.frontiers import Frontier
from trolley_mapper.explore.visited_frontiers import (
    PATIENCE,
    SQUEEZED,
    VisitedFrontiers,
    num_places,
)


def at(x: float, y: float, goal_x: float = 0.0) -> Frontier:
    return Frontier(x, y, Pose2D(goal_x, 0.0, 0.0), 1.0, 1.0)


def test_frontiers_near_each_other_are_one_place() -> None:
    visited = VisitedFrontiers()
    visited.find_or_add(at(1.0, 1.0)).failures += 1
    assert visited.find_or_add(at(1.0 + 0.9 * PATIENCE.same_m, 1.0)).failures == 1
    assert visited.find(at(1.0 + 1.1 * PATIENCE.same_m, 1.0)) is None
    assert len(visited) == 1
    assert num_places([(0.0, 0.0), (0.9 * PATIENCE.same_m, 0.0), (5.0, 0.0)]) == 2


def test_where_it_squeezes_the_goals_are_the_places() -> None:
    visited = VisitedFrontiers(SQUEEZED)
    visited.find_or_add(at(1.0, 1.0)).arrivals += 1
    assert visited.is_given_up(at(9.0, 9.0))
    assert not visited.is_given_up(at(1.0, 1.0, goal_x=0.2))


def test_a_place_is_given_up_after_so_many_tries() -> None:
    visited = VisitedFrontiers()
    looked_at, unreached = at(0.0, 0.0), at(5.0, 0.0)
    visited.find_or_add(looked_at).arrivals = PATIENCE.max_arrivals - 1
    visited.find_or_add(unreached).failures = PATIENCE.max_failures - 1
    assert not visited.is_given_up(looked_at)
    assert not visited.is_given_up(unreached)
    visited.find_or_add(looked_at).arrivals += 1
    visited.find_or_add(unreached).failures += 1
    assert visited.is_given_up(looked_at)
    assert visited.is_given_up(unreached)


def test_a_region_where_goals_add_nothing_is_dropped_though_its_frontiers_move_on() -> None:
    visited = VisitedFrontiers()
    for number in range(PATIENCE.max_barren):
        assert not visited.is_given_up(at(1.0, 1.0))
        visited.add_barren(at(1.0, 1.0 + 0.9 * PATIENCE.region_m * (number % 2)))
    assert visited.is_given_up(at(1.0, 1.0))
    assert not visited.is_given_up(at(1.0 - 1.1 * PATIENCE.region_m, 1.0))
