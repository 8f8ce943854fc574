"""Options and arguments that commands share."""

import math
import re
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeVar, cast

import click

if TYPE_CHECKING:  # with numpy, which the list of commands must not load
    from trolley.geometry import Pose2D

F = TypeVar("F", bound=Callable[..., Any])


def where_options(command: F) -> F:
    """Add `--robot`, `--connect` and `--config`, which may stand before the command's name too."""
    shared: dict[str, Any] = {"expose_value": False, "callback": _keep}
    robot = click.option("--robot", metavar="NAME", help="The robot's name.", **shared)
    connect = click.option(
        "--connect",
        metavar="ENDPOINT",
        multiple=True,
        help="Its router, such as tls/kiwi.local:7448 (may be repeated).",
        **shared,
    )
    return robot(connect(_config_option(command, _keep)))


def config_option(command: F) -> F:
    """Add `--config` alone, for what starts a robot: who it is and where stands in the file."""

    def keep(context: click.Context, parameter: click.Parameter, value: Any) -> None:
        for name, key in (("robot", "`[robot] name`"), ("connect", "`[zenoh] connect`")):
            if name in context.ensure_object(dict):
                raise click.UsageError(
                    f"--{name} is for commands that talk to a robot which runs; "
                    f"here {key} of robot.toml counts"
                )
        _keep(context, parameter, value)

    return _config_option(command, keep)


def _config_option(command: F, callback: Callable[..., None]) -> F:
    return click.option(
        "--config",
        type=click.Path(dir_okay=False, path_type=Path),
        expose_value=False,
        callback=callback,
        help="A robot.toml; else TROLLEY_CONFIG, else /etc/trolley/robot.toml.",
    )(command)


def _keep(context: click.Context, parameter: click.Parameter, value: Any) -> None:
    if value:
        name = parameter.name or ""
        _check(name, value)
        cast("dict[str, Any]", context.ensure_object(dict))[name] = value


def _check(name: str, value: Any) -> None:
    """Refuse what can be neither a robot's name nor an endpoint: nobody would ever answer."""
    # Not at the top: completing a command in the shell needs none of it.
    from trolley.config.robot import why_no_endpoint
    from trolley.topics import names_robot

    if name == "robot" and not names_robot(value):
        raise click.BadParameter("a robot's name is 1 to 32 characters of a-z, 0-9, _ and -")
    for endpoint in value if name == "connect" else ():
        if why_not := why_no_endpoint(endpoint):
            raise click.BadParameter(why_not)


def robot_name_option(_context: click.Context, _parameter: click.Parameter, name: str) -> str:
    """Refuse what is no robot's name."""
    return robot_name(name)


def robot_name(name: str) -> str:
    """Return a robot's name.

    Raises:
        click.BadParameter: It is none.
    """
    from trolley.topics import names_robot

    if not names_robot(name):
        raise click.BadParameter(
            f"{name!r} is not a valid robot name: use 1 to 32 characters of a-z, 0-9, _ and -"
        )
    return name


json_option = click.option("--json", "as_json", is_flag=True, help="Print JSON for programs.")


def given(name: str) -> Any:
    """What was given for `robot`, `connect` or `config`, None if nothing."""
    context = click.get_current_context()
    return cast("dict[str, Any]", context.ensure_object(dict)).get(name)


class FloatRange(click.FloatRange):
    """A finite number, if need be in a range."""

    def convert(
        self, value: Any, param: click.Parameter | None, ctx: click.Context | None
    ) -> float:
        """Refuse `nan`, which click finds in every range, and `inf`."""
        number = super().convert(value, param, ctx)
        if not math.isfinite(number):
            self.fail(f"{value!r} is not a finite number.", param, ctx)
        return number


class NumbersCommand(click.Command):
    """A command whose arguments may be negative numbers: `-1.5` is not an option."""

    def parse_args(self, ctx: click.Context, args: list[str]) -> list[str]:
        """Keep click from taking a negative number for an option."""
        ctx.ignore_unknown_options = True
        rest = super().parse_args(ctx, args)
        for parameter in self.params:
            value = ctx.params.get(parameter.name or "")
            if not isinstance(parameter, click.Argument) or value is None:
                continue
            for word in value if isinstance(value, tuple) else (value,):
                if word.startswith("-") and not _NUMBER.match(word):
                    raise click.NoSuchOption(word, ctx=ctx)
        return rest


_NUMBER = re.compile(r"-[0-9.]")


def pose_options(command: F) -> F:
    """Take a pose on the map, for `as_pose`; the command is a `NumbersCommand`."""
    command = click.option("--deg", is_flag=True, help="YAW is in degrees.")(command)
    return click.argument("where", nargs=-1, metavar="X Y YAW")(command)


def as_pose(where: tuple[str, ...], *, deg: bool) -> "Pose2D":
    """Read X, Y and YAW; complain about anything else."""
    from trolley.geometry import Pose2D

    if len(where) != 3:
        raise click.UsageError("give X, Y and YAW")
    x, y, yaw = (as_number(text, name) for text, name in zip(where, ("X", "Y", "YAW"), strict=True))
    return Pose2D.from_array((x, y, math.radians(yaw) if deg else yaw))


def as_number(text: str, name: str) -> float:
    """A finite number of the command line.

    Raises:
        click.BadParameter: It is none.
    """
    try:
        number = float(text)
    except ValueError:
        number = float("nan")
    if not abs(number) < 1e9:
        raise click.BadParameter(f"{name} must be a number, not {text!r}")
    return number
