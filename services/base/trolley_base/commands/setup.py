"""`trolley setup`: the robot measures itself, step by step, into its `robot.toml`."""

from pathlib import Path

import click

from trolley.cli import exits
from trolley.cli.options import given, where_options
from trolley.cli.printing import say
from trolley.cli.robots import reports_errors
from trolley.config import find_config
from trolley.interrupts import Interrupts
from trolley_base.commands.setup_dialogue import LONG_S, SHORT_S, SetupDialogue
from trolley_base.commands.setup_page import run_on_page
from trolley_base.commands.setup_terminal import Terminal
from trolley_base.setup.drive import PARAMS as DRIVE
from trolley_base.setup.person import StoppedByHand
from trolley_base.setup.record import SetupRefused


@click.command(name="setup")
@click.argument("ports", nargs=-1, metavar="[PORT]...")
@click.option("--undo", is_flag=True, help="Give the file back as it was before the last setup.")
@click.option("--again", is_flag=True, help="Begin with the first step, whatever is done already.")
@click.option(
    "--short",
    is_flag=True,
    help=f"Drive {SHORT_S:.0f} s instead of {DRIVE.driving_s:.0f} s, and measure less exactly.",
)
@click.option(
    "--long",
    is_flag=True,
    help=f"Drive {LONG_S:.0f} s, so that wheels that slip are measured more exactly.",
)
@click.option("--page", is_flag=True, help="Ask at a page of the viewer, such as on a phone.")
@where_options
@reports_errors
def setup_command(
    ports: tuple[str, ...], undo: bool, again: bool, short: bool, long: bool, page: bool
) -> int:
    """Let the robot measure itself: devices, wheels, lidar, gyro, delays; into its robot.toml.

    Three steps, each checked before the next: find the devices (at the PORTs given, else all);
    try the wheels in the air; drive on the floor for three minutes, to and fro and in circles.
    Any key stops the robot. Called again, it goes on with the step that was not finished. Base
    must not be running.
    With --page it starts a router and the viewer where none runs, and prints the page's link.
    """
    if short and long:
        raise click.UsageError("--short and --long exclude each other.")
    driving_s = LONG_S if long else SHORT_S if short else DRIVE.driving_s
    path = find_config(given("config")) or Path("robot.toml")
    dialogue = SetupDialogue(path, ports, Terminal(), driving_s)
    if undo:
        say(dialogue.undo())
        return exits.OK
    if page:
        return run_on_page(
            path, lambda desk: SetupDialogue(path, ports, desk, driving_s), again=again
        )
    try:
        with Interrupts().handled():  # until the board's own watchdog, it would drive on
            dialogue.run(again=again)
    except SetupRefused as refusal:
        say(str(refusal), err=True, fg="red")
        say(
            "`trolley setup` tries this step again, `trolley setup --undo` takes back what was "
            "written before.",
            err=True,
        )
        return exits.FAILED
    except (KeyboardInterrupt, click.Abort, StoppedByHand):  # Abort: at a question
        say("Stopped. `trolley setup` goes on with this step.", err=True)
        return exits.INTERRUPTED
    say(f"All is written. `trolley up --config {path}` starts the robot; next comes its first map.")
    return exits.OK
