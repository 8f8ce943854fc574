"""Following a person through rooms: never too near, and no longer than they are seen."""

import math
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from support.flatland import Flatland, empty_room, two_rooms, with_block

from trolley import codes
from trolley.codes import Refused
from trolley.geometry import Pose2D
from trolley.gridmap import GridMap
from trolley.messages import GoalStatus
from trolley.messages.request_params import FollowPerson, WhichGoal

STEP_S = 0.05
Place = Callable[[float], tuple[float, float] | None]

pytestmark = pytest.mark.drives


class Walk:
    """A robot at x = 1 or `start_x` that looks along y = 3, and people of some width."""

    def __init__(
        self, ride, room: GridMap | None = None, start_x: float = 1.0, width_m: float = 0.3
    ) -> None:
        self._room = self._shown = room or empty_room(12.0, 6.0)
        self._width_m = width_m
        self.world = Flatland(self._room, Pose2D(start_x, 3.0, 0.0))
        self.drive = ride(self.world)
        self.gaps: list[float] = []
        self.elapsed_s = 0.0

    def go_on(self, seconds: float, *places: Place) -> None:
        """Let people be where `places` say, at times from the beginning; the first is followed."""
        for _ in range(round(seconds / STEP_S)):
            truth = self._room
            spots = [place(self.elapsed_s) for place in places]
            for spot in spots:
                if spot is not None:
                    x, y = spot[0] - 0.5 * self._width_m, spot[1] - 0.5 * self._width_m
                    truth = with_block(truth, x, y, self._width_m, self._width_m)
            if not np.array_equal(truth.cells, self._shown.cells):
                self.world.set_truth(truth)
                self._shown = truth
            self.drive.step()
            self.elapsed_s += STEP_S
            if spots and spots[0] is not None:
                pose = self.world.pose
                self.gaps.append(math.hypot(pose.x - spots[0][0], pose.y - spots[0][1]))

    def follow(self, point: tuple[float, float] | None = None, **options: Any) -> GoalStatus:
        """Ask to follow whoever is at a point given in frame `grid`."""
        if point is not None:
            in_frame = self.world.grid.origin.transform_points(np.array([point]))[0]
            point = float(in_frame[0]), float(in_frame[1])
        params = FollowPerson(point=point, **options)
        return self.drive.navigator.requests.follow(params, "made", self.drive.now_ns)

    @property
    def status(self) -> GoalStatus:
        return self.drive.navigator.current.status(self.drive.now_ns)


def ahead_at(speed: float, start: float = 2.2, until_s: float = 100.0) -> Place:
    return lambda t: (start + speed * min(t, until_s), 3.0)


@pytest.mark.parametrize("speed", [0.25, 0.45])
def test_stays_behind_who_walks_ahead(ride, speed: float) -> None:
    walk = Walk(ride)
    person = ahead_at(speed, until_s=14.0)
    walk.go_on(1.0, person)
    assert walk.follow().state == "driving"
    walk.go_on(12.0, person)
    assert min(walk.gaps) >= 0.8
    assert max(walk.gaps[100:]) <= 2.0
    # Standing with them, it keeps its distance for as long as they stand.
    walk.go_on(20.0, person)
    assert min(walk.gaps) >= 0.8
    assert max(walk.gaps) <= 2.0
    assert walk.world.twist.is_zero
    assert walk.status.state == "driving"
    assert walk.status.person is not None
    assert walk.world.touches == 0


def test_follows_whom_it_was_shown_and_not_who_walks_by(ride) -> None:
    walk = Walk(ride)

    def person(t: float) -> tuple[float, float]:
        return 2.2 + 0.3 * t, 4.0

    def other(t: float) -> tuple[float, float]:
        return 2.0 + 0.3 * t, 2.0

    def crossing(t: float) -> tuple[float, float]:
        return 6.0, 6.0 - 0.5 * t if t < 11.0 else 0.5

    walk.go_on(1.0, person, other, crossing)
    walk.follow((2.5, 4.0))
    walk.go_on(14.0, person, other, crossing)
    assert walk.status.state == "driving"
    x, y = walk.status.person or (0.0, 0.0)
    shown = walk.world.grid.origin.inverse().transform_points(np.array([[x, y]]))[0]
    assert math.dist(shown, person(walk.elapsed_s)) < 0.4


def test_follows_who_stood_when_they_were_shown(ride) -> None:
    walk = Walk(ride)

    def person(t: float) -> tuple[float, float]:
        return (3.0, 3.0) if t < 3.0 else (3.0 + 0.4 * (t - 3.0), 3.0)

    walk.go_on(1.0, person)
    walk.follow((3.1, 3.1))
    walk.go_on(14.0, person)
    assert walk.status.state == "driving"
    assert walk.gaps[-1] < 2.0
    assert min(walk.gaps) >= 0.8


def test_follows_the_same_person_when_the_map_is_published_again(ride) -> None:
    walk = Walk(ride)
    person = ahead_at(0.35)
    bins: list[Place] = [lambda _: (2.6, 1.0), lambda _: (4.0, 1.2), lambda _: (5.0, 5.0)]
    walk.go_on(1.0, person, *bins)
    walk.follow()
    for _ in range(4):
        walk.go_on(2.0, person, *bins)
        walk.drive.navigator.inputs.map = walk.world.map()
    walk.go_on(6.0, person, *bins)
    x, y = walk.status.person or (0.0, 0.0)
    shown = walk.world.grid.origin.inverse().transform_points(np.array([[x, y]]))[0]
    assert math.dist(shown, person(walk.elapsed_s) or (0.0, 0.0)) < 0.4


def test_goes_on_through_the_next_door_when_the_person_is_seen_again(ride) -> None:
    room = empty_room(16.0, 6.0)
    for x in (3.95, 7.5):  # doors of 0.42 m, which take a maneuver
        room = with_block(with_block(room, x, 0.0, 0.1, 2.79), x, 3.21, 0.1, 2.79)
    walk = Walk(ride, room, start_x=1.5, width_m=0.24)
    hidden_s = 5.35, 7.95

    def person(t: float) -> tuple[float, float] | None:
        if hidden_s[0] < t < hidden_s[1]:
            return None
        walked_s = min(t, hidden_s[0]) + max(t - hidden_s[1], 0.0)
        return min(2.7 + 0.3 * walked_s + (0.3 if t > hidden_s[1] else 0.0), 12.0), 3.0

    walk.go_on(1.0, person)
    walk.follow(distance=1.0)
    walk.go_on(50.0, person)
    assert walk.world.pose.x > 9.0
    assert walk.status.state == "driving"


def test_goes_through_a_door_after_who_is_out_of_sight_behind_it(ride) -> None:
    walk = Walk(ride, two_rooms(0.8))

    def person(t: float) -> tuple[float, float]:
        along = 2.2 + 0.4 * t
        if along < 4.6:
            return along, 3.0
        return 4.6, 3.0 + min(along - 4.6, 2.0)

    walk.go_on(1.0, person)
    walk.follow()
    walk.go_on(24.0, person)
    assert walk.status.state == "driving"
    assert walk.world.pose.x > 4.0
    assert walk.world.touches == 0


def test_stops_and_says_so_when_the_person_is_lost(ride) -> None:
    walk = Walk(ride)
    person = ahead_at(0.4)
    walk.go_on(1.0, person)
    walk.follow()
    walk.go_on(4.0, person)
    before = len(walk.drive.statuses)
    walk.go_on(2.5)
    assert walk.status.state == "recovering"
    assert walk.status.reason == codes.PERSON_LOST
    walk.go_on(1.5)
    assert walk.status.state == "failed"
    assert walk.status.reason == codes.PERSON_LOST
    assert walk.status.message
    walk.go_on(1.0)
    assert walk.world.twist.is_zero
    states = [one.state for one in walk.drive.statuses[before:]]
    assert states[-2:] == ["recovering", "failed"]


def test_is_refused_where_nobody_is_and_leaves_the_goal_alone(ride) -> None:
    walk = Walk(ride)
    walk.go_on(0.5)
    walk.drive.send(Pose2D(8.0, 3.0, 0.0))
    for point in (None, (3.0, 3.0)):
        with pytest.raises(Refused) as refused:
            walk.follow(point)
        assert refused.value.code == codes.NOBODY
    with pytest.raises(Refused) as refused:
        walk.follow(frame="odom")
    assert refused.value.code == codes.WRONG_FRAME
    assert walk.status.state == "driving"


def test_a_paused_follower_goes_on_when_it_is_told_to(ride) -> None:
    walk = Walk(ride)
    person = ahead_at(0.25)
    walk.go_on(1.0, person)
    walk.follow()
    walk.go_on(3.0, person)
    navigator = walk.drive.navigator
    navigator.requests.pause(WhichGoal(), walk.drive.now_ns)
    walk.go_on(2.0, person)
    assert walk.world.twist.is_zero
    navigator.requests.resume(WhichGoal(), walk.drive.now_ns)
    walk.go_on(10.0, person)
    assert walk.gaps[-1] < 2.0
    navigator.requests.pause(WhichGoal(), walk.drive.now_ns)
    walk.go_on(4.0)
    with pytest.raises(Refused) as refused:
        navigator.requests.resume(WhichGoal(), walk.drive.now_ns)
    assert refused.value.code == codes.PERSON_LOST


def test_a_goal_ends_following(ride) -> None:
    walk = Walk(ride)
    person = ahead_at(0.25)
    walk.go_on(1.0, person)
    walk.follow()
    walk.go_on(2.0, person)
    walk.drive.send(Pose2D(1.0, 4.5, 0.0))
    walk.go_on(25.0, person)
    assert walk.status.state == "arrived"
    assert walk.status.person is None
