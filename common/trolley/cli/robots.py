"""What commands that talk to a robot share: the connection, and errors as exit codes."""

import functools
from collections.abc import Callable, Generator
from contextlib import contextmanager
from typing import ParamSpec, TypeVar

import msgspec

from trolley import codes
from trolley.cli import exits
from trolley.cli.options import given
from trolley.cli.printing import say, say_block
from trolley.cli.show import as_json
from trolley.client import Robot
from trolley.codes import Refused
from trolley.config import ConfigError
from trolley.connection import (
    Connection,
    RobotUnreachable,
    SeveralRobots,
    find_target,
    pick_robot,
)
from trolley.topics import Topic

M = TypeVar("M", bound=msgspec.Struct)
P = ParamSpec("P")
R = TypeVar("R")


@contextmanager
def connected() -> Generator[Connection]:
    """A connection to the routers that the options name."""
    target = find_target(given("robot"), given("connect"), given("config"))
    with Connection(target.endpoints, keys=target.keys) as connection:
        yield connection


@contextmanager
def one_robot() -> Generator[Robot]:
    """The robot that the options name."""
    target = find_target(given("robot"), given("connect"), given("config"))
    with Connection(target.endpoints, keys=target.keys) as connection:
        yield Robot.over(connection, pick_robot(connection, target))


def known(robot: Robot, topic: Topic[M], missing: str) -> M:
    """The latest value of a topic of which its owner always keeps one.

    Args:
        robot: whose.
        topic: which.
        missing: a sentence about an owner that runs and has none.

    Raises:
        RobotUnreachable: There is no such robot.
        Refused: `not_ready`: its owner is not running, or has none.
    """
    message = robot.latest(topic)
    if message is not None:
        return message
    there, owner = robot.connection.services(robot.name), topic.first_owner
    if not there:
        raise robot.connection.unknown_robot(robot.name)
    if (robot.name, owner) in there:
        raise Refused(codes.NOT_READY, missing)
    raise Refused(codes.NOT_READY, f"The service {owner} is not running.", service=owner)


def exit_code_of(error: Exception) -> int:
    """The exit code that an error of the client stands for."""
    if isinstance(error, Refused):
        # Nobody there to answer is another thing than a robot that says no.
        return (
            exits.UNREACHABLE
            if error.code in codes.UNANSWERED and "service" in error.details
            else exits.FAILED
        )
    return exits.UNREACHABLE if isinstance(error, RobotUnreachable) else exits.USAGE


def reports_errors(command: Callable[P, R]) -> Callable[P, R]:
    """Turn what the client raises into one line on stderr (JSON with `--json`) and an exit code."""

    @functools.wraps(command)
    def run(*args: P.args, **kwargs: P.kwargs) -> R:
        try:
            return command(*args, **kwargs)
        except (Refused, RobotUnreachable, SeveralRobots, ConfigError) as error:
            _report(error, wants_json=bool(kwargs.get("as_json")))
            raise SystemExit(exit_code_of(error)) from error

    return run


def _report(error: Exception, *, wants_json: bool) -> None:
    match error:
        case Refused():
            code, text = error.code, f"{error.message} ({error.code})"
            details = error.details
        case SeveralRobots():
            code, text, details = "several_robots", _list_robots(error), {"robots": error.names}
        case RobotUnreachable():
            code, text, details = "unreachable", str(error), {}
        case _:
            code, text, details = "bad_config", str(error), {}
    if wants_json:
        message = error.message if isinstance(error, Refused) else str(error)
        say_block(as_json({"code": code, "message": message, "details": details}), err=True)
    else:
        printing = say if isinstance(error, Refused | RobotUnreachable) else say_block
        printing(text, err=True, fg="red")


def _list_robots(error: SeveralRobots) -> str:
    names = "\n".join(f"  {name}" for name in error.names)
    return f"Several robots are on the network; name one with --robot:\n{names}"
