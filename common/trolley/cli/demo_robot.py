"""The built-in robot of the demo: its settings, its places and its tour."""

import dataclasses
import math
import zipfile
import zlib
from pathlib import Path
from typing import Any

import click
import msgspec
import numpy as np
import tomli_w

from trolley import worlds
from trolley.config import ConfigError, PoseConfig
from trolley.config.load import read_toml
from trolley.drivers import BOARDS, LIDARS, Driver, Drivers, DriverUnusable
from trolley.files import open_file
from trolley.geometry import Pose2D, pose_from_quaternion
from trolley.gridmap import MapError, load_map
from trolley.invalid import in_words_of_a_file
from trolley.messages import Stop, Tour
from trolley.ports import ROUTER_PORT

WORLD = "apartment.toml"
NAME = "trolley"
TOUR_NAME = "article"
TITLE = "Demo robot"
FOOTPRINT = {"length_m": 0.30, "width_m": 0.24}
PORTS = "ports"
"""The folder of emulated ports, beside robot.toml."""


def _about_z(x: float, y: float, z: float, w: float) -> Pose2D:
    return pose_from_quaternion(x, y, (0.0, 0.0, z, w))


START = _about_z(0.549, 0.218, 0.12859, 0.99170)
PLACES = {
    "corridor": _about_z(5.315, 1.366, -0.49845, 0.86692),
    "entrance": _about_z(5.775, -1.246, -0.95949, 0.28175),
    "kitchen": _about_z(2.149, -2.706, -0.99147, 0.13033),
}
"""The goals of the article's robot, in the apartment's frame `map`."""
TOUR = Tour(name=TOUR_NAME, stops=[Stop(name=name) for name in PLACES])

NPZ_FIELDS = (
    ("stamps",),
    ("odom", "odom_signed"),
    ("ranges_mm",),
    ("angle_min",),
    ("angle_increment",),
    ("range_max",),
)
"""What an npz drive must hold; of several names one."""


@dataclasses.dataclass(frozen=True)
class Choices:
    """What the command line says about a demo."""

    name: str = NAME
    port: int = ROUTER_PORT
    viz_port: int | None = None
    """None: no viewer."""
    foxglove_port: int | None = None
    """Where the viewer lets Foxglove connect, if it does."""
    seed: int = 0
    speed: float = 1.0
    world: str | None = None
    recording: Path | None = None
    map_file: Path | None = None
    start: Pose2D | None = None
    outline: list[list[float]] | None = None
    """Another footprint than the built-in robot's [m]."""
    devices: tuple[str, str] | None = None
    """A board and a lidar to emulate, behind the real drivers; None: base's own simulation."""

    @property
    def endpoint(self) -> str:
        """Where its router listens."""
        return f"tcp/127.0.0.1:{self.port}"

    @property
    def has_places(self) -> bool:
        """Whether the article's places lie in its world."""
        return self.recording is None and self.world is None and self.map_file is None


def settings(choices: Choices) -> dict[str, Any]:
    """The demo's robot.toml.

    Raises:
        ConfigError: A file is missing or does not hold what is needed.
    """
    if choices.recording is not None:
        base, map_file, start = _recorded(choices, choices.recording)
    else:
        base, map_file, start = _simulated(choices)
    if choices.map_file is not None:
        try:
            load_map(map_file)  # else the localizer alone would say so, in its log
        except MapError as error:
            raise ConfigError(f"--map: {error}") from error
    if choices.devices is not None:
        base = _real(*choices.devices)
    outline = FOOTPRINT if choices.outline is None else {"polygon_m": choices.outline}
    robot = {"name": choices.name, "title": TITLE, "footprint": outline}
    plain: dict[str, Any] = {
        "robot": robot,
        "map": {"file": str(map_file)},
        "zenoh": {"connect": [choices.endpoint]},
        "base": base,
    }
    if start is not None:
        # A recording begins where it begins, whatever was the last pose of another run.
        always = choices.recording is not None
        plain["start"] = {"pose": _plain(start), "always": always}
    if choices.viz_port is not None:
        plain["viz"] = {"port": choices.viz_port}
        if choices.foxglove_port is not None:
            plain["viz"]["foxglove_port"] = choices.foxglove_port
    return plain


def write_settings(choices: Choices, folder: Path) -> Path:
    """Write the demo's robot.toml into a folder."""
    path = folder / "robot.toml"
    path.unlink(missing_ok=True)
    path.write_text(tomli_w.dumps(settings(choices)), encoding="utf-8")
    path.chmod(0o444)  # each demo writes it anew; what is set while it drives is kept in the state
    return path


def _simulated(choices: Choices) -> tuple[dict[str, Any], Path, Pose2D | None]:
    try:
        world = worlds.find(choices.world or WORLD)
        plain = read_toml(world)
        if choices.map_file is None and not isinstance(plain.get("map"), str):
            raise ConfigError(
                f"--world: {world}: is not a world: it names no map (worlds/README.md says what a "
                "world file holds)"
            )
        map_file = choices.map_file or worlds.find(plain["map"], beside=world.parent)
    except OSError as error:
        raise ConfigError(f"--world: {error}") from error
    simulated: dict[str, Any] = {"world": str(world), "seed": choices.seed, "rate": choices.speed}
    start = choices.start
    if start is not None:
        simulated["start"] = _plain(start)
    elif isinstance(plain.get("start"), dict):
        start = _start_of(world, plain["start"])
    return {"driver": "simulated", "simulated": simulated}, map_file.resolve(), start


def _real(board: str, lidar: str) -> dict[str, Any]:
    """The settings of real drivers, whose ports the emulator puts beside robot.toml."""
    try:
        examples = [
            Drivers(Driver, group).find(name).example
            for group, name in ((BOARDS, board), (LIDARS, lidar))
        ]
    except DriverUnusable as error:
        raise ConfigError(f"--emulate: {error}") from error
    chassis = {"board": board, "port": f"{PORTS}/{board}", **examples[0]}
    seeing = {"model": lidar, "port": f"{PORTS}/{lidar}", **examples[1]}
    return {"driver": "hardware", "chassis": chassis, "lidar": seeing}


def emulator_command(choices: Choices, config: Path) -> list[str]:
    """What plays the devices of `settings`: `python -m` these words.

    Raises:
        ConfigError: There is no such world.
    """
    assert choices.devices is not None
    try:
        world = worlds.find(choices.world or WORLD)
    except FileNotFoundError as error:
        raise ConfigError(f"--world: {error}") from error
    words = ["trolley.cli", "emulate", *choices.devices, "--quiet", "--config", str(config)]
    words += ["--world", str(world), "--seed", str(choices.seed)]
    words += ["--ports", str(config.parent / PORTS)]
    if choices.start is not None:
        start = choices.start
        words += [f"--start={start.x},{start.y},{start.yaw}"]
    return words


def _recorded(choices: Choices, recording: Path) -> tuple[dict[str, Any], Path, Pose2D | None]:
    if choices.map_file is None:
        raise ConfigError("--recording needs --map: the map that was driven on")
    file, map_file = recording.resolve(), choices.map_file.resolve()
    for path in (file, map_file):
        if not path.is_file():
            raise ConfigError(f"{path}: there is no such file")
    start = choices.start
    if file.suffix == ".npz":
        start = start or first_reference(file)
    play = {"file": str(file), "rate": choices.speed}
    return {"driver": "recording", "recording": play}, map_file, start


def first_reference(recording: Path) -> Pose2D | None:
    """The first reference pose of a drive in an npz file, None if it has none."""
    try:
        with open_file(recording) as file, np.load(file, allow_pickle=False) as archive:
            missing = [
                " or ".join(names)
                for names in NPZ_FIELDS
                if not any(name in archive.files for name in names)
            ]
            rows = archive["reference"] if "reference" in archive.files else None
    except (OSError, ValueError, EOFError, AttributeError, zipfile.BadZipFile, zlib.error) as error:
        raise ConfigError(
            f"{recording}: is not a recorded drive: not an npz file of plain arrays "
            "(docs/recording.md says what it holds)"
        ) from error
    if missing:
        raise ConfigError(
            f"{recording}: is not a recorded drive: it lacks {', '.join(missing)} "
            "(docs/recording.md says what it holds)"
        )
    try:
        return None if rows is None or not len(rows) else Pose2D.from_array(rows[0])
    except (ValueError, TypeError) as error:
        raise ConfigError(f"{recording}: its reference is not a list of x, y, yaw") from error


def _plain(pose: Pose2D) -> dict[str, float]:
    return {"x": pose.x, "y": pose.y, "yaw": pose.yaw}


def _start_of(world: Path, start: dict[str, Any]) -> Pose2D:
    """Where the robot stands in a world, as its file says; without a heading along x."""
    turned = start if "orientation" in start else {"yaw": 0.0, **start}
    try:
        return msgspec.convert(turned, PoseConfig).as_pose()
    except msgspec.ValidationError as error:
        why = in_words_of_a_file(str(error), PoseConfig, "start")
        raise ConfigError(f"--world: {world}: {why}") from error


def pose_option(
    _context: click.Context, _parameter: click.Parameter, text: str | None
) -> Pose2D | None:
    """Callback of an option that takes X,Y,YAW."""
    try:
        return None if text is None else parse_pose(text)
    except ValueError as error:
        raise click.BadParameter(str(error)) from error


def parse_pose(text: str) -> Pose2D:
    """Read `X,Y,YAW` of the command line.

    Raises:
        ValueError: It is not three finite numbers.
    """
    try:
        numbers = [float(part) for part in text.split(",")]
    except ValueError:
        numbers = []
    if len(numbers) != 3 or not all(math.isfinite(number) for number in numbers):
        raise ValueError(f"{text!r} is not X,Y,YAW in metres and radians")
    return Pose2D.from_array(numbers)
