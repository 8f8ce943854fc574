"""Three robots as real processes in one house: a router, and three services of each."""

import time
from collections.abc import Iterator
from contextlib import ExitStack
from pathlib import Path

import pytest
from support.processes import Process, find_free_port
from support.waiting import PATIENCE_S, wait_until

from trolley import requests, topics, worlds
from trolley.codes import Refused
from trolley.connection import Connection, RobotUnreachable
from trolley.geometry import Pose2D
from trolley.messages.request_params import SendGoal

STARTS = {"ann": (2.4, 3.2), "bob": (2.4, 4.75), "cleo": (4.7, 6.3)}
GOALS = {"ann": (1.2, 4.75), "bob": (2.4, 2.8), "cleo": (3.6, 6.4)}
CONFIG = """
[robot]
name = "{name}"
footprint = {{ length_m = 0.30, width_m = 0.24 }}
[map]
file = "{folder}/house.yaml"
[start]
pose = {{ x = {x}, y = {y}, yaw = 0.0 }}
[zenoh]
connect = ["{endpoint}"]
[planner]
rollouts = 96
control_rate_hz = 10.0
[base.simulated]
world = "{folder}/house.toml"
start = {{ x = {x}, y = {y}, yaw = 0.0 }}
"""


@pytest.fixture
def house(tmp_path: Path) -> Iterator[Connection]:
    """All processes, connected and localized."""
    endpoint = f"tcp/127.0.0.1:{find_free_port()}"
    with ExitStack() as stack:

        def start(what: str, *arguments: str, **environment: str) -> None:
            process = Process(arguments, tmp_path / f"{what}.log", environment)
            stack.callback(process.kill)

        start("router", "-m", "trolley.cli", "router", "--listen", endpoint)
        for name, (x, y) in STARTS.items():
            config = tmp_path / f"{name}.toml"
            config.write_text(
                CONFIG.format(name=name, folder=worlds.folder(), x=x, y=y, endpoint=endpoint)
            )
            for service in ("base", "localizer", "planner"):
                start(
                    f"{name}-{service}",
                    "-m",
                    f"trolley_{service}",
                    TROLLEY_CONFIG=str(config),
                    TROLLEY_STATE=str(tmp_path / "state"),
                )
        with Connection([endpoint], PATIENCE_S) as connection:
            wait_until(
                lambda: all(is_ready(connection, name) for name in STARTS), "pose", patience_s=300.0
            )
            yield connection


def is_ready(connection: Connection, name: str) -> bool:
    pose = connection.latest(name, topics.POSE)
    return pose is not None and pose.state == "localized"


def send(connection: Connection, name: str, place: tuple[float, float]) -> bool:
    goal = SendGoal(id=f"go-{name}", pose=Pose2D(*place, 0.0), yaw_tolerance=3.2)
    try:
        connection.ask(name, requests.GOAL_SEND, goal)
    except (Refused, RobotUnreachable):
        return False
    return True


@pytest.mark.slow
def test_three_robots_pass_each_other_at_a_door(house: Connection) -> None:
    for name, place in GOALS.items():
        wait_until(lambda name=name, place=place: send(house, name, place), name)
    ended: dict[str, str] = {}
    deadline = time.monotonic() + 300.0
    while len(ended) < len(GOALS) and time.monotonic() < deadline:
        for name in GOALS:
            status = house.latest(name, topics.GOAL)
            if status is not None and status.state in ("arrived", "failed", "canceled"):
                ended[name] = f"{status.state} {status.reason}".strip()
        time.sleep(0.5)
    assert ended == dict.fromkeys(GOALS, "arrived")
    truths = {name: house.latest(name, topics.SIM_TRUTH) for name in GOALS}
    assert {name: truth.collisions for name, truth in truths.items() if truth is not None} == (
        dict.fromkeys(GOALS, 0)
    )
