"""Where a loose part is joined to the map, and where it is not."""

import numpy as np
import pytest
from support.posts import keyframe_among

from trolley.config.mapper import MapperConfig
from trolley.slices import whole
from trolley_mapper.slam.joining import JoinJob, Joint, Place
from trolley_mapper.slam.keyframe_store import KeyframeStore
from trolley_mapper.slam.loop_closure import Closure
from trolley_mapper.slam.occupancy_grid import LogOddsGrid
from trolley_mapper.slam.pose_graph import ODOMETRY, Edge, between

ROOM_M = 16.0
IN_A_ROOM = np.random.default_rng(0).uniform((0.0, -4.0), (ROOM_M, 4.0), (300, 2))
POSTS = np.vstack([IN_A_ROOM, IN_A_ROOM + np.array([ROOM_M, 0.0])])
"""What stands about in each of two rooms alike, one beside the other [m]."""


@pytest.mark.parametrize(
    ("unseen_s", "is_joined"), [(1.5, False), (60.0, True)], ids=["between two scans", "carried"]
)
def test_a_part_is_not_joined_farther_off_than_somebody_can_have_carried_the_robot(
    unseen_s: float, is_joined: bool
) -> None:
    # One room is mapped; then the robot is in the other, as its odometry says.
    store, pending = KeyframeStore(), list[Closure]()
    places = [np.array([x, 0.0, 0.0]) for x in range(5, 12)]
    others = [place + np.array([ROOM_M, 0.0, 0.0]) for place in places]
    joint = Joint(len(places), others[0], np.diag([0.25, 0.25, 3.24]), None, unseen_s)
    accepted: list[Edge] = []
    for number, pose in enumerate(places + others):
        is_first = number in (0, joint.number)
        step = between(store.poses[-1], pose) if not is_first else np.zeros(3)
        information = np.diag([400.0, 400.0, 1e4])
        edges = [] if is_first else [Edge(number - 1, number, step, information, ODOMETRY)]
        store.add(keyframe_among(POSTS, number, pose), pose, edges)
        if number >= joint.number and not accepted:
            alike = Place(pose[:2] - np.array([ROOM_M, 0.0]), (1.0, 0.5))
            job = JoinJob(
                store.copy(), pending, MapperConfig(), LogOddsGrid(0.05), joint, pose, [alike],
                is_searched=False,
            )  # fmt: skip
            whole(job.slices())
            pending, accepted = [*pending, *job.found], job.accepted
    assert len(pending) > 1
    assert bool(accepted) == is_joined
