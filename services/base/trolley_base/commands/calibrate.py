"""`trolley calibrate`: measure the systematic errors of the odometry."""

import math
from collections.abc import Callable
from dataclasses import replace
from datetime import UTC, datetime, timedelta
from pathlib import Path
from typing import Any, TypeVar

import click

from trolley import codes, requests, topics
from trolley.cli import SuggestingGroup, exits
from trolley.cli.options import FloatRange, given, json_option, where_options
from trolley.cli.printing import say, say_block
from trolley.cli.robots import one_robot, reports_errors
from trolley.cli.show import print_json
from trolley.client import Robot
from trolley.codes import Refused
from trolley.config import ConfigError, find_config, load_config, load_host_config
from trolley.geometry import Pose2D
from trolley.messages import Proposal, Proposals
from trolley.messages.request_params import WhichConfig, WhichProposal
from trolley_base.calibration import (
    CalibrationDrive,
    Comparison,
    Correction,
    Estimate,
    Leg,
    Return,
    benchmark,
    combined,
    estimate,
    square,
    squares_both_ways,
)
from trolley_base.calibration.report import (
    describe_benchmark,
    describe_estimate,
    describe_fit,
    describe_track,
    is_right,
    usable,
)
from trolley_base.calibration.umbmark import Direction
from trolley_base.commands.calibration_robot import (
    drive_course,
    listen,
    refuse_narrow,
    refuse_unready,
)
from trolley_base.commands.odometry_file import (
    as_toml,
    settings_of,
    write_proposed,
    write_settings,
)
from trolley_base.odometry.wheel_scales import WheelScales, scales_of

F = TypeVar("F", bound=Callable[..., Any])
NO_TRACK = "The wheel ratio is left out: give --track, the track that the board assumes."
WORSE = (
    "Nothing is proposed: corrected, the odometry would miss the ends of the squares by more than "
    "it does now. The wheels slip, or have play whenever they turn back."
)
RIGHT = (
    "As far as this drive shows, nothing is to be corrected: no error is larger than twice its "
    "standard error. More runs and larger squares show smaller ones."
)
BY_HAND_M, BY_HAND_RAD = 0.01, math.radians(2.0)
"""Errors of a person with a tape measure, from the mark to where the robot stands."""
WAYS: dict[Direction, str] = {"ccw": "counter-clockwise", "cw": "clockwise"}
FREE_SIDE: dict[Direction, str] = {"ccw": "left", "cw": "right"}


def _result_options(command: F) -> F:
    options = [
        click.option(
            "--write",
            is_flag=False,
            flag_value="",
            metavar="[ROBOT.TOML]",
            help="Set [base.odometry] in this file, or in that of --config [default: print it].",
        ),
        click.option(
            "--in-force",
            nargs=3,
            type=FloatRange(0.5, 2.0),
            metavar="LINEAR ANGULAR RATIO",
            help="The scales that were in force [default: those that base uses].",
        ),
        click.option(
            "--track",
            type=FloatRange(0.02, 3.0),
            metavar="METRES",
            help="The track that the board assumes, if no robot.toml says it.",
        ),
    ]
    for option in reversed(options):
        command = option(command)
    return command


@click.group(name="calibrate", cls=SuggestingGroup)
def calibrate_command() -> None:
    """Measure the systematic errors of the odometry, and correct them."""


@calibrate_command.command(name="square")
@click.option(
    "--side",
    default=1.0,
    show_default=True,
    type=FloatRange(0.3, 5.0),
    metavar="METRES",
    help="How long each side is.",
)
@click.option(
    "--runs",
    default=3,
    show_default=True,
    type=click.IntRange(1, 20),
    metavar="NUMBER",
    help="How many squares in each direction.",
)
@click.option(
    "--speed",
    default=0.2,
    show_default=True,
    type=FloatRange(0.05, 0.5),
    metavar="M/S",
    help="How fast it drives.",
)
@click.option("--by-hand", is_flag=True, help="Measure where the robot ends yourself, with a tape.")
@click.option("--yes", is_flag=True, help="Do not ask before driving.")
@_result_options
@where_options
@reports_errors
def square_command(
    side: float, runs: int, speed: float, by_hand: bool, yes: bool, **result: Any
) -> None:
    """Drive squares of SIDE metres, RUNS times in each direction (UMBmark).

    The localizer measures where the robot really is; with --by-hand, you do. Ctrl-C stops the
    robot.
    """
    if by_hand and yes:
        raise click.UsageError(
            "--by-hand waits before each square until the robot is back on its mark: leave out "
            "--yes."
        )
    with one_robot() as robot:
        in_force, path = _in_force(robot, result)
        refuse_unready(robot, needs_pose=not by_hand)
        measure = _drive_by_hand if by_hand else _drive_by_map
        legs, returns = measure(robot, side, runs, speed, yes)
    found = estimate(legs, by_hand=by_hand)
    correction = usable(found)
    say_block("\n".join(describe_estimate(found)))
    before, after = (
        benchmark([_return(*one, correction=kind) for one in returns], side)
        for kind in (Correction(), correction)
    )
    say_block("\n".join(describe_benchmark(before, after, side)))
    say_block(describe_fit(legs, correction, found.lidar))
    if after.is_worse_than(before):
        say(WORSE, err=True)
        raise SystemExit(exits.FAILED)
    _propose(found, in_force, path, result)


@calibrate_command.command(name="compare")
@click.option("--seconds", default=120.0, show_default=True, type=FloatRange(5.0, 3600.0))
@_result_options
@where_options
@json_option
@reports_errors
def compare_command(seconds: float, as_json: bool, **result: Any) -> None:
    """Compare odometry and localizer while somebody else drives.

    Drive it by hand or let it drive a tour: straight stretches and turns in both directions.
    Ctrl-C ends it early and evaluates what was heard so far.
    """
    comparison = Comparison()
    with one_robot() as robot:
        in_force, path = _in_force(robot, result)
        robot.pose()  # refuses where there is no localizer
        listen(robot, comparison, seconds)
    if not comparison.legs:
        say(
            "Nothing to compare: the robot drove less than a metre and two radians while the "
            "localizer was sure.",
            err=True,
        )
        raise SystemExit(exits.FAILED)
    found = estimate(comparison.legs)
    if not as_json:
        say_block("\n".join(describe_estimate(found)))
        say_block(describe_fit(comparison.legs, usable(found), found.lidar))
    _propose(found, in_force, path, result, as_json=as_json)


@calibrate_command.command(name="proposed")
@click.option("--accept", metavar="ID", help="Set what is proposed in the file of --config.")
@click.option("--dismiss", metavar="ID", help="Do not propose that again.")
@where_options
@json_option
@reports_errors
def proposed_command(accept: str | None, dismiss: str | None, as_json: bool) -> None:
    """List what base has found wrong with robot.toml while the robot drove, and decide on it.

    Base compares wheels, lidar and localizer all the time. What is accepted is written into
    robot.toml, whose comments stay, and counts once base is restarted. What is dismissed is not
    proposed again, unless it was right in between or robot.toml says something else.
    """
    if accept is not None and dismiss is not None:
        raise click.UsageError("Give either --accept or --dismiss.")
    with one_robot() as robot:
        heard = robot.latest(topics.PROPOSALS)
        now_ns = robot.connection.robot_now_ns(robot.name)
        if heard is None:
            raise Refused(codes.NOT_READY, "Base is not running, or its wheels do not count.")
        if dismiss is not None:
            robot.ask(requests.PROPOSALS_DISMISS, WhichProposal(id=dismiss))
            say(f"{dismiss} will not be proposed again.")
            return
    if accept is not None:
        _accept(robot.name, heard, accept)
    elif as_json:
        print_json(heard)
    elif not heard.proposals:
        say("Nothing is proposed: as far as base can tell, robot.toml is right.")
    else:
        for one in heard.proposals:
            say_block(f"{one.id}: {one.message}{right_until_text(one, now_ns)}")
            say_block("".join(f"  {name} = {value}\n" for name, value in one.settings.items()))


def _accept(name: str, heard: Proposals, wanted: str) -> None:
    """Write a proposal into the file."""
    chosen = next((one for one in heard.proposals if one.id == wanted), None)
    if chosen is None:
        ids = ", ".join(one.id for one in heard.proposals) or "nothing is proposed"
        raise Refused(codes.UNKNOWN_NAME, f"There is no proposal {wanted!r}: {ids}.")
    if not chosen.settings:
        raise Refused(codes.BAD_REQUEST, f"There is nothing to write: {chosen.message}")
    path = find_config(given("config"))
    if path is None:
        raise ConfigError("there is no robot.toml; name one with --config")
    config = load_config(path)
    if config.robot.name != name:
        raise ConfigError(f"{path} is the file of robot {config.robot.name}, not of {name}")
    write_proposed(path, chosen.settings)
    say(
        f"Set {', '.join(chosen.settings)} in {path}. Restart base for it to take effect; until "
        "then it goes on as before, and proposes this."
    )


def right_until_text(proposal: Proposal, now_ns: int | None) -> str:
    """Say until when it was right, by the clock of this computer; `now_ns` is robot time."""
    if proposal.right_until is None or now_ns is None:
        return ""
    ago = timedelta(seconds=(now_ns - proposal.right_until) * 1e-9)
    at = (datetime.now(UTC) - ago).astimezone()
    return f" It was right until {at:%Y-%m-%d %H:%M}."


Square = tuple[Direction, Leg]


def _drive_by_map(
    robot: Robot, side: float, runs: int, speed: float, yes: bool
) -> tuple[list[Leg], list[Square]]:
    course = squares_both_ways(side, runs)
    refuse_narrow(robot, course.places)
    _confirm(
        f"{robot.name} will drive {2 * runs} squares of {side:g} m, on the floor ahead of it to "
        "the left. Is the floor free, and is somebody there to stop the robot?",
        yes,
    )
    drive = CalibrationDrive(course.places, speed)
    drive_course(robot, drive, "Squares")
    squares: list[Square] = []
    for direction, first, last in course.squares:
        steps, moved = drive.between(first, last)
        assert moved is not None  # the drive does not go on without
        squares.append((direction, Leg(steps, moved, BY_HAND_M, BY_HAND_RAD)))
    return drive.legs(), squares


def _drive_by_hand(
    robot: Robot, side: float, runs: int, speed: float, yes: bool
) -> tuple[list[Leg], list[Square]]:
    squares: list[Square] = []
    for _ in range(runs):
        for direction, way in WAYS.items():
            _confirm(
                f"Put {robot.name} on its mark. It will drive a square of {side:g} m {way}: the "
                f"floor ahead of it to the {FREE_SIDE[direction]} must be free. Ready?",
                yes,
            )
            places = square(side, direction)
            refuse_narrow(robot, places)
            drive = CalibrationDrive(places, speed, uses_map=False)
            drive_course(robot, drive, f"Square {way}")
            steps, _moved = drive.between(0, len(drive.stops) - 1)
            end, error_rad = ask_end(side)
            squares.append((direction, Leg(steps, end, BY_HAND_M, error_rad)))
    return [leg for _, leg in squares], squares


def ask_end(side_m: float) -> tuple[Pose2D, float]:
    """Ask where the robot ended relative to its mark, and how certain its heading is.

    What cannot be is asked again, such as centimetres for metres: the drive is not to be lost.
    """
    metres, degrees = FloatRange(-3.0 * side_m, 3.0 * side_m), FloatRange(-180.0, 180.0)
    x = click.prompt("How far ahead of its mark is it, in metres (negative: behind)", type=metres)
    y = click.prompt("How far to the left of it, in metres (negative: right)", type=metres)
    yaw: float | None = click.prompt(
        "Turned to the left by how many degrees (Enter: not measured)",
        default="",
        value_proc=lambda text: degrees.convert(text, None, None) if text else None,
    )
    end = Pose2D(x, y, 0.0 if yaw is None else math.radians(yaw))
    return end, math.inf if yaw is None else BY_HAND_RAD


def _return(direction: Direction, leg: Leg, *, correction: Correction) -> Return:
    return Return(direction, leg.start_T_end, correction.integrate(leg.steps))


def _confirm(question: str, yes: bool) -> None:
    if not yes:
        click.confirm(question, abort=True)


def _in_force(robot: Robot, result: dict[str, Any]) -> tuple[WheelScales, Path | None]:
    """Return the scales that the robot uses now, and the file to write.

    Raises:
        ConfigError: the file cannot be used, belongs to another robot, is none, or says something
            else than base uses.
    """
    name = robot.name
    wanted: str | None = result["write"]
    path = Path(wanted) if wanted else find_config(given("config"))
    if wanted is not None and path is None:
        raise ConfigError("--write: there is no robot.toml; name one")
    load = load_host_config if wanted is None else load_config
    config = None if path is None else load(path)
    if config is not None and (config.robot is None or config.robot.name != name):
        if wanted is not None and config.robot is not None:
            raise ConfigError(f"{path} is the file of robot {config.robot.name}, not of {name}")
        config = None
    scales = WheelScales() if config is None else scales_of(config)
    track_m: float | None = scales.track_m or result["track"]
    linear, angular, ratio = used = result["in_force"] or _used_by(robot)
    written = scales.linear, scales.angular, scales.wheel_ratio
    if config is not None and result["in_force"] is None and written != used:
        raise ConfigError(
            f"{path} has other scales in [base.odometry] than base uses, which reads them when it "
            "starts: restart base first, or what is right already would be corrected again"
        )
    if ratio != 1.0 and track_m is None:
        raise ConfigError("a wheel ratio is in force: give --track")
    return WheelScales(linear, scales.sideways, angular, ratio, track_m), path


def _used_by(robot: Robot) -> tuple[float, float, float]:
    """Return linear scale, angular scale and wheel ratio that base uses."""
    heard = robot.ask(requests.CONFIG_GET, WhichConfig(section="base.odometry"))
    values: dict[str, float] = {one.key: one.value for one in heard.settings}
    return values["linear_scale"], values["angular_scale"], values["wheel_ratio"]


def _propose(
    found: Estimate,
    in_force: WheelScales,
    path: Path | None,
    result: dict[str, Any],
    *,
    as_json: bool = False,
) -> None:
    correction = usable(found)
    if correction != Correction() and is_right(found):
        say(RIGHT, err=as_json)
        if as_json:
            print_json({"settings": {}, "file": None})
        return
    if correction.bend != 0.0 and in_force.track_m is None:
        say(NO_TRACK, err=as_json)
        correction = replace(correction, bend=0.0)
    if correction == Correction():
        say("Nothing is certain enough to propose; drive more of what was missing.", err=True)
        raise SystemExit(exits.FAILED)
    scales = combined(correction, in_force)
    settings = settings_of(scales, with_track=result["track"] is not None)
    if as_json:
        if result["write"] is not None and path is not None:
            write_settings(path, settings)
        print_json({"settings": settings, "file": None if result["write"] is None else str(path)})
        return
    words = describe_track(scales)
    if words is not None:
        say_block(words)
    if result["write"] is None:
        say_block(f"\nFor robot.toml:\n\n{as_toml(settings)}")
        return
    assert path is not None  # `_in_force` has refused that
    write_settings(path, settings)
    say(f"Set [base.odometry] in {path}. Restart base for it to take effect.")
