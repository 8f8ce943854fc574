"""`trolley detect`: which board and which lidar are plugged in, and where."""

import tomllib
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import click

from trolley.cli import exits
from trolley.cli.options import given, json_option, where_options
from trolley.cli.printing import say, say_block
from trolley.cli.robots import reports_errors
from trolley.cli.show import Progress, print_json, print_table
from trolley.config import ConfigError, find_config, robot_toml
from trolley_base.detection import settings, udev_rules
from trolley_base.detection.detector import detect_devices
from trolley_base.detection.known import what_is_left_out
from trolley_base.detection.ports import find_ports
from trolley_base.detection.results import PortResult
from trolley_base.detection.settings import Proposal

USUAL, SCREEN = "<usual>", "-"
"""An option that may stand without a value: for "the usual file", and for "the screen"."""


@click.command(name="detect")
@click.argument("ports", nargs=-1, metavar="[PORT]...")
@click.option(
    "--write",
    is_flag=False,
    flag_value=USUAL,
    metavar="[ROBOT.TOML]",
    help="Write the settings to this file, else the usual one; name ports before it.",
)
@click.option(
    "--udev",
    is_flag=False,
    flag_value=SCREEN,
    metavar="[FILE.RULES]",
    help="Print a udev rule with permanent names for the ports, or write it to this file.",
)
@where_options
@json_option
@reports_errors
def detect_command(
    ports: tuple[str, ...], write: str | None, udev: str | None, as_json: bool
) -> int:
    """Find the motor board and the lidar by what they answer; nothing on wheels moves.

    Tries the given serial ports, else all that no program has open; that takes up to 11 s. It
    sends a few short questions to each: name the ports if something is plugged in that must not
    get them. A PORT may be an address in the network, such as tcp://192.168.0.10:10940, or
    udp://:8888 for a board that calls this computer; what is not named is not tried. Devices are
    left as they were found, except that a lidar left running is told to stop.
    """
    for value, suffix in ((write, ".toml"), (udev, ".rules")):
        # A port behind such an option would be taken for the file, and written over.
        if value not in (None, USUAL, SCREEN) and Path(value).suffix != suffix:
            raise click.UsageError(
                f"{value} is not a *{suffix} file to write to; name ports before the options"
            )
    path = _file_to_write(write) if write is not None else None
    text = robot_toml.read_text(path) if path is not None else ""
    seen = look_at_ports(ports)
    proposal = settings.propose(seen, tomllib.loads(text))
    proposal.notes += [*proposal.sensor_notes, *what_is_left_out()]
    if as_json:
        print_json(_plain(seen, proposal))
    else:
        _show(seen)
    if udev is not None:
        _give_rule(udev, seen, quiet=as_json)
    if path is not None:
        _write(path, text, proposal, quiet=as_json)
    elif not as_json and udev is None:
        _show_settings(proposal)
    return exits.OK if any(one.found for one in seen) else exits.FAILED


def look_at_ports(ports: Sequence[str]) -> list[PortResult]:
    """Look at these ports, else at all that no program has open, and show how far it is."""
    candidates = find_ports(ports)
    progress = Progress()
    ports_in_words = "1 port" if len(candidates) == 1 else f"{len(candidates)} ports"
    progress.show(f"Looking at {ports_in_words} ...")
    try:
        return detect_devices(
            candidates, lambda one, left: progress.show(_progress(one, left), one.port.name)
        )
    finally:
        progress.clear()


def _file_to_write(write: str) -> Path:
    path = find_config(given("config")) if write == USUAL else Path(write)
    if path is None:
        raise ConfigError(
            "there is no robot.toml to write to: name it (--write robot.toml), or make one first "
            "with `trolley init`"
        )
    if not path.exists():
        raise ConfigError(f"{path} is not there: make it first with `trolley init {path}`")
    return path


def _progress(one: PortResult, left: int) -> str:
    what = one.found.title if one.found is not None else "nothing known"
    rest = f", {left} more to look at" if left else ""
    return f"{one.port.name}: {what}{rest}"


def _show(seen: Sequence[PortResult]) -> None:
    """Print a table, and below it what is to be said of each port."""
    if not seen:
        say(
            "There is no serial port: is anything plugged in, and by a data cable (not "
            "charge-only)? In a virtual machine or container, is the device passed on?"
        )
        return
    rows = [
        (
            one.port.name,
            one.found.title if one.found is not None else "-",
            (one.found.model or "no driver") if one.found is not None else "-",
            ", ".join(one.found.details) if one.found is not None else one.port.description,
        )
        for one in seen
    ]
    print_table(("port", "device", "model", "details"), rows)
    for one in seen:
        remarks = [*one.problems]
        if one.found is not None and one.port.reason:
            remarks.append(one.port.reason)
        if remarks:
            say()
            say(one.port.name)
        for remark in remarks:
            say(f"  {remark}")


def _show_settings(proposal: Proposal) -> None:
    for note in proposal.notes:
        say()
        say(note)
    if proposal.values:
        say()
        say("For robot.toml (`trolley detect --write` puts it there):")
        say()
        say_block(settings.render(proposal), nl=False)


def _write(path: Path, old: str, proposal: Proposal, *, quiet: bool) -> None:
    new = robot_toml.with_values(old, proposal.values, proposal.waiting, proposal.tables)
    if new != old:
        robot_toml.replace_text(path, new)
    if quiet:
        return
    for note in proposal.notes:
        say()
        say(note)
    if new == old:
        say()
        say(f"{path} stays as it is.")
        return
    say()
    say(f"Changed in {path}:")
    say()
    say_block(robot_toml.difference(path, old, new), nl=False)


def _give_rule(udev: str, seen: Sequence[PortResult], *, quiet: bool) -> None:
    if udev == SCREEN:
        if not quiet:
            say()
            say_block(udev_rules.render(seen), nl=False)
        return
    path = Path(udev)
    try:
        path.write_text(udev_rules.render(seen, udev), encoding="utf-8")
    except OSError as error:
        raise ConfigError(f"{path}: cannot be written: {error.strerror}") from error
    if not quiet:
        say()
        say(f"Wrote {path}; its first lines say how to install it.")


def _plain(seen: Sequence[PortResult], proposal: Proposal) -> dict[str, Any]:
    """What was seen, for a program."""
    return {
        "ports": [
            {
                "port": one.port.name,
                "device": one.port.device,
                "description": one.port.description,
                "name_reason": one.port.reason,
                "found": None
                if one.found is None
                else {
                    "kind": one.found.kind,
                    "model": one.found.model,
                    "title": one.found.title,
                    "baud": one.found.baud,
                    "details": one.found.details,
                },
                "problems": one.problems,
            }
            for one in seen
        ],
        "settings": settings.by_name(proposal),
        "notes": proposal.notes,
        "toml": settings.render(proposal) if proposal.values else "",
        "udev_rule": udev_rules.render(seen),
    }
