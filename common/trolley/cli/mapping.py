"""`trolley map new` and its kin: a map from one drive."""

import time
from pathlib import Path
from typing import Any

import click

from trolley import codes, requests, topics
from trolley.cli.map_edit import edit_map
from trolley.cli.map_of_drive import map_of_drive
from trolley.cli.options import (
    FloatRange,
    NumbersCommand,
    as_pose,
    json_option,
    pose_options,
    where_options,
)
from trolley.cli.printing import say
from trolley.cli.robots import known, one_robot, reports_errors
from trolley.cli.show import Progress, counted, print_json, seconds_text
from trolley.client import Robot
from trolley.codes import Refused
from trolley.messages import MappingStatus, request_params
from trolley.requests import Request

START_TIMEOUT_S = 900.0
"""A small computer that compiles its kernels takes minutes."""
SAVE_TIMEOUT_S = 60.0

DRIVE = (
    "Drive it through every room by hand (`trolley teleop`, or the viewer's joystick), come back "
    "to where you started, then run `trolley map save`."
)


def add_commands(group: click.Group) -> None:
    """Add the commands about a map in the making to `trolley map`."""
    for command in (
        new_map,
        extend_map,
        save_map,
        _control(
            "pause",
            requests.MAP_PAUSE,
            request_params.PauseMap(),
            "Pause mapping; the map stays as it is.",
        ),
        _control(
            "resume", requests.MAP_PAUSE, request_params.PauseMap(on=False), "Resume mapping."
        ),
        undo_map,
        join_part,
        _control("drop", requests.MAP_DROP, request_params.Nothing(), "Remove what hangs loose."),
        explore_map,
        cancel_map,
        map_status,
        edit_map,
    ):
        group.add_command(command)


EXPLORES = (
    "The robot explores on its own and comes back. Stay near it: it cannot see mirrors, glass, "
    "stairs or low objects. `trolley map explore off` or any key of `trolley teleop` "
    "stops it; `trolley map status` shows progress; finish with `trolley map save`."
)
explore_option = click.option("--explore", is_flag=True, help="The robot explores on its own.")


@click.command(name="new")
@click.argument("name")
@explore_option
@click.option(
    "--from",
    "drive",
    type=click.Path(exists=True, path_type=Path),
    metavar="DRIVE",
    help="Make it of a recording or a ROS bag, without a robot.",
)
@where_options
@json_option
@reports_errors
def new_map(name: str, explore: bool, drive: Path | None, as_json: bool) -> None:
    """Start the map NAME; its origin is where the robot stands.

    With --from it is made at once, as NAME.yaml and NAME.pgm in the current folder.
    """
    if drive is not None:
        if explore:
            raise click.UsageError("--explore needs a robot, --from a recording: give one of them")
        map_of_drive(name, drive, as_json=as_json)
        return
    with one_robot() as robot:
        status = _begin(robot, requests.MAP_NEW, name, explore=explore)
    _show(status, as_json=as_json, text=f"Mapping {name}. {EXPLORES if explore else DRIVE}")


@click.command(name="extend")
@click.argument("name")
@explore_option
@where_options
@json_option
@reports_errors
def extend_map(name: str, explore: bool, as_json: bool) -> None:
    """Extend the map NAME, which the robot is using; saving keeps the old version."""
    with one_robot() as robot:
        status = _begin(robot, requests.MAP_EXTEND, name, explore=explore)
    text = f"Extending {name}. {EXPLORES if explore else DRIVE}"
    _show(status, as_json=as_json, text=f"{text} {status.message}".rstrip())


@click.command(name="explore")
@click.argument("switch", type=click.Choice(["on", "off"]), default="on")
@where_options
@json_option
@reports_errors
def explore_map(switch: str, as_json: bool) -> None:
    """Let the robot explore what the map still lacks, or stop exploring (`off`)."""
    with one_robot() as robot:
        status = robot.ask(requests.MAP_EXPLORE, request_params.ExploreMap(on=switch == "on"))
    _show(status, as_json=as_json, text=EXPLORES if switch == "on" else status_text(status))


@click.command(name="save")
@click.argument("name", required=False)
@where_options
@json_option
@reports_errors
def save_map(name: str | None, as_json: bool) -> None:
    """Save the map, under another NAME if one is given; the robot uses it from then on."""
    with one_robot() as robot:
        asked = robot.ask(requests.MAP_SAVE, request_params.SaveMap(name=name))
        status = _wait(robot, asked, "saving", SAVE_TIMEOUT_S)
    if status.state != "idle":
        raise Refused(codes.NOT_SAVED, status.message or None)
    _show(status, as_json=as_json, text=status.message)


@click.command(name="undo")
@click.option("--seconds", type=FloatRange(0.1, 86_400.0), default=60.0, show_default=True)
@where_options
@json_option
@reports_errors
def undo_map(seconds: float, as_json: bool) -> None:
    """Remove what was mapped last."""
    with one_robot() as robot:
        status = robot.ask(requests.MAP_UNDO, request_params.UndoMap(seconds=seconds))
    _show(status, as_json=as_json, text=status_text(status))


@click.command(name="join", cls=NumbersCommand)
@pose_options
@where_options
@json_option
@reports_errors
def join_part(where: tuple[str, ...], deg: bool, as_json: bool) -> None:
    """Join what hangs loose: the robot is there, roughly; metres on the map, YAW in radians."""
    pose = as_pose(where, deg=deg)
    with one_robot() as robot:
        status = robot.ask(requests.MAP_JOIN, request_params.JoinPart(pose=pose))
    _show(status, as_json=as_json, text=status_text(status))


@click.command(name="cancel")
@click.option("--yes", is_flag=True, help="Do not ask for confirmation.")
@where_options
@json_option
@reports_errors
def cancel_map(yes: bool, as_json: bool) -> None:
    """Discard the map; the robot goes back to the previous map.

    Of a map that is saved, but whose zones wait for a localizer that is not running, discard what
    was changed in these zones.
    """
    with one_robot() as robot:
        if not yes:
            now = robot.latest(topics.MAPPING)
            if now is not None and now.state == "idle":
                raise Refused(codes.NOT_MAPPING)  # and not asked: a map may be begun meanwhile
            what = f"the map {'that is being made' if now is None else now.name}"
            if now is not None and now.state == "saving":
                what = "the zones that are not saved yet"
            click.confirm(f"Discard {what}?", abort=True, err=True)
        status = robot.ask(requests.MAP_CANCEL)
    _show(status, as_json=as_json, text=status.message)


@click.command(name="status")
@where_options
@json_option
@reports_errors
def map_status(as_json: bool) -> None:
    """Show mapping progress."""
    with one_robot() as robot:
        status = known(robot, topics.MAPPING, "The mapper is still starting.")
    _show(status, as_json=as_json, text=status_text(status))


def status_text(status: MappingStatus) -> str:
    """How a map in the making goes, for a person."""
    if status.state == "idle":
        return status.message or "No map is being made."
    scans = counted(status.scans, "scan")
    text = f"{status.state}: {status.name}, {seconds_text(status.seconds)}, {scans}"
    if status.loops:
        text += f", {counted(status.loops, 'loop')} closed"
    if status.loose:
        scans = "1 scan that hangs" if status.loose == 1 else f"{status.loose} scans that hang"
        text += f", {scans} loose"
    return f"{text}. {status.message}" if status.message else text


def _control(
    name: str, request: Request[Any, MappingStatus], params: Any, text: str
) -> click.Command:
    """Return a command that asks a request with fixed parameters."""

    @click.command(name=name, help=text)
    @where_options
    @json_option
    @reports_errors
    def control(as_json: bool) -> None:
        with one_robot() as robot:
            status = robot.ask(request, params)
        _show(status, as_json=as_json, text=status_text(status))

    return control


def _begin(
    robot: Robot,
    request: Request[request_params.MapNamed, MappingStatus],
    name: str,
    *,
    explore: bool,
) -> MappingStatus:
    """Ask for a map and wait until it is being made."""
    asked = robot.ask(request, request_params.MapNamed(name=name, explore=explore))
    status = _wait(robot, asked, "starting", START_TIMEOUT_S)
    if status.state not in ("mapping", "paused"):
        raise Refused(codes.NOT_READY, status.message or "The mapper has given up.")
    return status


def _wait(robot: Robot, status: MappingStatus, state: str, timeout_s: float) -> MappingStatus:
    """Wait until the mapper is in another state.

    Raises:
        Refused: it takes too long.
    """
    progress, until_s = Progress(), time.monotonic() + timeout_s
    try:
        while status.state == state:
            progress.show(f"{state} ...", state)
            if time.monotonic() > until_s:
                doing = status.message or f"The mapper is {state}."
                raise Refused(
                    codes.TIMEOUT,
                    f"Not finished after {timeout_s:.0f} s (`trolley map status` shows how it goes "
                    f"on): {doing}",
                )
            time.sleep(0.2)
            status = robot.latest(topics.MAPPING) or status
    finally:
        progress.clear()
    return status


def _show(status: MappingStatus, *, as_json: bool, text: str) -> None:
    if as_json:
        print_json(status)
    else:
        say(text)
