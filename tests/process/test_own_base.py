"""The examples' bases as programs, driven by localizer, planner and tour over a real router."""

from collections.abc import Iterator
from contextlib import ExitStack
from pathlib import Path

import pytest
from support.examples import EXAMPLES
from support.processes import Process
from support.waiting import PATIENCE_S, wait_until

from trolley import Robot, codes, requests, topics
from trolley.codes import Refused
from trolley.geometry import Pose2D, Twist2D
from trolley.messages.request_params import SendGoal

pytestmark = pytest.mark.slow

WORLDS = EXAMPLES.parent / "worlds"
THERE = Pose2D(-1.4, -1.2, 0.0)
UP = ["-m", "trolley.cli", "up", "--no-router"]
WITHOUT = [f"--without={name}" for name in ("base", "mapper", "viz")]


@pytest.fixture(params=["own_base", "bare_base"])
def robot(
    request: pytest.FixtureRequest,
    endpoint: str,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
) -> Iterator[Robot]:
    """A robot with the example in base's place."""
    file = tmp_path / "robot.toml"
    file.write_text(
        '[robot]\nname = "mine"\nfootprint = { radius_m = 0.15 }\n'
        f'[map]\nfile = "{WORLDS / "room.yaml"}"\n'
        "[start]\npose = { x = -2.2, y = -1.8, yaw = 0.0 }\n"
        f'[zenoh]\nconnect = ["{endpoint}"]\n'
    )
    monkeypatch.setenv("TROLLEY_CONFIG", str(file))
    example = [str(EXAMPLES / f"{request.param}.py")]
    if request.param == "bare_base":
        example += ["mine", endpoint]
    with ExitStack() as stack:
        for number, program in enumerate([[*UP, *WITHOUT], example]):
            process = Process(program, tmp_path / f"{number}.log")
            stack.callback(process.kill)
        mine = stack.enter_context(Robot("mine", endpoint, connect_timeout=PATIENCE_S))
        mine.wait_until_localized(PATIENCE_S)
        wait_until(lambda: can_plan(mine), "the planner has all that it needs")
        yield mine


def can_plan(robot: Robot) -> bool:
    """Whether the planner no longer waits for anything."""
    try:
        robot.ask(requests.GOAL_PREVIEW, SendGoal(pose=THERE))
    except Refused as refused:
        if refused.code not in (codes.NOT_READY, codes.NOT_LOCALIZED):  # it may lack the pose
            raise
        return False
    return True


def test_a_base_of_one_s_own_is_driven_over_the_wire(robot: Robot) -> None:
    robot.capture("corner")
    assert robot.go_to(THERE, timeout=PATIENCE_S).state == "arrived"
    assert robot.go_to("corner", timeout=PATIENCE_S).state == "arrived"
    with robot.subscribe(topics.ODOM) as heard:

        def next_twist() -> Twist2D:
            odometry = heard.next(PATIENCE_S)
            assert odometry is not None
            return odometry.message.twist

        robot.go_to(THERE, wait=False)
        wait_until(lambda: not next_twist().is_zero, "it drives")
        assert robot.stop().mode == "stopped"
        wait_until(lambda: next_twist().is_zero, "it stands")
        assert robot.resume().mode == "ok"
        # One command, which nobody renews.
        robot.drive(Twist2D(0.0, 0.0, 1.0), valid_for=0.3)
        wait_until(lambda: next_twist().wz > 0.0, "it turns")
        wait_until(lambda: next_twist().is_zero, "it stands again")
