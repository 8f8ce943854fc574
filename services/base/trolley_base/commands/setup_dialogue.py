"""The steps of the setup, as a dialogue with the owner: the same at a terminal and at a page."""

import math
import tomllib
from datetime import UTC, datetime
from pathlib import Path
from typing import Literal

import msgspec

from trolley.cli.init import render
from trolley.config import ConfigError, load_config, robot_toml
from trolley.config.describe import Key, to_toml
from trolley.files import write_atomically
from trolley.messages import SetupChoice, SetupQuestion
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
from trolley_base.setup.findings import Settings, describe, evaluate, picture_of, settings_of
from trolley_base.setup.person import Person, ask_number, is_confirmed, value_of
from trolley_base.setup.record import SetupRefused
from trolley_base.setup.sight import Beams, Sector, near_sectors, picture, usual_ranges
from trolley_base.setup.wheels import Seen, WheelTrial, judge_counts, judge_wiring

STEPS = ("Devices", "Wheels in the air", "On the floor")
USUAL_NAME = "trolley"
SEEN: dict[str, tuple[Seen, str]] = {
    "f": ("both forward", "both forward"),
    "b": ("both back", "both back"),
    "l": ("left forward", "the left one forward, the right one back"),
    "r": ("right forward", "the right one forward, the left one back"),
    "n": ("not both", "not both of them turned"),
}
"""How wheels may have turned, by what a person answers."""
SHORT_S, LONG_S = 45.0, 360.0
"""How long a short drive takes, and a long one [s]."""
MEASURED = "# Measured by `trolley setup`"
"""How the comments begin that say what was measured."""
EVERYWHERE = "0.0.0.0"


class Progressed(msgspec.Struct, forbid_unknown_fields=True):
    """How far the setup of a file has come; stands beside it until it is undone."""

    before: str | None
    """What the file said before; None: there was none."""
    has_devices: bool = False
    has_wheels: bool = False
    has_floor: bool = False


class SetupDialogue:
    """The three steps; each writes what it found, and is not repeated once it is done.

    Args:
        path: the robot.toml.
        ports: where to look for devices; none: at all that no program has open.
        person: who answers.
        driving_s: how long the robot drives on the floor [s].
    """

    def __init__(
        self, path: Path, ports: tuple[str, ...], person: Person, driving_s: float
    ) -> None:
        self._path = path
        self._ports = ports
        self._person = person
        self._driving_s = driving_s
        self._notes = path.with_name(f"{path.name}.setup.json")

    def run(self, *, again: bool) -> None:
        """Go through the steps that are not done yet, or through all of them `again`.

        Raises:
            SetupRefused: It cannot go on, with the reason.
            StoppedByHand: The person stopped the robot.
        """
        state = self._load()
        if state is None or again or state.has_floor:
            path = self._path
            state = Progressed(path.read_text(encoding="utf-8") if path.exists() else None)
        if not state.has_devices:
            self._begin(1)
            self._save(state)  # before anything is written
            self._find_devices()
            state.has_devices = True
            self._save(state)
        if not state.has_wheels:
            self._begin(2)
            self._try_wheels()
            state.has_wheels = True
            self._save(state)
        self._begin(3)
        self._drive()
        state.has_floor = True
        self._save(state)

    def undo(self) -> str:
        """Give the file back as it was before; returns what was done, in words.

        Raises:
            ConfigError: There is nothing to undo, or it cannot be written.
        """
        path, state = self._path, self._load()
        if state is None:
            raise ConfigError(f"there is nothing to undo: {self._notes} is not there")
        kept = path.with_name(f"{path.name}.undone")
        if path.exists():
            write_atomically(kept, path.read_bytes())
        if state.before is None:
            path.unlink(missing_ok=True)
            words = f"{path} is gone, as it was before; what it said is in {kept}."
        else:
            robot_toml.replace_text(path, state.before)
            words = f"{path} is as it was before; what it said is in {kept}."
        self._notes.unlink()
        return words

    # Keeping track.
    def _load(self) -> Progressed | None:
        try:
            return msgspec.json.decode(self._notes.read_bytes(), type=Progressed)
        except FileNotFoundError:
            return None
        except (OSError, msgspec.DecodeError) as error:
            raise ConfigError(
                f"{self._notes}: cannot be used: {error}. Delete it; the setup then begins anew."
            ) from error

    def _save(self, state: Progressed) -> None:
        try:
            write_atomically(self._notes, msgspec.json.encode(state))
        except OSError as error:
            raise ConfigError(f"{self._notes}: cannot be written: {error.strerror}") from error

    def _begin(self, step: int) -> None:
        self._person.begin(step, STEPS[step - 1])

    def _confirm(self, question: str) -> None:
        """Ask, and go on only with a yes."""
        if not is_confirmed(self._person, question):
            raise SetupRefused("Then it does not go on.")

    def _write(self, values: Settings, appendix: str = "") -> None:
        old = robot_toml.read_text(self._path)
        text = without_measured(old) if appendix else old
        new = robot_toml.with_values(text, values, tables=[appendix] if appendix else [])
        robot_toml.replace_text(self._path, new)
        if new != old:
            self._person.show_changes(self._path, robot_toml.difference(self._path, old, new))

    # Step 1.
    def _find_devices(self) -> None:
        path, person = self._path, self._person
        if not path.exists():
            self._make_file()
        config = load_config(path)
        chassis, lidar = config.base.chassis, config.base.lidar
        is_named = config.base.driver == "hardware" and chassis.port and lidar.port
        if is_named and not self._ports:
            person.tell(
                f"{path} names them: {chassis.board} at {chassis.port}, {lidar.model} at "
                f"{lidar.port}."
            )
            return
        person.tell("Looking for the motor board and the lidar; that takes some seconds.")
        seen = look_at_ports(self._ports)
        text = robot_toml.read_text(path)
        proposal = detected.propose(seen, tomllib.loads(text))
        values = proposal.values | proposal.waiting
        board = values.get((*detected.CHASSIS, "board"), chassis.board)
        model = values.get((*detected.LIDAR, "model"), lidar.model)
        if not (board and model):
            missing = "lidar" if board else "motor board"
            said = [f"No {missing} was found; `trolley detect` says more.", *proposal.notes]
            raise SetupRefused(" ".join(said))
        ports = [
            values.get((*detected.CHASSIS, "port"), chassis.port),
            values.get((*detected.LIDAR, "port"), lidar.port),
        ]
        person.tell(f"Found {board} at {ports[0]}, {model} at {ports[1]}.")
        for note in proposal.sensor_notes:
            person.tell(note)
        self._confirm("Are these the devices of this robot?")
        values |= self._ask_owner(proposal)
        new = robot_toml.with_values(text, values, tables=proposal.sensor_tables)
        if new != text:
            robot_toml.replace_text(path, new)

    def _ask_owner(self, proposal: detected.Proposal) -> detected.Settings:
        """Ask for what the devices need to know of the robot."""
        answers: detected.Settings = {}
        for table, keys in proposal.missing.items():
            for key in keys:
                question = question_about(key)
                answers[*table, key.name] = value_of(question, self._person.ask(question))
        return answers

    def _make_file(self) -> None:
        person = self._person
        person.tell(f"{self._path} is not there yet. It needs a name and the size of the robot.")
        name = person.ask(SetupQuestion(text="Name of the robot", kind="name", default=USUAL_NAME))
        chosen = {
            "robot.name": to_toml(name),
            "robot.footprint": to_toml(
                {
                    "length_m": ask_number(person, "Length of the robot in metres", 0.05, 3.0),
                    "width_m": ask_number(person, "Width of the robot in metres", 0.05, 3.0),
                }
            ),
        }
        if is_confirmed(
            person,
            "May phones and computers of this network open the robot's page? They need a link that "
            "only you can give.",
        ):
            chosen["viz.host"] = to_toml(EVERYWHERE)
        robot_toml.replace_text(self._path, render(chosen))

    # Step 2.
    def _try_wheels(self) -> None:
        config, person = load_config(self._path), self._person
        half_track_m = half_track_of(config, footprint_of(config))
        person.tell(
            "Put the robot on a block, so that its wheels turn freely. They turn slowly, twice."
        )
        self._confirm("Do the wheels hang free?")
        robot = OpenRobot(config)
        ahead = self._try(robot, "ahead", half_track_m)
        left = self._try(robot, "left", half_track_m)
        wiring = judge_wiring(ahead, left)
        if wiring.is_right:
            person.tell("Both wheels turn and count as they should.")
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
                f"The {' and the '.join(sides)} wheel turns the wrong way round: exchange both "
                "wires of its motor, and A and B of its encoder; or set it right in the board's "
                "firmware."
            )
        now = {"left": wheels.reverse_left, "right": wheels.reverse_right}
        table = ("base", "chassis", "wheels")
        self._write({(*table, f"reverse_{side}"): not now[side] for side in sides})
        self._try_wheels()

    def _try(self, robot: OpenRobot, way: Literal["ahead", "left"], half_track_m: float) -> Seen:
        what = "go ahead" if way == "ahead" else "turn to the left"
        trial = WheelTrial(way, half_track_m)
        with self._person.hold() as hand, robot.opened():
            robot.run(
                trial,
                lambda now_ns, motions, scans, _imu: trial.step(now_ns, motions, scans),
                lambda: f"The wheels {what}",
                hand,
            )
        assert trial.counted is not None  # it has ended well
        judge_counts(trial.counted)
        question = SetupQuestion(
            text=f"The wheels were told to {what}. How did they turn, seen along the robot's "
            "forward direction?",
            kind="choice",
            choices=[SetupChoice(answer=key, label=label) for key, (_, label) in SEEN.items()],
        )
        return SEEN[self._person.ask(question)][0]

    # Step 3.
    def _drive(self) -> None:
        config, person = load_config(self._path), self._person
        footprint = footprint_of(config)
        half_track_m = half_track_of(config, footprint)
        radius_m = Body(footprint).radius_m
        room_m = 2.0 * (radius_m + DRIVE.half_stroke_m + CLEARANCE.margin_m)
        person.tell(
            f"Put the robot on the floor in the middle of {room_m:.1f} m of free room all round, "
            "with walls or furniture in sight. It turns on the spot, then drives to and fro and in "
            "circles. Keep out of its sight, and your hand on Stop."
        )
        robot = OpenRobot(config)
        with robot.opened():
            scans = robot.look(DRIVE.scans)
        beams = Beams.round_about(scans[0])
        seen = beams.points(usual_ranges(beams, scans), beams.outside([]))
        mount, room_m = config.base.lidar.pose.as_pose(), 0.5 * room_m
        person.show_sight(picture(seen, mount, footprint, room_m, is_measured=False))
        own = self._ask_what_is_near(scans, 2.0 * radius_m + CLEARANCE.turn_margin_m)
        self._confirm("Is the floor free, and may it drive?")
        limits = limits_of(config, robot.watchdog_s)
        drive = SetupDrive(
            footprint,
            half_track_m,
            own,
            speed_mps=limits.speed,
            turn_radps=limits.wz,
            driving_s=self._driving_s,
        )
        with person.hold() as hand, robot.opened():
            robot.run(drive, drive.step, lambda: f"Measuring: {drive.step_name}", hand)
        findings = evaluate(drive, half_track_m)
        person.show_sight(picture_of(drive, findings.geometry, footprint, room_m))
        lines = describe(findings, counted_track_of(config))
        person.tell("Measured, with one standard deviation:")
        for line in lines:
            person.tell(line)
        if not is_confirmed(person, "Write this to robot.toml?"):
            raise SetupRefused("Nothing of it was written.")
        date = datetime.now(UTC).date().isoformat()
        comment = f"{MEASURED}, {date}:\n" + "".join(f"# {line}\n" for line in lines)
        self._write(settings_of(findings, config), comment)

    def _ask_what_is_near(self, scans: list[LidarScan], reach_m: float) -> list[Sector]:
        """Ask whether what is nearer to the lidar than the robot reaches is a part of the robot."""
        beams = Beams.round_about(scans[0])
        own: list[Sector] = []
        ranges = usual_ranges(beams, scans)
        for sector in near_sectors(beams, ranges, reach_m):
            first, last = map(math.degrees, sector)
            self._confirm(
                f"The lidar sees something near it, at its angles from {first:.0f}° to "
                f"{last:.0f}°. Is that a part of the robot, such as a post?"
            )
            own.append(sector)
        return own


def without_measured(text: str) -> str:
    """Return a file without the comments in which an earlier setup says what it measured."""
    lines: list[str] = []
    is_inside = False
    for line in text.splitlines(keepends=True):
        is_inside = line.startswith("#") and (is_inside or line.startswith(MEASURED))
        if not is_inside:
            lines.append(line)
    return "".join(lines)


def question_about(key: Key) -> SetupQuestion:
    """Ask for a setting that only the owner knows; the file's own check comes after that."""
    text = f"{key.name}: {key.meaning}"
    if key.choices:
        choices = [SetupChoice(answer=one, label=one) for one in key.choices]
        return SetupQuestion(text=text, kind="choice", choices=choices)
    if "number" not in key.allowed:
        return SetupQuestion(text=text, kind="text")
    return SetupQuestion(
        text=text,
        kind="whole" if key.allowed.startswith("whole number") else "number",
        least=key.least,
        greatest=key.greatest,
        is_above="above" in key.allowed,
    )
