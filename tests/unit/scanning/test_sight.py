"""Whether a lidar looks all round."""

import math

import numpy as np
import pytest

from trolley.sight import looks_all_round

STEP_RAD = math.radians(0.5)


@pytest.mark.parametrize(
    ("hidden_deg", "expected"),
    [
        ([], True),
        ([(40, 50), (130, 140), (220, 230), (310, 320)], True),
        ([(165, 195)], False),
        ([(0, 15), (345, 360)], False),
        ([(0, 360)], False),
    ],
)
def test_a_gap_wider_than_a_post_is_where_it_does_not_look(
    hidden_deg: list[tuple[int, int]], expected: bool
) -> None:
    looks = np.ones(720, np.bool_)
    for first, last in hidden_deg:
        looks[2 * first : 2 * last] = False
    assert looks_all_round(looks, STEP_RAD) is expected


@pytest.mark.parametrize(("width_deg", "expected"), [(355, True), (270, False), (180, False)])
def test_where_it_has_no_beams_it_does_not_look(width_deg: int, expected: bool) -> None:
    assert looks_all_round(np.ones(2 * width_deg, np.bool_), STEP_RAD) is expected
