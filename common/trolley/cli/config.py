"""`trolley config`: settings of a robot that runs."""

from typing import Any

import click

from trolley.cli import SuggestingGroup
from trolley.cli.options import NumbersCommand, json_option, where_options
from trolley.cli.printing import say, say_block
from trolley.cli.robots import one_robot, reports_errors
from trolley.cli.show import print_json, print_table
from trolley.config.changeable_settings import all_keys, parse_value
from trolley.config.describe import to_toml
from trolley.config.kept_settings import KEPT_FILE
from trolley.messages import Setting

COUNTS = {"at_once": "at once", "file": "in robot.toml only"}
"""When a change counts, where it does not say `after a restart`."""
SOURCES = {
    "default": "It is the default.",
    "not_saved": "It was set while the robot ran, and is not saved.",
    "robot_toml": "robot.toml says so.",
    "settings_toml": "It was set while the robot ran, and overrides robot.toml.",
}
FROM = {
    "default": "",
    "not_saved": "not saved",
    "robot_toml": "robot.toml",
    "settings_toml": KEPT_FILE,
}
"""The same in one or two words."""
NOTHING = "-"
"""In place of a value that is not given."""


@click.group(name="config", cls=SuggestingGroup)
def config_command() -> None:
    """Show and change settings while the robot runs.

    What may be set counts at once, or after a restart of a service, as `config get` says; it is
    also written into robot.toml, whose comments stay, or kept beside the robot's state where
    robot.toml cannot be written.
    """


@config_command.command()
@click.argument("name", required=False)
@where_options
@json_option
@reports_errors
def get(name: str | None, as_json: bool) -> None:
    """Show settings: all, of a section such as `planner`, or one such as `planner.clearance_m`."""
    with one_robot() as robot:
        settings = robot.config(*_parts_of(name))
    if as_json:
        print_json(settings)
    elif name is not None and len(settings) == 1:
        say_block(_in_full(settings[0]))
    else:
        rows = [
            (_name_of(one), _values(one), one.unit, FROM[one.source], _counts(one))
            for one in settings
        ]
        print_table(("SETTING", "VALUE", "UNIT", "FROM", "A CHANGE COUNTS"), rows)


@config_command.command(name="set", cls=NumbersCommand)
@click.argument("name")
@click.argument("value")
@click.option("--no-save", is_flag=True, help="Do not save it.")
@where_options
@json_option
@reports_errors
def set_(name: str, value: str, no_save: bool, as_json: bool) -> None:
    """Change a setting: `trolley config set planner.max_speed_mps 0.3`.

    VALUE is written as in robot.toml; quotes around a word may be left out. `default` stands for
    what it is without a line in robot.toml.
    """
    section, _, key = name.rpartition(".")
    if not section:
        raise click.UsageError(f"{name!r} is not SECTION.KEY, such as planner.max_speed_mps")
    with one_robot() as robot:
        done = robot.set_config(section, save=not no_save, **{key: parse_value(value)})
    if as_json:
        print_json(done)
        return
    for one in done.settings:
        say(f"{_name_of(one)} = {_value(one.next)}")
    say(done.message)


def _parts_of(name: str | None) -> tuple[str | None, str | None]:
    """Split `planner.clearance_m`; a name of a section stays whole."""
    if name is None:
        return None, None
    section, _, key = name.rpartition(".")
    is_section = not section or any(one.section == name for one in all_keys())
    return (name, None) if is_section else (section, key)


def _in_full(one: Setting) -> str:
    """Say all there is to say about a setting."""
    unit = f" {one.unit}" if one.unit else ""
    lines = [
        f"{_name_of(one)} = {_value(one.value)}{unit}",
        one.meaning,
        f"Allowed: {one.allowed}. Default: {_value(one.default)}. A change counts {_counts(one)}.",
    ]
    if one.next != one.value:
        lines.append(f"After a restart of the {one.service}: {_value(one.next)}{unit}.")
    lines.append(SOURCES[one.source])
    return "\n".join(lines)


def _name_of(one: Setting) -> str:
    return f"{one.section}.{one.key}"


def _value(value: Any) -> str:
    return NOTHING if value is None else to_toml(value)


def _values(one: Setting) -> str:
    """What it is, and what it will be if a restart changes that."""
    now = _value(one.value)
    return now if one.next == one.value else f"{now}, then {_value(one.next)}"


def _counts(one: Setting) -> str:
    return COUNTS.get(one.acts) or f"after a restart of the {one.service}"
