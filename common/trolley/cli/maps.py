"""`trolley map` and `trolley zones`."""

import math

import click
import numpy as np

from trolley import requests, topics
from trolley.cli import SuggestingGroup
from trolley.cli.changes import map_changes
from trolley.cli.mapping import add_commands
from trolley.cli.options import FloatRange, NumbersCommand, json_option, where_options
from trolley.cli.printing import say
from trolley.cli.robots import known, one_robot, reports_errors
from trolley.cli.show import pose_text, print_json, print_table
from trolley.gridmap import OCCUPIED_FROM
from trolley.messages import OccupancyGrid, Zone
from trolley.messages.arrays import arrays_of
from trolley.zones import LINE_KINDS


@click.group(
    name="map",
    cls=SuggestingGroup,
    sections={
        "Use and edit": ("list", "info", "load", "edit", "changes"),
        "Make one": ("new", "extend", "explore", "status", "pause", "resume"),
        "Mend it": ("undo", "join", "drop"),
        "Finish it": ("save", "cancel"),
    },
)
def map_command() -> None:
    """Show which map the robot uses and which it has; make a new one by driving."""


add_commands(map_command)
map_command.add_command(map_changes)


@map_command.command(name="info")
@where_options
@json_option
@reports_errors
def map_info(as_json: bool) -> None:
    """Describe the map that the robot uses."""
    with one_robot() as robot:
        grid = known(robot, topics.MAP, "There is no map: the localizer has loaded none.")
    cells = arrays_of(grid)["cells"]
    counts = {
        "free": int(np.count_nonzero((cells >= 0) & (cells < OCCUPIED_FROM))),
        "occupied": int(np.count_nonzero(cells >= OCCUPIED_FROM)),
        "unknown": int(np.count_nonzero(cells < 0)),
    }
    if as_json:
        print_json(
            {
                "name": grid.name,
                "frame": grid.frame,
                "resolution": grid.resolution,
                "width": grid.width,
                "height": grid.height,
                "origin": grid.origin,
                "cells": counts,
            }
        )
        return
    _print_map(grid, counts)


def _print_map(grid: OccupancyGrid, counts: dict[str, int]) -> None:
    size = f"{grid.width * grid.resolution:.2f} x {grid.height * grid.resolution:.2f} m"
    say(f"{grid.name} in frame {grid.frame}")
    say(f"{size}: {grid.width} x {grid.height} cells of {grid.resolution:g} m")
    say(f"origin {pose_text(grid.origin)}")
    total = max(1, grid.width * grid.height)
    say(", ".join(f"{count / total:.1%} {what}" for what, count in counts.items()))


@map_command.command(name="list")
@where_options
@json_option
@reports_errors
def list_maps(as_json: bool) -> None:
    """List the maps that the robot has."""
    with one_robot() as robot:
        names = robot.ask(requests.MAP_LIST)
    if as_json:
        print_json(names)
    else:
        for name in names or ["There is no map."]:
            say(name)


@map_command.command(name="load", cls=NumbersCommand)
@click.argument("name")
@click.option(
    "--at",
    type=(FloatRange(),) * 3,
    metavar="X Y YAW",
    help="Where the robot is [m, m, rad].",
)
@where_options
@json_option
@reports_errors
def load_map(name: str, at: tuple[float, float, float] | None, as_json: bool) -> None:
    """Switch the robot to the map NAME; without --at it works out where it is on it."""
    with one_robot() as robot:
        info = robot.load_map(name, at)
    if as_json:
        print_json(info)
    else:
        say(f"The robot now uses the map {info.name}.")


@click.command(name="zones")
@where_options
@json_option
@reports_errors
def zones_command(as_json: bool) -> None:
    """List the zones of the map: mirrors, glass, no-go and slow areas, rooms."""
    with one_robot() as robot:
        missing = "There are no zones: the localizer has loaded no map."
        zones = known(robot, topics.ZONES, missing)
    if as_json:
        print_json(zones)
    elif not zones.zones:
        say(f"The map {zones.map} has no zones.")
    else:
        print_table(("NAME", "KIND", "SIZE", "POINTS"), [_row(zone) for zone in zones.zones])


def _row(zone: Zone) -> tuple[str, str, str, str]:
    points = [f"({x:.2f}, {y:.2f})" for x, y in zone.points]
    shown = points if len(points) <= 4 else [*points[:3], f"... {len(points) - 3} more"]
    if zone.kind in LINE_KINDS:
        length = sum(math.dist(a, b) for a, b in zip(zone.points, zone.points[1:], strict=False))
        size = f"{length:.2f} m"
    else:
        size = f"{_area(zone.points):.2f} m²"
    kind = zone.kind if zone.speed is None else f"{zone.kind} {zone.speed:g} m/s"
    return zone.name, kind, size, " ".join(shown)


def _area(points: list[tuple[float, float]]) -> float:
    """Area of a polygon by the shoelace formula [m^2]."""
    following = [*points[1:], points[0]]
    twice = sum(x * y2 - x2 * y for (x, y), (x2, y2) in zip(points, following, strict=True))
    return abs(twice) / 2.0
