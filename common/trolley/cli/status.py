"""`trolley status`: the robot and its services at a glance."""

from typing import Any

import click

from trolley import topics
from trolley.cli import exits
from trolley.cli.options import json_option, where_options
from trolley.cli.robots import one_robot, reports_errors
from trolley.cli.show import pose_text, print_json, print_table, seconds_text
from trolley.client import STALE_AFTER_S, Robot
from trolley.connection import RobotUnreachable
from trolley.messages import BaseState, GoalStatus, Health, PoseEstimate, TourStatus

EXPECTED = ("base", "localizer", "planner", "tour")
"""What a robot needs to drive tours."""
_COLOURS = {"ok": "green", "starting": "yellow", "degraded": "yellow", "failed": "red"}


@click.command(name="status")
@where_options
@json_option
@reports_errors
def status_command(as_json: bool) -> None:
    """Say how the robot is: services, pose, goal, trip.

    Exit code 1 where a service is missing or has failed, or the robot is stopped or lost.
    """
    with one_robot() as robot:
        found = read_status(robot)
    if as_json:
        print_json(found)
    else:
        _print(found)
    if found["problems"]:
        raise SystemExit(exits.FAILED)


def read_status(robot: Robot) -> dict[str, Any]:
    """Everything that `trolley status` says, messages as they are.

    Raises:
        RobotUnreachable: No service of the robot is alive.
    """
    runs = {
        service: ids
        for (name, service), ids in robot.connection.services(robot.name).items()
        if name == robot.name
    }
    if not runs:
        endpoints = ", ".join(robot.connection.endpoints)
        raise RobotUnreachable(f"no service of a robot called {robot.name} runs at {endpoints}")
    health = {parts[0]: message for parts, message in robot.get(topics.HEALTH).items()}
    pose = robot.latest(topics.POSE)
    now_ns = robot.connection.robot_now_ns(robot.name)
    age_s = None if pose is None or now_ns is None else max(0.0, (now_ns - pose.stamp_ns) * 1e-9)
    found: dict[str, Any] = {
        "name": robot.name,
        "robot": robot.latest(topics.ROBOT),
        "services": {
            service: {"runs": runs.get(service, []), "health": health.get(service)}
            for service in sorted({*EXPECTED, *runs, *health})
        },
        "base": robot.latest(topics.BASE),
        "pose": pose,
        "pose_age": age_s,
        "goal": robot.latest(topics.GOAL),
        "trip": robot.latest(topics.TOUR),
    }
    found["problems"] = problems(found)
    return found


def problems(found: dict[str, Any]) -> list[str]:
    """What keeps the robot from its work, a sentence each."""
    services: dict[str, dict[str, Any]] = found["services"]
    result = [f"{name} is not running" for name, service in services.items() if not service["runs"]]
    for name, service in services.items():
        health: Health | None = service["health"]
        if service["runs"] and health is not None and health.state in ("failed", "degraded"):
            result.append(f"{name} is {health.state}: {health.message}")
    base: BaseState | None = found["base"]
    if base is not None and base.mode in ("stopped", "fault"):
        result.append(f"the robot is {base.mode}: {base.message or base.reason}")
    pose: PoseEstimate | None = found["pose"]
    if pose is not None:
        age_s: float | None = found["pose_age"]
        if pose.state == "lost":
            result.append(f"the robot is lost: {pose.message}")
        elif age_s is None or age_s > STALE_AFTER_S:
            result.append("the pose is stale")
    return result


def _print(found: dict[str, Any]) -> None:
    robot = found["robot"]
    title = f" ({robot.title})" if robot is not None and robot.title else ""
    kind = ""
    if robot is not None:
        kind = f", {'simulated ' if robot.simulated else ''}{robot.drive}"
    click.secho(f"{found['name']}{title}{kind}", bold=True)
    click.echo(f"base   {_base_text(found['base'])}")
    click.echo(f"pose   {_pose_text(found['pose'], found['pose_age'])}")
    click.echo(f"goal   {_goal_text(found['goal'])}")
    click.echo(f"trip   {_trip_text(found['trip'])}")
    click.echo()
    rows = [_service_row(name, service) for name, service in found["services"].items()]
    print_table(("SERVICE", "STATE", "CPU", "MEMORY", "MESSAGE"), rows)
    if found["problems"]:
        click.echo()
        for problem in found["problems"]:
            click.secho(problem, fg="red")


def _base_text(base: BaseState | None) -> str:
    if base is None:
        return "-"
    text = base.mode
    if base.source:
        text += f", driven by {base.source}"
    if base.battery is not None and base.battery.fraction is not None:
        text += f", battery {base.battery.fraction:.0%}"
    links = [f"{link.name} {link.state}" for link in base.links if link.state != "up"]
    return ", ".join([text, *links]) + (f": {base.message}" if base.message else "")


def _pose_text(pose: PoseEstimate | None, age_s: float | None) -> str:
    if pose is None:
        return "-"
    state = pose.state if age_s is not None and age_s <= STALE_AFTER_S else "stale"
    at = f", {pose_text(pose.pose)} on {pose.map}" if pose.pose is not None else ""
    return f"{state}{at}, match {pose.match:.0%}" + (f": {pose.message}" if pose.message else "")


def _goal_text(goal: GoalStatus | None) -> str:
    if goal is None or goal.state == "idle":
        return "-"
    eta = f", {seconds_text(goal.eta)} left" if goal.eta is not None else ""
    return f"{goal.id} {goal.state}{eta}" + (f": {goal.message}" if goal.message else "")


def _trip_text(trip: TourStatus | None) -> str:
    if trip is None or trip.state == "idle":
        return "-"
    stop = f", stop {trip.stop + 1}" if trip.stop is not None else ""
    lap = f", lap {trip.lap + 1}" if trip.lap else ""
    message = f": {trip.message}" if trip.message else ""
    return f"{trip.name or 'unnamed'} {trip.state}{stop}{lap}{message}"


def _service_row(name: str, service: dict[str, Any]) -> tuple[str, ...]:
    health: Health | None = service["health"]
    if not service["runs"]:
        return name, click.style("not running", fg="red"), "", "", ""
    if health is None:
        return name, "starting", "", "", ""
    state = click.style(health.state, fg=_COLOURS[health.state])
    return name, state, f"{health.cpu:.1%}", f"{health.rss / 2**20:.0f} MiB", health.message
