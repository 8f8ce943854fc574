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
from trolley_viz.server.links import OUT_OF_REACH, Links, links_of
from trolley_viz.server.qr import BLOCKS, qr_lines


@click.command(name="viewer-link")
@click.option("--qr", "with_codes", is_flag=True, help="Print each link as a QR code, too.")
@where_options
@json_option
@reports_errors
def viewer_link(as_json: bool, with_codes: bool) -> None:
    """Print the links that open the viewer from another host.

    One lets its holder do everything, the other only look and press Stop. They hold a token: treat
    them as passwords. Run this on the viewer's host, as the user that the viewer runs as (if
    installed, with sudo). To revoke all links, delete viewer_access.toml in the state folder and
    restart the viewer.
    """
    if as_json and with_codes:
        raise click.UsageError("--json and --qr exclude each other.")
    path, config = find_settings()
    tokens = _read(state_root(path) / (given("robot") or config.robot.name) / FILE)
    links = links_of(config.viz, tokens)
    if as_json:
        print_json({"operator": links.operator, "viewer": links.viewer})
        return
    why_not = "" if links.is_reachable else OUT_OF_REACH
    if with_codes:
        why_not = why_not or _why_no_code(links)
    if why_not:
        say(why_not, err=True)
    for what, link in (("To drive:", links.operator), ("To look and stop:", links.viewer)):
        say(f"{what:17} {link}")
        if with_codes and not why_not:
            _print_code(link)


def _why_no_code(links: Links) -> str:
    """Return why no code can be shown here, "" if it can."""
    if not can_say(BLOCKS):
        return "No QR code can be shown here: the output is not UTF-8."
    width = max(len(qr_lines(link)[0]) for link in (links.operator, links.viewer))
    if is_terminal() and shutil.get_terminal_size().columns < width:
        return f"No QR code can be shown here: it needs a terminal of {width} columns."
    return ""


def _print_code(link: str) -> None:
    for line in qr_lines(link):
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
