"""`trolley go`, `trolley follow` and `trolley cancel`."""

import math
from collections.abc import Generator
from contextlib import contextmanager
from typing import Any

import click

from trolley import codes, requests
from trolley.cli import exits
from trolley.cli.any_robot import ask_offers, in_order
from trolley.cli.options import (
    FloatRange,
    NumbersCommand,
    as_number,
    given,
    json_option,
    where_options,
)
from trolley.cli.printing import say
from trolley.cli.robot_sentence import goal_message
from trolley.cli.robots import connected, one_robot, reports_errors
from trolley.cli.show import Progress, pose_text, print_json, seconds_text
from trolley.client import GOAL_ENDS, Place, Robot, goal_to, person_at
from trolley.codes import SENTENCES, Refused
from trolley.messages import GoalStatus, request_params
from trolley.requests import Request


def _place(where: tuple[str, ...], *, deg: bool) -> Place:
    if len(where) == 1:
        return where[0]
    if len(where) not in (2, 3):
        raise click.UsageError("give the NAME of a saved place, or X Y, or X Y YAW")
    numbers = [as_number(text, name) for text, name in zip(where, ("X", "Y", "YAW"), strict=False)]
    if deg:
        numbers[2:] = [math.radians(yaw) for yaw in numbers[2:]]
    return numbers


_speed = click.option(
    "--speed",
    type=FloatRange(min=0.0, min_open=True),
    metavar="M/S",
    help="Highest speed.",
)
_frame = click.option(
    "--frame", metavar="NAME", help="The frame of X and Y [default: the planner's]."
)


@click.command(name="go", cls=NumbersCommand)
@click.argument("where", nargs=-1, required=True, metavar="NAME | X Y [YAW]")
@click.option("--deg", is_flag=True, help="YAW is in degrees.")
@_speed
@click.option(
    "--xy-tolerance",
    type=FloatRange(min=request_params.FINEST_XY_M),
    metavar="METRES",
    help="How near is near enough [default: 0.05].",
)
@click.option(
    "--yaw-tolerance",
    type=FloatRange(min=request_params.FINEST_YAW_RAD),
    metavar="RADIANS",
    help="How near the heading has to be [default: 0.05].",
)
@_frame
@click.option("--any", "anyone", is_flag=True, help="Send the nearest free robot.")
@click.option("--preview", is_flag=True, help="Only say how long it would take.")
@click.option("--no-wait", is_flag=True, help="Send the goal and return.")
@click.option(
    "--timeout",
    type=FloatRange(min=0.0, min_open=True),
    metavar="SECONDS",
    help="When to give up and cancel.",
)
@where_options
@json_option
@reports_errors
def go_command(
    where: tuple[str, ...],
    deg: bool,
    anyone: bool,
    preview: bool,
    no_wait: bool,
    timeout: float | None,
    as_json: bool,
    **options: Any,
) -> None:
    """Drive to the saved place NAME, or to X Y in metres on the map (YAW in radians, else any).

    Follows the drive until it ends; Ctrl-C cancels the goal.
    """
    goal = goal_to(_place(where, deg=deg), **options)
    with _whoever_is_first(goal) if anyone else one_robot() as robot:
        if preview:
            _preview(robot, goal, as_json=as_json)
            return
        status = _drive(robot, requests.GOAL_SEND, goal, timeout, waits=not no_wait)
    _say(status, is_over=not no_wait, as_json=as_json)
    if not no_wait and status.state != "arrived":
        raise SystemExit(exits.FAILED)


@contextmanager
def _whoever_is_first(goal: request_params.SendGoal) -> Generator[Robot]:
    """The free robot that would reach the goal first; its name is printed on stderr."""
    if given("robot"):
        raise click.UsageError("--any asks all robots: leave out --robot")
    with connected() as connection:
        name = in_order(ask_offers(connection, goal))[0]
        say(f"{name} goes", err=True)
        yield Robot.over(connection, name)


def _preview(robot: Robot, goal: request_params.SendGoal, *, as_json: bool) -> None:
    path = robot.ask(requests.GOAL_PREVIEW, goal)
    if as_json:
        print_json(path)
        return
    poses = len(path.poses) // 12
    say(f"{seconds_text((poses - 1) * path.dt)} by {poses} poses in {path.frame}")


def _drive(
    robot: Robot,
    request: Request[Any, GoalStatus],
    goal: request_params.SendGoal | request_params.FollowPerson,
    timeout: float | None,
    *,
    waits: bool,
) -> GoalStatus:
    """Send a goal, and show how it goes until it has ended; interrupted or too late, cancel it."""
    if not waits:
        return robot.ask(request, goal)
    progress = Progress()
    try:
        # An interrupt may come before the answer, when the robot has set off already.
        status = robot.ask(request, goal)
        if status.warning:
            say(f"Careful: {SENTENCES.get(status.warning, status.warning)}", err=True)
        for status in robot.follow(goal.id, timeout):
            if status.state not in GOAL_ENDS:  # the caller says how it ended
                progress.show(_progress_text(status), f"{status.state} {status.reason}")
    except (KeyboardInterrupt, Refused) as error:
        progress.clear()
        if isinstance(error, Refused) and error.code != codes.TIMEOUT:
            raise
        say("Canceling the goal ...", err=True)
        try:
            robot.cancel(goal.id)
        except Refused as refused:
            say(refused.message, err=True)
        raise
    finally:
        progress.clear()
    return status


def _progress_text(status: GoalStatus) -> str:
    text = status.state
    if status.distance_remaining is not None:
        text += f", {status.distance_remaining:.2f} m to go"
    if status.eta is not None:
        text += f", {seconds_text(status.eta)} left"
    text += f", {seconds_text(status.elapsed)} so far"
    message = goal_message(status)
    return f"{text}: {message}" if message else text


def _say(status: GoalStatus, *, is_over: bool, as_json: bool) -> None:
    if as_json:
        print_json(status)
    else:
        say(_ending(status) if is_over else f"goal {status.id}: {status.state}")


def _ending(status: GoalStatus) -> str:
    after = f"after {seconds_text(status.elapsed)}"
    if status.state == "arrived":
        at = f" at {pose_text(status.pose)}" if status.pose is not None else ""
        return f"arrived{at} {after}"
    return f"{status.state} {after}: {status.message or status.reason} ({status.reason})"


@click.command(name="follow", cls=NumbersCommand)
@click.argument("where", nargs=-1, metavar="[X Y]")
@click.option(
    "--distance",
    type=FloatRange(0.8, 2.0),
    help="How far behind them to stay, in m [default: 1.2].",
)
@_speed
@_frame
@click.option("--no-wait", is_flag=True, help="Begin to follow and return.")
@click.option(
    "--timeout",
    type=FloatRange(min=0.0, min_open=True),
    metavar="SECONDS",
    help="When to stop following.",
)
@where_options
@json_option
@reports_errors
def follow_command(
    where: tuple[str, ...], no_wait: bool, timeout: float | None, as_json: bool, **options: Any
) -> None:
    """Follow the person nearest to X Y in metres on the map, else the nearest one ahead.

    Goes on until they are out of sight for 3 s; Ctrl-C ends it.
    """
    if len(where) not in (0, 2):
        raise click.UsageError("give X Y, or nothing for the nearest person ahead")
    point = [as_number(text, name) for text, name in zip(where, ("X", "Y"), strict=False)]
    with one_robot() as robot:
        person = person_at(point or None, **options)
        status = _drive(robot, requests.GOAL_FOLLOW, person, timeout, waits=not no_wait)
    _say(status, is_over=not no_wait, as_json=as_json)
    if not no_wait:
        raise SystemExit(exits.FAILED)


@click.command(name="cancel")
@where_options
@json_option
@reports_errors
def cancel_command(as_json: bool) -> None:
    """Cancel the current goal; the robot stops, and a trip under way is paused."""
    with one_robot() as robot:
        status = robot.cancel()
    _say(status, is_over=False, as_json=as_json)
