"""What an edge says of the way between two keyframes."""

import numpy as np
import pytest

from trolley_mapper.slam.edges import Travel, odometry_edge
from trolley_mapper.slam.pose_graph import Edge, compose

WELL_SEEN = np.diag([0.005**2, 0.005**2, 0.002**2])
LONG_UNSEEN = np.diag([0.3**2, 0.005**2, 0.002**2])
"""Covariance of a pose after a corridor that does not show the place along it."""
BY_ODOMETRY = np.diag([0.03**2, 0.03**2, 0.02**2])


@pytest.mark.parametrize(
    ("start_covariance", "step_m"), [(LONG_UNSEEN, 0.7), (WELL_SEEN, 1.0)], ids=["drift", "slip"]
)
def test_the_end_of_a_corridor_corrects_its_drift_and_not_the_last_step_alone(
    start_covariance: np.ndarray, step_m: float
) -> None:
    travel = Travel.begin(start_covariance).then(np.array([0.7, 0.0, 0.0]), BY_ODOMETRY)
    # A match that shows the place along it moves the newest keyframe by 0.3 m.
    poses = (np.zeros(3), np.array([1.0, 0.0, 0.0]))
    edge = odometry_edge((0, 1), poses, travel, np.zeros((3, 3)))
    assert edge.step == pytest.approx([step_m, 0.0, 0.0], abs=0.01)
    assert edge.information[0, 0] == pytest.approx(1.0 / 0.03**2, rel=0.01)


def test_the_path_is_added_up_in_the_frame_of_the_keyframe() -> None:
    quarter = np.array([0.5, 0.0, 0.5 * np.pi])
    travel = Travel.begin(WELL_SEEN).then(quarter, BY_ODOMETRY).then(quarter, BY_ODOMETRY)
    assert travel.step == pytest.approx([0.5, 0.5, np.pi])
    assert travel.covariance == pytest.approx(2.0 * BY_ODOMETRY)


def step_of_a_metre(unlearnt: float, matched: np.ndarray) -> Edge:
    """An edge whose odometry was corrected by 0.9, along a path that bends to the left."""
    travel = Travel.begin(WELL_SEEN, 0.9, unlearnt).then(np.array([0.9, 0.0, 0.4]), BY_ODOMETRY)
    poses = (np.array([0.0, 0.0, 1.0]), compose(np.array([0.0, 0.0, 1.0]), travel.step))
    return odometry_edge((0, 1), poses, travel, matched)


def test_what_is_learnt_of_the_wheels_later_lengthens_what_only_they_have_measured() -> None:
    edge = step_of_a_metre(1.0, np.zeros((3, 3)))
    assert edge.step_at(0.9) == pytest.approx([0.9, 0.0, 0.4])
    assert edge.step_at(1.0) == pytest.approx([1.0, 0.0, 0.4], abs=1e-3)
    settled = edge.settled(1.0)
    assert settled.step == pytest.approx(edge.step_at(1.0))
    assert settled.step_at(1.2) == pytest.approx(settled.step)


def test_what_is_learnt_later_changes_nothing_that_scans_have_measured() -> None:
    edge = step_of_a_metre(1.0, np.diag([1e6, 1e6, 1e6]))
    assert edge.step_at(1.0) == pytest.approx([0.9, 0.0, 0.4], abs=1e-3)


def test_what_is_learnt_later_changes_nothing_once_the_wheels_are_known() -> None:
    edge = step_of_a_metre(0.01, np.zeros((3, 3)))
    assert edge.step_at(1.0) == pytest.approx(edge.step)
