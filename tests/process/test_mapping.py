"""A new robot without a map, over a real router: one drive, and it knows its home."""

import math
import time
from collections.abc import Callable
from pathlib import Path

import pytest
from support.demo import PROGRAM
from support.processes import Process, find_free_port, write_config
from support.waiting import PATIENCE_S, wait_until

from trolley import codes, requests, topics, worlds
from trolley.client import Refused, Robot
from trolley.geometry import Pose2D
from trolley.messages import MappingStatus, PoseEstimate
from trolley.messages.request_params import SendGoal
from trolley_mapper.edit.map_versions import MapVersions

pytestmark = pytest.mark.slow
GOALS = ((1.2, 0.0), (2.4, 0.2), (0.3, 0.0))
"""Of the first map, whose origin is where the robot stood [m]."""


@pytest.fixture
def robot_log(tmp_path: Path):
    """A simulated robot in the apartment, without a map."""
    endpoint = f"tcp/127.0.0.1:{find_free_port()}"
    world = worlds.find("apartment.toml")
    config = write_config(
        tmp_path / "robot.toml",
        endpoint,
        more=f'[base.simulated]\nworld = "{world}"\nseed = 3\n',
    )
    state = {"TROLLEY_STATE": str(tmp_path / "state")}
    up = Process(
        ["-c", PROGRAM, "--config", str(config), "up", "--no-viz"], tmp_path / "up.log", state
    )
    yield endpoint, up
    if up.is_running:
        up.terminate()


def rss_of_mapper(robot: Robot) -> float:
    """What it takes [bytes]; infinite where it does not say."""
    health = robot.get(topics.HEALTH).get(("mapper",))
    return health.rss if health is not None and health.rss else math.inf


def test_a_new_robot_makes_its_map_and_knows_its_home(
    robot_log: tuple[str, Process], trolley: Callable, tmp_path: Path
) -> None:
    endpoint, up = robot_log
    with Robot("tester", endpoint, connect_timeout=PATIENCE_S) as robot:

        def mapping() -> MappingStatus | None:
            return robot.latest(topics.MAPPING)

        def is_ready() -> bool:
            names = {"base", "localizer", "mapper", "planner", "tour"}
            health = robot.get(topics.HEALTH)
            return {parts[0] for parts in health} >= names and robot.now_ns() is not None

        wait_until(is_ready, lambda: f"all run: {up.log}")
        idle = robot.get(topics.HEALTH)[("mapper",)]
        begin = robot.latest(topics.SIM_TRUTH)
        assert begin is not None
        done = trolley("map", "new", "home", "--connect", endpoint)
        assert done.returncode == 0, done.stderr
        assert "trolley map save" in done.stdout

        def can_plan() -> bool:
            try:
                robot.ask(requests.GOAL_PREVIEW, SendGoal(pose=Pose2D(*GOALS[0], 0.0)))
            except Refused as refused:
                return refused.code != codes.NOT_READY
            return True

        wait_until(can_plan, "the planner has the first of the map")
        for x, y in GOALS:
            robot.go_to((x, y), timeout=PATIENCE_S)
        status = mapping()
        assert status is not None
        assert status.state == "mapping"
        assert status.scans > 8
        done = trolley("map", "save", "--connect", endpoint)
        assert done.returncode == 0, done.stderr
        assert "in use" in done.stdout

        def localized() -> PoseEstimate | None:
            pose = robot.latest(topics.POSE)
            return pose if pose is not None and pose.state == "localized" else None

        wait_until(localized, "the localizer has taken over")
        time.sleep(0.5)
        pose, truth = localized(), robot.latest(topics.SIM_TRUTH)
        assert pose is not None
        assert truth is not None
        assert pose.map == "home"
        assert pose.pose is not None
        saved = MapVersions(tmp_path / "state" / "maps").newest("home")
        assert saved is not None
        assert saved.start is not None
        found = begin.pose @ saved.start.inverse() @ pose.pose
        assert found.distance_to(truth.pose) < 0.1
        assert abs((found.inverse() @ truth.pose).yaw) < 0.05
        assert (tmp_path / "state" / "maps" / "home.pgm").exists()
        # numba and SciPy are not there before they are used, nor long after.
        large = robot.get(topics.HEALTH)[("mapper",)].rss
        wait_until(lambda: rss_of_mapper(robot) < 100e6, "memory is given back")
    assert idle.rss == 0 or idle.rss < 100e6
    assert large > 100e6
