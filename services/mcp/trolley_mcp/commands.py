"""`trolley mcp`: a session with a chat assistant, which starts this program itself."""

from pathlib import Path
from typing import Literal

import click

from trolley.cli.options import given, where_options
from trolley.cli.robots import one_robot, reports_errors
from trolley.config import find_config, load_host_config
from trolley.config.mcp import McpConfig
from trolley.connection import RobotUnreachable, find_target
from trolley.runtime.zenoh_bus import NotConnected


@click.command(name="mcp")
@click.option(
    "--role",
    type=click.Choice(["viewer", "operator"]),
    help="Let it only look and stop (viewer), whatever robot.toml says.",
)
@where_options
@reports_errors
def mcp(role: Literal["viewer", "operator"] | None) -> None:
    """Let a chat assistant talk to the robot, by the Model Context Protocol on stdin and stdout.

    Assistants start it themselves: docs/assistants.md has the line for each. What it may do stands
    in the section [mcp] of robot.toml.
    """
    settings = narrowed(_settings(find_config(given("config"))), role)
    with one_robot() as robot:
        name = robot.name
    target = find_target(given("robot"), given("connect"), given("config"))
    # With pydantic and all of the SDK: whoever asks for help need not load it.
    from trolley_mcp.session import talk

    try:
        talk(name, target, settings)
    except NotConnected as error:
        raise RobotUnreachable(str(error)) from error


def narrowed(settings: McpConfig, role: Literal["viewer", "operator"] | None) -> McpConfig:
    """The settings with a role of the command line, which may only take away.

    Raises:
        click.UsageError: It would give more than the settings do.
    """
    if role == "operator" and settings.role == "viewer":
        raise click.UsageError('robot.toml says role = "viewer" in [mcp]: change it there.')
    return (
        settings
        if role is None
        else McpConfig(
            role=role, max_speed_mps=settings.max_speed_mps, may_resume=settings.may_resume
        )
    )


def _settings(path: Path | None) -> McpConfig:
    return McpConfig() if path is None else load_host_config(path).mcp
