"""When what is seen since the robot stood speaks against the map, and when it does not."""

import numpy as np
import pytest
from support.posts import keyframe_among

from trolley.config.mapper import MapperConfig
from trolley_mapper.slam.join_watch import JoinWatch
from trolley_mapper.slam.joining import Joint
from trolley_mapper.slam.keyframe_store import KeyframeStore
from trolley_mapper.slam.pose_graph import ODOMETRY, Edge, between

POSTS = np.random.default_rng(0).uniform((-4.0, -4.0), (16.0, 4.0), (400, 2))
"""What stands about [m]."""


@pytest.mark.parametrize(
    ("out_m", "is_refuted"), [(12.0, False), (1.5, True)], ids=["drift of a loop", "other floor"]
)
def test_only_what_is_near_along_the_drive_tells_another_floor(
    out_m: float, is_refuted: bool
) -> None:
    # Out and back; what is seen on the way back lies 0.5 m beside what the map shows.
    out = np.arange(0.0, out_m, 0.5)
    back = out[::-1]
    places = [*(np.array([x, 0.0, 0.0]) for x in out), *(np.array([x, 0.0, 0.0]) for x in back)]
    places += [np.array([-x, 0.0, 0.0]) for x in np.arange(0.5, 3.0, 0.5)]
    store, watch = KeyframeStore(), None
    begin = len(out)
    for number, true in enumerate(places):
        pose = true + np.array([0.0, 0.5 if number >= begin else 0.0, 0.0])
        edges = []
        if number:
            step = between(store.poses[-1], pose)
            edges = [Edge(number - 1, number, step, np.eye(3), ODOMETRY)]
        if number == begin:
            watch = JoinWatch(Joint(number, pose, np.eye(3), None), edges, has_stood=True)
        store.add(keyframe_among(POSTS, number, true), pose, edges)
        # After a loop, only its end comes to where the map shows something else.
        if watch is not None and (is_refuted or true[0] < 2.0):
            watch.see(store, MapperConfig())
    assert watch is not None
    assert watch.is_refuted == is_refuted
