"""`trolley stop` and `trolley resume`."""

import time

import click

from trolley import codes, topics
from trolley.cli.options import json_option, where_options
from trolley.cli.printing import say
from trolley.cli.robot_sentence import CONTINUES
from trolley.cli.robots import connected, one_robot, reports_errors
from trolley.cli.show import print_json
from trolley.client import Robot
from trolley.codes import Refused
from trolley.connection import RobotUnreachable
from trolley.messages import BaseState, Odometry
from trolley.under_way import what_is_under_way

WATCHED_S = 1.2
"""A motor board that does not obey is detected within 0.5 s; a sound robot stands by then."""
LOOK_S = 0.1
LATE_NS = 100_000_000
"""Odometry is stamped when it was measured, up to this long before it arrives."""
STANDING_MPS, STANDING_RADPS = 0.02, 0.05


@click.command(name="stop")
@click.option("--all", "everybody", is_flag=True, help="Stop every robot on the network.")
@where_options
@json_option
@reports_errors
def stop_command(everybody: bool, as_json: bool) -> None:
    """Stop the robot; it stays stopped, even after a restart, until it is resumed."""
    if everybody:
        with connected() as connection:
            stopped = connection.stop_all()
            if as_json:
                print_json(stopped)
            else:
                for name, state in sorted(stopped.items()):
                    say(f"{name}: {state.message if state.may_still_move else state.mode}")
            missing = [name for name in connection.robots() if name not in stopped]
        if missing or not stopped:
            raise RobotUnreachable(f"NOT STOPPED: no connection to {', '.join(missing) or 'any'}")
        return
    with one_robot() as robot:
        state = stop_and_watch(robot)
    if as_json:
        print_json(state)
    elif state.reason != codes.DOES_NOT_OBEY:
        say(state.message or "Stopped. `trolley resume` lets it drive.")
    if state.reason == codes.DOES_NOT_OBEY:
        raise Refused(state.reason, state.message)


def stop_and_watch(robot: Robot) -> BaseState:
    """Stop a robot, and return its state once it stands or is known not to, or after a while.

    Raises:
        RobotUnreachable: NOT STOPPED: base does not answer.
    """
    state = robot.stop()
    end_s = time.monotonic() + WATCHED_S
    with robot.subscribe(topics.BASE) as states, robot.subscribe(topics.ODOM) as motions:
        while not state.not_stopped and time.monotonic() < end_s:
            while (said := states.next(0.0)) is not None:
                if not said.message.is_from_before(state.stamp_ns):
                    state = said.message
            motion = motions.next(LOOK_S)
            if motion is not None and _stands_after(motion.message, state):
                break
    return state


def _stands_after(motion: Odometry, state: BaseState) -> bool:
    """Whether the robot stood at the time of its state or later."""
    stands = motion.twist.speed < STANDING_MPS and abs(motion.twist.wz) < STANDING_RADPS
    return stands and motion.stamp_ns >= state.stamp_ns - LATE_NS


@click.command(name="resume")
@where_options
@json_option
@reports_errors
def resume_command(as_json: bool) -> None:
    """Allow a stopped robot to drive again; it does not set off by itself."""
    with one_robot() as robot:
        state = robot.resume()
        goal, trip = robot.latest(topics.GOAL), robot.latest(topics.TOUR)
    if as_json:
        print_json(state)
    else:
        say(
            "Resumed; it can drive again."
            if state.mode == "ok"
            else f"Resumed, but it cannot drive yet ({state.mode}): {state.message}"
        )
        is_paused = goal is not None and goal.state == "paused"
        if is_paused and what_is_under_way(goal, trip) == "goal":
            say(f"Its goal is still paused: {CONTINUES}")
