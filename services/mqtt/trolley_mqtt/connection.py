"""The connection to the broker. Its thread only stores what arrives, and wakes."""

import ssl
import sys
import threading
import time
from collections import deque
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any, Protocol

from paho.mqtt.client import Client, ConnectFlags, DisconnectFlags, MQTTMessage
from paho.mqtt.enums import CallbackAPIVersion, MQTTErrorCode, MQTTProtocolVersion
from paho.mqtt.packettypes import PacketTypes
from paho.mqtt.properties import Properties
from paho.mqtt.reasoncodes import ReasonCode
from paho.mqtt.subscribeoptions import SubscribeOptions

from trolley.config import RobotConfig
from trolley_mqtt.credentials import read_secret, trust
from trolley_mqtt.unreachable import why_unreachable

KEEP_ALIVE_S = 10
"""A broker that is silent for this long, or half as long again, is taken for lost."""
FIRST_PAUSE_S, LONGEST_PAUSE_S = 1, 30
"""Between attempts to connect; doubled each time."""
MAX_STORED = 1024
"""Messages that wait for the service; more are dropped."""
MAX_RECEIVED = 1024
"""Bytes of a payload that are kept, and one more that shows that it was longer."""
MAX_PACKET = 65_535
"""The broker is asked to keep anything larger to itself."""
SHORT_S = 5.0
MANY_SHORT = 5
"""So many connections in a row that last no longer are taken away by somebody: of two clients of
one id each connects again a second after the other. Two or three a bad Wi-Fi ends, too."""
TAKEN_OVER = "Session taken over"
"""What brokers say who say it; Mosquitto 2.0 hangs up without a word."""
GOODBYE_S = 1.0
"""How long to wait for the last word to go out."""


@dataclass(frozen=True, slots=True)
class Connected:
    """The broker has accepted the connection."""


@dataclass(frozen=True, slots=True)
class Lost:
    """The connection was lost or refused: one sentence why."""

    why: str


@dataclass(frozen=True, slots=True)
class Arrived:
    """A message; `is_retained`: the sender asked the broker to keep it."""

    topic: str
    payload: bytes
    is_retained: bool


Event = Connected | Lost | Arrived


@dataclass(frozen=True, slots=True)
class Subscription:
    """Topics to hear of; `with_kept`: also what the broker keeps there."""

    topics: str
    with_kept: bool = False


@dataclass(frozen=True, slots=True, kw_only=True)
class Broker:
    """Where the broker is and how to log in."""

    host: str
    port: int
    client_id: str
    username: str = ""
    password: str = ""
    tls: ssl.SSLContext | None = None
    will: tuple[str, bytes]
    """A topic, and what the broker publishes and keeps there when the robot is gone."""


class Connection(Protocol):
    """A connection to a broker that reconnects by itself."""

    def start(self, subscriptions: Sequence[Subscription], wake: Callable[[], None]) -> None:
        """Begin to connect; `wake` is called, on any thread, when there is something to take."""
        ...

    def take_events(self) -> list[Event]:
        """What happened since the last call, oldest first."""
        ...

    def take_num_dropped(self) -> int:
        """How many messages were dropped since the last call because too many came."""
        ...

    def publish(self, topic: str, payload: bytes, *, keep: bool, valid_s: int = 0) -> None:
        """Send a message; the broker keeps it if asked to, `valid_s` at most where that is set."""
        ...

    def close(self) -> None:
        """Say goodbye."""
        ...


class NoConnection:
    """In place of a connection where no broker is named: nothing comes, nothing goes."""

    def start(self, subscriptions: Sequence[Subscription], wake: Callable[[], None]) -> None:
        """Nothing to connect to."""

    def take_events(self) -> list[Event]:
        """Nothing."""
        return []

    def take_num_dropped(self) -> int:
        """None."""
        return 0

    def publish(self, topic: str, payload: bytes, *, keep: bool, valid_s: int = 0) -> None:
        """To nobody."""

    def close(self) -> None:
        """Nobody is there to say goodbye to."""


class BrokerConnection:
    """The same by the library paho.

    Args:
        broker: Where, and how.
        precious: Messages of this topic push out others where too many wait.
    """

    def __init__(self, broker: Broker, precious: str) -> None:
        self._broker = broker
        self._precious = precious
        self._lock = threading.Lock()
        self._events: deque[Event] = deque()
        self._num_arrived = 0
        self._num_dropped = 0
        self._is_accepted: bool | None = None
        self._accepted_s = 0.0
        self._num_short = 0
        """Connections in a row that were lost soon after they had been accepted."""
        self._wake: Callable[[], None] = lambda: None
        self._subscriptions: Sequence[Subscription] = ()
        client = self._client = Client(
            CallbackAPIVersion.VERSION2, broker.client_id, protocol=MQTTProtocolVersion.MQTTv5
        )
        client.reconnect_delay_set(FIRST_PAUSE_S, LONGEST_PAUSE_S)
        if broker.username:
            client.username_pw_set(broker.username, broker.password)
        if broker.tls is not None:
            client.tls_set_context(broker.tls)
        topic, last_word = broker.will
        client.will_set(topic, last_word, qos=1, retain=True)
        client.on_connect = self._on_connect
        client.on_connect_fail = self._on_connect_fail
        client.on_disconnect = self._on_disconnect
        client.on_message = self._on_message

    def start(self, subscriptions: Sequence[Subscription], wake: Callable[[], None]) -> None:
        """Begin to connect."""
        self._subscriptions, self._wake = subscriptions, wake
        limits = Properties(PacketTypes.CONNECT)
        limits.MaximumPacketSize = MAX_PACKET
        # A clean start: the broker keeps nothing for us while we are away.
        self._client.connect_async(
            self._broker.host,
            self._broker.port,
            keepalive=KEEP_ALIVE_S,
            clean_start=True,
            properties=limits,
        )
        self._client.loop_start()

    def take_events(self) -> list[Event]:
        """What happened since the last call, oldest first."""
        with self._lock:
            events = list(self._events)
            self._events.clear()
            self._num_arrived = 0
        # Where a broken packet ended the thread it starts over; while it runs this does nothing.
        self._client.loop_start()
        return events

    def take_num_dropped(self) -> int:
        """How many messages were dropped since the last call because too many came."""
        with self._lock:
            dropped, self._num_dropped = self._num_dropped, 0
        return dropped

    def publish(self, topic: str, payload: bytes, *, keep: bool, valid_s: int = 0) -> None:
        """Send a message; without a connection it is gone."""
        properties = None
        if valid_s:
            properties = Properties(PacketTypes.PUBLISH)
            properties.MessageExpiryInterval = valid_s
        self._client.publish(topic, payload, qos=0, retain=keep, properties=properties)

    def close(self) -> None:
        """Say the last word ourselves, since the broker says it only for those who vanish."""
        if self._client.is_connected():
            topic, last_word = self._broker.will
            said = self._client.publish(topic, last_word, qos=1, retain=True)
            until_s = time.monotonic() + GOODBYE_S
            # paho calls itself connected for a moment after the broker has said goodbye.
            is_sent = said.rc == MQTTErrorCode.MQTT_ERR_SUCCESS
            while is_sent and not said.is_published() and time.monotonic() < until_s:
                time.sleep(0.01)
        self._client.disconnect()
        self._client.loop_stop()

    @property
    def _where(self) -> str:
        return f"{self._broker.host}:{self._broker.port}"

    # On the thread of paho.
    def _on_connect(
        self,
        client: Client,
        _data: Any,
        _flags: ConnectFlags,
        reason: ReasonCode,
        _properties: Properties | None,
    ) -> None:
        self._is_accepted, self._accepted_s = not reason.is_failure, time.monotonic()
        if reason.is_failure:
            self._store(Lost(f"The MQTT broker refuses the connection: {reason}."))
            return
        self._store(Connected())
        for subscription in self._subscriptions:
            kept = (
                SubscribeOptions.RETAIN_SEND_ON_SUBSCRIBE
                if subscription.with_kept
                else SubscribeOptions.RETAIN_DO_NOT_SEND
            )
            options = SubscribeOptions(qos=0, retainAsPublished=True, retainHandling=kept)
            client.subscribe(subscription.topics, options=options)

    def _on_connect_fail(self, _client: Client, _data: Any) -> None:
        error = sys.exc_info()[1]  # paho calls this while it handles it
        if self._broker.tls and isinstance(error, ConnectionResetError):
            error = ssl.SSLError()  # Mosquitto hangs up on a TLS greeting at a plain port
        why = why_unreachable(
            error if isinstance(error, OSError) else OSError(),
            self._client.connect_timeout,
            "is this its port without TLS?",
        )
        self._store(Lost(f"The MQTT broker at {self._where} {why}."))

    def _on_disconnect(
        self,
        _client: Client,
        _data: Any,
        _flags: DisconnectFlags,
        reason: ReasonCode,
        _properties: Properties | None,
    ) -> None:
        accepted, self._is_accepted = self._is_accepted, None
        if accepted:
            is_short = time.monotonic() - self._accepted_s < SHORT_S
            self._num_short = self._num_short + 1 if is_short else 0
            self._store(Lost(self._why_lost(reason)))
        elif accepted is None:  # else its reason has been said
            hint = "" if self._broker.tls else "; is it a port for TLS? Then set [mqtt] tls = true"
            why = f"What listens at {self._where} does not answer as an MQTT 5 broker does{hint}."
            self._store(Lost(why))

    def _why_lost(self, reason: ReasonCode) -> str:
        if reason == TAKEN_OVER:
            what = "Another client has taken over the connection to the MQTT broker"
        elif self._num_short >= MANY_SHORT:
            what = "The MQTT broker ends each connection within seconds"
        else:
            return f"The connection to the MQTT broker was lost: {reason}."
        return (
            f"{what}: is there another robot with the same name? Only one client may be called "
            f"{self._broker.client_id}."
        )

    def _on_message(self, _client: Client, _data: Any, message: MQTTMessage) -> None:
        try:
            topic = message.topic
        except UnicodeDecodeError:
            topic = ""
        payload = bytes(message.payload[: MAX_RECEIVED + 1])
        self._store(Arrived(topic, payload, message.retain))

    def _store(self, event: Event) -> None:
        with self._lock:
            if isinstance(event, Arrived) and not self._has_room(event):
                self._num_dropped += 1
                return
            self._events.append(event)
            is_first = len(self._events) == 1
        if is_first:
            self._wake()

    def _has_room(self, event: Arrived) -> bool:
        if self._num_arrived < MAX_STORED:
            self._num_arrived += 1
            return True
        if event.topic != self._precious:
            return False
        for index, other in enumerate(self._events):
            if isinstance(other, Arrived) and other.topic != self._precious:
                del self._events[index]
                self._num_dropped += 1
                return True
        return False


def broker_of(config: RobotConfig, will: tuple[str, bytes]) -> Broker:
    """The broker that the configuration names.

    Raises:
        ConfigError: A file cannot be read.
    """
    mqtt = config.mqtt
    host, port = mqtt.address
    password = ""
    if mqtt.password_file:
        password = read_secret(config, "[mqtt] password_file", mqtt.password_file)
    tls = trust(config, "[mqtt] tls_ca", mqtt.tls_ca) if mqtt.is_encrypted else None
    return Broker(
        host=host,
        port=port,
        client_id=f"trolley-{config.robot.name}",
        username=mqtt.username,
        password=password,
        tls=tls,
        will=will,
    )
