"""Windows of a drive between two sure poses."""

import math

import pytest

from trolley.geometry import Pose2D, Twist2D, exp_twist
from trolley.messages import Odometry, PoseEstimate
from trolley_base.upkeep.comparison import Comparison

SURE = [1e-4, 0.0, 0.0, 0.0, 1e-4, 0.0, 0.0, 0.0, 1e-4]
PERIOD_NS = 100_000_000


def drive(twist: Twist2D, share: float) -> Comparison:
    """Drive for 20 s by the wheels, of which a share moves the robot."""
    comparison = Comparison()
    odom, true = Pose2D.identity(), Pose2D(3.0, 1.0, 0.5)
    for number in range(200):
        stamp_ns = number * PERIOD_NS
        comparison.update_pose(
            PoseEstimate(
                stamp_ns=stamp_ns,
                map="hall",
                match=1.0,
                spread=0.0,
                pose=true,
                state="localized",
                covariance=SURE,
            )
        )
        comparison.update_odometry(Odometry(stamp_ns=stamp_ns, pose=odom, twist=twist))
        odom = odom @ exp_twist(twist.scaled(0.1))
        true = true @ exp_twist(twist.scaled(0.1 * share))
    return comparison


@pytest.mark.parametrize("twist", [Twist2D(0.3, 0.0, 0.0), Twist2D(0.0, 0.0, -0.8)])
def test_a_robot_that_something_holds_shows_nothing_of_its_wheels(twist: Twist2D) -> None:
    assert drive(twist, 0.05).legs == []
    # Wheels whose size is quite wrong do.
    legs = drive(twist, 0.6).legs
    assert len(legs) >= 5
    assert all(leg.distance_m > 0.9 or leg.turned_rad > 1.9 for leg in legs)
    assert math.isfinite(legs[0].start_T_end.yaw)
