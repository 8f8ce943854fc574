"""Who may do what over TLS: real routers, real certificates, and clients that must fail."""

import json
import os
import socket
import time
from collections.abc import Callable, Iterator
from contextlib import ExitStack
from datetime import UTC, datetime, timedelta
from pathlib import Path
from typing import Any

import pytest
import zenoh
from support.processes import Process, find_free_port
from support.waiting import PATIENCE_S, wait_until

from trolley import codes, requests, topics
from trolley.client import Robot
from trolley.codes import Refused
from trolley.connection import Connection, RobotUnreachable
from trolley.doctor.endpoints import check_uplink
from trolley.geometry import Pose2D, Twist2D
from trolley.messages import Marker, OccupancyGrid, SavedPose, Transform, VelocityCommand
from trolley.messages.request_params import Nothing, SendGoal
from trolley.requests import Request
from trolley.runtime import codec
from trolley.runtime.bus import Sample
from trolley.runtime.zenoh_bus import NotConnected, open_router
from trolley.runtime.zenoh_config import router_config
from trolley.security.access import security_of
from trolley.security.certificates import Role
from trolley.security.host_keys import HostKeys
from trolley.security.keyring import Keyring
from trolley.topics import Qos, Topic

NOW = datetime.now(UTC)
UNTIL = NOW + timedelta(days=30)
PROGRAM = "from trolley.cli import main; main()"
HERE = Pose2D(1.0, 2.0, 0.0)


class House:
    """A home router for other hosts, and routers of hosts that link themselves to it."""

    def __init__(self, folder: Path, stack: ExitStack) -> None:
        self.keyring = Keyring(folder / "ring")
        self.keyring.create(NOW)
        self._folder = folder
        self._stack = stack
        self.local = f"tcp/127.0.0.1:{find_free_port()}"
        self.home = f"tls/127.0.0.1:{find_free_port()}"
        self.router_keys = self.keys("router", "home")

    def keys(self, role: Role, name: str) -> HostKeys:
        hosts = ["127.0.0.1"] if role == "router" else []
        return self.keyring.issue(role, name, UNTIL, hosts, replace=False)

    def open(self) -> None:
        """Start the home router, which reads now whom to let in."""
        self._start([self.local, self.home], [], self.router_keys)

    def host(self, keys: HostKeys) -> str:
        """Start the router of another host; where its programs connect to."""
        where = f"tcp/127.0.0.1:{find_free_port()}"
        self._start([where], [self.home], keys)
        return where

    def connect(self, endpoint: str, keys: HostKeys | None = None) -> Connection:
        return self._stack.enter_context(Connection([endpoint], PATIENCE_S, keys))

    def log(self, keys: HostKeys) -> str:
        """What the router with these keys has logged."""
        return self._log_of(keys).read_text()

    def _log_of(self, keys: HostKeys) -> Path:
        return self._folder / f"router-{keys.folder.name}.log"

    def _start(self, listen: list[str], uplink: list[str], keys: HostKeys) -> None:
        words = [word for one in listen for word in ("--listen", one)]
        words += [word for one in uplink for word in ("--uplink", one)]
        process = Process(
            ["-c", PROGRAM, "router", *words, "--keys", str(keys.folder)],
            self._log_of(keys),
            {"TROLLEY_CONFIG": ""},
        )
        self._stack.callback(process.kill)
        for endpoint in listen:
            port = int(endpoint.rpartition(":")[2])
            wait_until(lambda port=port: _listens(port, process), f"{endpoint} listens")


def _listens(port: int, process: Process) -> bool:
    assert process.is_running, process.log
    with socket.socket() as probe:
        return probe.connect_ex(("127.0.0.1", port)) == 0


@pytest.fixture
def house(tmp_path: Path) -> Iterator[House]:
    with ExitStack() as stack:
        yield House(tmp_path, stack)


class Heard:
    """The keys of what others put and what arrives at the robot's own router."""

    def __init__(self, connection: Connection, robot: str) -> None:
        self.keys: list[str] = []
        connection.listen(f"trolley/{robot}/**", self._take)

    def _take(self, sample: Sample) -> None:
        is_own = sample.key.split("/")[2] in OWN and MARK not in sample.payload
        if not is_own:
            self.keys.append(sample.key)

    @property
    def names(self) -> set[str]:
        """The keys below the robot's name."""
        return {key.split("/", 2)[2] for key in self.keys}

    def wait_for(self, names: set[str], put: Callable[[], None]) -> None:
        """Put again and again until all has come: what is of class `command` may be dropped."""

        def has_come() -> bool:
            put()
            time.sleep(0.1)
            return names <= self.names

        wait_until(has_come, f"{names} arrive")


NO_LINK = "answers, but this host cannot link to it."
NOT_ALLOWED = "not there or not allowed"


def code_of(connection: Connection, request: Request, params: Any = None) -> str:
    """`ok`, the code of a refusal, or that its sentence says both what may be the cause."""
    try:
        connection.ask("one", request, Nothing() if params is None else params)
    except Refused as refused:
        absent, present = (
            "not running, or this connection is not allowed to ask it.",
            "look but not command.",
        )
        says_both = refused.message.endswith((absent, present))
        return NOT_ALLOWED if says_both else refused.code
    return "ok"


def command(connection: Connection) -> VelocityCommand:
    clock = wait_until(lambda: connection.latest("one", topics.CLOCK), "who was let in reads")
    assert clock is not None
    return VelocityCommand(stamp_ns=clock.stamp_ns, twist=Twist2D.zero(), valid_for=0.2)


def frame(child: str) -> Transform:
    return Transform(stamp_ns=1, parent=MARK.decode(), child=child, pose=HERE)


OWN = {"tf", "clock", "odom", "pose", "base", "health", "robot", "poses", "goal"}
"""What the robot itself puts."""
MARK = b"elsewhere"
MARKER = Marker(frame="map", kind="sphere", pose=HERE)
PLACE = SavedPose(name="den", map="elsewhere", pose=HERE)
COSTS = OccupancyGrid(
    stamp_ns=0,
    name="home",
    frame="map",
    resolution=1.0,
    width=1,
    height=1,
    origin=HERE,
    cells=memoryview(b"\x64"),
)


def publish_all(connection: Connection) -> None:
    """What an operator may put, and what it may not, each under the robot `one`."""
    drive = command(connection)
    for topic, message, parts in (
        (topics.COMMAND, drive, ("planner",)),
        (topics.COMMAND, drive, ("calibrate",)),
        (topics.TF, frame("odom"), ("odom",)),
        (topics.TF, frame("laser"), ("laser",)),
        (topics.TF, frame("base_link"), ("base_link",)),
        (topics.COMMAND, drive, ("teleop",)),
        (topics.TF, frame("camera"), ("camera",)),
        (topics.MARKER, MARKER, ("plan", "1")),
        (topics.SAVED_POSE, PLACE, ("den",)),
        (topics.COSTS, COSTS, ("night",)),
    ):
        put(connection, topic, message, *parts)


def put(connection: Connection, topic: Topic, message: Any, *parts: str) -> None:
    connection.publish("one", topic, message, *parts)


ALLOWED = {"cmd_vel/teleop", "tf/camera", "markers/plan/1", "poses/den", "costs/night"}


@pytest.fixture
def robot_keys(house: House) -> HostKeys:
    return house.keys("robot", "one")


@pytest.fixture
def endpoint(house: House, robot_keys: HostKeys, monkeypatch: pytest.MonkeyPatch) -> str:
    """The robot's own router; the home router knows all certificates made until the first use."""
    monkeypatch.setenv("TROLLEY_STATE", str(robot_keys.folder.parent / "state"))
    house.keys("operator", "anna")
    house.keys("viewer", "tablet")
    house.keys("robot", "two")
    house.open()
    return house.host(robot_keys)


@pytest.mark.parametrize("way", ["client", "router"])
def test_each_role_does_what_it_may_and_no_more(
    house: House, endpoint: str, add_robot: Callable, way: str
) -> None:
    robot = add_robot("one")

    def as_(role: Role, name: str) -> Connection:
        """A program at the home router itself, or at the router of its own host."""
        keys = house.keyring.host(role, name)
        if way == "client":
            return house.connect(house.home, keys)
        return house.connect(house.host(keys))

    operator, viewer, other = as_("operator", "anna"), as_("viewer", "tablet"), as_("robot", "two")
    heard = Heard(house.connect(endpoint), "one")
    for connection in (operator, viewer, other):
        wait_until(lambda c=connection: c.robots() == ["one"], "the robot is seen")
        wait_until(lambda c=connection: c.latest("one", topics.CLOCK), "it can be read")
        with connection.subscribe("*", topics.POSE, with_latest=False) as poses:
            assert poses.next(PATIENCE_S) is not None

    # What the wrong ones put comes first: what an operator puts shows that it would be here by now.
    publish_all(viewer)
    publish_all(other)
    last = {"markers/last/1"}
    heard.wait_for(last, lambda: put(operator, topics.MARKER, MARKER, "last", "1"))
    assert heard.names == last
    heard.wait_for(ALLOWED, lambda: publish_all(operator))
    assert heard.names == ALLOWED | last

    goal = SendGoal(name="kitchen", id="g1")
    assert code_of(viewer, requests.GOAL_SEND, goal) == NOT_ALLOWED
    assert code_of(viewer, requests.BASE_RESUME) == NOT_ALLOWED
    assert code_of(other, requests.GOAL_SEND, goal) == NOT_ALLOWED
    assert code_of(other, requests.BASE_STOP) == NOT_ALLOWED
    assert robot.sent == []
    assert code_of(operator, requests.GOAL_SEND, goal) == "ok"
    assert [one.id for one in robot.sent] == ["g1"]

    assert code_of(viewer, requests.BASE_STOP) == "ok"
    assert robot.stopped
    assert code_of(operator, requests.BASE_RESUME) == "ok"
    assert list(viewer.stop_all()) == ["one"]
    assert robot.stopped


def test_doctor_looks_at_a_robot_through_the_home_router(
    house: House, endpoint: str, add_robot: Callable, trolley: Callable
) -> None:
    """It came without keys, and said that no router answers."""
    add_robot("one")
    anna = house.connect(house.home, house.keyring.host("operator", "anna"))
    wait_until(lambda: anna.robots() == ["one"], "the robot is seen")
    settings = house.keyring.folder / "robot.toml"
    settings.write_text('[zenoh]\nkeys = "operator-anna"\n')
    done = trolley(
        *("doctor", "--config", str(settings), "--connect", house.home, "--robot", "one"),
        *("--seconds", "1", "--json"),
    )
    found = [one["sentence"] for one in json.loads(done.stdout)["findings"]]
    assert f"The router at {house.home} answers." in found
    assert "planner is not running, or hangs." in found


def test_doctor_says_why_a_host_has_no_link(
    house: House, endpoint: str, add_robot: Callable, tmp_path: Path
) -> None:
    """Whatever answered at the home router's port was fine."""
    add_robot("one")
    anna = house.keyring.host("operator", "anna")
    wait_until(lambda: house.connect(house.home, anna).robots() == ["one"], "the robot is seen")

    def said(keys: HostKeys) -> str:
        (found,) = check_uplink(house.home, keys)
        return found.sentence.removeprefix(f"The home router at {house.home} ")

    assert said(anna) == "answers."
    revoked = said(house.keys("operator", "new"))  # it may be sent away before it looks
    assert revoked in ("shows no robot to this host.", NO_LINK)
    foreign = Keyring(tmp_path / "foreign")
    foreign.create(NOW)
    stranger = foreign.issue("operator", "anna", UNTIL, replace=False)
    assert said(stranger) == NO_LINK


MANY_AT_ONCE = (
    *("one/tf/*", "one/tf/**", "*/tf/odom", "*/tf/*", "one/tf/od$*", "one/tf/$*m", "on$*/tf/odom"),
    *("**/odom", "**/tf/odom", "one/**", "one/**/odom", "one/*/odom", "**"),
    *("one/cmd_vel/*", "*/cmd_vel/planner", "one/cmd_vel/p$*", "one/health/*", "one/@do/**"),
)
OF_ONE = ("tf/odom", "tf/laser", "tf/base_link", "odom", "cmd_vel/planner", "clock", "pose")


def test_what_is_put_to_many_keys_at_once_passes_no_rule_by(
    house: House, endpoint: str, add_robot: Callable
) -> None:
    """A pattern that means `tf/odom` as well does not reach anybody, not even a foreign program."""
    add_robot("one")
    operator = house.connect(house.home, house.keyring.host("operator", "anna"))
    listener = house.connect(endpoint)
    heard: set[str] = set()

    def hear(sample: Sample) -> None:
        is_own = sample.key.split("/")[2] in OWN and not sample.is_delete
        if "*" in sample.key or not is_own or sample.key == "trolley/one/tf/camera":
            heard.add(sample.key)

    listener.bus.subscribe("trolley/**", hear)
    wait_until(lambda: operator.robots() == ["one"], "the robot is seen")
    payload = codec.encode(frame("odom"), "msgpack")

    def has_come() -> bool:
        for key in MANY_AT_ONCE:
            operator.bus.put(f"trolley/{key}", payload, codec.MIME["msgpack"], Qos.SENSOR)
            operator.bus.delete(f"trolley/{key}")
        for key in OF_ONE:
            operator.bus.delete(f"trolley/one/{key}")
        put(operator, topics.TF, frame("camera"), "camera")
        return "trolley/one/tf/camera" in heard

    wait_until(has_come, "what is allowed")
    assert heard == {"trolley/one/tf/camera"}


def test_a_viewer_shows_itself_and_what_was_clicked(
    house: House, endpoint: str, add_robot: Callable
) -> None:
    add_robot("one")
    viewer = house.connect(house.home, house.keyring.host("viewer", "tablet"))
    heard = Heard(house.connect(endpoint), "one")
    wait_until(lambda: viewer.robots() == ["one"], "the robot is seen")
    shown = topics.ALIVE.key("one", "viz-tablet", "tablet-1-2")
    viewer.bus.declare_token(topics.ALIVE.key("one", "base", "tablet-1-2"))
    viewer.bus.declare_token(shown)
    runs = house.connect(endpoint)
    wait_until(lambda: ("one", "viz-tablet") in runs.services(), "the viewer is seen")
    assert all("tablet" not in run for run in runs.services()["one", "base"])

    def put_all() -> None:
        for key in ("health/base", "goal", "choices/menu", "health/viz-tablet"):
            viewer.bus.put(f"trolley/one/{key}", MARK, "application/json", Qos.STATE)

    heard.wait_for({"choices/menu", "health/viz-tablet"}, put_all)
    assert heard.names == {"choices/menu", "health/viz-tablet"}


def test_who_is_not_known_stays_outside(house: House, tmp_path: Path) -> None:
    lost = house.keys("operator", "lost")
    kept = tmp_path / "copy"
    os.rename(lost.folder, kept)  # somebody has it
    lost.folder.mkdir()
    house.keyring.remove("operator", "lost")
    house.keys("operator", "lost")  # a new one of the same name opens no door for the old one
    house.open()
    at_home = house.connect(house.local)
    at_home.bus.declare_token(topics.ALIVE.key("one", "base", "h-1-2"))
    assert at_home.robots() == ["one"]

    with pytest.raises(RobotUnreachable), Connection([house.home], 1.0):
        pass
    foreign = Keyring(tmp_path / "foreign")
    foreign.create(NOW)
    stranger = foreign.issue("operator", "anna", UNTIL, replace=False)
    with pytest.raises(RobotUnreachable), Connection([house.home], 1.0, stranger):
        pass

    thief = house.connect(house.home, HostKeys(kept))
    is_there: list[bool] = []
    thief.bus.on_connection(is_there.append)
    heard: list[str] = []
    at_home.listen("trolley/**", lambda sample: heard.append(sample.key))
    assert thief.robots() == []
    thief.bus.put("trolley/one/cmd_vel/teleop", b"{}", "application/json", Qos.COMMAND)
    with pytest.raises(RobotUnreachable, match="not allowed to ask it"):
        thief.ask("one", requests.BASE_STOP, Nothing())
    wait_until(lambda: False in is_there, "it is sent away")
    assert "not in allowed.pem" in house.log(house.router_keys)
    owner = house.connect(house.home, lost)
    assert owner.robots() == ["one"]
    owner.bus.put("trolley/one/markers/a/b", b"{}", "application/json", Qos.STATE)
    wait_until(lambda: heard, "the owner's word")
    assert heard == ["trolley/one/markers/a/b"]


def test_a_router_says_what_becomes_of_its_link(house: House, tmp_path: Path) -> None:
    """One that was never let in said that it listens, and no more."""
    anna = house.keys("operator", "anna")
    house.open()
    house.host(anna)
    wait_until(lambda: "Linked to the home router" in house.log(anna), "the link is told")
    foreign = Keyring(tmp_path / "foreign")
    foreign.create(NOW)
    stranger = foreign.issue("operator", "eve", UNTIL, replace=False)
    house.host(stranger)
    wait_until(lambda: "No link to the home router" in house.log(stranger), "there is none")


def test_who_is_not_known_is_sent_away_by_the_router_of_any_program(house: House) -> None:
    """`trolley up` lets other hosts in as `trolley router` does."""
    security = security_of(house.router_keys)
    late = house.keys("operator", "late")
    is_there: list[bool] = []
    with open_router([house.local, house.home], security=security):
        house.connect(house.home, late).bus.on_connection(is_there.append)
        wait_until(lambda: False in is_there, "it is sent away")


def test_nobody_can_pretend_to_be_the_home_router(house: House) -> None:
    viewer = house.keys("viewer", "tablet")
    robot = house.keys("robot", "one")
    where = f"tls/127.0.0.1:{find_free_port()}"
    with (
        zenoh.open(router_config([where], security=security_of(viewer))),
        pytest.raises(RobotUnreachable),
        Connection([where], 1.0, robot),
    ):
        pass


def test_broken_keys_are_told_at_the_start(house: House, tmp_path: Path) -> None:
    keys = house.keys("router", "other")
    keys.key.write_text("rubbish")
    where = f"tls/127.0.0.1:{find_free_port()}"
    broken = security_of(keys)
    with pytest.raises(NotConnected, match="cannot listen"), open_router([where], (), broken):
        pass


def test_drives_the_robot_from_another_host(
    house: House, endpoint: str, add_robot: Callable
) -> None:
    robot = add_robot("one")
    where = house.host(house.keyring.host("operator", "anna"))
    operator = house.connect(where)
    wait_until(lambda: operator.robots() == ["one"], "the robot is seen")
    # That it is there may be known before what it answers.
    nowhere = SendGoal(name="nowhere")
    wait_until(
        lambda: code_of(operator, requests.GOAL_SEND, nowhere) == codes.UNKNOWN_NAME,
        "the robot answers",
    )
    with Robot("one", connect=where) as far:
        assert far.go_to("kitchen").state == "arrived"
    assert [one.name for one in robot.sent] == ["kitchen"]
