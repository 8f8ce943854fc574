"""Where a robot can be that comes back from off the map."""

import numpy as np
import pytest

from trolley.config.localizer import LocalizerConfig
from trolley.geometry import Pose2D
from trolley.gridmap import GridMap
from trolley_localizer.filter.pose_estimator import AlignedPose
from trolley_localizer.matching.likelihood_field import build_field
from trolley_localizer.tracking.reach import PARAMS, Reach

DEVIATION_M = 0.4
RESOLUTION = 0.05


@pytest.fixture
def reach(flat: GridMap) -> Reach:
    """A robot that was led to 60, 60 cells, 0.4 m off perhaps."""
    config = LocalizerConfig()
    led = AlignedPose(build_field(flat, config), config)
    cells = DEVIATION_M / RESOLUTION
    led.reset(np.array([60.0, 60.0, 0.0]), np.diag([cells**2, cells**2, 0.1**2]))
    return Reach(led)


@pytest.mark.parametrize(
    ("away_m", "turned", "holds"),
    [(0.0, 0.0, True), (1.5, 0.0, True), (2.0, 0.0, False), (0.0, 0.5, True), (0.0, 3.1, False)],
)
def test_it_holds_what_the_odometry_can_have_led_to(
    reach: Reach, away_m: float, turned: float, holds: bool
) -> None:
    pose = reach.pose + np.array([away_m / RESOLUTION, 0.0, turned])
    assert reach.holds(pose, RESOLUTION) is holds


def test_it_moves_along_and_is_over_after_a_way_without_a_place(reach: Reach) -> None:
    start = reach.pose.copy()
    for _ in range(int(PARAMS.lasts_m / 0.1)):
        assert not reach.is_over
        reach.predict(Pose2D(0.1, 0.0, 0.0))
    reach.predict(Pose2D(0.1, 0.0, 0.0))
    assert reach.is_over
    assert (reach.pose[0] - start[0]) * RESOLUTION == pytest.approx(PARAMS.lasts_m + 0.1, abs=0.01)
