"""The bridge: tells an MQTT broker what the robot does, and takes a few commands from there.

What happens is an event, which goes to the broker and to web addresses; either may be missing.
"""

import importlib.metadata
from collections.abc import Callable
from functools import partial

import msgspec

from trolley import topics
from trolley.config import ConfigError, RobotConfig
from trolley.runtime.service import Service, every
from trolley_mqtt.connection import (
    Arrived,
    Broker,
    BrokerConnection,
    Connected,
    Connection,
    Lost,
    NoConnection,
    Subscription,
    broker_of,
)
from trolley_mqtt.discovery import Device
from trolley_mqtt.events import Events, Happened, located_of
from trolley_mqtt.freshness import Freshness
from trolley_mqtt.home_assistant import HomeAssistant
from trolley_mqtt.map_image import MapImage
from trolley_mqtt.outbox import OFFLINE, ONLINE_AGAIN_S, Outbox
from trolley_mqtt.remote_commands import STOP
from trolley_mqtt.remote_control import RemoteControl
from trolley_mqtt.remote_stop import RemoteStop
from trolley_mqtt.robot_inputs import RobotInputs
from trolley_mqtt.state_report import StateReport
from trolley_mqtt.webhook import Report, Webhook, endpoints_of, notification


class MqttService(Service):
    """The bridge between the robot and an MQTT broker, and to webhooks.

    Args:
        config: The robot's; it names the broker.
        connect: Makes the connection; tests put a broker of their own in its place.

    Raises:
        ConfigError: There is neither broker nor webhook, or a file of theirs cannot be read.
    """

    name = "mqtt"

    def __init__(
        self, config: RobotConfig, connect: Callable[[Broker, str], Connection] = BrokerConnection
    ) -> None:
        self._robot = robot = config.robot
        if not config.mqtt.broker and not config.webhook.urls:
            raise ConfigError(
                "neither [mqtt] broker nor [webhook] urls is set: name one, or do not run `mqtt`"
            )
        base_topic = config.mqtt.base_topic or f"{topics.ROOT}/{robot.name}"
        self._connection = NoConnection()
        self._broker_problem = ""
        if config.mqtt.broker:
            broker = broker_of(config, will=(f"{base_topic}/bridge", OFFLINE))
            self._connection = connect(broker, f"{base_topic}/do/{STOP}")
            self._broker_problem = "The MQTT broker has not answered yet."
        self._outbox = Outbox(self._connection, base_topic)
        self.robot_inputs = RobotInputs(self)
        device = Device(
            robot=robot.name,
            title=robot.title or robot.name,
            version=importlib.metadata.version("trolley-robot"),
            base_topic=base_topic,
            prefix=config.mqtt.discovery_prefix,
            has_map=config.mqtt.map_every_s > 0.0,
        )
        self._home_assistant = HomeAssistant(
            self.robot_inputs, self._outbox, device, lambda: self.monotonic_ns
        )
        self._report = StateReport(self.robot_inputs, self._outbox)
        self._events = Events()
        self._wanted = frozenset(config.webhook.events)
        endpoints = endpoints_of(config)
        self._webhooks = [
            Webhook(endpoint, partial(self._hear, index))
            for index, endpoint in enumerate(endpoints)
        ]
        self._webhook_problems = [""] * len(endpoints)
        self._map_image = MapImage(self, self.robot_inputs, self._outbox, config.mqtt.map_every_s)
        self._freshness = Freshness()
        stop = RemoteStop(self, self._report)
        self._remote = RemoteControl(
            self,
            self.robot_inputs,
            self._report,
            stop,
            self._freshness,
            config.mqtt.start_tour,
            self._locate,
        )
        self.parts = (stop, self.robot_inputs)

    def start(self) -> None:
        """Watch the robot, and begin to connect."""
        self._freshness.start(self.new_id())
        self.robot_inputs.start(self._tell_news)
        subscriptions = [
            Subscription(self._outbox.topic("do", "+")),
            Subscription(self._outbox.topic("echo")),
            *self._home_assistant.subscriptions,
        ]
        self._say_health()
        for webhook in self._webhooks:
            webhook.start()
        self._connection.start(
            subscriptions, lambda: self.call_soon(self._take_events, urgent=True)
        )

    def stop(self) -> None:
        """Tell the broker that the bridge is gone."""
        self._connection.close()
        for webhook in self._webhooks:
            webhook.close()

    def _say_health(self) -> None:
        problems = [one for one in (self._broker_problem, *self._webhook_problems) if one]
        self.set_health("degraded" if problems else "ok", " ".join(problems))

    def _update_broker(self, problem: str) -> None:
        self._broker_problem = problem
        self._say_health()

    def _hear(self, index: int, report: Report) -> None:
        """What became of a notification; on the webhook's thread."""
        self.call_soon(lambda: self._update_webhook(index, report))

    def _update_webhook(self, index: int, report: Report) -> None:
        self.count("webhook/sent", report.num_sent)
        self.count("webhook/lost", report.num_dropped)
        if report.problem and report.problem != self._webhook_problems[index]:
            self.log.limited(f"webhook {index}", report.problem)
        self._webhook_problems[index] = report.problem
        self._say_health()

    def _take_events(self) -> None:
        for event in self._connection.take_events():
            match event:
                case Connected():
                    self._greet()
                case Lost(why):
                    self._outbox.is_open = False
                    self._update_broker(why)
                    self.log.limited("lost", "No connection to the MQTT broker", why=why)
                case Arrived():
                    self._update(event)
        dropped = self._connection.take_num_dropped()
        if dropped:
            self.count("command/flood", dropped)
            self.log.limited("flood", "The MQTT broker sends too much", dropped=dropped)

    def _greet(self) -> None:
        """Say everything on a new connection."""
        self._update_broker("")
        self._freshness.renew()
        self._outbox.open()
        self._home_assistant.repeat()
        self._map_image.repeat()
        self.log.info("Connected to the MQTT broker", base_topic=self._outbox.base_topic)
        self._outbox.keep_online()
        self._speak()

    def _update(self, message: Arrived) -> None:
        if message.topic == self._outbox.topic("echo"):
            self._freshness.update(message.payload)
        elif self._home_assistant.update(message.topic, message.payload):
            return
        elif message.topic.startswith(self._outbox.topic("do", "")):
            self._remote.execute(message.topic.rpartition("/")[2], message)
        else:
            self.count("command/unknown")

    @every(1.0, clock="local")
    def _beat(self) -> None:
        self._remote.begin_second()
        self._take_events()
        if self._outbox.is_open:
            self._check_echo()
            self._speak()
            self._map_image.update()
        self._tell_news()

    @every(ONLINE_AGAIN_S, clock="local")
    def _stay_online(self) -> None:
        if self._outbox.is_open:
            self._outbox.keep_online()

    def _check_echo(self) -> None:
        """Notice a broker that passes nothing on: mostly an account's rights."""
        problem = self._home_assistant.problem(self._freshness.is_passed_on)
        if self._freshness.is_cut_off():
            problem = (
                "Commands from the MQTT broker do not arrive: may this account read and write "
                f"{self._outbox.base_topic}/#?"
            )
        if problem and not self._broker_problem:
            self.log.warning(problem)
        self._update_broker(problem)

    def _tell_news(self) -> None:
        """Say what has just happened."""
        for one in self._events.update(self.robot_inputs.view):
            self._tell(one)

    def _tell(self, event: Happened) -> None:
        """Say to everybody what has happened."""
        if self._outbox.is_open:
            self._outbox.send(self._outbox.topic("event"), msgspec.json.encode(event))
        if self._wanted and event.event_type not in self._wanted:
            return
        if self._webhooks:
            title = self._robot.title or self._robot.name
            body = notification(event, self.new_id(), self.utc_now(), self._robot.name, title)
            for webhook in self._webhooks:
                webhook.send(body)

    def _locate(self) -> None:
        """Say where the robot is."""
        located = located_of(self.robot_inputs.view)
        self._tell(located)
        self._report.answer(located.message)

    def _speak(self) -> None:
        """Prove that the connection is alive, and say what is new."""
        self._outbox.send(self._outbox.topic("echo"), self._freshness.mark(self.monotonic_ns))
        self._home_assistant.announce()
        self._report.update()
