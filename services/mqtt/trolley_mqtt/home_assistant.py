"""Tells Home Assistant what there is: entities of the robot, a button per place and tour."""

from collections.abc import Callable

from trolley_mqtt.announcements import Announcements
from trolley_mqtt.connection import Subscription
from trolley_mqtt.discovery import Device
from trolley_mqtt.outbox import ONLINE, Outbox
from trolley_mqtt.robot_inputs import RobotInputs

BIRTH_PAUSE_S = 10.0
"""A Home Assistant that says more often that it has started is not believed."""


class HomeAssistant:
    """The discovery topics below `prefix`; nothing is announced where that is empty.

    Args:
        robot: What can be announced.
        outbox: Where it is announced.
        device: The robot as a device.
        monotonic_ns: The local clock.
    """

    def __init__(
        self,
        robot: RobotInputs,
        outbox: Outbox,
        device: Device,
        monotonic_ns: Callable[[], int],
    ) -> None:
        self._robot = robot
        self._outbox = outbox
        self._device = device
        self._monotonic_ns = monotonic_ns
        self._announcements = Announcements(device)
        self._born_ns: int | None = None
        self._announced_ns: int | None = None

    @property
    def subscriptions(self) -> list[Subscription]:
        """What it must hear of."""
        if not self._device.prefix:
            return []
        return [
            Subscription(self._birth_topic),
            Subscription(self._device.all_topics, with_kept=True),
        ]

    def repeat(self) -> None:
        """Announce everything again, at the next `announce`."""
        self._announcements.repeat()
        self._announced_ns = None

    def update(self, topic: str, payload: bytes) -> bool:
        """Take a message; False where it is not for Home Assistant's sake."""
        if topic == self._birth_topic:
            self._update_birth(payload)
            return True
        return self._announcements.update(topic, is_empty=not payload)

    def announce(self) -> None:
        """Send what is new, and take back what is gone."""
        if not self._device.prefix:
            return
        names = self._robot.names if self._robot.knows_names else None
        for topic, payload in self._announcements.due(self._robot.battery, names):
            self._outbox.announce(topic, payload)
            if self._announced_ns is None:
                self._announced_ns = self._monotonic_ns()

    def problem(self, is_passed_on: Callable[[int], bool]) -> str:
        """Why nobody hears of what is announced, as a sentence; "" where that is not known.

        Args:
            is_passed_on: Whether the broker has passed on what was sent at this time.
        """
        is_due = self._announced_ns is not None and is_passed_on(self._announced_ns)
        if not is_due or self._announcements.is_heard:
            return ""
        return (
            "What is announced to Home Assistant does not arrive at the MQTT broker: may this "
            f"account read and write {self._device.prefix}/#?"
        )

    @property
    def _birth_topic(self) -> str:
        return f"{self._device.prefix}/status"

    def _update_birth(self, payload: bytes) -> None:
        """Say everything again to a Home Assistant that has just started."""
        now_ns, before_ns = self._monotonic_ns(), self._born_ns
        is_soon = before_ns is not None and now_ns - before_ns < BIRTH_PAUSE_S * 1e9
        if payload == ONLINE and not is_soon:
            self._born_ns = now_ns
            self._outbox.repeat()
            self.repeat()
