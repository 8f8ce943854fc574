"""`trolley mcp` as an assistant starts it: a process, stdin and stdout, real Zenoh."""

import json
import os
import signal
import subprocess
import sys
import time
from collections.abc import Awaitable, Callable, Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING

import anyio
import pytest
from mcp import Client, StdioServerParameters
from support.waiting import PATIENCE_S, wait_until

if TYPE_CHECKING:
    from .conftest import ScriptedRobot

CLIENT = {"name": "test", "version": "1"}


def talk(endpoint: str, script: Callable[[Client], Awaitable[None]], *options: str) -> None:
    trolley = str(Path(sys.executable).with_name("trolley"))
    server = StdioServerParameters(
        command=trolley, args=["mcp", "--connect", endpoint, *options], env=dict(os.environ)
    )

    async def run() -> None:
        with anyio.fail_after(PATIENCE_S):
            async with Client(server, mode="legacy") as client:
                await script(client)

    anyio.run(run)


def test_an_assistant_drives_and_a_flood_delays_no_stop(
    add_robot: Callable[..., "ScriptedRobot"], endpoint: str
) -> None:
    robot = add_robot()

    async def script(client: Client) -> None:
        told: list[str] = []
        began_s = time.monotonic()

        async def tell(progress: float, total: float | None, message: str | None) -> None:
            told.append(message or "")

        arrived = await client.call_tool("go", {"place": "kitchen"}, progress_callback=tell)
        assert not arrived.is_error, arrived.content
        assert told
        assert robot.sent[0].speed == 0.3
        answered: list[bool] = []

        async def ask() -> None:
            answered.append((await client.call_tool("go", {"place": "kitchen"})).is_error is True)

        async with anyio.create_task_group() as tasks:
            for _ in range(1000):
                tasks.start_soon(ask)
            await anyio.sleep(0)
            assert not (await client.call_tool("stop", {})).is_error
        assert robot.stopped
        assert len(answered) == 1000
        # Six at once, and one more each two seconds, however long the flood took.
        assert len(robot.sent) <= 6 + 0.5 * (time.monotonic() - began_s)

    talk(endpoint, script)


def test_a_client_that_goes_away_leaves_no_drive_behind(
    add_robot: Callable[..., "ScriptedRobot"], endpoint: str
) -> None:
    robot = add_robot(script=())

    async def script(client: Client) -> None:
        async with anyio.create_task_group() as tasks:
            tasks.start_soon(lambda: client.call_tool("go", {"place": "kitchen"}))
            while not robot.sent:
                await anyio.sleep(0.01)
            tasks.cancel_scope.cancel()

    talk(endpoint, script)
    wait_until(lambda: robot.canceled, "the drive is canceled")


def test_without_a_robot_it_says_so(trolley: Callable, endpoint: str) -> None:
    done = trolley("mcp", "--connect", endpoint)
    assert done.returncode == 3
    assert done.stdout == ""
    assert "no robot is on the network" in done.stderr


@pytest.mark.parametrize(
    ("number", "code"), [(signal.SIGTERM, 0), (signal.SIGHUP, 0), (signal.SIGINT, 130)]
)
def test_a_session_that_is_asked_to_end_leaves_no_drive_behind(
    add_robot: Callable[..., "ScriptedRobot"], endpoint: str, number: signal.Signals, code: int
) -> None:
    robot = add_robot(script=())
    with session(endpoint) as (process, tell):
        tell({"method": "notifications/initialized"})
        go = {"name": "go", "arguments": {"place": "kitchen"}}
        tell({"id": 2, "method": "tools/call", "params": go})
        wait_until(lambda: robot.sent, "the robot is sent")
        process.send_signal(number)
        assert process.wait(PATIENCE_S) == code
        assert process.stderr is not None
        assert b"Traceback" not in process.stderr.read()
    assert robot.canceled == [robot.sent[0].id]


def test_the_first_answer_knows_the_robot(
    add_robot: Callable[..., "ScriptedRobot"], endpoint: str
) -> None:
    add_robot().clock_every = 8
    with session(endpoint) as (process, tell):
        tell({"method": "notifications/initialized"})
        tell({"id": 2, "method": "tools/call", "params": {"name": "status", "arguments": {}}})
        assert process.stdout is not None
        result = json.loads(process.stdout.readline())["result"]
        status = json.loads(result["content"][1]["text"])
        assert process.stdin is not None
        process.stdin.close()
    assert (status["mode"], status["position"]) == ("ok", "localized")


def test_the_robot_toml_of_a_host_without_a_robot_counts(
    trolley: Callable, endpoint: str, tmp_path: Path
) -> None:
    config = tmp_path / "robot.toml"
    config.write_text(f'[zenoh]\nconnect = ["{endpoint}"]\n\n[mcp]\nrole = "viewer"\n')
    done = trolley("mcp", "--config", str(config))
    assert "no robot is on the network" in done.stderr
    done = trolley("mcp", "--config", str(config), "--role", "operator")
    assert 'robot.toml says role = "viewer"' in done.stderr


def test_a_client_that_reads_no_more_ends_the_session_and_aborts_nothing(
    add_robot: Callable[..., "ScriptedRobot"], endpoint: str
) -> None:
    add_robot()
    with session(endpoint) as (process, tell):
        assert process.stdout is not None
        assert process.stderr is not None
        process.stdout.close()
        tell({"id": 2, "method": "tools/list"})
        assert process.wait(PATIENCE_S) == 0  # while stdin is still open
        said = process.stderr.read().decode()
        assert "The assistant reads no more" in said
        assert "Traceback" not in said


@contextmanager
def session(
    endpoint: str, *options: str
) -> Iterator[tuple[subprocess.Popen[bytes], Callable[[Mapping[str, object]], None]]]:
    """A session that has begun, and what tells it something."""
    trolley = str(Path(sys.executable).with_name("trolley"))
    with subprocess.Popen(
        [trolley, "mcp", "--connect", endpoint, *options],
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
    ) as process:
        assert process.stdin is not None
        assert process.stdout is not None
        stdin = process.stdin

        def tell(message: Mapping[str, object]) -> None:
            stdin.write(json.dumps({"jsonrpc": "2.0", **message}).encode() + b"\n")
            stdin.flush()

        about = {"protocolVersion": "2025-06-18", "capabilities": {}, "clientInfo": CLIENT}
        tell({"id": 1, "method": "initialize", "params": about})
        assert b"result" in process.stdout.readline()
        yield process, tell
