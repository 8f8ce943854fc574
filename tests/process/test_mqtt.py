"""The bridge as a process, at a real broker (Debian's mosquitto)."""

import json
import os
import shutil
import signal
import socket
import subprocess
import threading
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Any

import pytest
from paho.mqtt.client import Client, MQTTMessage
from paho.mqtt.enums import CallbackAPIVersion
from support.processes import Process, find_free_port, write_config
from support.waiting import PATIENCE_S, wait_until

from trolley import topics
from trolley.messages import Health, Stop, Tour, Tours
from trolley.runtime import codec
from trolley.runtime.zenoh_bus import open_bus
from trolley_mqtt.connection import Broker, BrokerConnection, Lost
from trolley_mqtt.freshness import MAX_AGE_S

if TYPE_CHECKING:
    from .conftest import ScriptedRobot

MOSQUITTO = shutil.which("mosquitto", path=f"{os.environ.get('PATH', '')}:/usr/sbin")
PRESS_AGAIN_S = 5.0
pytestmark = pytest.mark.skipif(MOSQUITTO is None, reason="mosquitto is not installed")


class Mosquitto:
    """A broker that can go away and come back, with nothing kept."""

    def __init__(self, folder: Path, *lines: str) -> None:
        self.port = find_free_port()
        self._log = folder / "mosquitto.log"
        self._config = folder / "mosquitto.conf"
        who = [] if any("password_file" in line for line in lines) else ["allow_anonymous true"]
        text = [f"listener {self.port} 127.0.0.1", "user root", "log_dest stderr", *who, *lines]
        self._config.write_text("\n".join(text) + "\n", encoding="utf-8")
        self.start()

    def start(self) -> None:
        with self._log.open("ab") as log:
            self._process = subprocess.Popen(
                [str(MOSQUITTO), "-c", str(self._config)], stderr=log, stdout=log
            )
        wait_until(self._answers, "the broker listens")

    def stop(self) -> None:
        self._process.terminate()
        self._process.wait(PATIENCE_S)

    def _answers(self) -> bool:
        assert self._process.poll() is None, self._log.read_text()
        with socket.socket() as probe:
            probe.settimeout(0.2)
            return probe.connect_ex(("127.0.0.1", self.port)) == 0


class Home:
    """A client as Home Assistant is one: it hears everything and presses buttons."""

    def __init__(self, port: int, **account: str) -> None:
        self.heard: dict[str, bytes] = {}
        self.client = Client(CallbackAPIVersion.VERSION2, "home")
        if account:
            self.client.username_pw_set(account["username"], account["password"])
        self.client.on_message = self._hear
        self.client.on_connect = self._subscribe
        self.client.connect("127.0.0.1", port)
        self.client.loop_start()
        wait_until(self.client.is_connected, "the broker lets the client in")

    def _subscribe(self, client: Client, *_: Any) -> None:
        client.subscribe([(f"trolley/one/{one}", 0) for one in ("state", "bridge", "echo")])
        client.subscribe("homeassistant/#")

    def _hear(self, _client: Client, _data: Any, message: MQTTMessage) -> None:
        self.heard[message.topic] = bytes(message.payload)

    @property
    def state(self) -> dict[str, Any]:
        return json.loads(self.heard.get("trolley/one/state", b"{}"))

    @property
    def bridge(self) -> bytes | None:
        return self.heard.get("trolley/one/bridge")

    def press_until(self, name: str, happened: Callable[[], object], what: str) -> None:
        """Press a button; again where nothing comes of it, since what may be old is dropped."""
        pressed_s = -PRESS_AGAIN_S

        def has_happened() -> object:
            nonlocal pressed_s
            if time.monotonic() > pressed_s + PRESS_AGAIN_S:
                self.press(name)
                pressed_s = time.monotonic()
            return happened()

        wait_until(has_happened, what)

    def press(self, name: str) -> None:
        """Press the button of this name, as it was announced."""
        for topic, payload in list(self.heard.items()):
            if topic.startswith("homeassistant/button/") and payload:
                button = json.loads(payload)
                if button["name"] == name:
                    do = button["command_topic"].replace("~", button["~"])
                    self.client.publish(do, button.get("payload_press", "PRESS"))
                    return
        raise AssertionError(f"there is no button {name!r}")

    def close(self) -> None:
        self.client.disconnect()
        self.client.loop_stop()


@pytest.fixture
def broker(tmp_path: Path) -> Iterator[Mosquitto]:
    made = Mosquitto(tmp_path)
    yield made
    made.stop()


@pytest.fixture
def home(broker: Mosquitto) -> Iterator[Home]:
    made = Home(broker.port)
    yield made
    made.close()


@pytest.fixture
def robot(add_robot: Callable[..., "ScriptedRobot"]) -> "ScriptedRobot":
    made = add_robot()
    tours = Tours(stamp_ns=0, tours=[Tour(name="evening", stops=[Stop(name="kitchen")])])
    made.call_soon(lambda: made.publish(topics.TOURS, tours))
    return made


@pytest.fixture
def run_bridge(endpoint: str, tmp_path: Path) -> Iterator[Callable[..., Process]]:
    """Starts the bridge: `run_bridge(port, more)`."""
    started: list[Process] = []

    def run(port: int, more: str = "") -> Process:
        text = f'[mqtt]\nbroker = "127.0.0.1:{port}"\n{more}'
        config = write_config(tmp_path / "robot.toml", endpoint, "one", text)
        process = Process(["-m", "trolley_mqtt", "--config", str(config)], tmp_path / "mqtt.log")
        started.append(process)
        return process

    yield run
    for process in started:
        process.kill()


def health_of(endpoint: str) -> Health | None:
    """What the bridge says of itself."""
    found: list[Health] = []
    done = threading.Event()
    with open_bus([endpoint], PATIENCE_S) as bus:
        bus.get(
            topics.HEALTH.key("one", "mqtt") + "?format=msgpack",
            b"",
            "",
            PATIENCE_S,
            lambda reply: found.append(codec.decode(Health, reply.payload, reply.encoding)),
            done.set,
        )
        done.wait(PATIENCE_S)
    return found[0] if found else None


def test_home_assistant_drives_and_stops_the_robot(
    robot: "ScriptedRobot", home: Home, broker: Mosquitto, run_bridge: Callable[..., Process]
) -> None:
    bridge = run_bridge(broker.port)
    wait_until(lambda: any("go_kitchen" in topic for topic in home.heard), "announcements")
    wait_until(lambda: home.state.get("activity") == "ready", "a state")
    home.press_until("Go to kitchen", lambda: robot.sent, "the robot is sent")
    assert robot.sent[0].name == "kitchen"
    home.press("Stop")
    wait_until(lambda: robot.stopped, "the robot is stopped")
    wait_until(lambda: home.state["activity"] == "stopped", "the state says so")
    assert bridge.terminate() == 0
    wait_until(lambda: home.bridge == b"offline", "the last word")


def test_two_robots_of_one_name_are_reported(
    robot: "ScriptedRobot",
    endpoint: str,
    broker: Mosquitto,
    run_bridge: Callable[..., Process],
) -> None:
    run_bridge(broker.port)
    other = Client(CallbackAPIVersion.VERSION2, "trolley-one")  # connects again and again, too
    other.connect_async("127.0.0.1", broker.port)
    other.loop_start()

    def is_told() -> bool:
        health = health_of(endpoint)
        return health is not None and "another robot with the same name" in health.message

    wait_until(is_told, "the bridge says so")
    other.disconnect()
    other.loop_stop()


@pytest.mark.parametrize(
    ("last_word", "asks_after", "why"),
    [(b"", 5, "within seconds"), (b"\xe0\x01\x8e", 1, "taken over")],
    ids=["hangs up", "says that another took the session over"],
)
def test_a_second_robot_is_asked_for_where_a_bad_wifi_cannot_be_the_cause(
    last_word: bytes, asks_after: int, why: str
) -> None:
    with socket.create_server(("127.0.0.1", 0)) as server:
        server.settimeout(PATIENCE_S)
        port = server.getsockname()[1]
        bridge = BrokerConnection(
            Broker(host="127.0.0.1", port=port, client_id="trolley-one", will=("gone", b"")), ""
        )
        bridge.start([], lambda: None)
        loss, said = "", list[bool]()
        for _ in range(asks_after):
            client, _ = server.accept()
            with client:
                client.recv(4096)
                client.sendall(b"\x20\x03\x00\x00\x00" + last_word)
            loss = next_loss(bridge)
            said.append("another robot with the same name" in loss)
        bridge.close()
    assert said == [False] * (asks_after - 1) + [True]
    assert why in loss


def next_loss(bridge: BrokerConnection) -> str:
    found: list[str] = []

    def has_lost() -> list[str]:
        found.extend(event.why for event in bridge.take_events() if isinstance(event, Lost))
        return found

    wait_until(has_lost, "the connection is lost")
    return found[0]


def test_a_bridge_that_is_killed_is_unavailable(
    robot: "ScriptedRobot", home: Home, broker: Mosquitto, run_bridge: Callable[..., Process]
) -> None:
    bridge = run_bridge(broker.port)
    wait_until(lambda: home.bridge == b"online", "the bridge")
    bridge.kill()
    wait_until(lambda: home.bridge == b"offline", "the broker says it for the dead")


def test_retained_commands_are_dropped_live_and_at_the_start(
    robot: "ScriptedRobot", home: Home, broker: Mosquitto, run_bridge: Callable[..., Process]
) -> None:
    home.client.publish("trolley/one/do/go", "kitchen", retain=True)
    bridge = run_bridge(broker.port)
    wait_until(lambda: home.state.get("activity") == "ready", "a state")
    wait_until(lambda: "trolley/one/echo" in home.heard, "what comes is known to be new")
    home.client.publish("trolley/one/do/go", "kitchen", retain=True)
    home.press("Stop")  # the broker keeps the order
    wait_until(lambda: robot.stopped, "the robot is stopped")
    wait_until(lambda: "retained" in bridge.log, "the drop in the log")
    assert robot.sent == []


def test_a_broker_that_restarts_is_found_again(
    robot: "ScriptedRobot", broker: Mosquitto, run_bridge: Callable[..., Process], endpoint: str
) -> None:
    run_bridge(broker.port)
    home = Home(broker.port)
    wait_until(lambda: home.bridge == b"online", "the bridge")
    home.close()
    broker.stop()
    wait_until(lambda: is_degraded(endpoint), "the bridge says what is wrong")
    broker.start()
    home = Home(broker.port)
    wait_until(lambda: home.bridge == b"online", "the bridge is back")
    wait_until(lambda: any("go_kitchen" in topic for topic in home.heard), "announcements")
    home.press_until("Go to kitchen", lambda: robot.sent, "the robot is sent")
    home.close()


def is_degraded(endpoint: str) -> bool:
    health = health_of(endpoint)
    return health is not None and health.state == "degraded"


def test_a_broker_that_talks_rubbish_does_no_harm(
    robot: "ScriptedRobot", tmp_path: Path, run_bridge: Callable[..., Process], endpoint: str
) -> None:
    rubbish = [
        b"\x20\x03\x00\x00\x00" + b"\x30\x02\x00\xff",  # a topic longer than its packet
        b"\x20\x03\x00\x00\x00" + b"\x30\x00",  # an empty publish
        b"\x20\x03\x00\x00\x00" + b"\x30\x05\x00\x02\xff\xfe\x00",  # a topic of no characters
        b"\x20\x03\x00\x00\x00" + b"\x90\x01\x00" + b"\xff" * 50,
        b"\x20\x00",
        b"HTTP/1.1 400 Bad Request\r\n\r\n",
    ]
    with socket.create_server(("127.0.0.1", 0)) as server:
        server.settimeout(PATIENCE_S)
        bridge = run_bridge(server.getsockname()[1])
        for data in rubbish:
            connection, _ = server.accept()
            with connection:
                connection.recv(4096)
                connection.sendall(data)
                time.sleep(0.2)
        connection, _ = server.accept()  # it still tries
        connection.close()
    assert bridge.is_running
    wait_until(lambda: is_degraded(endpoint), "it says that it has no broker")


def test_a_flood_is_bounded_and_a_stop_comes_through(
    robot: "ScriptedRobot",
    home: Home,
    broker: Mosquitto,
    run_bridge: Callable[..., Process],
    endpoint: str,
) -> None:
    bridge = run_bridge(broker.port)
    wait_until(lambda: home.state.get("activity") == "ready", "a state")
    is_over = threading.Event()
    flood = threading.Thread(target=pour, args=(broker.port, 1000, is_over))
    flood.start()
    try:
        wait_until(lambda: num_dropped(endpoint) > 1000, "much is dropped")
        before = memory_of(bridge)
        wait_until(lambda: num_dropped(endpoint) > 2000, "as much again is dropped")
        # A broker may drop what is for a slow reader: people press again.
        what = "the robot is stopped in the middle of it"
        home.press_until("Stop", lambda: robot.stopped, what)
        grown = memory_of(bridge) - before
    finally:
        is_over.set()
        flood.join()
    assert grown < 10e6
    assert robot.sent == []


def num_dropped(endpoint: str) -> int:
    """How many commands the bridge has dropped."""
    health = health_of(endpoint)
    counters = {} if health is None else health.counters
    return sum(number for name, number in counters.items() if name.startswith("command/"))


def pour(port: int, packets: int, is_over: threading.Event) -> None:
    """Publish `packets` commands ten times a second, as plain MQTT 3.1.1, until it is over."""
    connect = b"\x10\x11\x00\x04MQTT\x04\x02\x00\x3c\x00\x05flood"
    body = b"\x00\x11trolley/one/do/go" + b"x" * 90
    publish = b"\x30" + bytes([len(body)]) + body
    with socket.create_connection(("127.0.0.1", port)) as connection:
        connection.sendall(connect)
        connection.recv(4)
        while not is_over.is_set():
            began_s = time.monotonic()
            connection.sendall(publish * packets)
            time.sleep(max(0.0, 0.1 - (time.monotonic() - began_s)))


def memory_of(process: Process) -> float:
    pages = int(Path(f"/proc/{process.pid}/statm").read_text().split()[1])
    return pages * float(os.sysconf("SC_PAGE_SIZE"))


class StallingProxy:
    """Passes TCP on, and holds back what the broker says while `is_stalled`."""

    def __init__(self, port: int) -> None:
        self._target = port
        self.is_stalled = False
        self._server = socket.create_server(("127.0.0.1", 0))
        self.port = self._server.getsockname()[1]
        threading.Thread(target=self._accept, daemon=True).start()

    def _accept(self) -> None:
        while True:
            try:
                near, _ = self._server.accept()
            except OSError:
                return
            far = socket.create_connection(("127.0.0.1", self._target))
            threading.Thread(target=self._pass, args=(near, far, False), daemon=True).start()
            threading.Thread(target=self._pass, args=(far, near, True), daemon=True).start()

    def _pass(self, source: socket.socket, sink: socket.socket, may_stall: bool) -> None:
        with source, sink:
            try:
                while data := source.recv(4096):
                    while may_stall and self.is_stalled:
                        time.sleep(0.02)
                    sink.sendall(data)
            except OSError:
                return

    def close(self) -> None:
        self._server.close()


def test_what_waited_in_a_stalled_connection_is_not_carried_out(
    robot: "ScriptedRobot",
    home: Home,
    broker: Mosquitto,
    run_bridge: Callable[..., Process],
) -> None:
    proxy = StallingProxy(broker.port)
    bridge = run_bridge(proxy.port)
    wait_until(lambda: home.state.get("activity") == "ready", "a state")
    wait_until(lambda: "trolley/one/echo" in home.heard, "what comes is known to be new")
    wait_until(lambda: any("go_kitchen" in topic for topic in home.heard), "announcements")
    proxy.is_stalled = True
    home.press("Go to kitchen")
    time.sleep(1.5 * MAX_AGE_S)
    proxy.is_stalled = False
    wait_until(lambda: "waited" in bridge.log, "the drop in the log")
    assert robot.sent == []
    home.press_until("Go to kitchen", lambda: robot.sent, "a new press is obeyed")
    proxy.close()


def test_a_broker_that_wants_a_password_gets_it_from_a_file(
    robot: "ScriptedRobot", tmp_path: Path, run_bridge: Callable[..., Process], endpoint: str
) -> None:
    passwords = tmp_path / "passwords"
    subprocess.run(["mosquitto_passwd", "-b", "-c", str(passwords), "robby", "secret"], check=True)
    passwords.chmod(0o644)
    broker = Mosquitto(tmp_path, f"password_file {passwords}")
    (tmp_path / "password").write_text("wrong\n", encoding="utf-8")
    account = 'username = "robby"\npassword_file = "password"\n'
    bridge = run_bridge(broker.port, account)
    wait_until(lambda: "refuses the connection" in bridge.log, "the reason in the log")
    health = health_of(endpoint)
    assert health is not None
    assert "refuses the connection" in health.message
    bridge.terminate()
    (tmp_path / "password").write_text("secret\n", encoding="utf-8")
    run_bridge(broker.port, account)
    home = Home(broker.port, username="robby", password="secret")
    wait_until(lambda: home.bridge == b"online", "the bridge")
    home.close()
    broker.stop()


@pytest.mark.skipif(shutil.which("openssl") is None, reason="openssl is not installed")
def test_tls_with_a_certificate_authority_of_ones_own(
    robot: "ScriptedRobot", tmp_path: Path, run_bridge: Callable[..., Process]
) -> None:
    key, certificate = tmp_path / "key.pem", tmp_path / "ca.pem"
    subject = ["-subj", "/CN=localhost", "-addext", "subjectAltName=IP:127.0.0.1"]
    subprocess.run(
        [
            *("openssl", "req", "-x509", "-newkey", "rsa:2048", "-nodes", "-days", "2"),
            *("-keyout", str(key), "-out", str(certificate), *subject),
        ],
        check=True,
        capture_output=True,
    )
    broker = Mosquitto(tmp_path, f"certfile {certificate}", f"keyfile {key}")
    plain = run_bridge(broker.port)
    wait_until(lambda: "is it a port for TLS?" in plain.log, "without TLS it is not let in")
    plain.terminate()
    wary = run_bridge(broker.port, "tls = true\n")
    wait_until(lambda: "certificate that is not trusted" in wary.log, "the authority is unknown")
    wary.terminate()
    bridge = run_bridge(broker.port, f'tls_ca = "{certificate}"\n')
    wait_until(lambda: "Connected to the MQTT broker" in bridge.log, "the connection")
    broker.stop()


def test_a_broker_without_tls_is_told_from_one_that_is_away(
    broker: Mosquitto, run_bridge: Callable[..., Process]
) -> None:
    bridge = run_bridge(broker.port, "tls = true\n")
    wait_until(lambda: "is this its port without TLS?" in bridge.log, "the reason in the log")


@pytest.mark.parametrize(
    ("more", "problem"),
    [
        ("", "neither [mqtt] broker nor [webhook] urls is set"),
        ('[mqtt]\nbroker = "b"\npassword_file = "no"\n', "password_file"),
        ('[mqtt]\nbroker = "b"\ntls_ca = "no.pem"\n', "tls_ca"),
        ('[mqtt]\nbroker = "mqtt://b"\n', "is not a broker"),
        ('[mqtt]\nbroker = "b"\nbase_topic = "a/#"\n', "base_topic"),
    ],
)
def test_settings_that_cannot_be_used_are_refused(tmp_path: Path, more: str, problem: str) -> None:
    config = write_config(tmp_path / "robot.toml", "tcp/127.0.0.1:1", "one", more)
    process = Process(["-m", "trolley_mqtt", "--config", str(config)], tmp_path / "log")
    assert process.wait() == 2
    assert problem in process.log


def test_killing_the_bridge_by_signal_is_clean(
    robot: "ScriptedRobot", run_bridge: Callable[..., Process]
) -> None:
    bridge = run_bridge(find_free_port())  # nobody answers there
    wait_until(lambda: "nothing listens there" in bridge.log, "the reason in the log")
    bridge.send(signal.SIGINT)
    assert bridge.wait() == 0
