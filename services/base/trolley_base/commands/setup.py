"""`trolley setup`: the robot measures itself, step by step, into its `robot.toml`."""

import math
import tomllib
from datetime import UTC, datetime
from pathlib import Path
from typing import Any, Literal

import click
import msgspec

from trolley.cli import exits
from trolley.cli.init import render
from trolley.cli.options import given, where_options
from trolley.cli.printing import say, say_block
from trolley.cli.robots import reports_errors
from trolley.config import ConfigError, find_config, load_config, robot_toml
from trolley.config.describe import Key, to_toml
from trolley.files import write_atomically
from trolley.topics import names_robot
from trolley_base.commands.detect import look_at_ports
from trolley_base.commands.setup_robot import OpenRobot
from trolley_base.description import footprint_of, half_track_of, limits_of
from trolley_base.detection import settings as detected
from trolley_base.drivers import LidarScan
from trolley_base.odometry.wheel_scales import counted_track_of
from trolley_base.setup.clearance import PARAMS as CLEARANCE
from trolley_base.setup.clearance import Body
from trolley_base.setup.drive import PARAMS as DRIVE
from trolley_base.setup.drive import SetupDrive
from trolley_base.setup.findings import Settings, describe, evaluate, settings_of
from trolley_base.setup.record import SetupRefused
from trolley_base.setup.sight import Beams, Sector, near_sectors, usual_ranges
from trolley_base.setup.wheels import Seen, WheelTrial, judge_counts, judge_wiring

ANSWERS: dict[str, Seen] = {
    "f": "both forward",
    "b": "both back",
    "l": "left forward",
    "r": "right forward",
    "n": "not both",
}
ANSWER_WORDS = (
    "  f  both forward\n"
    "  b  both back\n"
    "  l  the left one forward, the right one back\n"
    "  r  the right one forward, the left one back\n"
    "  n  not both of them turned"
)
SHORT_STROKES = 6
MEASURED = "# Measured by `trolley setup`"
"""How the comments begin that say what was measured."""


class Progressed(msgspec.Struct, forbid_unknown_fields=True):
    """How far the setup of a file has come; stands beside it until it is undone."""

    before: str | None
    """What the file said before; None: there was none."""
    has_devices: bool = False
    has_wheels: bool = False
    has_floor: bool = False


@click.command(name="setup")
@click.argument("ports", nargs=-1, metavar="[PORT]...")
@click.option("--undo", is_flag=True, help="Give the file back as it was before the last setup.")
@click.option("--again", is_flag=True, help="Begin with the first step, whatever is done already.")
@click.option("--short", is_flag=True, help="Drive half as long, and measure less exactly.")
@where_options
@reports_errors
def setup_command(ports: tuple[str, ...], undo: bool, again: bool, short: bool) -> int:
    """Let the robot measure itself: devices, wheels, lidar, gyro, delays; into its robot.toml.

    Three steps, each checked before the next: find the devices (at the PORTs given, else all);
    try the wheels in the air; drive to and fro on the floor for some minutes. Any key stops the
    robot. Called again, it goes on with the step that was not finished. Base must not be running.
    """
    path = find_config(given("config")) or Path("robot.toml")
    notes = path.with_name(f"{path.name}.setup.json")
    if undo:
        return _undo(path, notes)
    state = _load(notes)
    if state is None or again or state.has_floor:
        state = Progressed(path.read_text(encoding="utf-8") if path.exists() else None)
    try:
        if not state.has_devices:
            _find_devices(path, ports, notes, state)
            state.has_devices = True
            _save(notes, state)
        if not state.has_wheels:
            _try_wheels(path)
            state.has_wheels = True
            _save(notes, state)
        _drive(path, short)
        state.has_floor = True
        _save(notes, state)
    except SetupRefused as refusal:
        say(str(refusal), err=True, fg="red")
        say(
            "`trolley setup` tries this step again, `trolley setup --undo` takes back what was "
            "written before.",
            err=True,
        )
        return exits.FAILED
    except KeyboardInterrupt:
        say("Stopped. `trolley setup` goes on with this step.", err=True)
        return exits.INTERRUPTED
    say(f"All is written. `trolley up --config {path}` starts the robot; next comes its first map.")
    return exits.OK


# Keeping track.
def _load(notes: Path) -> Progressed | None:
    try:
        return msgspec.json.decode(notes.read_bytes(), type=Progressed)
    except FileNotFoundError:
        return None
    except (OSError, msgspec.DecodeError) as error:
        raise ConfigError(
            f"{notes}: cannot be used: {error}. Delete it; the setup then begins anew."
        ) from error


def _save(notes: Path, state: Progressed) -> None:
    try:
        write_atomically(notes, msgspec.json.encode(state))
    except OSError as error:
        raise ConfigError(f"{notes}: cannot be written: {error.strerror}") from error


def _undo(path: Path, notes: Path) -> int:
    state = _load(notes)
    if state is None:
        raise ConfigError(f"there is nothing to undo: {notes} is not there")
    kept = path.with_name(f"{path.name}.undone")
    if path.exists():
        write_atomically(kept, path.read_bytes())
    if state.before is None:
        path.unlink(missing_ok=True)
        say(f"{path} is gone, as it was before; what it said is in {kept}.")
    else:
        robot_toml.replace_text(path, state.before)
        say(f"{path} is as it was before; what it said is in {kept}.")
    notes.unlink()
    return exits.OK


def _write(path: Path, values: Settings, appendix: str = "") -> None:
    old = robot_toml.read_text(path)
    text = without_measured(old) if appendix else old
    new = robot_toml.with_values(text, values, tables=[appendix] if appendix else [])
    robot_toml.replace_text(path, new)
    if new != old:
        say(f"Changed in {path}:")
        say_block(robot_toml.difference(path, old, new), nl=False)


def without_measured(text: str) -> str:
    """Return a file without the comments in which an earlier setup says what it measured."""
    lines: list[str] = []
    is_inside = False
    for line in text.splitlines(keepends=True):
        is_inside = line.startswith("#") and (is_inside or line.startswith(MEASURED))
        if not is_inside:
            lines.append(line)
    return "".join(lines)


# Step 1.
def _find_devices(path: Path, ports: tuple[str, ...], notes: Path, state: Progressed) -> None:
    say("1. Devices", bold=True)
    _save(notes, state)
    if not path.exists():
        _make_file(path)
    config = load_config(path)
    chassis, lidar = config.base.chassis, config.base.lidar
    if not ports and config.base.driver == "hardware" and chassis.port and lidar.port:
        say(f"{path} names them: {chassis.board} at {chassis.port}, {lidar.model} at {lidar.port}.")
        return
    seen = look_at_ports(ports)
    text = robot_toml.read_text(path)
    proposal = detected.propose(seen, tomllib.loads(text))
    values = proposal.values | proposal.waiting
    board = values.get((*detected.CHASSIS, "board"), chassis.board)
    model = values.get((*detected.LIDAR, "model"), lidar.model)
    if not (board and model):
        missing = "lidar" if board else "motor board"
        said = " ".join([f"No {missing} was found; `trolley detect` says more.", *proposal.notes])
        raise SetupRefused(said)
    new = robot_toml.with_values(text, values | _ask_owner(proposal), tables=proposal.sense_tables)
    if new != text:
        robot_toml.replace_text(path, new)
    now = load_config(path).base
    say(f"Found {now.chassis.board} at {now.chassis.port}, {now.lidar.model} at {now.lidar.port}.")
    for note in proposal.sense_notes:
        say(note)


def _ask_owner(proposal: detected.Proposal) -> detected.Settings:
    """Ask for what the devices need to know of the robot."""
    answers: detected.Settings = {}
    for table, keys in proposal.missing.items():
        say(f"[{'.'.join(table)}] must say about the robot:")
        for key in keys:
            say_block(f"  {key.meaning} ({key.allowed})")
            answers[*table, key.name] = click.prompt(f"  {key.name}", type=_type_of(key))
    return answers


def _type_of(key: Key) -> "click.ParamType[Any, Any]":
    """Return what may be answered; the file's own check comes after that."""
    if key.choices:
        return click.Choice(key.choices)
    if key.allowed.startswith("whole number"):
        return click.INT
    if key.allowed.startswith("number"):
        return click.FloatRange(key.least, key.greatest, min_open="above" in key.allowed)
    return click.STRING


def _name(typed: str) -> str:
    if not names_robot(typed):
        raise click.BadParameter("1 to 32 of a-z, 0-9, _ and -")
    return typed


def _make_file(path: Path) -> None:
    say(f"{path} is not there yet. It needs a name and the size of the robot.")
    name = click.prompt("Name (a-z, 0-9, _ and -)", default="trolley", value_proc=_name)
    length = click.prompt("Length in metres", type=click.FloatRange(0.05, 3.0))
    width = click.prompt("Width in metres", type=click.FloatRange(0.05, 3.0))
    chosen = {
        "robot.name": to_toml(name),
        "robot.footprint": to_toml({"length_m": length, "width_m": width}),
    }
    robot_toml.replace_text(path, render(chosen))


# Step 2.
def _try_wheels(path: Path) -> None:
    say()
    say("2. Wheels in the air", bold=True)
    config = load_config(path)
    half_track_m = half_track_of(config, footprint_of(config))
    say("Put the robot on a block, so that its wheels turn freely. They turn slowly, twice.")
    _confirm("Do the wheels hang free?")
    robot = OpenRobot(config)
    ahead = _try(robot, "ahead", half_track_m)
    left = _try(robot, "left", half_track_m)
    wiring = judge_wiring(ahead, left)
    if wiring.is_right:
        say("Both wheels turn and count as they should.")
        return
    if wiring.is_swapped:
        raise SetupRefused(
            "Left and right are swapped: exchange the plugs of both motors, and those of both "
            "encoders."
        )
    sides = [
        name
        for name, is_reversed in (
            ("left", wiring.left_is_reversed),
            ("right", wiring.right_is_reversed),
        )
        if is_reversed
    ]
    wheels = config.base.chassis.wheels
    if wheels is None:
        raise SetupRefused(
            f"The {' and the '.join(sides)} wheel turns the wrong way round: exchange both wires "
            "of its motor, and A and B of its encoder; or set it right in the board's firmware."
        )
    now = {"left": wheels.reverse_left, "right": wheels.reverse_right}
    table = ("base", "chassis", "wheels")
    _write(path, {(*table, f"reverse_{side}"): not now[side] for side in sides})
    _try_wheels(path)


def _try(robot: OpenRobot, way: Literal["ahead", "left"], half_track_m: float) -> Seen:
    what = "go ahead" if way == "ahead" else "turn to the left"
    trial = WheelTrial(way, half_track_m)
    with robot.opened():
        robot.run(
            trial,
            lambda now_ns, motions, scans, _imu: trial.step(now_ns, motions, scans),
            lambda: f"The wheels {what}",
        )
    assert trial.counted is not None  # it has ended well
    judge_counts(trial.counted)
    say(f"They were told to {what}. How did they turn, seen along the robot's forward direction?")
    say_block(ANSWER_WORDS)
    return ANSWERS[click.prompt("Answer", type=click.Choice(list(ANSWERS)), show_choices=False)]


# Step 3.
def _drive(path: Path, short: bool) -> None:
    say()
    say("3. On the floor", bold=True)
    config = load_config(path)
    footprint = footprint_of(config)
    half_track_m = half_track_of(config, footprint)
    radius_m = Body(footprint).radius_m
    room_m = 2.0 * (radius_m + DRIVE.half_stroke_m + CLEARANCE.margin_m)
    say(
        f"Put the robot on the floor in the middle of {room_m:.1f} m of free room all round, with "
        "walls or furniture in sight. It turns on the spot, then drives to and fro. Keep out of "
        "its sight, and your hand at the keyboard: any key stops it."
    )
    robot = OpenRobot(config)
    with robot.opened():
        scans = robot.look(DRIVE.scans)
    own = _ask_what_is_near(scans, 2.0 * radius_m + CLEARANCE.turn_margin_m)
    _confirm("Is the floor free, and may it drive?")
    drive = SetupDrive(
        footprint,
        half_track_m,
        own,
        speed_mps=min(DRIVE.speed_mps, limits_of(config, robot.watchdog_s).speed),
        num_strokes=SHORT_STROKES if short else DRIVE.num_strokes,
        num_turns=DRIVE.num_round if short else DRIVE.num_turns,
    )
    with robot.opened():
        robot.run(drive, drive.step, lambda: f"Measuring: {drive.step_name}")
    findings = evaluate(drive, half_track_m)
    lines = describe(findings, counted_track_of(config))
    say("Measured, with one standard deviation:")
    say_block("\n".join(f"  {line}" for line in lines))
    date = datetime.now(UTC).date().isoformat()
    comment = f"{MEASURED}, {date}:\n" + "".join(f"# {line}\n" for line in lines)
    _write(path, settings_of(findings, config), comment)


def _ask_what_is_near(scans: list[LidarScan], reach_m: float) -> list[Sector]:
    """Ask whether what is nearer to the lidar than the robot reaches is a part of the robot."""
    beams = Beams.round_about(scans[0])
    own: list[Sector] = []
    ranges = usual_ranges(beams, scans)
    for sector in near_sectors(beams, ranges, reach_m):
        first, last = map(math.degrees, sector)
        _confirm(
            f"The lidar sees something near it, at its angles from {first:.0f}° to {last:.0f}°. Is "
            "that a part of the robot, such as a post?"
        )
        own.append(sector)
    return own


def _confirm(question: str) -> None:
    """Ask, and go on only with a yes."""
    if not click.confirm(question):
        raise SetupRefused("Then it does not go on.")
