"""Home Assistant's MQTT discovery: one retained message per entity, all of one device.

Single-component messages, since places and tours come and go: an empty message takes an entity
away, and other programs than Home Assistant understand them, too.
https://www.home-assistant.io/integrations/mqtt/#mqtt-discovery
"""

import dataclasses
import hashlib
import unicodedata
from collections.abc import Sequence
from typing import Any

from trolley.names import canonical
from trolley_mqtt import remote_commands
from trolley_mqtt.events import EVENT_TYPES
from trolley_mqtt.robot_view import PLACED, POSITIONS
from trolley_mqtt.sentences import ACTIVITIES

Payload = dict[str, Any]

MAX_BUTTONS = 100
"""Of places, and as many of tours; nobody presses more, and a broker keeps them all."""


ALSO_AWAY: Payload = {"availability": [{"topic": "~/bridge"}]}
"""What is of use while the robot is not heard of: to stop it, and what the bridge says of it."""


@dataclasses.dataclass(frozen=True)
class Device:
    """What the entities say of the robot."""

    robot: str
    title: str
    version: str
    base_topic: str
    prefix: str
    has_map: bool = True
    """Whether pictures of the map are sent."""

    @property
    def node(self) -> str:
        """Its part of every discovery topic."""
        return f"trolley_{self.robot}"

    def topic(self, component: str, object_id: str) -> str:
        """The discovery topic of an entity."""
        return f"{self.prefix}/{component}/{self.node}/{object_id}/config"

    @property
    def all_topics(self) -> str:
        """Matches the discovery topics of all its entities."""
        return f"{self.prefix}/+/{self.node}/+/config"


def entities(device: Device, *, has_battery: bool, has_charging: bool) -> dict[str, Payload]:
    """Everything but places and tours: discovery topic to payload."""
    sensor, binary, button = "sensor", "binary_sensor", "button"
    found = {
        (sensor, "activity"): _value("Activity", "activity", "mdi:robot")
        | {"device_class": "enum", "options": list(ACTIVITIES)}
        | ALSO_AWAY,
        (sensor, "message"): _value("Message", "message", "mdi:message-text") | ALSO_AWAY,
        (sensor, "place"): _value("Place", "place", "mdi:map-marker"),
        (sensor, "room"): _value("Room", "room", "mdi:floor-plan"),
        (sensor, "destination"): _value("Destination", "destination", "mdi:map-marker-path"),
        (sensor, "tour"): _value("Tour", "tour", "mdi:routes"),
        (sensor, "position"): _value("Position", "position", "mdi:crosshairs-gps")
        | {"device_class": "enum", "options": list(POSITIONS), "entity_category": "diagnostic"},
        (sensor, "answer"): _value("Last answer", "answer", "mdi:message-alert")
        | {"entity_category": "diagnostic"}
        | ALSO_AWAY,
        ("event", "event"): {
            "name": "Event",
            "state_topic": "~/event",
            "event_types": list(EVENT_TYPES),
            "icon": "mdi:bell",
        },
        # No name of its own: it is the device. "Stop" is a button, for it takes effect in any case.
        ("vacuum", "vacuum"): {
            "name": None,
            "state_topic": "~/vacuum",
            "command_topic": f"~/do/{remote_commands.VACUUM}",
            "supported_features": ["start", "pause", "return_home", "locate"],
            "payload_start": remote_commands.START,
            "payload_pause": remote_commands.PAUSE,
            "payload_return_to_base": remote_commands.RETURN,
            "payload_locate": remote_commands.LOCATE,
            "icon": "mdi:robot",
        },
        # On while a stop has no answer; else nobody knows of a robot that is away.
        (binary, "problem"): _flag("Problem", "problem")
        | {
            "value_template": "{{ 'ON' if value_json.problem else "
            "'None' if value_json.activity == 'away' else 'OFF' }}"
        }
        | ALSO_AWAY,
        (button, "stop"): _button("Stop", remote_commands.STOP, "mdi:hand-back-right") | ALSO_AWAY,
        (button, "pause"): _button("Pause", remote_commands.PAUSE, "mdi:pause"),
        (button, "resume"): _button("Continue", remote_commands.RESUME, "mdi:play"),
        (button, "cancel"): _button("Cancel", remote_commands.CANCEL, "mdi:cancel"),
    }
    if device.has_map:
        found["image", "map"] = {
            "name": "Map",
            "image_topic": "~/map",
            "content_type": "image/png",
            "icon": "mdi:map",
        }
    if has_battery:
        found[sensor, "battery"] = _value("Battery", "battery", None) | {
            "device_class": "battery",
            "state_class": "measurement",
            "unit_of_measurement": "%",
        }
    if has_charging:
        found[binary, "charging"] = _flag("Charging", "charging") | {
            "device_class": "battery_charging"
        }
    return _addressed(device, found)


def buttons(device: Device, places: Sequence[str], tours: Sequence[str]) -> dict[str, Payload]:
    """A button per place and per tour: discovery topic to payload."""
    found: dict[tuple[str, str], Payload] = {}
    for verb, title, icon, names in (
        (remote_commands.GO, "Go to", "mdi:map-marker-right", places),
        (remote_commands.TOUR, "Tour", "mdi:routes", tours),
    ):
        for name in sorted(names)[:MAX_BUTTONS]:
            found["button", f"{verb}_{slug(name)}"] = _button(f"{title} {name}", verb, icon) | {
                "payload_press": name
            }
    return _addressed(device, found)


def slug(name: str) -> str:
    """A name as an object id: [a-z0-9_], and a sum that keeps "Küche" and "Kuche" apart."""
    plain = unicodedata.normalize("NFKD", name).encode("ascii", "ignore").decode().lower()
    word = "_".join("".join(c if c.isalnum() else " " for c in plain).split())
    digest = hashlib.sha256(canonical(name).encode()).hexdigest()[:8]
    return f"{word[:40]}_{digest}".lstrip("_")


def _value(name: str, field: str, icon: str | None) -> Payload:
    # Home Assistant shows "None" as unknown (2024.3 still as this word).
    shown = {"name": name, "state_topic": "~/state", "value_template": _read(field)}
    return shown if icon is None else shown | {"icon": icon}


def _read(field: str) -> str:
    words = {
        "place": "elsewhere",
        "room": "none",
        "destination": "nowhere",
        "tour": "none",
        "answer": "none",
    }
    default = f" or '{words[field]}'" if field in words else ""
    if field in ("place", "room"):  # a robot that is lost may be in any
        default = f" or ('{words[field]}' if value_json.position in {list(PLACED)} else none)"
    return f"{{{{ value_json.{field}{default} }}}}"


def _flag(name: str, field: str) -> Payload:
    return {
        "name": name,
        "state_topic": "~/state",
        "value_template": f"{{{{ 'ON' if value_json.{field} else 'OFF' }}}}",
        "device_class": "problem",
    }


def _button(name: str, verb: str, icon: str) -> Payload:
    return {"name": name, "command_topic": f"~/do/{verb}", "icon": icon, "qos": 0, "retain": False}


def _addressed(device: Device, found: dict[tuple[str, str], Payload]) -> dict[str, Payload]:
    """With the device and the identity that every entity says again."""
    common: Payload = {
        "~": device.base_topic,
        "availability": [{"topic": "~/bridge"}, {"topic": "~/robot"}],
        "availability_mode": "all",
        "origin": {"name": "Trolley", "sw_version": device.version},
        "device": {
            "identifiers": [device.node],
            "name": device.title,
            "manufacturer": "Trolley",
            "sw_version": device.version,
        },
    }
    return {
        device.topic(component, object_id): common
        | payload
        | {"unique_id": f"{device.node}_{object_id}"}
        for (component, object_id), payload in found.items()
    }
