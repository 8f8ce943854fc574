"""The router as a service: what it proves to whoever watches it."""

import ctypes
import os
import signal
import socket
import stat
import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import ExitStack
from datetime import UTC, datetime, timedelta
from pathlib import Path

import pytest
from support.processes import Process, find_free_port
from support.waiting import PATIENCE_S, wait_until

from trolley import topics
from trolley.cli.demo_robot import Choices, write_settings
from trolley.config import ZenohSection
from trolley.connection import Connection, RobotUnreachable
from trolley.ports import ROUTER_PORT
from trolley.security.keyring import Keyring
from trolley.supervision import Watchdog

FEW_FILES = 64
PROGRAM = f"""
import resource
resource.setrlimit(resource.RLIMIT_NOFILE, ({FEW_FILES}, {FEW_FILES}))
from trolley.cli import main
main()
"""
WATCHDOG_S = 3.0


@pytest.fixture
def watchdog() -> Iterator[Watchdog]:
    one = Watchdog(WATCHDOG_S)
    yield one
    one.close()


def test_a_router_that_takes_no_new_session_falls_silent_and_lives(
    tmp_path: Path, watchdog: Watchdog
) -> None:
    with ExitStack() as stack:
        port = find_free_port()
        endpoint = f"tcp/127.0.0.1:{port}"
        arguments = ["-c", PROGRAM, "router", "--listen", endpoint]
        environment = {**watchdog.environment, "TROLLEY_CONFIG": "", "PYTHONUNBUFFERED": "1"}
        router = Process(arguments, tmp_path / "router.log", environment)
        stack.callback(router.kill)

        def is_silent() -> bool:
            assert router.is_running, router.log
            return watchdog.is_silent(time.monotonic())

        def opens() -> bool:
            try:
                with Connection([endpoint], 1.0):
                    return True
            except RobotUnreachable:
                return False

        wait_until(opens, "the router")
        wait_until(lambda: not is_silent(), "it says that it lives")
        idle = [
            stack.enter_context(socket.create_connection(("127.0.0.1", port)))
            for _ in range(2 * FEW_FILES)
        ]
        wait_until(
            lambda: is_silent() and "gets no new session" in router.log, "it does not claim to live"
        )
        for one in idle:
            one.close()
        wait_until(lambda: not is_silent(), "it is well again")
        wait_until(opens, "a new session")
        assert router.terminate() == 0


def test_it_ends_whichever_of_its_threads_is_told_to(tmp_path: Path) -> None:
    """The kernel may give a signal to any thread, and only Python's own wakes up by it."""
    endpoint = f"tcp/127.0.0.1:{find_free_port()}"
    command = ["-c", PROGRAM, "router", "--listen", endpoint]
    router = Process(command, tmp_path / "router.log", {"TROLLEY_CONFIG": ""})
    try:
        wait_until(lambda: "Listening" in router.log, "the router")
        threads = {int(one.name) for one in Path(f"/proc/{router.pid}/task").iterdir()}
        other = (threads - {router.pid}).pop()
        assert ctypes.CDLL(None).tgkill(router.pid, other, signal.SIGTERM) == 0
        assert router.wait() == 0
    finally:
        router.kill()


@pytest.fixture
def at_a_socket(tmp_path: Path) -> Iterator[str]:
    """A router of a PC with several users: it lets other hosts in, and its own group."""
    ring, now = Keyring(tmp_path / "ring"), datetime.now(UTC)
    ring.create(now)
    keys = ring.issue("router", "home", now + timedelta(days=1), ["127.0.0.1"], replace=False)
    os.chmod(tmp_path, 0o755)
    endpoint = f"unixsock-stream/{tmp_path}/router"
    words = ["--listen", endpoint, "--listen", f"tls/127.0.0.1:{find_free_port()}"]
    command = ["-c", PROGRAM, "router", *words, "--keys", str(keys.folder)]
    router = Process(command, tmp_path / "router.log", {"TROLLEY_CONFIG": ""})

    def listens() -> bool:
        assert router.is_running, router.log
        return "Listening" in router.log

    try:
        wait_until(listens, "the router")
        yield endpoint
    finally:
        router.kill()


def test_who_may_open_the_socket_of_a_router_may_do_everything(at_a_socket: str) -> None:
    with (
        Connection([at_a_socket], PATIENCE_S) as speaker,
        Connection([at_a_socket], PATIENCE_S) as listener,
    ):
        speaker.bus.declare_token(topics.ALIVE.key("one", "base", "run-1-2"))
        wait_until(lambda: listener.robots() == ["one"], "it is heard")
    assert stat.S_IMODE(os.stat(at_a_socket.partition("/")[2]).st_mode) == 0o660


OTHER_USER = f"""
import os, socket, sys
from trolley.runtime.zenoh_bus import NotConnected, open_bus
endpoint, group = sys.argv[1:]
os.setgroups([]); os.setgid(int(group)); os.setuid(65534)
try:
    with socket.socket(socket.AF_UNIX) as knock:
        knock.connect(endpoint.partition("/")[2])
except PermissionError:
    try:
        with open_bus([endpoint], 0.5):
            pass
    except NotConnected as said:
        print(said)
else:
    with open_bus([endpoint], {PATIENCE_S}):
        print("came in")
"""


@pytest.mark.skipif(os.geteuid() != 0, reason="only root can be another user")
def test_another_user_of_the_host_comes_in_only_by_the_group(at_a_socket: str) -> None:
    path = Path(at_a_socket.partition("/")[2])
    for folder in path.parents:
        if not folder.stat().st_mode & 1:
            folder.chmod(folder.stat().st_mode | 1)
    group = 54321

    def comes_in(of_group: int) -> str:
        command = [sys.executable, "-c", OTHER_USER, at_a_socket, str(of_group)]
        return subprocess.check_output(command, text=True).strip()

    assert comes_in(group).startswith(f"this user may not use {at_a_socket}")
    os.chown(path, 0, group)
    assert comes_in(group) == "came in"
    assert comes_in(group + 1).startswith(f"this user may not use {at_a_socket}")


def test_without_keys_nothing_listens_beyond_this_host(tmp_path: Path) -> None:
    port = find_free_port()
    config = write_settings(Choices(name="one", port=port), tmp_path)
    assert ZenohSection().connect == [f"tcp/127.0.0.1:{ROUTER_PORT}"]
    command = ["-c", PROGRAM, "router", "--config", str(config)]
    process = Process(command, tmp_path / "router.log")
    try:
        wait_until(lambda: "Listening" in process.log or not process.is_running, "the router")
        assert listening(process.pid) == {f"0100007F:{port:04X}"}
    finally:
        process.kill()


def listening(pid: int) -> set[str]:
    """Where a process listens for TCP or UDP, as the kernel writes it."""
    files = {os.readlink(one) for one in Path(f"/proc/{pid}/fd").iterdir()}
    found: set[str] = set()
    for table, state in (("tcp", "0A"), ("tcp6", "0A"), ("udp", "07"), ("udp6", "07")):
        for line in Path(f"/proc/{pid}/net/{table}").read_text().splitlines()[1:]:
            fields = line.split()
            if fields[3] == state and f"socket:[{fields[9]}]" in files:
                found.add(fields[1])
    return found
