"""`trolley stop` and `trolley resume`."""

import click

from trolley.cli.options import json_option, where_options
from trolley.cli.printing import say
from trolley.cli.robots import connected, one_robot, reports_errors
from trolley.cli.show import print_json
from trolley.connection import RobotUnreachable


@click.command(name="stop")
@click.option("--all", "everybody", is_flag=True, help="Stop every robot on the network.")
@where_options
@json_option
@reports_errors
def stop_command(everybody: bool, as_json: bool) -> None:
    """Stop the robot; it stays stopped, even after a restart, until it is resumed."""
    if everybody:
        with connected() as connection:
            stopped = connection.stop_all()
            names = connection.robots()
        missing = [name for name in names if name not in stopped]
        if as_json:
            print_json(stopped)
        else:
            for name, state in sorted(stopped.items()):
                say(f"{name}: {state.mode}")
        if missing or not stopped:
            raise RobotUnreachable(f"NOT STOPPED: no connection to {', '.join(missing) or 'any'}")
        return
    with one_robot() as robot:
        state = robot.stop()
    if as_json:
        print_json(state)
    else:
        say("Stopped. `trolley resume` lets it drive.")


@click.command(name="resume")
@where_options
@json_option
@reports_errors
def resume_command(as_json: bool) -> None:
    """Allow a stopped robot to drive again; it does not set off by itself."""
    with one_robot() as robot:
        state = robot.resume()
    if as_json:
        print_json(state)
    else:
        say(
            "Resumed; it can drive again."
            if state.mode == "ok"
            else f"Resumed, but it cannot drive yet ({state.mode}): {state.message}"
        )
