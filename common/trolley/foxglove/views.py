"""Which channels of Foxglove show which topics, and with what schema."""

import dataclasses
import json
from collections.abc import Callable, Iterator, Set
from typing import Any, cast

import msgspec
from foxglove import Schema
from foxglove import messages as fox

from trolley import topics
from trolley.foxglove import convert, scene
from trolley.messages import Robot as RobotMessage
from trolley.messages import SavedPoses
from trolley.runtime.bus import matches
from trolley.topics import Topic

MARKERS = "scene/markers"


@dataclasses.dataclass(frozen=True)
class Channel:
    """A channel of each robot: `/<robot>/<name>`."""

    name: str
    encoding: str
    schema: Schema
    topics: tuple[Topic[Any], ...]
    """The keys to subscribe to for it."""

    def of(self, robot: str) -> str:
        """Its full name."""
        return f"/{robot}/{self.name}"


Encode = Callable[[str, Any], bytes | None]
_DRAWN: dict[str, tuple[Any, dict[Topic[Any], Encode]]] = {
    "scan": (fox.LaserScan, {topics.SCAN: convert.laser_scan}),
    "map": (fox.Grid, {topics.MAP: convert.grid}),
    "costmap": (fox.Grid, {topics.COSTMAP: convert.grid}),
    "costmap/global": (fox.Grid, {topics.COSTMAP_GLOBAL: convert.grid}),
    "path": (fox.PosesInFrame, {topics.PATH: convert.path}),
    "trajectory": (fox.PosesInFrame, {topics.TRAJECTORY: convert.path}),
    "tf": (
        fox.FrameTransforms,
        {topics.TF: convert.transform, topics.ODOM: convert.odometry_transform},
    ),
    "pose": (fox.PoseInFrame, {topics.POSE: convert.pose}),
    "particles": (fox.PointCloud, {topics.PARTICLES: convert.particles}),
    "scene/robot": (fox.SceneUpdate, {topics.ROBOT: scene.robot_outline}),
    "scene/zones": (fox.SceneUpdate, {topics.ZONES: scene.zones}),
    "scene/suspects": (fox.SceneUpdate, {topics.SUSPECTS: scene.suspects}),
}
"""Channels in Foxglove's own schemas."""
_PLACES = "scene/places"

_PLAIN: dict[str, Topic[Any]] = {
    "robot": topics.ROBOT,
    "clock": topics.CLOCK,
    "odom": topics.ODOM,
    "imu": topics.IMU,
    "cmd_vel": topics.CMD_VEL,
    "cmd_vel/wishes": topics.COMMAND,
    "base": topics.BASE,
    "zones": topics.ZONES,
    "pose/estimate": topics.POSE,
    "suspects": topics.SUSPECTS,
    "goal": topics.GOAL,
    "poses": topics.POSES,
    "tours": topics.TOURS,
    "tour": topics.TOUR,
    "choices": topics.CHOICE,
    "truth": topics.SIM_TRUTH,
    "health": topics.HEALTH,
}
"""Channels in JSON, for plots and tables; the key's varying chunk is one more field."""


def plain_schema(topic: Topic[Any]) -> dict[str, Any]:
    """The JSON schema of a message without what Foxglove does not read: unions, tuples, limits."""
    whole = msgspec.json.schema(topic.message)
    named = cast("dict[str, Any]", whole.get("$defs", {}))
    schema = _simplified(whole, named)
    added = {chunk.strip("{}"): {"type": "string"} for chunk in topic.chunks if "{" in chunk}
    properties = {**added, **schema.get("properties", {})}
    return {
        "title": f"trolley.{topic.message.__name__}",
        "type": "object",
        "properties": properties,
    }


def _simplified(schema: dict[str, Any], named: dict[str, Any]) -> dict[str, Any]:
    if "$ref" in schema:
        return _simplified(named[schema["$ref"].rpartition("/")[2]], named)
    if "anyOf" in schema:  # all unions of the wire are "something or null"
        return _simplified(next(one for one in schema["anyOf"] if one != {"type": "null"}), named)
    if "enum" in schema:
        return {"type": "string"}
    simple = {name: schema[name] for name in ("type", "contentEncoding") if name in schema}
    if "properties" in schema:
        inner = cast("dict[str, dict[str, Any]]", schema["properties"])
        simple["properties"] = {name: _simplified(one, named) for name, one in inner.items()}
    items = (schema.get("prefixItems") or [None])[0] or schema.get("items")
    if items:
        simple["items"] = _simplified(items, named)
    return simple


def _json_schema(topic: Topic[Any]) -> Schema:
    plain = plain_schema(topic)
    return Schema(name=plain["title"], encoding="jsonschema", data=json.dumps(plain).encode())


def _channels() -> Iterator[Channel]:
    for name, (kind, rows) in _DRAWN.items():
        yield Channel(name, "protobuf", kind.get_schema(), tuple(rows))
    drawing = fox.SceneUpdate.get_schema()
    yield Channel(_PLACES, "protobuf", drawing, (topics.POSES, topics.MAP))
    # The clock brings the moments to look which markers are gone.
    yield Channel(MARKERS, "protobuf", drawing, (topics.MARKER, topics.CLOCK))
    for name, topic in _PLAIN.items():
        yield Channel(name, "json", _json_schema(topic), (topic,))


CHANNELS: dict[str, Channel] = {channel.name: channel for channel in _channels()}
"""All channels of a robot, by name."""


class Views:
    """What is seen of one robot; keeps the map's name, the places and the markers' names."""

    def __init__(self, robot: str) -> None:
        self.robot = robot
        self._map_name: str | None = None
        self._places: SavedPoses | None = None
        self._markers: set[str] = set()

    def of(
        self, topic: Topic[Any], parts: tuple[str, ...], message: Any, now_ns: int
    ) -> Iterator[tuple[str, bytes]]:
        """The channels that a message is seen in, and what is seen.

        `now_ns` is robot time, for what has no stamp of its own.
        """
        if parts in topic.get_only_parts:  # the odometry says it for every moment
            return
        for name, (_, rows) in _DRAWN.items():
            if topic in rows:
                data = rows[topic](self.robot, message)
                if data is not None:
                    yield name, data
        if self._changes_places(topic, message) and self._places is not None:
            yield _PLACES, scene.places(self.robot, self._places, self._map_name)
        if topic is topics.MARKER:
            self._markers.add("/".join(parts))
            yield MARKERS, scene.marker(self.robot, "/".join(parts), message, now_ns)
        for name, plain_topic in _PLAIN.items():
            if topic is plain_topic:
                yield name, _plain(topic, parts, message)

    def _changes_places(self, topic: Topic[Any], message: Any) -> bool:
        """Note the map and the places; whether the places have to be shown again."""
        if topic is topics.MAP:
            before, self._map_name = self._map_name, str(message.name)
            return before != self._map_name
        if topic is topics.POSES:
            self._places = message
        return topic is topics.POSES

    def without(self, key: str, now_ns: int) -> Iterator[tuple[str, bytes]]:
        """What is seen when the markers that `key` matches are deleted."""
        there = {
            name
            for name in self._markers
            if not matches(key, topics.MARKER.key(self.robot, *name.split("/")))
        }
        return self.left(there, now_ns)

    def left(self, there: Set[str], now_ns: int) -> Iterator[tuple[str, bytes]]:
        """What is seen when only these markers, `<ns>/<id>`, are left."""
        gone = self._markers - there
        self._markers -= gone
        if gone:
            yield MARKERS, scene.deletions(self.robot, sorted(gone), now_ns)


def _plain(topic: Topic[Any], parts: tuple[str, ...], message: Any) -> bytes:
    if isinstance(message, RobotMessage):  # a mesh is nothing to plot, and large
        message = msgspec.structs.replace(message, mesh=None)
    if not parts:
        return msgspec.json.encode(message)
    fields = [chunk.strip("{}") for chunk in topic.chunks if chunk.startswith("{")]
    plain = cast("dict[str, Any]", msgspec.to_builtins(message))
    return msgspec.json.encode({**dict(zip(fields, parts, strict=True)), **plain})
