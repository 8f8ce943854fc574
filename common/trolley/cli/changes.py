"""`trolley map changes`: what has appeared or disappeared since the map was made."""

import click

from trolley import codes, requests, topics
from trolley.cli.map_edit import ask_to_edit
from trolley.cli.options import json_option, where_options
from trolley.cli.printing import say
from trolley.cli.robots import known, one_robot, reports_errors
from trolley.cli.show import print_json, print_table
from trolley.client import Robot
from trolley.codes import Refused
from trolley.map_editing.proposals import first_that_fit, ops_of
from trolley.messages import EditMap, MapChange, MapChanges, MapEdited, request_params
from trolley.names import free_name

ALL = "all"


@click.command(name="changes")
@click.option(
    "--accept", "accepted", metavar="ID", help="Apply a change to the map; `all` applies every one."
)
@click.option("--dismiss", "dismissed", metavar="ID", help="Do not propose a change again.")
@click.option("--as", "as_name", metavar="NAME", help="Store the changed map under another name.")
@where_options
@json_option
@reports_errors
def map_changes(
    accepted: str | None, dismissed: str | None, as_name: str | None, as_json: bool
) -> None:
    """List what has appeared or disappeared since the map was made, and decide on it.

    The localizer watches for it only where `[localizer] propose_changes` is true. What is accepted
    becomes a new version of the map; the old one is kept.
    """
    if accepted is not None and dismissed is not None:
        raise click.UsageError("Give either --accept or --dismiss.")
    with one_robot() as robot:
        proposed = known(robot, topics.CHANGES, "No map is in use, or one is being made.")
        if accepted is not None:
            edited = _accept(robot, proposed, accepted, as_name)
            say(edited.message)
            return
        if dismissed is not None:
            for one in _chosen(proposed, dismissed):
                robot.ask(requests.CHANGES_DISMISS, request_params.WhichChange(id=one.id))
                say(f"{one.id} will not be proposed again.")
            return
    if as_json:
        print_json(proposed)
    elif not proposed.changes:
        say(f"No changes to the map {proposed.map} are proposed.")
    else:
        print_table(("ID", "SURE", "WHAT"), [_row(one) for one in proposed.changes])


def _row(change: MapChange) -> tuple[str, str, str]:
    return change.id, f"{change.score:.0%}", change.message


def _chosen(proposed: MapChanges, wanted: str) -> list[MapChange]:
    """Return the changes that an id, or `all`, means.

    Raises:
        Refused: `unknown_name`.
    """
    chosen = [one for one in proposed.changes if wanted in (one.id, ALL)]
    if not chosen:
        ids = ", ".join(one.id for one in proposed.changes) or "none is proposed"
        raise Refused(codes.UNKNOWN_NAME, f"There is no change {wanted!r}: {ids}.")
    return chosen


def _accept(robot: Robot, proposed: MapChanges, wanted: str, as_name: str | None) -> MapEdited:
    """Store a map with changes."""
    ops = ops_of(first_that_fit(_chosen(proposed, wanted)))
    params = EditMap(name=proposed.map, ops=ops, as_name=as_name)
    try:
        return ask_to_edit(robot, params)
    except Refused as refused:
        if refused.code != codes.EXISTS or as_name is not None:
            raise
    # The file that robot.toml names is never written.
    as_name = free_name(proposed.map, robot.ask(requests.MAP_LIST))
    return ask_to_edit(robot, EditMap(name=proposed.map, ops=ops, as_name=as_name))
