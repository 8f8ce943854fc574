"""Rugs, thresholds and the sun."""

import math

import numpy as np

from trolley.geometry import Pose2D
from trolley_base.world.floor import GOOD, Floor
from trolley_base.world.spec import Rug, Sun

RUG = Rug(x=1.0, y=0.0, yaw=math.pi / 2, length_m=2.0, width_m=0.5, slip=0.1, pull_per_m=0.2)


def make_floor() -> Floor:
    sun = Sun(x=3.0, y=0.0, length_m=1.0, width_m=1.0, towards=0.5)
    return Floor([RUG], [sun], np.random.default_rng(1))


def test_wheels_slip_on_the_rug_and_nowhere_else() -> None:
    floor = make_floor()
    assert floor.grip(Pose2D(0.7, 0.0, 0.0)) is GOOD
    assert floor.grip(Pose2D(0.8, 0.9, 0.0)).share == 0.9
    assert floor.grip(Pose2D(0.8, 1.1, 0.0)) is GOOD


def test_each_crossing_pulls_in_its_own_way() -> None:
    floor = make_floor()
    on, off = Pose2D(1.0, 0.0, 0.0), Pose2D(0.0, 0.0, 0.0)
    pulls: list[float] = []
    for _ in range(20):
        pulls.append(floor.grip(on).pull)
        assert floor.grip(on).pull == pulls[-1]
        floor.grip(off)
    assert len(set(pulls)) == len(pulls)
    assert min(pulls) < 0.0 < max(pulls)


def test_the_sun_shines_where_it_shines() -> None:
    floor = make_floor()
    assert floor.sun(Pose2D(3.2, -0.3, 0.0)) is not None
    assert floor.sun(Pose2D(2.0, 0.0, 0.0)) is None
