"""Commands compared with motions, where one of the two is missing."""

from trolley.geometry import Pose2D, Twist2D
from trolley_base.drivers import MotionSample
from trolley_base.safety.motion_limits import MotionLimits
from trolley_base.safety.motion_supervision import MotionSupervision

MS = 1_000_000
LIMITS = MotionLimits(0.5, 1.5, 0.8, 1.0, 4.0)


def test_what_moves_before_anything_was_commanded_is_not_judged() -> None:
    supervision, twist = MotionSupervision(LIMITS, 0.1), Twist2D(0.5, 0.0, 0.0)
    for period in range(50):
        samples = [
            MotionSample((20 * period + ms) * MS, Pose2D(0.005, 0.0, 0.0), twist) for ms in (10, 20)
        ]
        supervision.take((20 * period + 20) * MS, [(sample, None) for sample in samples])
        assert supervision.take_finding() is None
