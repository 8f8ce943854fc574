"""Hosts without a certificate at a real router's port for other hosts: whom they may delay."""

import os
import resource
import signal
import socket
import ssl
from collections.abc import Callable, Iterator
from contextlib import ExitStack
from datetime import UTC, datetime, timedelta
from pathlib import Path

import pytest
from support.processes import Process, children_of, find_free_port
from support.waiting import wait_until

from trolley import topics
from trolley.connection import Connection, RobotUnreachable
from trolley.security.host_keys import HostKeys
from trolley.security.keyring import Keyring

FEW_FILES = 256
MANY = 400
PROGRAM = f"""
import resource
resource.setrlimit(resource.RLIMIT_NOFILE, ({FEW_FILES}, {FEW_FILES}))
from trolley.cli import main
main()
"""
TRY_S = 5.0
SOON_S = 60.0
"""What takes a second on a busy machine; it only tells who is served from who is not."""
ALIVE = topics.ALIVE.key("one", "base", "run-1-2")


def client_hello() -> bytes:
    """What a TLS client says first."""
    context = ssl.SSLContext(ssl.PROTOCOL_TLS_CLIENT)
    heard, said = ssl.MemoryBIO(), ssl.MemoryBIO()
    speaker = context.wrap_bio(heard, said, server_hostname="home")
    with pytest.raises(ssl.SSLWantReadError):
        speaker.do_handshake()
    return said.read()


HELLO = client_hello()
WORDS = {
    "nothing": b"",
    "half a hello": HELLO[: len(HELLO) // 2],
    "a hello and no more": HELLO,
    "no TLS": b"GET / HTTP/1.1\r\n\r\n",
}


class Home:
    """A router with few files to open, and the certificate of a person whom it lets in."""

    def __init__(self, folder: Path, stack: ExitStack) -> None:
        ring = Keyring(folder / "ring")
        now = datetime.now(UTC)
        ring.create(now)
        until = now + timedelta(days=30)
        router = ring.issue("router", "home", until, ["127.0.0.1"], replace=False)
        self.person: HostKeys = ring.issue("operator", "anna", until, replace=False)
        self.stack = stack
        self.port = find_free_port()
        self.local = f"tcp/127.0.0.1:{find_free_port()}"
        self.far = f"tls/127.0.0.1:{self.port}"
        listen = ["--listen", self.local, "--listen", f"tls/0.0.0.0:{self.port}"]
        command = ["-c", PROGRAM, "router", *listen, "--keys", str(router.folder)]
        self.router = Process(command, folder / "router.log", {"TROLLEY_CONFIG": ""})
        stack.callback(self.router.kill)
        inside = wait_until(self.try_local, "the router")
        assert inside is not None
        self.lost: list[bool] = []
        inside.bus.on_connection(lambda is_there: None if is_there else self.lost.append(True))
        inside.bus.declare_token(ALIVE)

    def try_local(self) -> Connection | None:
        return self._try([self.local], None)

    def try_far(self) -> Connection | None:
        return self._try([self.far], self.person)

    def _try(self, endpoints: list[str], keys: HostKeys | None) -> Connection | None:
        assert self.router.is_running, self.router.log
        connection = Connection(endpoints, TRY_S, keys)
        try:
            connection.__enter__()
        except RobotUnreachable:
            return None
        self.stack.push(connection.__exit__)
        return connection

    def hang(self, words: bytes) -> None:
        """Many connections from outside that say only this."""
        for _ in range(MANY):
            stranger = self.stack.enter_context(socket.socket())
            stranger.settimeout(TRY_S)
            stranger.connect(("127.0.0.1", self.port))
            try:
                stranger.sendall(words)
            except ConnectionError:
                continue  # it was shown the door

    def door(self) -> int:
        """The process that stands at the port."""
        (door,) = wait_until(lambda: children_of(self.router.pid), "the door")
        return door


@pytest.fixture
def home(tmp_path: Path) -> Iterator[Home]:
    with ExitStack() as stack:
        files = resource.getrlimit(resource.RLIMIT_NOFILE)
        assert files[0] > 2 * MANY, "this process plays the strangers"
        yield Home(tmp_path, stack)


def sees_the_robot(attempt: Callable[[], Connection | None]) -> bool:
    connection = attempt()
    return connection is not None and connection.robots() == ["one"]


def served(attempt: Callable[[], Connection | None], what: str) -> None:
    """Without the door, a router whose files were taken served nobody for minutes."""
    wait_until(lambda: sees_the_robot(attempt), what, SOON_S)


@pytest.mark.parametrize("words", WORDS.values(), ids=WORDS.keys())
def test_hosts_that_hang_at_the_door_keep_nobody_out(home: Home, words: bytes) -> None:
    served(home.try_far, "who has a certificate comes in")
    home.hang(words)
    served(home.try_local, "local programs notice nothing")
    served(home.try_far, "who has a certificate comes in")
    served(home.try_local, "local programs notice nothing")


@pytest.mark.parametrize("number", [signal.SIGKILL, signal.SIGSTOP], ids=["dead", "frozen"])
def test_a_door_that_fails_is_replaced_and_nobody_inside_notices(
    home: Home, number: signal.Signals
) -> None:
    served(home.try_far, "it is open")
    first = home.door()
    os.kill(first, number)
    assert not home.lost, "who is inside stays there"
    served(home.try_local, "local programs notice nothing")
    served(home.try_far, "there is a new one")
    assert not home.lost
    assert home.door() != first
    assert home.router.terminate() == 0


def test_no_door_outlives_its_router(home: Home) -> None:
    door = Path(f"/proc/{home.door()}")
    home.router.kill()
    wait_until(lambda: not door.exists(), "it has ended")


def test_a_port_that_is_taken_is_told(home: Home, tmp_path: Path) -> None:
    where = f"tls/0.0.0.0:{home.port}"
    words = ["--listen", where, "--keys", str(tmp_path / "ring" / "router-home")]
    second = Process(["-c", PROGRAM, "router", *words], tmp_path / "second.log")
    assert second.wait() == 2
    assert f"cannot listen at {where}" in second.log
