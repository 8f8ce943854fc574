"""`trolley init`: a commented robot.toml."""

import textwrap
from collections.abc import Mapping
from pathlib import Path

import click

from trolley.cli.options import FloatRange, json_option, robot_name_option
from trolley.cli.printing import say
from trolley.cli.robots import reports_errors
from trolley.cli.show import print_json
from trolley.config.describe import (
    COMMENT_WIDTH,
    Key,
    Section,
    driver_sections,
    sections,
    sensor_tables,
    to_toml,
)
from trolley.config.robot_toml import check_text
from trolley.drivers import Driver, Drivers
from trolley.files import why_not_written


@click.command(name="init")
@click.argument("path", default="robot.toml", type=click.Path(path_type=Path))
@click.option(
    "--name",
    default="trolley",
    show_default=True,
    callback=robot_name_option,
    help="The robot's name.",
)
@click.option(
    "--length",
    type=FloatRange(min=0.0, min_open=True),
    default=0.30,
    show_default=True,
    help="Its length in metres.",
)
@click.option(
    "--width",
    type=FloatRange(min=0.0, min_open=True),
    default=0.24,
    show_default=True,
    help="Its width in metres.",
)
@click.option("--map", "map_file", help="The map to start with, a map_server YAML file.")
@json_option
@reports_errors
def init_command(
    path: Path, name: str, length: float, width: float, map_file: str | None, as_json: bool
) -> None:
    """Write a robot.toml with every setting explained to PATH (robot.toml if not given).

    An existing file is never overwritten.
    """
    chosen = {
        "robot.name": to_toml(name),
        "robot.footprint": to_toml({"length_m": length, "width_m": width}),
    }
    if map_file is not None:
        _check_map(path.parent / map_file)
        chosen["map.file"] = to_toml(map_file)
    try:
        text = render(chosen)
        check_text(path, text)
        with path.open("x", encoding="utf-8") as file:
            file.write(text)
    except FileExistsError as error:
        raise click.UsageError(f"{path} already exists; not overwritten") from error
    except OSError as error:
        raise click.UsageError(
            f"{path} cannot be written: {why_not_written(path, error)}"
        ) from error
    if as_json:
        print_json({"file": str(path)})
        return
    say(f"Wrote {path}. Next: `trolley up --config {path}`.")


def _check_map(file: Path) -> None:
    if not file.is_file():
        raise click.UsageError(
            f"--map: {file} is not there; leave it out, and make a map with `trolley map new`"
        )
    from trolley.gridmap import MapError, load_map
    from trolley.messages.mapping import MAP_NAME, MAP_NAME_RULE

    if MAP_NAME.fullmatch(file.stem) is None:
        raise click.UsageError(f"--map: {file.stem!r} cannot name a map: {MAP_NAME_RULE}")
    try:
        load_map(file)
    except MapError as error:
        raise click.UsageError(f"--map: {error}") from error


def render(chosen: Mapping[str, str]) -> str:
    """The text of a robot.toml: settings in `chosen` (by `section.key`) are set, all explained.

    Tables that must be given in full once they are there (`base.recording`) are commented out.
    """
    head = "# One robot. Settings that are commented out have the value shown, or none.\n"
    own = [_render_section(section, chosen) for section in sections()]
    of_drivers = [_render_driver(*one) for one in driver_sections()]
    return head + "".join([*own, *of_drivers, *(f"\n{table}" for table in sensor_tables())])


def _render_driver(name: str, section: Section) -> str:
    """A driver's own settings, all commented out: there is one such table, of the one in use."""
    body = "".join(f"{line}\n" for key in section.keys for line in _render_key(key, None))
    head = "\n".join(_comment(f"With {name}: {section.meaning}"))
    return f"\n{head}\n# [{section.name}]\n{body}"


def _render_section(section: Section, chosen: Mapping[str, str]) -> str:
    missing = [
        key
        for key in section.keys
        if key.is_required and f"{section.name}.{key.name}" not in chosen
    ]
    title = f"# [{section.name}]" if missing else f"[{section.name}]"
    lines = ["", *_comment(section.meaning), title]
    for key in section.keys:
        lines += _render_key(key, chosen.get(f"{section.name}.{key.name}"))
    return "\n".join(lines) + "\n"


def _render_key(key: Key, value: str | None) -> list[str]:
    added = Drivers(Driver, key.drivers).added if key.drivers else ()
    names = " or ".join([key.allowed, *map(to_toml, added)])
    words = f"{key.meaning} ({names})".strip().replace("`", "")
    if value is not None:
        return [*_comment(words), f"{key.name} = {value}"]
    return [*_comment(words), f"# {key.name} = {key.default or ''}".rstrip()]


def _comment(text: str) -> list[str]:
    lines = textwrap.wrap(text.replace("`", ""), COMMENT_WIDTH, break_on_hyphens=False)
    return [f"# {line}" for line in lines]
