"""`trolley ros2`, the bridge, in the foreground until it is ended; bags in and out."""

from dataclasses import asdict
from pathlib import Path
from typing import Any

import click
import msgspec
from msgspec import structs

from trolley.cli.options import FloatRange, given, json_option, where_options
from trolley.cli.printing import say
from trolley.cli.robots import connected, reports_errors
from trolley.cli.show import print_json
from trolley.config import ConfigError, Ros2Config, find_config, load_host_config
from trolley.config.ros2 import why_no_namespace
from trolley.connection import find_target, pick_robot
from trolley.geometry import Pose2D
from trolley.topics import names_robot


@click.command(name="ros2")
@click.option(
    "--domain",
    type=click.IntRange(0, 232),
    envvar="ROS_DOMAIN_ID",
    help="The nodes' domain; else ROS_DOMAIN_ID.",
)
@click.option(
    "--distro", type=click.Choice(["jazzy", "humble"]), help="humble, or jazzy for all newer ones."
)
@click.option("--namespace", help="Where the topics are, such as /kiwi; / for none.")
@click.option("--router", metavar="ENDPOINT", help="The nodes' router, if it is not Trolley's.")
@click.option(
    "--role",
    type=click.Choice(["viewer", "operator"]),
    help="Let them only look (viewer), whatever robot.toml says.",
)
@where_options
@reports_errors
def ros2(**options: Any) -> None:
    """Let ROS 2 nodes that use rmw_zenoh see the robot and drive it.

    It runs until Ctrl-C. What is not given stands in the section [ros2] of robot.toml; see
    docs/ros2.md.
    """
    settings = with_options(_settings(find_config(given("config"))), options)
    target = find_target(given("robot"), given("connect"), given("config"))
    with connected() as connection:
        name = pick_robot(connection, target)
        if name not in connection.robots():  # it may come later
            say(f"Waiting: {connection.unknown_robot(name)}", err=True, fg="yellow")
    # With rosbags: whoever asks for help need not load it.
    from trolley_ros2.session import bridge

    bridge(name, target, settings)


def with_options(settings: Ros2Config, options: dict[str, Any]) -> Ros2Config:
    """The settings with what the command line says; its role may only take away.

    Raises:
        click.UsageError: It would give more than the settings do, or says what cannot be.
    """
    changes = {name: value for name, value in options.items() if value is not None}
    if changes.get("role") == "operator" and settings.role == "viewer":
        raise click.UsageError('robot.toml says role = "viewer" in [ros2]: change it there.')
    plain = {**structs.asdict(settings), **changes}
    try:
        return msgspec.convert(plain, Ros2Config)
    except msgspec.ValidationError as error:
        raise click.UsageError(str(error).replace(" - at `$.", " (--").replace("`", ")")) from error


def _settings(path: Path | None) -> Ros2Config:
    return Ros2Config() if path is None else load_host_config(path).ros2


@click.command(name="bag")
@click.argument("bag", type=click.Path(exists=True, path_type=Path))
@click.argument("file", required=False, type=click.Path(dir_okay=False, path_type=Path))
@click.option("--scan", metavar="TOPIC", help="The laser scans, if there are several.")
@click.option("--odom", metavar="TOPIC", help="The odometry; /tf for the transforms.")
@click.option(
    "--laser",
    type=(FloatRange(),) * 3,
    metavar="X Y YAW",
    help="Where the lidar sits on the robot [m, m, rad], if the bag does not say.",
)
@click.option(
    "--radius",
    "radius_m",
    type=FloatRange(min=0.02, max=5.0),
    default=0.2,
    show_default=True,
    help="Half the robot's width [m]: no bag says it.",
)
@click.option("--name", default="bag", show_default=True, help="What the robot is called.")
@json_option
@reports_errors
def import_bag(
    bag: Path,
    file: Path | None,
    scan: str | None,
    odom: str | None,
    laser: tuple[float, float, float] | None,
    radius_m: float,
    name: str,
    as_json: bool,
) -> None:
    """Make a recording of a ROS 1 bag or a rosbag2 (mcap, db3; a file or its folder).

    It takes one topic of laser scans, one of odometry (else the transforms odom -> base_link), and
    where the lidar sits, and lists what it did not take and why. Without FILE it is
    BAG.trolley.mcap in the current folder; an existing file is never overwritten. `trolley replay`
    and `trolley demo --recording` play it.
    """
    if not names_robot(name):
        raise click.BadParameter(
            f"{name!r} cannot be a robot's name: use a-z, 0-9, _ and -", param_hint="--name"
        )
    from trolley_ros2.bag import BadBag, Bag
    from trolley_ros2.import_bag import Wishes, convert

    path = file or Path(f"{bag.resolve().stem}.trolley.mcap")
    try:
        mount = None if laser is None else Pose2D.from_array(laser)
        found = convert(Bag(bag), name, path, Wishes(scan, odom, mount, radius_m))
    except BadBag as error:
        raise ConfigError(f"{bag}: {str(error).removeprefix(f'{bag}: ')}") from error
    except FileExistsError as error:
        raise ConfigError(f"{path} already exists; name another file") from error
    except OSError as error:
        raise ConfigError(f"{path} cannot be written: {error.strerror or error}") from error
    except ValueError as error:
        raise click.BadParameter(str(error), param_hint="--laser") from error
    if as_json:
        print_json({"file": str(path), **asdict(found)})
        return
    say(f"{path}: {found.seconds:.1f} s.")
    for topic, what in found.taken.items():
        say(f"taken      {topic}  {what}")
    for topic, why in found.left.items():
        say(f"not taken  {topic}  {why}")
    for note in found.notes:
        say(note)


def _namespace(_context: click.Context, _option: click.Parameter, text: str) -> str:
    if why_not := why_no_namespace(text):
        raise click.BadParameter(why_not)
    return text


@click.command(name="bag")
@click.argument("recording", type=click.Path(exists=True, dir_okay=False, path_type=Path))
@click.argument("folder", required=False, type=click.Path(path_type=Path))
@click.option(
    "--namespace",
    default="/",
    show_default=True,
    callback=_namespace,
    help="Where the topics are, such as /kiwi.",
)
@json_option
@reports_errors
def export_bag(recording: Path, folder: Path | None, namespace: str, as_json: bool) -> None:
    """Make a rosbag2 of a recording, for `ros2 bag play`, rviz2 and other tools of ROS 2.

    The bag is a folder with an mcap file and metadata.yaml; without FOLDER it is called after the
    recording, in the current folder. It holds what `trolley ros2` publishes: scan, odom, tf,
    tf_static, map, amcl_pose, plan and local_costmap/costmap, with the robot's own stamps. What is
    there already is never overwritten.
    """
    if folder is not None and folder.suffix in {".mcap", ".db3", ".bag"}:
        raise click.BadParameter(
            f"a rosbag2 is a folder: {folder.with_suffix('')} will hold {folder.stem}.mcap",
            param_hint="FOLDER",
        )
    from trolley.recording.reader import BadRecording, RecordingFile
    from trolley_ros2.export_bag import export

    out = folder or Path(f"{recording.name.partition('.')[0]}-bag")
    if out.exists() or out.is_symlink():
        raise ConfigError(f"{out} already exists; name another folder")
    try:
        found = export(RecordingFile(recording), out, namespace)
    except BadRecording as error:
        raise ConfigError(str(error)) from error
    except OSError as error:
        raise ConfigError(f"{out} cannot be written: {error.strerror or error}") from error
    if as_json:
        print_json({"folder": str(out), **asdict(found)})
        return
    say(f"{out}: {found.seconds:.1f} s.")
    for topic, number in found.written.items():
        say(f"written      {topic}  {number}")
    if found.left:
        say(f"not written  {', '.join(found.left)}: `trolley ros2` does not publish them")
    for note in found.notes:
        say(note)
