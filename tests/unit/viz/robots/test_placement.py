"""Where things are drawn."""

import numpy as np
import pytest

from trolley.geometry import Pose2D, Twist2D
from trolley.messages import Odometry, Scan, Transform, floats_from_bytes, floats_to_bytes
from trolley_viz.robots.placement import Placement

STILL = Twist2D(0.0, 0.0, 0.0)
MS = 1_000_000


def odometry(stamp_ms: int, x: float, yaw: float = 0.0) -> Odometry:
    return Odometry(stamp_ns=stamp_ms * MS, pose=Pose2D(x, 0.0, yaw), twist=STILL)


def link(parent: str, child: str, pose: Pose2D) -> dict[tuple[str, ...], Transform]:
    return {(child,): Transform(stamp_ns=0, parent=parent, child=child, pose=pose)}


LASER = link("base_link", "laser", Pose2D(0.1, 0.0, 0.0))
ODOM = link("map", "odom", Pose2D(5.0, 0.0, 0.0))


def scan(stamp_ms: int, beams: int, time_increment: float) -> Scan:
    return Scan(
        stamp_ns=stamp_ms * MS,
        frame="laser",
        angle_min=0.0,
        angle_increment=1e-9,  # all beams look ahead
        time_increment=time_increment,
        range_min=0.0,
        range_max=9.0,
        ranges=floats_to_bytes(np.full(beams, 2.0)),
    )


def points(placement: Placement, one: Scan) -> np.ndarray:
    found = placement.scan_points(one, floats_from_bytes(one.ranges))
    assert found is not None
    return found


def test_each_beam_is_placed_where_the_robot_was() -> None:
    placement = Placement()
    placement.update(ODOM | LASER, [odometry(0, 0.0), odometry(100, 0.1)], has_map=True)
    found = points(placement, scan(0, 3, 0.05))
    assert found[:, 0] == pytest.approx([7.1, 7.15, 7.2])


def test_a_turn_over_pi_is_interpolated_the_short_way() -> None:
    placement = Placement()
    turning = [odometry(0, 0.0, np.pi - 0.1), odometry(100, 0.0, -np.pi + 0.1)]
    placement.update(
        ODOM | link("base_link", "laser", Pose2D(0.0, 0.0, 0.0)), turning, has_map=True
    )
    assert points(placement, scan(50, 1, 0.0))[0] == pytest.approx([3.0, 0.0], abs=1e-6)


def test_without_a_map_the_world_is_odom() -> None:
    placement = Placement()
    placement.update(LASER, [odometry(0, 1.0)], has_map=False)
    assert placement.world == "odom"
    assert placement.world_T_base == Pose2D(1.0, 0.0, 0.0)
    assert points(placement, scan(0, 1, 0.0))[0] == pytest.approx([3.1, 0.0])


def test_before_the_robot_has_found_itself_nothing_is_placed_on_the_map() -> None:
    placement = Placement()
    placement.update(LASER, [odometry(0, 1.0)], has_map=True)
    assert placement.world == "map"
    assert placement.world_T_base is None
    assert "tf/odom" in placement.missing("base_link")
    one = scan(0, 1, 0.0)
    assert placement.scan_points(one, floats_from_bytes(one.ranges)) is None


def test_frames_that_form_a_loop_are_left_out() -> None:
    placement = Placement()
    loop = link("arm", "hand", Pose2D.identity()) | link("hand", "arm", Pose2D.identity())
    placement.update(ODOM | loop, [odometry(0, 0.0)], has_map=True)
    assert placement.world_T_base == Pose2D(5.0, 0.0, 0.0)
