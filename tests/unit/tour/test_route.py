"""The order of stops."""

import pytest

from trolley_tour.trips.route import lap_stops


@pytest.mark.parametrize(
    ("num_stops", "lap", "stops"),
    [
        (1, 0, [0]),
        (1, 5, [0]),
        (2, 0, [0, 1, 0]),
        (2, 1, [1, 0]),
        (3, 0, [0, 1, 2, 1, 0]),
        (3, 2, [1, 2, 1, 0]),
    ],
)
def test_there_and_back(num_stops: int, lap: int, stops: list[int]):
    assert lap_stops(num_stops, True, lap) == stops


def test_round_and_round():
    assert lap_stops(3, False, 0) == lap_stops(3, False, 7) == [0, 1, 2]
