"""The Zenoh runtime as it runs on a robot: real processes, real sessions, a real router."""

import signal
import socket
import threading
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any, Literal

import pytest
from support.processes import Process, RouterProcess, find_free_port, write_config
from support.samples import make_place
from support.waiting import PATIENCE_S, wait_until
from support.wire import health_of, read, stored_names, wait_for_service

from trolley import topics
from trolley.messages import BaseState, Health, SavedPoses
from trolley.runtime import codec
from trolley.runtime.bus import Query, Sample
from trolley.runtime.clash import OlderRuns, Run, host_name
from trolley.runtime.zenoh_bus import ZenohBus, open_bus
from trolley.topics import Qos

KEEPER = "support.services:Keeper"
StartService = Callable[..., Process]


class NotifySocket:
    """The end of the `sd_notify` protocol that systemd holds."""

    def __init__(self, path: Path) -> None:
        self.path = path
        self._socket = socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM)
        self._socket.bind(str(path))
        self._socket.setblocking(False)
        self.said: list[str] = []

    def hears(self, what: str) -> bool:
        """Whether `what` was said since the last call that heard it."""
        try:
            while True:
                self.said += self._socket.recv(4096).decode().splitlines()
        except BlockingIOError:
            pass
        found = what in self.said
        if found:
            del self.said[: self.said.index(what) + 1]
        return found

    def close(self) -> None:
        self._socket.close()


@pytest.fixture
def notify_socket(tmp_path: Path):
    opened = NotifySocket(tmp_path / "notify")
    yield opened
    opened.close()


# Beginning and end.


def test_a_service_begins_anew_in_its_process_and_stops_when_told_to_meanwhile(
    bus: ZenohBus, service_process: StartService, tmp_path: Path, notify_socket: NotifySocket
):
    flag = tmp_path / "flag"
    environment = {"NOTIFY_SOCKET": str(notify_socket.path), "RENEWED": str(flag)}
    process = service_process("support.services:Renewed", environment=environment)
    first = wait_for_service(bus, "mapper")
    wait_until(lambda: notify_socket.hears("READY=1"), "ready")
    flag.touch()
    for when in ("as it goes", "as it comes"):  # it is watched meanwhile
        wait_until(lambda: notify_socket.hears("WATCHDOG=1"), f"a sign of life {when}")
    wait_until(lambda: notify_socket.hears("READY=1"), "ready again")
    assert "STOPPING=1" not in notify_socket.said
    second = wait_for_service(bus, "mapper")
    assert second.run != first.run
    assert second.run.split("-")[:-1] == first.run.split("-")[:-1]  # host and process
    assert not flag.exists()  # what it saves at its end was saved
    assert process.terminate() == 0


@pytest.mark.parametrize("number", [signal.SIGTERM, signal.SIGINT])
def test_a_signal_ends_it_cleanly(
    keeper: Process, bus: ZenohBus, tmp_path: Path, number: signal.Signals
):
    said: list[Sample] = []
    bus.subscribe("trolley/tester/base", said.append)
    bus.put("trolley/tester/poses/kitchen", codec.encode(make_place(), "json"), "", Qos.STATE)
    wait_until(lambda: stored_names(bus) == {"kitchen"}, "the pose is stored")
    keeper.send(number)
    wait_until(lambda: not keeper.is_running, "it ends")
    assert keeper.wait() == 0
    wait_until(lambda: said, "its last word")
    assert codec.decode(BaseState, said[0].payload).message == "bye"
    assert "kitchen" in (tmp_path / "state" / "tester" / "kept.toml").read_text()
    wait_until(lambda: tokens_of(bus) == [], "its token is gone")


def test_without_a_router_it_waits_and_can_be_ended(
    tmp_path: Path, service_process: StartService, notify_socket: NotifySocket
):
    config = write_config(tmp_path / "alone.toml", f"tcp/127.0.0.1:{find_free_port()}")
    environment = {"NOTIFY_SOCKET": str(notify_socket.path)}
    process = service_process(KEEPER, config=config, environment=environment)
    # systemd is asked for patience meanwhile.
    wait_until(lambda: notify_socket.hears("EXTEND_TIMEOUT_USEC=90000000"), "patience")
    assert not notify_socket.hears("READY=1")
    wait_until(lambda: "Waiting for the router; `trolley router` starts one" in process.log, "told")
    process.send(signal.SIGTERM)
    wait_until(lambda: not process.is_running, "it ends")
    assert process.wait() == 0


def test_services_may_start_before_their_router(
    tmp_path: Path, service_process: StartService, notify_socket: NotifySocket
):
    port = find_free_port()
    config = write_config(tmp_path / "early.toml", f"tcp/127.0.0.1:{port}")
    environment = {"NOTIFY_SOCKET": str(notify_socket.path)}
    service_process(KEEPER, config=config, environment=environment)
    wait_until(lambda: notify_socket.hears("EXTEND_TIMEOUT_USEC=90000000"), "it tries")
    router = RouterProcess(port, tmp_path / "late-router.log")
    router.start()
    try:
        with open_bus([router.endpoint], PATIENCE_S) as bus:
            wait_for_service(bus, "tour")
    finally:
        router.stop()


@pytest.mark.parametrize(
    ("endpoint", "said"),
    [("nonsense", "zenoh"), ("quatsch/127.0.0.1:1", "quatsch"), ("tcp/127.0.0.1", "port")],
)
def test_an_endpoint_that_is_none_is_refused(
    tmp_path: Path, service_process: StartService, endpoint: str, said: str
):
    config = write_config(tmp_path / "wrong.toml", endpoint)
    process = service_process(KEEPER, config=config)
    assert process.wait() == 2
    assert said in process.log


def test_a_missing_configuration_is_told(tmp_path: Path, service_process: StartService):
    process = service_process(KEEPER, config=tmp_path / "absent.toml")
    assert process.wait() == 2
    assert "absent.toml" in process.log
    assert "Traceback" not in process.log


@pytest.mark.parametrize(
    ("fault", "code", "said"),
    [
        ("start", 1, "no start"),
        ("tick", 1, "no tick"),
        ("work", 1, "no disk"),
        ("stop", 1, "no stop"),
        ("save", 1, "no disk"),
        ("none", 0, ""),
    ],
)
def test_a_fault_ends_it_with_its_trace_and_its_last_word(
    service_process: StartService, bus: ZenohBus, fault: str, code: int, said: str
):
    heard: list[Sample] = []
    bus.subscribe("trolley/tester/base", heard.append)
    process = service_process("support.services:Faulty", environment={"FAULT": fault})
    if fault in ("stop", "save", "none"):
        wait_for_service(bus, "planner")
        process.send(signal.SIGTERM)
    assert process.wait() == code
    assert said in process.log
    assert "panicked" not in process.log
    wait_until(lambda: heard, "its last word")


# Two of a name.


def test_of_two_processes_the_later_ends_and_names_the_other(
    keeper: Process, service_process: StartService, bus: ZenohBus
):
    later = service_process(KEEPER)
    assert later.wait() == 3
    assert f"host={host_name()}" in later.log
    assert f"pid={keeper.pid}" in later.log
    assert keeper.is_running
    # The router takes a token back a moment after the process that held it has ended.
    wait_until(lambda: len(tokens_of(bus)) == 1, "one token is left")
    (token,) = tokens_of(bus)
    assert token.startswith(f"trolley/tester/alive/tour/{host_name()}-{keeper.pid}-")


def test_of_two_that_start_together_one_stays(service_process: StartService, bus: ZenohBus):
    both = [service_process(KEEPER), service_process(KEEPER)]
    wait_until(lambda: not all(one.is_running for one in both), "one of two ends")
    wait_for_service(bus, "tour")
    assert sorted(one.is_running for one in both) == [False, True]
    assert {one.wait() for one in both if not one.is_running} == {3}


def test_after_sigkill_the_next_one_takes_over(
    keeper: Process, service_process: StartService, bus: ZenohBus
):
    bus.put("trolley/tester/poses/kitchen", codec.encode(make_place(), "json"), "", Qos.STATE)
    wait_until(lambda: stored_names(bus) == {"kitchen"}, "the pose is stored")
    wait_until(lambda: "kept.toml" in keeper_files(keeper), "the pose is saved")
    keeper.kill()
    service_process(KEEPER)
    wait_for_service(bus, "tour")
    assert stored_names(bus) == {"kitchen"}


def keeper_files(process: Process) -> set[str]:
    state = process.log_path.parent / "state" / "tester"
    return {file.name for file in state.iterdir()} if state.is_dir() else set()


ELDER = Run(started_ms=1, host="elder", pid=77)


def show(bus: ZenohBus, run: Run) -> None:
    bus.declare_token(topics.ALIVE.key("tester", "tour", str(run)))


def answer_for(bus: ZenohBus, run: str, state: Literal["starting", "ok"] = "ok") -> list[str]:
    """Answer for the health of a run; what was asked is noted."""
    key, asked = "trolley/tester/health/tour", list[str]()

    def answer(query: Query) -> None:
        asked.append(query.key)
        health = Health(stamp_ns=0, state=state, run=run)
        query.reply(key, codec.encode(health, "msgpack"), codec.MIME["msgpack"])
        query.finish()

    bus.serve(key, answer)
    return asked


@pytest.mark.parametrize("run", [str(ELDER), ""], ids=["this release", "an earlier release"])
def test_two_that_meet_after_a_reconnection_settle_it(keeper: Process, bus: ZenohBus, run: str):
    """An older process, so far on the other side of a broken link, appears."""
    answer_for(bus, run)
    show(bus, ELDER)
    assert keeper.wait() == 3
    assert "host=elder" in keeper.log
    assert "pid=77" in keeper.log
    assert "give this robot another [robot] name" in keeper.log


def test_one_that_starts_ends_none_that_serves_though_its_clock_is_behind(
    keeper: Process, bus: ZenohBus
):
    """As a copy of the robot's SD card does that begins with the time of its last shutdown."""
    asked = answer_for(bus, str(ELDER), "starting")
    show(bus, ELDER)
    wait_until(lambda: len(asked) >= 2, "it asks, and asks again")
    assert keeper.is_running


def test_one_that_starts_ends_where_one_serves_whose_clock_is_ahead(
    service_process: StartService, bus: ZenohBus
):
    ahead = Run(started_ms=10**15, host="ahead", pid=78)
    answer_for(bus, str(ahead))
    show(bus, ahead)
    later = service_process(KEEPER)
    assert later.wait() == 3
    assert "host=ahead" in later.log


def test_one_that_starts_is_told_of_one_that_serves_before_it_goes_on(
    router: RouterProcess, bus: ZenohBus
):
    """Also where what Zenoh tells of tokens by itself comes late, as on a busy computer."""
    answer_for(bus, str(ELDER))
    show(bus, ELDER)
    wait_until(lambda: tokens_of(bus), "its token is known")
    for number in range(5):
        with open_bus([router.endpoint], PATIENCE_S) as own:
            watch = own.watch_tokens

            def watch_late(
                key_expr: str, callback: Callable[[str, bool], None], watch: Any = watch
            ) -> Any:
                return watch(key_expr, lambda *told: threading.Timer(1.0, callback, told).start())

            own.watch_tokens = watch_late
            starts = Run(number, "copy", 80)
            older = OlderRuns(own, "tester", "tour", starts, lambda: None)
            while not older.settle():
                older.ask()
                time.sleep(0.01)
            assert older.oldest() == ELDER


def test_a_token_that_nobody_answers_for_ends_no_service(
    service_process: StartService, keeper: Process, bus: ZenohBus
):
    """Neither one that runs nor one that starts."""
    asked = answer_for(bus, str(Run(started_ms=3, host="somebody", pid=79)))
    show(bus, ELDER)
    wait_until(lambda: len(asked) >= 2, "it asks, and asks again")
    assert keeper.is_running
    keeper.kill()
    later = service_process(KEEPER)
    wait_until(lambda: is_up(bus, later), "it is up")
    assert later.is_running


def tokens_of(bus: ZenohBus) -> list[str]:
    """The tokens of those that run."""
    return bus.alive("trolley/tester/alive/**", PATIENCE_S)


def is_up(bus: ZenohBus, process: Process) -> bool:
    """Whether the health of the service is answered for by this very process, and is good."""
    found = [
        codec.decode(Health, reply.payload, reply.encoding)
        for reply in read(bus, "trolley/tester/health/tour")
        if not reply.is_error
    ]
    return any(one.state == "ok" and f"-{process.pid}-" in one.run for one in found)


def test_health_tells_the_run_of_the_token(keeper: Process, bus: ZenohBus):
    (token,) = tokens_of(bus)
    assert is_up(bus, keeper)
    health = health_of(bus, "tour")
    assert health is not None
    assert token.endswith(f"/{health.run}")


def test_a_younger_one_and_a_stranger_are_ignored(keeper: Process, bus: ZenohBus):
    younger = Run(started_ms=10**15, host="younger", pid=78)
    for run in (str(younger), "nonsense", "a-b-c", f"x-1-{'9' * 5000}"):
        bus.declare_token(topics.ALIVE.key("tester", "tour", run))
    reports: list[Sample] = []
    bus.subscribe(topics.HEALTH.key("tester", "tour"), reports.append)
    wait_until(lambda: len(reports) >= 2, "two reports of its health, one second apart")
    assert keeper.is_running


# The router goes and comes.


def test_after_a_router_restart_everything_is_there_again(
    keeper: Process, service_process: StartService, bus: ZenohBus, router: RouterProcess
):
    listener = service_process("support.services:Listener")
    viewer = f"viz-{host_name()}"
    wait_for_service(bus, viewer)
    router.stop()
    time.sleep(1.0)
    router.start()
    wait_for_service(bus, "tour")
    bus.put("trolley/tester/poses/kitchen", codec.encode(make_place(), "json"), "", Qos.STATE)
    expected = "1 poses, stamp 2"
    wait_until(lambda: (health := health_of(bus, viewer)) and health.message == expected, "")
    assert keeper.is_running
    assert listener.is_running
    both = {"tour", viewer}
    wait_until(lambda: {one.split("/")[3] for one in tokens_of(bus)} == both, "they are shown")


def test_what_was_said_while_the_router_was_away_is_read_afterwards(
    service_process: StartService, router: RouterProcess, config_file: Path
):
    with open_bus([router.endpoint], PATIENCE_S) as bus:
        places = SavedPoses(stamp_ns=1, poses=[make_place("a")])

        def answer(query: Any) -> None:
            query.reply("trolley/tester/poses", codec.encode(places, "json"), codec.MIME["json"])
            query.finish()

        bus.serve("trolley/tester/poses", answer)
        service_process("support.services:Listener")
        viewer = f"viz-{host_name()}"
        wait_for_service(bus, viewer)
        router.stop()
        places = SavedPoses(stamp_ns=2, poses=[make_place("a"), make_place("b")])
        router.start()
        expected = "2 poses, stamp 2"
        wait_until(
            lambda: (health := health_of(bus, viewer)) and health.message == expected,
            "the list is read again",
        )


def test_a_stranger_does_not_have_the_last_word(keeper: Process, bus: ZenohBus) -> None:
    key = "trolley/tester/poses"
    heard: list[bytes] = []
    bus.subscribe(key, lambda sample: heard.append(sample.payload))
    strange = codec.encode(SavedPoses(stamp_ns=1, poses=[make_place("strange")]), "msgpack")
    for _ in range(1000):
        bus.put(key, strange, codec.MIME["msgpack"], Qos.STATE)
    wait_until(lambda: heard and heard[-1] != strange, "its owner says again what holds")
    assert keeper.is_running


# Supervision.


def test_systemd_hears_ready_alive_and_stopping(
    service_process: StartService, tmp_path: Path, notify_socket: NotifySocket
):
    blocker = tmp_path / "blocker"
    environment = {
        "NOTIFY_SOCKET": str(notify_socket.path),
        "WATCHDOG_USEC": "600000",
        "SLEEPER": str(blocker),
    }
    process = service_process("support.services:Sleeper", environment=environment)
    wait_until(lambda: notify_socket.hears("READY=1"), "ready")
    for _ in range(3):
        wait_until(lambda: notify_socket.hears("WATCHDOG=1"), "alive")
    blocker.touch()
    wait_until(blocker.with_suffix(".met").exists, "it hangs")
    notify_socket.hears("nothing")
    notify_socket.said.clear()
    time.sleep(1.0)
    assert not notify_socket.hears("WATCHDOG=1")  # its thread hangs, and so it is silent
    blocker.unlink()
    wait_until(lambda: notify_socket.hears("WATCHDOG=1"), "alive again")
    assert process.terminate() == 0
    assert notify_socket.hears("STOPPING=1")
