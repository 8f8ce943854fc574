"""The command line: `trolley`.

One module per group of commands, imported when one of them is used: completing a name in the shell
must not load Zenoh.
"""

import ast
import importlib
import importlib.util
import os
from collections.abc import Mapping, Sequence
from importlib.metadata import EntryPoint, entry_points
from pathlib import Path
from types import MappingProxyType
from typing import Any

import click

from trolley.cli import exits
from trolley.cli.options import where_options
from trolley.cli.printing import show_error
from trolley.start import EndingAtOnce, leave

SECTIONS = {
    "Begin": {
        "demo": (
            "trolley.cli.demo",
            "Watch a simulated robot drive through an apartment, in the browser.",
        ),
        "init": ("trolley.cli.init", "Write a commented robot.toml."),
        "up": ("trolley.cli.running", "Run all services of a robot in this terminal."),
        "router": ("trolley.cli.running", "Run the router that services and tools connect to."),
        "run": ("trolley.cli.running", "Run one service in the foreground."),
        "doctor": ("trolley.cli.doctor", "Find out what is wrong, and what to do about it."),
    },
    "Drive": {
        "go": ("trolley.cli.go", "Drive to a place."),
        "follow": ("trolley.cli.go", "Follow a person."),
        "cancel": ("trolley.cli.go", "Cancel the current goal."),
        "tour": ("trolley.cli.tour", "Drive through several places."),
        "stop": ("trolley.cli.stopping", "Stop the robot until it is resumed."),
        "resume": ("trolley.cli.stopping", "Allow a stopped robot to drive again."),
        "teleop": ("trolley.cli.teleop", "Drive by hand, with the keys of this terminal."),
    },
    "Look": {
        "status": ("trolley.cli.status", "Show how the robot and its services are doing."),
        "top": ("trolley.cli.top", "Watch services and topics live: rates, processor, memory."),
        "pose": ("trolley.cli.pose", "Show where the robot is; manage saved places."),
        "map": ("trolley.cli.maps", "Show, make, edit and switch maps."),
        "zones": ("trolley.cli.maps", "List mirrors, glass, no-go and slow areas."),
        "topic": ("trolley.cli.topic", "Show what is published; publish something."),
        "tf": ("trolley.cli.tf", "Show where one frame is in another."),
    },
    "Set and keep": {
        "config": ("trolley.cli.config", "Show and change settings while the robot runs."),
        "record": ("trolley.cli.record", "Record what a robot publishes into a file."),
        "replay": ("trolley.cli.replay", "Play a recording under another robot's name."),
        "backup": ("trolley.cli.backup", "Save everything the robot knows in one file."),
        "restore": ("trolley.cli.backup", "Restore what `trolley backup` saved."),
        "import": ("trolley.cli.importing", "Import settings or drives from another system."),
        "export": ("trolley.cli.importing", "Export drives to another system."),
    },
    "For hosts and programs": {
        "keys": ("trolley.cli.keys", "Make certificates for the hosts that may connect."),
        "ask": ("trolley.cli.ask", "Ask any request of the wire."),
        "completion": (
            "trolley.cli.completion",
            "Print the script that completes commands in a shell.",
        ),
    },
}
"""By section: command, its module (where it is the function `<command>_command`), short help."""

COMMANDS = {name: row for section in SECTIONS.values() for name, row in section.items()}

ADDED = "More"
"""The section of what services bring along."""

SECTION_OF = {
    "detect": "Begin",
    "setup": "Begin",
    "emulate": "Begin",
    "calibrate": "Set and keep",
    "viewer-link": "For hosts and programs",
    "ros2": "For hosts and programs",
    "mcp": "For hosts and programs",
}
"""Of what our own services bring along, where they are installed; others stand under `ADDED`."""

WHOLE_SENTENCE = 1000
"""Letters of a short help: as many as it has."""

PLUGINS = "trolley.commands"
"""Entry-point group of the services' own commands: `tour-import` is `trolley tour import`."""


class SuggestingGroup(click.Group):
    """A group that names the nearest commands where one is mistyped, whoever brings it along.

    Its help has whole sentences, and sections where there are any.

    Args:
        sections: the commands by title, in the order of the help; others stand below them.
    """

    def __init__(
        self, *args: Any, sections: Mapping[str, Sequence[str]] = MappingProxyType({}), **more: Any
    ) -> None:
        super().__init__(*args, **more)
        self._sections = sections

    def format_commands(self, ctx: click.Context, formatter: click.HelpFormatter) -> None:
        """List the commands, each with its whole first sentence."""
        names = self.list_commands(ctx)
        named = {name for some in self._sections.values() for name in some}
        others = [name for name in names if name not in named]
        sections = {**self._sections, ADDED if named else "Commands": others}
        longest = max(map(len, names), default=0)
        for title, some in sections.items():
            rows = [
                (f"{name:<{longest}}", command.get_short_help_str(limit=WHOLE_SENTENCE))
                for name in some
                if (command := self.get_command(ctx, name)) is not None
            ]
            if rows:
                with formatter.section(title):
                    formatter.write_dl(rows)

    def resolve_command(
        self, ctx: click.Context, args: list[str]
    ) -> tuple[str | None, click.Command | None, list[str]]:
        """Find the command that the first of `args` names."""
        try:
            return super().resolve_command(ctx, args)
        except click.NoSuchCommand as error:
            names = self.list_commands(ctx)
            raise click.NoSuchCommand(error.command_name, possibilities=names, ctx=ctx) from error


class LazyGroup(SuggestingGroup):
    """A group whose commands are imported when they are used."""

    def list_commands(self, ctx: click.Context) -> list[str]:
        """Every command, in the order of the help."""
        own = {name.partition("-")[0] for name in COMMANDS}
        return [*COMMANDS, *(name for name in plugins() if name.partition("-")[0] not in own)]

    def get_command(self, ctx: click.Context, cmd_name: str) -> click.Command | None:
        """Import a command."""
        if cmd_name in COMMANDS:
            with EndingAtOnce():
                module = importlib.import_module(COMMANDS[cmd_name][0])
            return getattr(module, f"{cmd_name}_command")
        return _loaded(plugins().get(cmd_name))

    def format_commands(self, ctx: click.Context, formatter: click.HelpFormatter) -> None:
        """List the commands by section without importing any."""
        added = self.list_commands(ctx)[len(COMMANDS) :]
        sections = {
            title: [(name, text) for name, (_, text) in commands.items()]
            for title, commands in SECTIONS.items()
        }
        for name in added:
            row = name, _short_help(plugins()[name])
            sections.setdefault(SECTION_OF.get(name, ADDED), []).append(row)
        longest = max(len(name) for name in (*COMMANDS, *added))
        for title, rows in sections.items():
            with formatter.section(title):
                formatter.write_dl([(f"{name:<{longest}}", text) for name, text in rows])


def plugins() -> dict[str, EntryPoint]:
    """Entry points of commands that other packages bring along, by name."""
    # By themselves they come as their files lie in a folder: otherwise on each computer.
    return {one.name: one for one in sorted(entry_points(group=PLUGINS), key=lambda one: one.name)}


def _loaded(entry: EntryPoint | None) -> click.Command | None:
    with EndingAtOnce():
        return None if entry is None else entry.load()


def _short_help(entry: EntryPoint) -> str:
    """What a command's docstring begins with.

    It is read from the source: importing it with all that it needs takes a second, and ten times
    that on a Raspberry Pi 3.
    """
    spec = importlib.util.find_spec(entry.module)
    if spec is None or spec.origin is None:
        return ""
    for node in ast.parse(Path(spec.origin).read_text(encoding="utf-8")).body:
        if isinstance(node, ast.FunctionDef) and node.name == entry.attr:
            return click.Command(None, help=ast.get_docstring(node)).get_short_help_str(
                WHOLE_SENTENCE
            )
    return ""


class PluggedGroup(SuggestingGroup):
    """A group that services add commands to: entry point `<group>-<command>`."""

    def list_commands(self, ctx: click.Context) -> list[str]:
        """The group's own commands and those of installed services."""
        prefix = f"{self.name}-"
        added = [name.removeprefix(prefix) for name in plugins() if name.startswith(prefix)]
        return sorted({*super().list_commands(ctx), *added})

    def get_command(self, ctx: click.Context, cmd_name: str) -> click.Command | None:
        """One of the group's own commands, else one of an installed service."""
        entry = plugins().get(f"{self.name}-{cmd_name}")
        return super().get_command(ctx, cmd_name) or _loaded(entry)


def _epilog() -> str:
    lines = "\n".join(f"  {code:<4} {meaning}" for code, meaning in exits.MEANINGS.items())
    return f"\b\nExit codes:\n{lines}"


@click.group(
    cls=LazyGroup,
    epilog=_epilog(),
    context_settings={"help_option_names": ["-h", "--help"], "max_content_width": 100},
)
@click.version_option(package_name="trolley-robot", prog_name="trolley")
@where_options
@click.pass_context
def cli(ctx: click.Context) -> None:
    """Navigation for small indoor robots.

    Commands that talk to a robot take --robot and --connect, then the configuration file, then the
    only robot on the network.
    """
    ctx.ensure_object(dict)
    if os.environ.get("NO_COLOR"):  # no-color.org
        ctx.color = False


def main() -> None:
    """Run the command line.

    It ends without Python's own shutdown, which threads of Zenoh's that still run would abort.
    """
    code: object = exits.INTERRUPTED
    try:
        code = cli.main(prog_name="trolley", standalone_mode=False)
    except click.exceptions.Abort:
        leave("interrupted\n", exits.INTERRUPTED)
    except click.ClickException as error:
        show_error(error)
        code = exits.USAGE
    except SystemExit as end:
        code = end.code
    leave("", code if isinstance(code, int) else exits.OK)
