"""Where the middle of somebody lies who is seen in part: of round ones it is known."""

import math

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from trolley_planner.people.segments import segments_of
from trolley_planner.people.sights import HIDDEN, middle_of, width_seen

STEP_RAD = math.radians(0.25)


@given(
    st.floats(0.1, 0.5), st.floats(1.2, 5.0), st.floats(-3.0, 3.0), st.floats(0.3, 1.0),
    st.booleans(),
)  # fmt: skip
def test_the_middle_of_a_round_body_does_not_depend_on_what_hides_it(
    radius: float, away: float, bearing: float, share: float, is_left_hidden: bool
) -> None:
    half = math.asin(radius / away) * 0.98
    hidden = 2.0 * half * (1.0 - share)
    first, last = (-half, half - hidden) if is_left_hidden else (hidden - half, half)
    turns = np.arange(first, last, STEP_RAD)
    if len(turns) < 4:
        return
    ranges = away * np.cos(turns) - np.sqrt(radius**2 - (away * np.sin(turns)) ** 2)
    points = ranges[:, None] * np.column_stack([np.cos(turns + bearing), np.sin(turns + bearing)])
    is_hidden = np.zeros((len(points), 2), np.bool_)
    is_part = share < 1.0
    is_hidden[0, 0], is_hidden[-1, 1] = is_part and not is_left_hidden, is_part and is_left_hidden
    segments = segments_of(points, is_hidden, np.zeros(2), STEP_RAD)
    for segment in segments:
        assert width_seen(segment.sight) <= 2.0 * radius + 1e-9
    (segment,) = segments
    assert segment.sight[HIDDEN] == (0 if not is_part else 1 + is_left_hidden)
    middle = middle_of(segment.sight, 2.0 * radius)
    truth = away * math.cos(bearing), away * math.sin(bearing)
    assert math.dist(middle, truth) < 0.25 * radius + STEP_RAD * away
