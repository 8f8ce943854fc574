"""What the bridge sends to the broker."""

from trolley_mqtt.connection import Connection

ONLINE, OFFLINE = b"online", b"offline"
ONLINE_FOR_S, ONLINE_AGAIN_S = 30, 10.0
"""The broker forgets so late that the bridge is there unless it is told so again. Where both lose
power at once nobody says that the bridge is gone, and the broker would remember it for good."""


class Outbox:
    """Sends while it is open; what the broker is to keep goes out only when it changed."""

    def __init__(self, connection: Connection, base_topic: str) -> None:
        self.is_open = False
        """Whether there is a connection."""
        self.base_topic = base_topic
        self._connection = connection
        self._kept: dict[str, bytes] = {}

    def topic(self, *parts: str) -> str:
        """A topic of this robot."""
        return "/".join((self.base_topic, *parts))

    def open(self) -> None:
        """Send everything anew: another broker, or one that forgot, may have answered."""
        self.is_open = True
        self.repeat()

    def repeat(self) -> None:
        """Send again what the broker is to keep, as it comes."""
        self._kept.clear()

    def keep(self, topic: str, payload: bytes) -> None:
        """Send what the broker is to keep, unless it has it."""
        if self._kept.get(topic) != payload:
            self._kept[topic] = payload
            self._connection.publish(topic, payload, keep=True)

    def keep_online(self) -> None:
        """Let the broker keep for a while that the bridge is there."""
        self._connection.publish(self.topic("bridge"), ONLINE, keep=True, valid_s=ONLINE_FOR_S)

    def announce(self, topic: str, payload: bytes) -> None:
        """Send what the broker is to keep, in any case."""
        self._connection.publish(topic, payload, keep=True)

    def send(self, topic: str, payload: bytes) -> None:
        """Send what the broker only passes on."""
        self._connection.publish(topic, payload, keep=False)
