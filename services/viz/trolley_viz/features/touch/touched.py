"""Touching the map: what lies under a finger that comes down and goes up in one place."""

import math
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Literal

import numpy as np

from trolley import topics
from trolley.geometry.frames import MAP
from trolley.geometry.polygon import (
    distance_to_outline,
    distance_to_segments,
    polygon_contains,
)
from trolley.messages import Zone
from trolley.zones import LINE_KINDS, room_at
from trolley_viz.graphics.shapes import meet_floor
from trolley_viz.robots.view import View
from trolley_viz.scene.place_labels import Eye
from trolley_viz.scene.places import ICON_SIZE, current_places

REACH_PX = 22.0
"""Half of what a fingertip covers."""
ROBOT_M = 0.2
"""How far a robot reaches whose outline is not known."""

What = Literal["robot", "place", "zone", "floor"]
Point = tuple[float, float]


@dataclass(frozen=True)
class Touched:
    """What was touched.

    Attributes:
        what: it is.
        name: of the robot, place or zone; "" for the floor.
        x, y: where the finger was, in the world [m].
        room: that the floor belongs to, "" for none.
    """

    what: What
    name: str
    x: float
    y: float
    room: str = ""


def touched(view: View, eye: Eye, at: Point) -> Touched | None:
    """Return what is touched: another robot, a place, this robot, a zone, else the floor.

    Where this robot stands on a place, the place is meant: it has more to offer.

    Args:
        view: the robot that is followed.
        eye: the camera.
        at: shares of the picture's width and height, from its upper left corner.

    Returns:
        None above the horizon.
    """
    point = meet_floor(eye.position, eye.direction(at))
    if point is None:
        return None
    reach = _reach(eye, point)
    finders: tuple[tuple[What, Iterator[tuple[str, float]]], ...] = (
        ("robot", _other_robots(view, point)),
        ("place", _places(view, point)),
        ("robot", _this_robot(view, point)),
        ("zone", _zones_near(view, point)),
    )
    for what, found in finders:
        name = _nearest(found, reach)
        if name is not None:
            return Touched(what, name, *point)
    return Touched("floor", "", *point, room=room_at(_zones(view), *point) or "")


def place_at(view: View, eye: Eye, point: Point) -> str | None:
    """Return the name of the place that a finger at a point of the world [m] touches, or None."""
    return _nearest(_places(view, point), _reach(eye, point))


def _reach(eye: Eye, point: Point) -> float:
    """How far a finger reaches on the floor around a point [m]."""
    depth = float((np.array([*point, 0.0]) - eye.position) @ eye.direction((0.5, 0.5)))
    return REACH_PX * 2.0 * math.tan(0.5 * eye.fov) * depth / max(eye.size[1], 1.0)


def _nearest(found: Iterator[tuple[str, float]], reach: float) -> str | None:
    """The nearest of what was found within reach [m], None for none."""
    distance, name = min(((metres, name) for name, metres in found), default=(math.inf, ""))
    return name if distance <= reach else None


def _this_robot(view: View, point: Point) -> Iterator[tuple[str, float]]:
    """The robot that is followed, and how far from it the point is [m]."""
    here = view.placement.world_T_base
    if here is not None:
        outline = [] if view.robot is None else view.robot.footprint
        radius = max((math.hypot(x, y) for x, y in outline), default=ROBOT_M)
        yield view.robot_name, max(math.dist((here.x, here.y), point) - radius, 0.0)


def _other_robots(view: View, point: Point) -> Iterator[tuple[str, float]]:
    """The others on this map by name, and how far from each the point is [m]."""
    for one in view.fleet:
        told, grid = one.pose, view.map
        if one.name == view.robot_name or told is None or told.pose is None or grid is None:
            continue
        if told.map == grid.name:
            yield one.name, max(math.dist((told.pose.x, told.pose.y), point) - ROBOT_M, 0.0)


def _places(view: View, point: Point) -> Iterator[tuple[str, float]]:
    if view.placement.world == MAP:
        for one in current_places(view):
            gap = math.dist((one.pose.x, one.pose.y), point) - 0.5 * ICON_SIZE
            yield one.name, max(gap, 0.0)


def _zones(view: View) -> list[Zone]:
    """The zones of the map that is shown."""
    zones, grid = view.streams.latest(topics.ZONES), view.map
    return [] if zones is None or grid is None or zones.map != grid.name else zones.zones


def _zones_near(view: View, point: Point) -> Iterator[tuple[str, float]]:
    """How far the point is from each zone [m]; a room is the floor itself."""
    for zone in _zones(view):
        if zone.kind != "room":
            yield zone.name, _distance_to(zone, point)


def _distance_to(zone: Zone, point: Point) -> float:
    """How far a point is from a line, or from an area that it is not in [m]."""
    corners, points = np.array(zone.points, np.float64).reshape(-1, 2), np.array([point])
    if zone.kind in LINE_KINDS:
        return float(distance_to_segments(points, corners[:-1], corners[1:])[0])
    if polygon_contains(corners, points)[0]:
        return 0.0
    return float(distance_to_outline(corners, points)[0])
