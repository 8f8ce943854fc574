"""`trolley map edit`: change a stored map from the command line."""

import math
import secrets
import time

import click
from msgspec.structs import replace

from trolley import codes, requests
from trolley.cli.options import FloatRange, json_option, where_options
from trolley.cli.printing import say
from trolley.cli.robots import one_robot, reports_errors
from trolley.cli.show import Progress, print_json
from trolley.client import Robot
from trolley.codes import Refused
from trolley.geometry import Pose2D
from trolley.messages import (
    Crop,
    DrawWall,
    EditMap,
    EraseStroke,
    MapEdited,
    MapOp,
    Merge,
    TakeBack,
    Turn,
)

TIMEOUT_S = 120.0
"""A large map on a small computer takes its time."""
WORKING = "working"
LINE = (FloatRange(),) * 4
Line = tuple[float, float, float, float]


@click.command(name="edit")
@click.argument("name")
@click.option("--erase", type=LINE, multiple=True, metavar="X Y X Y", help="Erase along a line.")
@click.option("--wall", type=LINE, multiple=True, metavar="X Y X Y", help="Draw a wall.")
@click.option(
    "--width",
    type=FloatRange(min=0.0, max=100.0, min_open=True),
    help="Width of the brush and of walls [m]; default 0.2 and 0.05.",
)
@click.option("--merge", "other", metavar="MAP", help="Fill in unknown areas from this map.")
@click.option(
    "--at", type=(FloatRange(),) * 3, metavar="X Y YAW", help="Where that map lies [m, m, °]."
)
@click.option(
    "--turn",
    type=FloatRange(-360.0, 360.0),
    metavar="DEGREES",
    help="Turn it counter-clockwise.",
)
@click.option("--crop", type=LINE, metavar="X Y X Y", help="Keep this rectangle.")
@click.option("--undo", is_flag=True, help="Go back to the previous version.")
@click.option("--as", "as_name", metavar="NEW", help="Store the result as a map of its own.")
@click.option("--dry-run", is_flag=True, help="Only say what would happen.")
@where_options
@json_option
@reports_errors
def edit_map(name: str, as_name: str | None, dry_run: bool, as_json: bool, **what: object) -> None:
    """Edit the map NAME and store it as a new version; the previous one is kept.

    Edits are made in this order: erase, draw walls, merge, turn, crop.
    """
    ops = _operations(**what)  # type: ignore[arg-type]
    if not ops:
        raise click.UsageError("Say what to do, such as --turn 3.5 or --undo.")
    params = EditMap(name=name, ops=ops, as_name=as_name, preview=dry_run)
    with one_robot() as robot:
        reply = ask_to_edit(robot, params)
    if as_json:
        print_json(reply)
    else:
        say(f"Dry run, nothing is stored. {reply.message}" if dry_run else reply.message)


def ask_to_edit(robot: Robot, params: EditMap) -> MapEdited:
    """Ask for a change of a map, and wait until it is made.

    Raises:
        Refused: it is not made, or takes too long.
    """
    params = replace(params, id=secrets.token_hex(6))
    progress, until_s = Progress(), time.monotonic() + TIMEOUT_S
    try:
        while (reply := _answer(robot, params, until_s)) is None:
            progress.show("working ...", WORKING)
    finally:
        progress.clear()
    return reply


def _answer(robot: Robot, params: EditMap, until_s: float) -> MapEdited | None:
    """Return what came of a change; None while it is being made, or the computer is busy."""
    try:
        reply = robot.ask(requests.MAP_EDIT, params)
    except Refused as refused:
        if refused.code != codes.TIMEOUT or time.monotonic() > until_s:
            raise
        return None
    if reply.state != WORKING:
        return reply
    if time.monotonic() > until_s:
        raise Refused(codes.TIMEOUT, "The map is still being changed.")
    return None


def _operations(
    erase: tuple[Line, ...],
    wall: tuple[Line, ...],
    width: float | None,
    other: str | None,
    at: tuple[float, float, float] | None,
    turn: float | None,
    crop: Line | None,
    undo: bool,
) -> list[MapOp]:
    """Return what the options ask for, in the order of the help text."""
    ops: list[MapOp] = [TakeBack()] if undo else []
    for x0, y0, x1, y1 in erase:
        ops.append(EraseStroke(points=[(x0, y0), (x1, y1)], width=width or 0.2))
    for x0, y0, x1, y1 in wall:
        ops.append(DrawWall(points=[(x0, y0), (x1, y1)], width=width or 0.05))
    if other is not None:
        pose = None if at is None else Pose2D(at[0], at[1], math.radians(at[2]))
        ops.append(Merge(name=other, pose=pose))
    if turn is not None:
        ops.append(Turn(angle=math.radians(turn)))
    if crop is not None:
        ops.append(Crop(corners=((crop[0], crop[1]), (crop[2], crop[3]))))
    return ops
