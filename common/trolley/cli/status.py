"""`trolley status`: the robot and its services at a glance."""

import shutil
from typing import Any

import click

from trolley import topics
from trolley.cli import exits
from trolley.cli.columns import Column, table_lines
from trolley.cli.options import json_option, where_options
from trolley.cli.printing import say
from trolley.cli.robot_sentence import goal_message, robot_sentence
from trolley.cli.robots import connected, one_robot, reports_errors
from trolley.cli.show import pose_text, print_json, print_table, seconds_text
from trolley.cli.top_picture import short_time
from trolley.client import STALE_AFTER_S, Robot
from trolley.connection import RobotUnreachable
from trolley.doctor.computer_facts import Host
from trolley.doctor.units import read_units
from trolley.messages import BaseState, GoalStatus, Health, PoseEstimate, TourStatus
from trolley.sanitize import sanitize

EXPECTED = ("base", "localizer", "planner", "tour")
"""What a robot needs to drive tours."""
REPLAYED = "A recording is played; no robot is there."
COLUMNS = (
    Column("SERVICE", is_number=False),
    Column("STATE", 9, is_number=False),
    Column("HEARD", 6),
    Column("CPU", 8),
    Column("MEMORY", 7),
    Column("UP", 5),
    Column("RESTARTS", 4),
    Column("MESSAGE", 3, is_number=False),
)
_COLOURS = {"starting": "yellow", "degraded": "yellow", "failed": "red", "not running": "red"}


@click.command(name="status")
@click.option("--all", "everybody", is_flag=True, help="All robots on the network, a line each.")
@where_options
@json_option
@reports_errors
def status_command(everybody: bool, as_json: bool) -> None:
    """Show what the robot is doing, its services, pose, goal and trip.

    The exit code is 1 if a problem is listed, such as a service that is missing or degraded, or a
    robot that is stopped or lost.
    """
    found: list[dict[str, Any]]
    if everybody:
        with connected() as connection:
            names = connection.robots()
            if not names:
                where = ", ".join(connection.endpoints)
                raise RobotUnreachable(f"no robot is on the network at {where}")
            found = [read_status(Robot.over(connection, name)) for name in names]
    else:
        with one_robot() as robot:
            found = [read_status(robot)]
    if as_json:
        print_json(found if everybody else found[0])
    elif everybody:
        _print_all(found)
    else:
        _print(found[0])
    if any(one["problems"] for one in found):
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
        raise robot.connection.unknown_robot(robot.name)
    now_ns = robot.connection.robot_now_ns(robot.name)  # first: late answers make nothing old
    health = {parts[0]: message for parts, message in robot.get(topics.HEALTH).items()}
    pose = robot.latest(topics.POSE)
    restarts = {unit.service: unit.restarts for unit in read_units(Host()) or []}
    of_robot = robot.latest(topics.ROBOT)
    is_replayed = of_robot is not None and of_robot.replayed
    found: dict[str, Any] = {
        "name": robot.name,
        "robot": of_robot,
        "services": {
            service: {
                "runs": runs.get(service, []),
                "health": health.get(service),
                "age_s": _age_s(health.get(service), now_ns),
                "up_s": health[service].up if service in health else None,
                "restarts": restarts.get(service),
            }
            for service in sorted(set() if is_replayed else {*EXPECTED, *runs, *health})
        },
        "base": robot.latest(topics.BASE),
        "pose": pose,
        "pose_age": _age_s(pose, now_ns),
        "goal": robot.latest(topics.GOAL),
        "trip": robot.latest(topics.TOUR),
    }
    found["sentence"] = REPLAYED if is_replayed else _sentence(found)
    found["problems"] = [] if is_replayed else problems(found)
    return found


def _age_s(message: Health | PoseEstimate | None, now_ns: int | None) -> float | None:
    """How old a message is by the robot's clock; a stamp of 0 was made without it."""
    if message is None or now_ns is None or not message.stamp_ns:
        return None
    return max(0.0, (now_ns - message.stamp_ns) * 1e-9)


def _sentence(found: dict[str, Any]) -> str:
    age_s: float | None = found["pose_age"]
    is_stale = age_s is None or age_s > STALE_AFTER_S
    # A latest value may have been left behind by a base that is gone.
    base = found["base"] if found["services"]["base"]["runs"] else None
    return robot_sentence(base, found["pose"], found["goal"], found["trip"], is_stale=is_stale)


def problems(found: dict[str, Any]) -> list[str]:
    """What keeps the robot from its work, a sentence each."""
    services: dict[str, dict[str, Any]] = found["services"]
    result = [f"{name} is not running" for name, service in services.items() if not service["runs"]]
    for name, service in services.items():
        health: Health | None = service["health"]
        if service["runs"] and health is not None and health.state in ("failed", "degraded"):
            result.append(f"{name} is {health.state}: {health.message}")
    base: BaseState | None = found["base"]
    if base is not None and (base.may_still_move or (base.mode == "stopped" and base.message)):
        result.append(base.message)
    elif base is not None and base.mode in ("stopped", "fault"):
        result.append(f"the robot is {base.mode}: {base.message or base.reason}")
    pose: PoseEstimate | None = found["pose"]
    if pose is not None:
        age_s: float | None = found["pose_age"]
        if pose.state == "lost":
            result.append(f"the robot is lost: {pose.message}")
        elif age_s is None or age_s > STALE_AFTER_S:
            result.append("the pose is stale")
    return result


def _print_all(found: list[dict[str, Any]]) -> None:
    """A line for each robot; what is wrong with it below."""
    print_table(("ROBOT", "NOW"), [(one["name"], sanitize(one["sentence"])) for one in found])
    for one in found:
        for problem in one["problems"]:
            say(sanitize(f"{one['name']}: {problem}"), fg="red")


def _print(found: dict[str, Any]) -> None:
    robot = found["robot"]
    title = f" ({robot.title})" if robot is not None and robot.title else ""
    kind = ""
    if robot is not None:
        kind = f", {'simulated ' if robot.simulated else ''}{robot.drive}"
    say(sanitize(f"{found['name']}{title}{kind}"), bold=True)
    say(sanitize(found["sentence"]))
    say()
    say(sanitize(f"base   {_base_text(found['base'])}"))
    say(sanitize(f"pose   {_pose_text(found['pose'], found['pose_age'])}"))
    say(sanitize(f"goal   {_goal_text(found['goal'], found['base'])}"))
    say(sanitize(f"trip   {_trip_text(found['trip'])}"))
    if not found["services"]:
        return
    say()
    width = shutil.get_terminal_size().columns
    rows = [_service_row(name, service) for name, service in found["services"].items()]
    head, lines = table_lines(COLUMNS, rows, width)
    say(head, bold=True)
    for line, row in zip(lines, rows, strict=True):
        say(line, fg=_COLOURS.get(row[1]))
    if found["problems"]:
        say()
        for problem in found["problems"]:
            say(sanitize(problem), fg="red")


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
    if pose is None or pose.map is None:
        return "-"
    state = pose.state if age_s is not None and age_s <= STALE_AFTER_S else "stale"
    at = f", {pose_text(pose.pose)} on {pose.map}" if pose.pose is not None else ""
    return f"{state}{at}, match {pose.match:.0%}" + (f": {pose.message}" if pose.message else "")


def _goal_text(goal: GoalStatus | None, base: BaseState | None) -> str:
    if goal is None or goal.state == "idle":
        return "-"
    eta = f", {seconds_text(goal.eta)} left" if goal.eta is not None else ""
    message = goal_message(goal, base)
    return f"{goal.id} {goal.state}{eta}" + (f": {message}" if message else "")


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
        return sanitize(name), "not running", *[""] * (len(COLUMNS) - 2)
    up_s, age_s, restarts = service["up_s"], service["age_s"], service["restarts"]
    return (
        sanitize(name),
        "starting" if health is None else health.state,
        "-" if age_s is None else short_time(age_s),
        "-" if health is None else f"{health.cpu:.1%}",
        "-" if health is None else f"{health.rss / 1e6:.0f} MB",
        "-" if up_s is None else short_time(up_s),
        "-" if restarts is None else str(restarts),
        "" if health is None else sanitize(health.message),
    )
