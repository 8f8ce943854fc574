"""Tables of a map."""

import numpy as np
import pytest

from trolley.config.localizer import LocalizerConfig
from trolley.geometry import Pose2D
from trolley.gridmap import GridMap
from trolley_localizer.matching.likelihood_field import MAX_DISTANCE_M, build_field

CONFIG = LocalizerConfig()


def test_scores_fall_from_the_wall_to_the_ring(flat: GridMap) -> None:
    field = build_field(flat, CONFIG)
    assert field.score.shape == (flat.rows + 2, flat.cols + 2)
    assert field.score[1, 1] == 65535
    assert field.score[0].max() < 100
    row = field.score[30, 3:30].astype(int)
    assert (np.diff(row[:10]) <= 0).all()


def test_a_map_without_walls_scores_nothing_anywhere() -> None:
    empty = GridMap("empty", 0.05, Pose2D.identity(), np.zeros((20, 30), np.int8))
    field = build_field(empty, CONFIG)
    assert field.score.max() < 100
    assert field.distance.min() == pytest.approx(MAX_DISTANCE_M / 0.05)


def test_poses_and_covariances_go_there_and_back(flat: GridMap) -> None:
    field = build_field(flat, CONFIG)
    pose = Pose2D(2.0, 1.0, -2.5)
    back = field.to_map(field.to_cells(pose))
    assert back.distance_to(pose) < 1e-9
    assert back.yaw == pytest.approx(pose.yaw)
    covariance = np.array([[0.04, 0.01, 0.002], [0.01, 0.09, 0.0], [0.002, 0.0, 0.01]])
    cells = field.covariance_to_cells(covariance)
    assert field.covariance_to_map(cells) == pytest.approx(covariance)
    assert cells[2, 2] == pytest.approx(0.01)
