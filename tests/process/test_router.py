"""The router as a service: what it proves to whoever watches it."""

import socket
import time
from collections.abc import Iterator
from contextlib import ExitStack
from pathlib import Path

import pytest
from support.processes import Process, find_free_port
from support.waiting import wait_until

from trolley.connection import Connection, RobotUnreachable
from trolley.runtime.supervision import Watchdog

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
        assert not is_silent()
        idle = [
            stack.enter_context(socket.create_connection(("127.0.0.1", port)))
            for _ in range(2 * FEW_FILES)
        ]
        wait_until(is_silent, "it does not claim to live")
        assert "gets no new session" in router.log
        for one in idle:
            one.close()
        wait_until(lambda: not is_silent(), "it is well again")
        assert opens()
        assert router.terminate() == 0
