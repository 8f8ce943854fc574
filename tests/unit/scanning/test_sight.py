"""Whether a lidar looks all round."""

import math

import numpy as np
import pytest

from trolley.sight import LidarView

STEP_RAD = math.radians(0.5)


def view_of(
    hidden_deg: list[tuple[int, int]], num_beams: int = 720, first: float = 0.3
) -> LidarView:
    ranges_m = np.full(num_beams, np.inf, np.float32)
    for low, high in hidden_deg:
        ranges_m[2 * low : 2 * high] = 0.0
    view = LidarView()
    view.note(ranges_m, first, STEP_RAD)
    return view


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
    assert view_of(hidden_deg).is_all_round is expected


@pytest.mark.parametrize(("width_deg", "expected"), [(355, True), (270, False), (180, False)])
def test_where_it_has_no_beams_it_does_not_look(width_deg: int, expected: bool) -> None:
    assert view_of([], 2 * width_deg).is_all_round is expected


def test_what_measured_once_is_not_masked_however_many_beams_a_revolution_has() -> None:
    view = view_of([(165, 195)])
    turned = np.full(719, 2.0, np.float32)
    turned[:100] = 0.0  # nothing comes back from there now
    view.note(turned, 0.3, 2.0 * math.pi / 719)
    assert view.is_all_round


def test_the_gap_of_a_lidar_that_turns_clockwise_is_as_wide() -> None:
    view = LidarView()
    view.note(np.ones(270, np.float32), 2.0, -math.radians(1.0))
    assert view.widest_gap_rad == pytest.approx(0.5 * math.pi, abs=0.05)
