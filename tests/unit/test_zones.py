"""Which room a point lies in."""

import pytest

from trolley.geometry import Pose2D
from trolley.messages import PoseEstimate, Zone, Zones
from trolley.zones import room_at, room_of

FLAT = Zone(name="flat", kind="room", points=[(0, 0), (8, 0), (8, 6), (0, 6)])
KITCHEN = Zone(name="kitchen", kind="room", points=[(0, 0), (0, 3), (4, 3), (4, 0)])
CARPET = Zone(name="carpet", kind="speed", points=[(5, 1), (6, 1), (6, 2), (5, 2)], speed=0.2)
ZONES = [FLAT, KITCHEN, CARPET]


@pytest.mark.parametrize(
    ("point", "room"),
    [((1, 1), "kitchen"), ((5.5, 1.5), "flat"), ((7, 5), "flat"), ((9, 1), None)],
)
def test_the_smallest_room_counts(point: tuple[float, float], room: str | None) -> None:
    assert room_at(ZONES, *point) == room
    assert room_at(reversed(ZONES), *point) == room


def test_a_robot_is_in_a_room_of_its_own_map_only() -> None:
    zones = Zones(stamp_ns=0, map="home", zones=ZONES)

    def at(pose: Pose2D | None, chart: str = "home") -> PoseEstimate:
        return PoseEstimate(
            stamp_ns=0,
            map=chart,
            pose=pose,
            covariance=None,
            state="localized",
            match=1.0,
            spread=0,
        )

    assert room_of(at(Pose2D(1.0, 1.0, 0.0)), zones) == "kitchen"
    assert room_of(at(Pose2D(1.0, 1.0, 0.0), "office"), zones) is None
    assert room_of(at(None), zones) is None
    assert room_of(None, zones) is None
    assert room_of(at(Pose2D(1.0, 1.0, 0.0)), None) is None
