"""What is drawn, as Foxglove's scene: the robot, zones, places, suspected mirrors, markers.

What comes as a whole list is one entity, which the next list replaces.
"""

from collections.abc import Iterable, Sequence
from typing import Any

from foxglove import messages as fox

from trolley.foxglove.convert import frame_name, pose_message, timestamp
from trolley.geometry import Pose2D
from trolley.messages import Marker, Robot, SavedPoses, Suspects, Zones
from trolley.zones import LINE_KINDS

Rgb = tuple[float, float, float]

ZONE_COLOURS: dict[str, Rgb] = {
    "mirror": (0.2, 0.6, 0.9),
    "glass": (0.3, 0.8, 0.8),
    "keepout": (0.9, 0.2, 0.2),
    "speed": (0.9, 0.7, 0.1),
    "room": (0.5, 0.5, 0.6),
}
ROBOT_COLOUR: Rgb = (0.2, 0.45, 0.9)
PLACE_COLOUR: Rgb = (0.1, 0.6, 0.3)
SUSPECT_COLOUR: Rgb = (0.8, 0.3, 0.8)
TEXT_COLOUR: Rgb = (0.3, 0.3, 0.3)
LINE_M = 0.04
TEXT_M = 0.15
ARROW_M = 0.25
ABOVE_GROUND_M = 0.02
LONGEST_S = 1e9


def robot_outline(robot: str, message: Robot) -> bytes:
    """The footprint, fixed to the robot."""
    outline = _line(message.footprint, ROBOT_COLOUR, is_closed=True)
    return _update(
        fox.SceneEntity(
            timestamp=timestamp(message.stamp_ns),
            frame_id=frame_name(robot, "base_link"),
            id=f"{robot}/outline",
            frame_locked=True,
            lines=[outline],
        )
    )


def zones(robot: str, message: Zones) -> bytes:
    """The zones with their names."""
    lines = [
        _line(zone.points, ZONE_COLOURS[zone.kind], is_closed=zone.kind not in LINE_KINDS)
        for zone in message.zones
    ]
    texts = [_text(zone.name, Pose2D(*zone.points[0], 0.0)) for zone in message.zones]
    return _update(_on_map(robot, "zones", message.stamp_ns, lines=lines, texts=texts))


def suspects(robot: str, message: Suspects) -> bytes:
    """Lines that behave like mirrors."""
    lines = [_line(line.points, SUSPECT_COLOUR) for line in message.lines if line.points]
    return _update(_on_map(robot, "suspects", message.stamp_ns, lines=lines))


def places(robot: str, message: SavedPoses, map_name: str | None) -> bytes:
    """The saved poses of a map; of all maps where it is not known which is used."""
    here = [place for place in message.poses if map_name in (None, place.map)]
    arrows = [_arrow(pose_message(place.pose, ABOVE_GROUND_M), ARROW_M) for place in here]
    texts = [_text(place.name, place.pose) for place in here]
    return _update(_on_map(robot, "places", message.stamp_ns, arrows=arrows, texts=texts))


def marker(robot: str, name: str, message: Marker, stamp_ns: int) -> bytes:
    """A marker; Foxglove has no icons, so an icon is its name."""
    at = pose_message(message.pose, message.z)
    size = fox.Vector3(x=message.size[0], y=message.size[1], z=message.size[2])
    red, green, blue, alpha = message.color
    colour = fox.Color(r=red, g=green, b=blue, a=alpha)
    entity: dict[str, Any] = {
        "timestamp": timestamp(stamp_ns),
        "frame_id": frame_name(robot, message.frame),
        "id": f"{robot}/{name}",
        "lifetime": _duration(message.lifetime),
        "frame_locked": True,
    }
    shape: dict[str, Any]
    match message.kind:
        case "sphere":
            shape = {"spheres": [fox.SpherePrimitive(pose=at, size=size, color=colour)]}
        case "cube":
            shape = {"cubes": [fox.CubePrimitive(pose=at, size=size, color=colour)]}
        case "cylinder":
            round_one = fox.CylinderPrimitive(
                pose=at, size=size, color=colour, bottom_scale=1.0, top_scale=1.0
            )
            shape = {"cylinders": [round_one]}
        case "arrow":
            shape = {"arrows": [_arrow(at, message.size[0], colour)]}
        case "line":
            points = [fox.Point3(x=x, y=y, z=z) for x, y, z in message.points]
            line = fox.LinePrimitive(
                pose=at, thickness=message.size[1] or LINE_M, points=points, color=colour
            )
            shape = {"lines": [line]}
        case "text" | "icon":
            text = fox.TextPrimitive(
                pose=at,
                billboard=True,
                font_size=message.size[2] or TEXT_M,
                color=colour,
                text=message.text or message.icon,
            )
            shape = {"texts": [text]}
    return _update(fox.SceneEntity(**entity, **shape))


def deletions(robot: str, names: Iterable[str], stamp_ns: int) -> bytes:
    """Markers that were deleted."""
    gone = [
        fox.SceneEntityDeletion(timestamp=timestamp(stamp_ns), id=f"{robot}/{name}")
        for name in names
    ]
    return fox.SceneUpdate(deletions=gone).encode()


def _update(entity: fox.SceneEntity) -> bytes:
    return fox.SceneUpdate(entities=[entity]).encode()


def _on_map(
    robot: str,
    name: str,
    stamp_ns: int,
    lines: list[fox.LinePrimitive] | None = None,
    arrows: list[fox.ArrowPrimitive] | None = None,
    texts: list[fox.TextPrimitive] | None = None,
) -> fox.SceneEntity:
    return fox.SceneEntity(
        timestamp=timestamp(stamp_ns),
        frame_id=frame_name(robot, "map"),
        id=f"{robot}/{name}",
        lines=lines,
        arrows=arrows,
        texts=texts,
    )


def _duration(seconds: float) -> fox.Duration:
    whole = int(min(seconds, LONGEST_S))
    return fox.Duration(sec=whole, nsec=int(min(seconds, LONGEST_S) % 1.0 * 1e9))


def _colour(rgb: Rgb) -> fox.Color:
    return fox.Color(r=rgb[0], g=rgb[1], b=rgb[2], a=1.0)


def _line(
    points: Sequence[tuple[float, float]], rgb: Rgb, *, is_closed: bool = False
) -> fox.LinePrimitive:
    kind = fox.LinePrimitiveLineType
    return fox.LinePrimitive(
        type=kind.LineLoop if is_closed else kind.LineStrip,
        pose=pose_message(Pose2D.identity()),
        thickness=LINE_M,
        points=[fox.Point3(x=x, y=y, z=ABOVE_GROUND_M) for x, y in points],
        color=_colour(rgb),
    )


def _arrow(at: fox.Pose, length_m: float, colour: fox.Color | None = None) -> fox.ArrowPrimitive:
    return fox.ArrowPrimitive(
        pose=at,
        shaft_length=0.7 * length_m,
        shaft_diameter=0.15 * length_m,
        head_length=0.3 * length_m,
        head_diameter=0.4 * length_m,
        color=colour or _colour(PLACE_COLOUR),
    )


def _text(text: str, at: Pose2D) -> fox.TextPrimitive:
    return fox.TextPrimitive(
        pose=pose_message(at, TEXT_M),
        billboard=True,
        font_size=TEXT_M,
        color=_colour(TEXT_COLOUR),
        text=text,
    )
