"""`trolley viewer-link`: the links that let a browser on another host in."""

import shutil
import sys
from pathlib import Path

import click

from trolley.cli.options import given, json_option, where_options
from trolley.cli.printing import can_say, say
from trolley.cli.robots import reports_errors
from trolley.cli.running import find_settings
from trolley.cli.show import print_json
from trolley.files import read_file
from trolley.runtime.state import state_root
from trolley.state_file import parse
from trolley_viz.server.access import FILE, AccessTokens
from trolley_viz.server.links import OUT_OF_REACH, links_of
from trolley_viz.server.qr import BLOCKS, qr_lines


@click.command(name="viewer-link")
@click.option("--qr", "with_codes", is_flag=True, help="Print each link as a QR code, too.")
@where_options
@json_option
@reports_errors
def viewer_link(as_json: bool, with_codes: bool) -> None:
    """Print the links that open the viewer from another host.

    One lets its holder do everything, the other only look and press Stop. They hold a token: treat
    them as passwords. Run this on the viewer's host, as the user that it runs as (installed:
    by sudo). To make all links worthless, delete viewer_access.toml in the state folder and restart
    the viewer.
    """
    if as_json and with_codes:
        raise click.UsageError("--json and --qr exclude each other.")
    path, config = find_settings()
    tokens = _read(state_root(path) / (given("robot") or config.robot.name) / FILE)
    links = links_of(config.viz, tokens)
    if as_json:
        print_json({"operator": links.operator, "viewer": links.viewer})
        return
    if with_codes and not links.is_reachable:
        say(OUT_OF_REACH, err=True)
    with_codes = with_codes and links.is_reachable
    _print("To drive:         ", links.operator, with_code=with_codes)
    _print("To look and stop: ", links.viewer, with_code=with_codes)


def _print(what: str, link: str, *, with_code: bool) -> None:
    say(what + link)
    if not with_code:
        return
    if not can_say(BLOCKS):
        say("No QR code can be shown here: the output is not UTF-8.", err=True)
        return
    lines = qr_lines(link)
    if is_terminal() and shutil.get_terminal_size().columns < len(lines[0]):
        say(f"The QR code needs a terminal of {len(lines[0])} columns.", err=True)
        return
    for line in lines:
        # Colours of its own: not all cameras read light on dark.
        say(line, fg="black", bg="bright_white")


def is_terminal() -> bool:
    """Whether the output goes to a terminal."""
    return sys.stdout.isatty()


def _read(path: Path) -> AccessTokens:
    try:
        return parse(read_file(path), AccessTokens)
    except FileNotFoundError:
        raise click.ClickException(f"{path} does not exist: start the viewer once") from None
    except (OSError, ValueError) as error:
        raise click.ClickException(f"{path} cannot be read: {error}") from error
