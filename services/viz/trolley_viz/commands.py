"""`trolley viewer-link`: the links that let a browser on another host in."""

import socket
from pathlib import Path

import click

from trolley.cli.options import given, json_option, where_options
from trolley.cli.printing import say
from trolley.cli.robots import reports_errors
from trolley.cli.running import find_settings
from trolley.cli.show import print_json
from trolley.config import VizConfig
from trolley.files import read_file
from trolley.runtime.state import state_root
from trolley.state_file import parse
from trolley_viz.server.access import FILE, AccessTokens

EVERYWHERE = ("0.0.0.0", "::", "")


@click.command(name="viewer-link")
@where_options
@json_option
@reports_errors
def viewer_link(as_json: bool) -> None:
    """Print the links that open the viewer from another host.

    One lets its holder do everything, the other only look and press Stop. They hold a token: treat
    them as passwords. Run this on the viewer's host, as the user that it runs as (installed:
    by sudo). To make all links worthless, delete viewer_access.toml in the state folder and restart
    the viewer.
    """
    path, config = find_settings()
    access = _read(state_root(path) / (given("robot") or config.robot.name) / FILE)
    page = _page(config.viz)
    links = {
        "operator": f"{page}/?token={access.operator}",
        "viewer": f"{page}/?token={access.viewer}",
    }
    if as_json:
        print_json(links)
        return
    say(f"To drive:         {links['operator']}")
    say(f"To look and stop: {links['viewer']}")


def _read(path: Path) -> AccessTokens:
    try:
        return parse(read_file(path), AccessTokens)
    except FileNotFoundError:
        raise click.ClickException(f"{path} does not exist: start the viewer once") from None
    except (OSError, ValueError) as error:
        raise click.ClickException(f"{path} cannot be read: {error}") from error


def _page(viz: VizConfig) -> str:
    """The address of the page, as another host may call it."""
    if viz.origins:
        return viz.origins[0]
    host = socket.gethostname() if viz.host in EVERYWHERE else viz.host
    return f"http://{f'[{host}]' if ':' in host else host}:{viz.port}"
