"""The bridge: tells an MQTT broker what the robot does, and takes a few commands from there."""

import importlib.metadata
import ssl
from collections.abc import Callable

import msgspec
from msgspec import structs

from trolley import requests, topics
from trolley.codes import Refused
from trolley.config import ConfigError, RobotConfig
from trolley.messages import SavedPose
from trolley.messages.request_params import Nothing
from trolley.runtime.service import Service, every
from trolley_mqtt import commands
from trolley_mqtt.announcements import Announcements
from trolley_mqtt.commands import Order, name_in, order_of
from trolley_mqtt.connection import Arrived, Broker, BrokerLink, Connected, Interest, Link, Lost
from trolley_mqtt.discovery import Device
from trolley_mqtt.freshness import Freshness
from trolley_mqtt.sentences import Known, State, tell

ONLINE, OFFLINE = b"online", b"offline"
MAX_EACH_SECOND = 8
"""Commands that are looked at; more are dropped."""
STOP_AGAIN_S = 0.5
STOP_FOR_S = 60.0
"""A stop that nobody answers is repeated for so long."""
BIRTH_PAUSE_S = 10.0
NOT_STOPPED = "NOT STOPPED: no connection to the robot."


class MqttService(Service):
    """Between the robot and an MQTT broker.

    Args:
        config: The robot's; it names the broker.
        connect: Makes the connection; tests put a broker of their own in its place.

    Raises:
        ConfigError: There is no broker, or its password or certificates cannot be read.
    """

    name = "mqtt"

    def __init__(
        self, config: RobotConfig, connect: Callable[[Broker, str], Link] = BrokerLink
    ) -> None:
        robot = config.robot
        self._config = config.mqtt
        self._base_topic = config.mqtt.base_topic or f"{topics.ROOT}/{robot.name}"
        will = (self._topic("bridge"), OFFLINE)
        self._link = connect(broker_of(config, will), self._topic("do", commands.STOP))
        self._device = Device(
            robot=robot.name,
            title=robot.title or robot.name,
            version=importlib.metadata.version("trolley"),
            base_topic=self._base_topic,
            prefix=config.mqtt.discovery_prefix,
        )
        self._announcements = Announcements(self._device)
        self._is_up = False
        self._answer: str | None = None
        self._said: dict[str, bytes] = {}
        self._num_this_second = 0
        self._stop_until_ns: int | None = None
        self._born_ns: int | None = None

    def start(self) -> None:
        """Watch what is told, and begin to connect."""
        self._freshness = Freshness(self.new_id())
        self._base = self.watch(topics.BASE)
        self._pose = self.watch(topics.POSE)
        self._goal = self.watch(topics.GOAL)
        self._trip = self.watch(topics.TOUR)
        self._poses = self.watch(topics.POSES)
        self._tours = self.watch(topics.TOURS)
        interests = [Interest(self._topic("do", "+")), Interest(self._topic("echo"))]
        if self._config.discovery_prefix:
            interests += [
                Interest(self._birth_topic),
                Interest(self._device.all_topics, with_kept=True),
            ]
        self.set_health("degraded", "The MQTT broker has not answered yet.")
        self._link.start(interests, lambda: self.call_soon(self._hear_all, urgent=True))

    def stop(self) -> None:
        """Tell the broker that the bridge is gone."""
        self._link.close()

    def _topic(self, *parts: str) -> str:
        return "/".join((self._base_topic, *parts))

    @property
    def _birth_topic(self) -> str:
        return f"{self._config.discovery_prefix}/status"

    # What the broker says.
    def _hear_all(self) -> None:
        for event in self._link.take():
            match event:
                case Connected():
                    self._greet()
                case Lost(why):
                    self._is_up = False
                    self.set_health("degraded", why)
                    self.log.limited("lost", "No connection to the MQTT broker", why=why)
                case Arrived():
                    self._hear(event)
        dropped = self._link.take_dropped()
        if dropped:
            self.count("command/flood", dropped)
            self.log.limited("flood", "Too much comes from the MQTT broker", dropped=dropped)

    def _greet(self) -> None:
        """Say everything anew: another broker, or one that forgot, may have answered."""
        self._is_up = True
        self.set_health("ok")
        self._freshness.renew()
        self._said.clear()
        self._announcements.repeat()
        self.log.info("Connected to the MQTT broker", base_topic=self._base_topic)
        self._send(self._topic("bridge"), ONLINE)
        self._speak()

    def _hear(self, message: Arrived) -> None:
        if message.topic == self._topic("echo"):
            self._freshness.hear(message.payload)
        elif message.topic == self._birth_topic:
            self._hear_birth(message.payload)
        elif self._announcements.hear(message.topic, is_empty=not message.payload):
            return
        elif message.topic.startswith(self._topic("do", "")):
            self._obey(message.topic.rpartition("/")[2], message)
        else:
            self.count("command/unknown")

    def _hear_birth(self, payload: bytes) -> None:
        """Announce everything again to a Home Assistant that has just started."""
        now_ns, before_ns = self.monotonic_ns, self._born_ns
        paused = before_ns is not None and now_ns - before_ns < BIRTH_PAUSE_S * 1e9
        if payload == ONLINE and not paused:
            self._born_ns = now_ns
            self._said.clear()
            self._announcements.repeat()

    # Commands.
    def _obey(self, verb: str, message: Arrived) -> None:
        """Carry out a command, or drop it and say why."""
        if verb not in commands.VERBS:
            self._drop("unknown", verb[:40], "there is no such command")
        elif verb == commands.STOP:
            self._stop_until_ns = self.monotonic_ns + int(STOP_FOR_S * 1e9)
            self._ask_stop()
        elif message.is_retained:
            # A broker could give it to the robot again and again, days later too.
            self._drop("retained", verb, "a command must not be a retained message")
        elif not self._freshness.is_fresh(self.monotonic_ns):
            self._drop("stale", verb, "it may have waited for long on its way")
        elif self._num_this_second >= MAX_EACH_SECOND:
            self._drop("flood", verb, "too many commands at once")
        else:
            self._num_this_second += 1
            self._ask(verb, message.payload)

    def _drop(self, reason: str, verb: str, why: str) -> None:
        self.count(f"command/{reason}")
        self.log.limited(f"command/{reason}", "Command dropped", command=verb, why=why)

    def _ask(self, verb: str, payload: bytes) -> None:
        try:
            name = name_in(payload) if verb in commands.NAMED else ""
            names = ([one.name for one in self._places], self._tour_names)
            known = (self._goal.latest, self._trip.latest)
            order = order_of(verb, name, known, names, self.new_id())
        except Refused as refused:
            self.count("command/refused")
            self._tell_answer(f"Not done: {refused.message}")
            return
        self.log.info("Command", command=order.title)
        self.request(order.request, order.params, lambda reply: self._hear_reply(order, reply))

    def _hear_reply(self, order: Order, reply: object) -> None:
        if isinstance(reply, Refused):
            self.count("command/refused")
            self._tell_answer(f"{order.title}: not done: {reply.message}")
        else:
            self._tell_answer(f"{order.title}: {order.done}.")

    def _ask_stop(self) -> None:
        self.request(requests.BASE_STOP, Nothing(), self._hear_stopped, timeout_s=STOP_AGAIN_S)

    def _hear_stopped(self, reply: object) -> None:
        if not isinstance(reply, Refused):
            self._stop_until_ns = None
            self._tell_answer("Stop: done.")
        elif self._stop_until_ns is not None:
            self._tell_answer(NOT_STOPPED)

    @every(STOP_AGAIN_S, clock="local")
    def _stop_again(self) -> None:
        """Repeat a stop that nobody has answered."""
        if self._stop_until_ns is None:
            return
        if self.monotonic_ns < self._stop_until_ns:
            self._ask_stop()
        else:
            self._stop_until_ns = None

    def _tell_answer(self, answer: str) -> None:
        self._answer = answer
        self._tell()

    # What the broker is told.
    @every(1.0, clock="local")
    def _beat(self) -> None:
        self._num_this_second = 0
        self._hear_all()
        if self._is_up:
            self._speak()

    def _speak(self) -> None:
        """Prove that the connection is alive, and say what is new."""
        mark = self._freshness.mark(self.monotonic_ns)
        self._link.publish(self._topic("echo"), mark, keep=False)
        self._announce()
        self._tell()

    def _tell(self) -> None:
        """Say what has changed."""
        if not self._is_up:
            return
        state = self._state()
        self._send(self._topic("robot"), OFFLINE if state.activity == "away" else ONLINE)
        self._send(self._topic("state"), msgspec.json.encode(state))

    def _send(self, topic: str, payload: bytes) -> None:
        if self._said.get(topic) != payload:
            self._said[topic] = payload
            self._link.publish(topic, payload, keep=True)

    def _announce(self) -> None:
        if not self._config.discovery_prefix:
            return
        base = self._base.latest
        places, tours = self._poses.latest, self._tours.latest
        names = None
        if places is not None and tours is not None:
            names = ([one.name for one in self._places], self._tour_names)
        battery = None if base is None else base.battery
        for topic, payload in self._announcements.due(battery, names):
            self._link.publish(topic, payload, keep=True)

    def _state(self) -> State:
        now_ns, pose = self.now_ns, self._pose.latest
        age_s = None
        if pose is not None and now_ns is not None:
            age_s = (now_ns - pose.stamp_ns) * 1e-9
        known = Known(
            is_away=now_ns is None,
            base=self._base.latest,
            estimate=pose,
            age_s=age_s,
            goal=self._goal.latest,
            trip=self._trip.latest,
            places=self._places,
        )
        state = tell(known, self._answer)
        if self._stop_until_ns is not None and self._answer == NOT_STOPPED:
            return structs.replace(state, message=NOT_STOPPED, problem=True)
        return state

    @property
    def _places(self) -> list[SavedPose]:
        """The saved places on the robot's map; all of them while that is unknown."""
        poses, pose = self._poses.latest, self._pose.latest
        found = [] if poses is None else poses.poses
        return [one for one in found if pose is None or one.map == pose.map]

    @property
    def _tour_names(self) -> list[str]:
        return [] if self._tours.latest is None else [one.name for one in self._tours.latest.tours]


def broker_of(config: RobotConfig, will: tuple[str, bytes]) -> Broker:
    """Where the broker is and how to be let in.

    Raises:
        ConfigError: No broker is named, or a file cannot be read.
    """
    mqtt = config.mqtt
    if not mqtt.broker:
        raise ConfigError("[mqtt] broker is not set: name the MQTT broker, or do not run `mqtt`")
    host, port = mqtt.address
    password = ""
    if mqtt.password_file:
        path = config.path(mqtt.password_file)
        try:
            password = path.read_text(encoding="utf-8").partition("\n")[0].strip()
        except (OSError, UnicodeDecodeError) as error:
            raise ConfigError(f"[mqtt] password_file {path} cannot be read: {error}") from error
    tls = None
    if mqtt.is_encrypted:
        authority = str(config.path(mqtt.tls_ca)) if mqtt.tls_ca else None
        try:
            tls = ssl.create_default_context(cafile=authority)
        except OSError as error:
            raise ConfigError(f"[mqtt] tls_ca {authority} cannot be used: {error}") from error
    return Broker(
        host=host,
        port=port,
        client_id=f"trolley-{config.robot.name}",
        username=mqtt.username,
        password=password,
        tls=tls,
        will=will,
    )
