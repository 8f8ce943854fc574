"""The bridge as Foxglove sees it: a client over a real socket, a pretend robot in lock-step."""

import json
import socket
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest
from support.foxglove_client import FoxgloveClient, fields
from support.processes import find_free_port

from trolley import topics
from trolley.config import VizConfig
from trolley.messages import Marker
from trolley.runtime.lockstep import Lockstep
from trolley.runtime.service import Service
from trolley_viz.foxglove import open_bridge

from ..conftest import PretendRobot

PATIENCE = 400


class Host(Service):
    """What of the viewer the bridge needs."""

    name = "viz"
    all_robots = True

    def __init__(self, config: VizConfig) -> None:
        self._config = config

    def start(self) -> None:
        self.bridge = open_bridge(self, self._config)

    def stop(self) -> None:
        if self.bridge is not None:
            self.bridge.close()


class Scene:
    """A robot, the bridge, and clients."""

    def __init__(self, state: Path) -> None:
        self.port = find_free_port()
        self.runtime = Lockstep(state=state)
        self.host = self.runtime.add(Host(VizConfig(foxglove_port=self.port)))
        self.robot = self.runtime.add(PretendRobot())

    def until(self, client: FoxgloveClient, happened: Callable[[], object]) -> None:
        """Let simulated time pass, and the client listen, until this happened."""
        for _ in range(PATIENCE):
            self.runtime.run(0.1)
            client.listen(0.02)
            if happened():
                return
        raise AssertionError(f"not happened; received of {sorted(client.received)}")

    @property
    def subscribed(self) -> set[str]:
        assert self.host.bridge is not None
        return {name for _, name in self.host.bridge.subscribed}


@pytest.fixture
def scene(tmp_path: Path) -> Iterator[Scene]:
    scene = Scene(tmp_path)
    yield scene
    scene.runtime.close()


@pytest.fixture
def client(scene: Scene) -> Iterator[FoxgloveClient]:
    with FoxgloveClient(scene.port) as client:
        scene.until(client, lambda: "/trolley/scan" in client.channels)
        yield client


def test_scan_map_pose_and_frames_arrive(scene: Scene, client: FoxgloveClient) -> None:
    wanted = ["/trolley/scan", "/trolley/map", "/trolley/pose", "/trolley/tf", "/trolley/base"]
    client.subscribe(*wanted)
    scene.until(client, lambda: set(wanted) <= client.received.keys())
    schemas = {name: client.channels[name]["schemaName"] for name in wanted}
    assert schemas == {
        "/trolley/scan": "foxglove.LaserScan",
        "/trolley/map": "foxglove.Grid",
        "/trolley/pose": "foxglove.PoseInFrame",
        "/trolley/tf": "foxglove.FrameTransforms",
        "/trolley/base": "trolley.BaseState",
    }
    _, scan = client.received["/trolley/scan"][0]
    assert fields(scan)[2] == [b"trolley/laser"]
    children: set[bytes] = set()
    scene.until(client, lambda: children.update(child_frames(client)) or len(children) == 3)
    assert children == {b"trolley/odom", b"trolley/base_link", b"trolley/laser"}
    log_time, base = client.received["/trolley/base"][-1]
    assert json.loads(base)["mode"] == "ok"
    assert 0 <= log_time - json.loads(base)["stamp_ns"] < 1_000_000_000  # robot time


def child_frames(client: FoxgloveClient) -> set[bytes]:
    return {
        fields(one)[3][0] for _, data in client.received["/trolley/tf"] for one in fields(data)[1]
    }


def test_only_what_somebody_wants_is_subscribed_to(scene: Scene, client: FoxgloveClient) -> None:
    assert scene.subscribed == set()
    client.subscribe("/trolley/scan", "/trolley/tf")
    scene.until(client, lambda: scene.subscribed)
    assert scene.subscribed == {"scan", "tf/{child}", "odom"}
    with FoxgloveClient(scene.port) as other:
        scene.until(other, lambda: "/trolley/scan" in other.channels)
        other.subscribe("/trolley/scan")
        scene.until(other, lambda: "/trolley/scan" in other.received)
        client.unsubscribe("/trolley/scan")
        client.unsubscribe("/trolley/tf")
        scene.until(other, lambda: scene.subscribed == {"scan"})
    scene.until(client, lambda: scene.subscribed == set())


def test_who_comes_later_gets_the_map_too(scene: Scene, client: FoxgloveClient) -> None:
    client.subscribe("/trolley/map")
    scene.until(client, lambda: "/trolley/map" in client.received)
    with FoxgloveClient(scene.port) as other:
        scene.until(other, lambda: "/trolley/map" in other.channels)
        other.subscribe("/trolley/map")
        scene.until(other, lambda: "/trolley/map" in other.received)


def test_markers_come_and_go(scene: Scene, client: FoxgloveClient) -> None:
    client.subscribe("/trolley/scene/markers")
    scene.until(client, lambda: scene.subscribed)
    scene.runtime.publish(topics.MARKER, Marker(kind="cube"), "ns", "a")
    scene.until(client, lambda: client.received)
    _, update = client.received["/trolley/scene/markers"][0]
    assert fields(fields(update)[2][0])[3] == [b"trolley/ns/a"]
    scene.runtime.delete(topics.MARKER.key("trolley", "ns", "a"))
    scene.until(client, lambda: len(client.received["/trolley/scene/markers"]) == 2)
    _, update = client.received["/trolley/scene/markers"][1]
    assert fields(fields(update)[1][0])[3] == [b"trolley/ns/a"]


def test_markers_by_the_hundred_all_arrive(scene: Scene, client: FoxgloveClient) -> None:
    everything = {f"trolley/ns/m{number}" for number in range(3000)}
    client.subscribe("/trolley/scene/markers")
    scene.until(client, lambda: scene.subscribed)
    for number in range(3000):
        scene.runtime.publish(topics.MARKER, Marker(kind="cube"), "ns", f"m{number}")
    scene.until(client, lambda: marker_ids(client) == everything)
    with FoxgloveClient(scene.port) as other:
        scene.until(other, lambda: "/trolley/scene/markers" in other.channels)
        other.subscribe("/trolley/scene/markers")
        scene.until(other, lambda: marker_ids(other) == everything)


def marker_ids(client: FoxgloveClient) -> set[str]:
    return {
        fields(entity)[3][0].decode()
        for _, update in client.received.get("/trolley/scene/markers", [])
        for entity in fields(update).get(2, [])
    }


def test_a_client_can_command_nothing(scene: Scene, client: FoxgloveClient) -> None:
    assert client.info["capabilities"] == []
    client.subscribe("/trolley/base")
    for message in (
        {"op": "advertise", "channels": [{"id": 1, "topic": "/x", "encoding": "json"}]},
        {"op": "subscribe", "subscriptions": [{"id": 77, "channelId": 123456}]},
        {"op": "nonsense"},
    ):
        client.send(message)
    scene.until(client, lambda: "/trolley/base" in client.received)
    assert (scene.robot.stops, scene.robot.goals) == (0, [])


def test_it_listens_on_loopback_only(scene: Scene) -> None:
    with socket.socket() as other:
        other.bind(("127.0.0.2", scene.port))  # free: it does not listen on all addresses


def test_a_taken_port_is_told_and_the_viewer_goes_on(tmp_path: Path) -> None:
    runtime = Lockstep(state=tmp_path)
    with socket.socket() as taken:
        taken.bind(("127.0.0.1", 0))
        taken.listen()
        healths = runtime.record(topics.HEALTH, "viz")
        host = runtime.add(Host(VizConfig(foxglove_port=taken.getsockname()[1])))
        runtime.run(1.5)
    assert host.bridge is None
    assert healths[-1].state == "degraded"
    assert "Foxglove cannot connect" in healths[-1].message
    runtime.close()


def test_without_the_setting_there_is_none(tmp_path: Path) -> None:
    with Lockstep(state=tmp_path) as runtime:
        assert runtime.add(Host(VizConfig())).bridge is None


@pytest.mark.parametrize(("is_open", "is_served"), [(False, False), (True, True)])
def test_it_is_open_to_the_network_only_where_that_is_said(
    tmp_path: Path, *, is_open: bool, is_served: bool
) -> None:
    runtime = Lockstep(state=tmp_path)
    config = VizConfig(
        foxglove_port=find_free_port(), foxglove_host="0.0.0.0", foxglove_open=is_open
    )
    healths = runtime.record(topics.HEALTH, "viz")
    host = runtime.add(Host(config))
    runtime.run(1.5)
    assert (host.bridge is not None) is is_served
    assert ("asks for no password" in healths[-1].message) is not is_served
    runtime.close()
