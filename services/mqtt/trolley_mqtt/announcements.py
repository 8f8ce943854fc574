"""What Home Assistant has been told there is, and what is yet to be told or taken back."""

import json
from collections.abc import Iterator

from trolley.messages import Battery
from trolley_mqtt.discovery import Device, buttons, entities

MAX_KEPT = 2000
"""Announcements at the broker that are remembered; a stranger may send any number."""


class Announcements:
    """Which entities have been announced to Home Assistant, and which are due."""

    def __init__(self, device: Device) -> None:
        self._device = device
        self._announced: dict[str, bytes] = {}
        self._kept: set[str] = set()
        """Topics of this robot at which the broker keeps something, of earlier runs too."""
        self._has_battery = self._has_charging = False
        self.is_heard = False
        """Whether any announcement has come back since they were all sent."""

    def repeat(self) -> None:
        """Announce everything again."""
        self._announced.clear()
        self.is_heard = False

    def update(self, topic: str, *, is_empty: bool) -> bool:
        """Take what the broker keeps; False where it is not an announcement of this robot."""
        parts = topic.split("/")
        prefix = self._device.prefix.split("/")
        if not self._device.prefix or parts[: len(prefix)] != prefix:
            return False
        rest = parts[len(prefix) :]
        if len(rest) != 4 or rest[1] != self._device.node or rest[3] != "config":
            return False
        self.is_heard = True
        if is_empty:
            self._kept.discard(topic)
        elif len(self._kept) < MAX_KEPT:
            self._kept.add(topic)
        return True

    def due(
        self, battery: Battery | None, names: tuple[list[str], list[str]] | None
    ) -> Iterator[tuple[str, bytes]]:
        """Topics and payloads to send now, empty ones to take something back.

        Args:
            battery: The newest; once one was known it stays announced.
            names: Of places and tours; None: not known yet, so nothing is taken back.
        """
        if battery is not None:
            self._has_battery |= battery.fraction is not None
            self._has_charging |= battery.charging is not None
        wanted = entities(
            self._device, has_battery=self._has_battery, has_charging=self._has_charging
        )
        if names is not None:
            wanted |= buttons(self._device, *names)
        for topic, content in wanted.items():
            payload = json.dumps(content, ensure_ascii=False).encode()
            if self._announced.get(topic) != payload:
                self._announced[topic] = payload
                yield topic, payload
        if names is None:
            return
        for topic in sorted((self._kept | self._announced.keys()) - wanted.keys() - self._lasting):
            self._kept.discard(topic)
            self._announced.pop(topic, None)
            yield topic, b""

    @property
    def _lasting(self) -> set[str]:
        """What is never taken back: a battery that has not been heard of yet may well come."""
        device = self._device
        return {device.topic("sensor", "battery"), device.topic("binary_sensor", "charging")}
