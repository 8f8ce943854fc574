"""Following over the wire: somebody with two legs, in a world with noise."""

import math
from pathlib import Path

import pytest
from bench.harness.drives import make_config
from support.flatland import empty_room

from trolley import codes, requests, topics
from trolley.codes import Refused
from trolley.geometry import Pose2D
from trolley.gridmap import save_map
from trolley.messages import Truth
from trolley.messages.request_params import FollowPerson, WhichGoal
from trolley.runtime.lockstep import Lockstep
from trolley_base.service import BaseService
from trolley_localizer.service import LocalizerService
from trolley_planner.service import PlannerService

STARTS_S, SPEED_MPS, LENGTH_M = 3.0, 0.4, 6.0


@pytest.mark.drives
def test_somebody_with_two_legs_is_followed(tmp_path: Path) -> None:
    save_map(empty_room(10.0, 6.0), tmp_path / "hall.yaml")
    world = tmp_path / "hall.toml"
    start = "start = { x = 1.0, y = 3.0, yaw = 0.0 }"
    person = f"path = [[2.2, 3.0], [{2.2 + LENGTH_M}, 3.0]]\nspeed_mps = {SPEED_MPS}\n"
    person += f"legs = true\ndwell_s = 60.0\nstarts_s = {STARTS_S}"
    world.write_text(f'map = "hall.yaml"\n{start}\n[[person]]\n{person}\n')
    simulated = f'[base.simulated]\nworld = "{world}"\nseed = 3\n'
    config = make_config(tmp_path / "hall.yaml", Pose2D(1.0, 3.0, 0.0), simulated)
    lockstep = Lockstep(config.robot.name, 3)
    goals, truths = lockstep.record(topics.GOAL), lockstep.record(topics.SIM_TRUTH)
    for service in (BaseService, LocalizerService, PlannerService):
        lockstep.add(service(config))
    lockstep.run(STARTS_S)
    with pytest.raises(Refused) as refused:
        lockstep.ask(requests.GOAL_FOLLOW, FollowPerson(point=(8.0, 1.0)))
    assert refused.value.code == codes.NOBODY
    status = lockstep.ask(requests.GOAL_FOLLOW, FollowPerson(id="after-you", point=(2.3, 3.1)))
    assert (status.id, status.state) == ("after-you", "driving")
    lockstep.run(14.0)
    assert goals[-1].state == "driving"
    gaps = [gap_of(truth) for truth in truths[-200:]]
    assert min(gaps) >= 0.8
    assert max(gaps) <= 2.0
    assert truths[-1].collisions == 0
    assert goals[-1].person is not None
    lockstep.ask(requests.GOAL_CANCEL, WhichGoal(id="after-you"))
    lockstep.run(1.0)
    assert truths[-1].twist.is_zero
    lockstep.close()


def gap_of(truth: Truth) -> float:
    """From the robot's middle to the person's, who walks by the clock of the world."""
    walked = min(max(truth.stamp_ns * 1e-9 - STARTS_S, 0.0) * SPEED_MPS, LENGTH_M)
    return math.hypot(truth.pose.x - 2.2 - walked, truth.pose.y - 3.0)
