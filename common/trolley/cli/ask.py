"""`trolley ask`: any request of the wire."""

from typing import Any

import click
import msgspec

from trolley import requests
from trolley.cli.json_argument import read_json
from trolley.cli.options import json_option, where_options
from trolley.cli.printing import say, say_block
from trolley.cli.robots import one_robot, reports_errors
from trolley.cli.show import describe, print_json
from trolley.suggestions import did_you_mean

BY_NAME = {request.name: request for request in requests.REQUESTS}


def _complete(_context: click.Context, _parameter: click.Parameter, typed: str) -> list[str]:
    return [name for name in BY_NAME if name.startswith(typed)]


@click.command(name="ask")
@click.argument("request", metavar="REQUEST", shell_complete=_complete)
@click.argument("parameters", metavar="[JSON]", default="{}")
@where_options
@json_option
@reports_errors
def ask_command(request: str, parameters: str, as_json: bool) -> None:
    """Ask REQUEST of the wire, such as goal/send '{"name": "kitchen"}'; print the answer.

    JSON holds its parameters; docs/wire.md lists all requests. What it starts is not waited for.
    """
    row = BY_NAME.get(request.strip("/"))
    if row is None:
        raise click.BadParameter(
            f"there is no request {request!r}. {did_you_mean(request, BY_NAME)}"
        )
    params = read_json(parameters, row.params, row.name)
    with one_robot() as robot:
        answer: Any = robot.ask(row, params)
    if as_json:
        print_json(answer)
    elif isinstance(answer, msgspec.Struct):
        say_block(describe(answer))
    elif not answer:
        say("The answer is an empty list.")
    else:
        for item in answer:
            say_block(item if isinstance(item, str) else f"{describe(item)}\n---")
