"""Who touches somebody, or was hidden by them, is still known by their own way."""

import math

import numpy as np
import pytest
from numpy.typing import NDArray
from support.round_bodies import ranges_to

from trolley_planner.people.tracker import PeopleTracker, TrackedPerson

BEAMS, SCAN_S = 720, 0.1
WALL_M = 7.0
"""Around the lidar, farther away than people are tracked."""
NO_WALLS = np.full((320, 320), 10.0, np.float32)
EDGE_M = 0.05
Discs = NDArray[np.float64]
LIDAR = np.array([8.0, 8.0])


def beams_on(discs: Discs) -> NDArray[np.float64]:
    """A scan of round bodies (n, 3) x, y, radius [m] from the lidar on, in a round room."""
    angles = np.linspace(-math.pi, math.pi, BEAMS, endpoint=False)
    ways = np.column_stack([np.cos(angles), np.sin(angles)])
    ranges = np.minimum(ranges_to(discs, angles).min(axis=1), WALL_M)
    places = np.broadcast_to(LIDAR, ways.shape)
    return np.column_stack([places, ways, ranges, ranges])


def watched(bodies: Discs, seconds: float) -> list[tuple[Discs, list[TrackedPerson]]]:
    """Where bodies (n, 5) x, y, radius [m], velocity [m/s] are at each scan, and who is tracked."""
    watch, seen = PeopleTracker(), []
    for step in range(round(seconds / SCAN_S)):
        now = bodies[:, :3].copy()
        now[:, :2] += step * SCAN_S * bodies[:, 3:]
        people = watch.update(round(step * SCAN_S * 1e9), beams_on(now), NO_WALLS, EDGE_M)
        seen.append((now, people))
    return seen


def off_m(people: list[TrackedPerson], body: Discs) -> tuple[float, float]:
    """How far the nearest one is from a body (5,) [m], and its velocity from that one's [m/s]."""
    if not people:
        return math.inf, math.inf
    nearest = min(people, key=lambda one: math.dist(one.place - LIDAR, body[:2]))
    return (
        math.dist(nearest.place - LIDAR, body[:2]),
        float(np.hypot(*(nearest.velocity - body[3:]))),
    )


@pytest.mark.parametrize("radius", [0.25, 0.5])
@pytest.mark.parametrize(
    ("first", "second"),
    [
        ((3.4, 0.0, -0.8, 0.0), (1.6, 0.98, 0.4, 0.0)),  # towards and away, side by side
        ((2.2, -1.4, 0.0, 0.9), (2.2, 1.4, 0.35, -0.6)),  # across, into one another for a moment
    ],
)
def test_two_who_brush_past_each_other_keep_their_own_ways(
    radius: float, first: tuple[float, ...], second: tuple[float, ...]
) -> None:
    """The lidar sees them as one meanwhile."""
    bodies = np.array([(*one[:2], radius, *one[2:]) for one in (first, second)])
    bodies[1, 1] *= 2.0 * radius if first[3] == 0.0 else 1.0
    compared = 0
    for now, people in watched(bodies, 3.0)[12:]:
        for body, place in zip(bodies, now, strict=True):
            other = now[1] if body is bodies[0] else now[0]
            bearings = [math.atan2(one[1], one[0]) for one in (place, other)]
            is_behind = np.hypot(*place[:2]) > np.hypot(*other[:2])
            if is_behind and abs(bearings[0] - bearings[1]) < 1.3 * radius / np.hypot(*place[:2]):
                continue  # Half of it is hidden.
            place_m, velocity_mps = off_m(people, np.concatenate([place, body[3:]]))
            assert place_m < 0.7 * radius
            assert velocity_mps < 0.35
            compared += 1
    assert compared > 20


def test_who_comes_out_from_behind_somebody_is_known_by_how_they_went_there() -> None:
    """At the first sight after 0.8 s, not once a new way has been measured."""
    bodies = np.array([[3.0, -1.8, 0.25, 0.0, 1.0], [1.5, 0.0, 0.3, 0.0, 0.001]])
    hidden, known = 0, 0
    for now, people in watched(bodies, 3.6)[10:]:
        is_hidden = abs(math.atan2(now[0, 1], now[0, 0])) + 0.085 < math.asin(0.3 / 1.5)
        hidden += is_hidden
        _, velocity_mps = off_m(people, np.concatenate([now[0], bodies[0, 3:]]))
        if hidden > 4 and not is_hidden:
            assert velocity_mps < 0.3
            known += 1
    assert hidden > 4
    assert known > 3
