"""Wheels that slip are told from wheels that drive."""

import numpy as np

from trolley.geometry import Pose2D
from trolley_mapper.slam.sentences import SLIPS
from trolley_mapper.slam.slip_detector import SlipDetector

STEP = Pose2D(0.03, 0.0, 0.0)


def test_wheels_that_turn_while_the_robot_stands_slip() -> None:
    detector = SlipDetector()
    detector.update(STEP, np.zeros(3))
    assert detector.message == ""  # too little to judge
    for _ in range(5):
        detector.update(STEP, np.zeros(3))
    assert detector.message == SLIPS


def test_odometry_that_is_a_little_wrong_is_no_slip() -> None:
    detector = SlipDetector()
    for _ in range(30):
        detector.update(STEP, 0.8 * STEP.as_array())
    assert detector.message == ""


def test_slip_is_forgotten_once_the_robot_drives() -> None:
    detector = SlipDetector()
    for _ in range(10):
        detector.update(STEP, np.zeros(3))
    for _ in range(15):
        detector.update(STEP, STEP.as_array())
    assert detector.message == ""
