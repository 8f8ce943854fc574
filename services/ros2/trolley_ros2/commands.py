"""`trolley ros2`: the bridge, in the foreground until it is ended."""

from pathlib import Path
from typing import Any

import click
import msgspec
from msgspec import structs

from trolley.cli.options import given, where_options
from trolley.cli.printing import say
from trolley.cli.robots import connected, reports_errors
from trolley.config import Ros2Config, find_config, load_host_config
from trolley.connection import find_target, pick_robot


@click.command(name="ros2")
@click.option(
    "--domain", type=int, envvar="ROS_DOMAIN_ID", help="The nodes' domain; else ROS_DOMAIN_ID."
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
