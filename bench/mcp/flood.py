"""How long a stop takes behind a flood of tool calls, and what an idle session costs.

    python -m bench.mcp.flood [--calls 1000]

The flood comes twice: as lines that are written at once, which shows what the session takes, and
from the SDK's own client, whose sending of all the calls before the stop counts, too.
"""

import argparse
import json
import multiprocessing
import os
import subprocess
import sys
import threading
import time
from multiprocessing.connection import Connection
from pathlib import Path
from typing import IO, Any

import anyio
from mcp import Client, StdioServerParameters

from trolley import ports, requests, topics
from trolley.messages import BaseState, Clock, PoseEstimate, SavedPoses
from trolley.messages.request_params import Nothing
from trolley.runtime.guest import guest
from trolley.runtime.service import Service, answers, every
from trolley.runtime.zenoh_bus import open_router

IDLE_S = 4.0
SETTLE_S = 1.5
"""Until a session has loaded everything."""
ROBOT = "bench"


class Robot(Service):
    """A base that is stopped, and streams as a robot has them."""

    name = "base"

    def __init__(self) -> None:
        self.stopped_s: float | None = None

    def start(self) -> None:
        """Publish what is asked for."""
        self.publish(topics.POSES, SavedPoses(stamp_ns=0, poses=[]))

    @every(0.1, clock="local")
    def tick(self) -> None:
        """Publish a clock and a pose."""
        now_ns = time.time_ns()
        self.publish(topics.CLOCK, Clock(stamp_ns=now_ns, rate=1.0, epoch=0))
        self.publish(
            topics.POSE,
            PoseEstimate(
                stamp_ns=now_ns,
                map="home",
                pose=None,
                covariance=None,
                state="lost",
                match=0.0,
                spread=0.0,
            ),
        )

    @answers(requests.BASE_STOP)
    def halt(self, _params: Nothing) -> BaseState:
        """Note when the stop came, by the clock that all processes share."""
        self.stopped_s = self.stopped_s or time.monotonic()
        return BaseState(stamp_ns=0, mode="stopped")


def _cpu_s(pid: int) -> float:
    fields = Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()
    return (int(fields[11]) + int(fields[12])) / os.sysconf("SC_CLK_TCK")


def _child() -> int:
    """The session's process: the only child that is no robot."""
    children = Path(f"/proc/self/task/{os.getpid()}/children").read_text().split()
    others = {str(one.pid) for one in multiprocessing.active_children()}
    (pid,) = (
        one
        for one in children
        if one not in others and b"mcp" in Path(f"/proc/{one}/cmdline").read_bytes()
    )
    return int(pid)


def _play_robot(endpoint: str, line: Connection) -> None:
    """Run robot and router, and tell when a stop came each time it is asked."""
    robot = Robot()
    with open_router([endpoint]), guest(robot, ROBOT, [endpoint]):
        line.send(None)
        while line.recv():
            line.send(robot.stopped_s)
            robot.stopped_s = None


def _ask(line: Connection) -> float:
    line.send(True)
    return line.recv()


def _call(tool: str, number: object) -> bytes:
    return _line("tools/call", {"name": tool, "arguments": {}}, number)


def _line(method: str, params: dict[str, Any], number: object = None) -> bytes:
    message = {"jsonrpc": "2.0", "method": method, "params": params}
    return json.dumps(message if number is None else {**message, "id": number}).encode() + b"\n"


def _measure_lines(command: list[str], robot: Connection, calls: int) -> None:
    """Write all calls and then the stop at once."""
    with subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE) as session:
        assert session.stdin is not None
        assert session.stdout is not None
        about = {"protocolVersion": "2025-06-18", "capabilities": {}}
        begin = {**about, "clientInfo": {"name": "bench", "version": "1"}}
        session.stdin.write(_line("initialize", begin, "begin"))
        session.stdin.flush()
        session.stdout.readline()
        session.stdin.write(_line("notifications/initialized", {}))
        session.stdin.flush()
        time.sleep(SETTLE_S)
        flood = b"".join(_call("status", number) for number in range(calls)) + _call("stop", "stop")
        asked_s = time.monotonic()
        # Answers are read meanwhile, or both sides would wait for each other.
        writing = threading.Thread(target=_write, args=(session.stdin, flood))
        writing.start()
        for line in session.stdout:
            if json.loads(line).get("id") == "stop":
                break
        answered_s = time.monotonic()
        _report(f"{calls} lines at once", _ask(robot) - asked_s, answered_s - asked_s)
        for _ in range(calls - 1):
            session.stdout.readline()
        writing.join()
        session.terminate()


def _write(stream: IO[bytes], data: bytes) -> None:
    stream.write(data)
    stream.flush()


async def _measure_client(command: list[str], robot: Connection, calls: int) -> None:
    server = StdioServerParameters(command=command[0], args=command[1:], env=dict(os.environ))
    async with Client(server, mode="legacy") as client:
        await client.list_tools()
        pid = _child()
        before_s = _cpu_s(pid)
        await anyio.sleep(IDLE_S)
        print(f"idle: {100.0 * (_cpu_s(pid) - before_s) / IDLE_S:.1f} % of a core")
        async with anyio.create_task_group() as tasks:
            for _ in range(calls):
                tasks.start_soon(lambda: client.call_tool("status", {}))
            await anyio.sleep(0)
            asked_s, client_s, session_s = time.monotonic(), time.process_time(), _cpu_s(pid)
            await client.call_tool("stop", {})
            answered_s, client_s = time.monotonic(), time.process_time() - client_s
            session_s = _cpu_s(pid) - session_s
            _report(f"{calls} calls by the SDK", _ask(robot) - asked_s, answered_s - asked_s)
            print(f"  the client computed {client_s:.2f} s, the session {session_s:.2f} s")


def _report(flood: str, at_robot_s: float, answered_s: float) -> None:
    print(
        f"stop behind {flood}: at the robot after {at_robot_s:.3f} s, "
        f"answered after {answered_s:.3f} s"
    )


def main() -> None:
    """Measure."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--calls", type=int, default=1000)
    options = parser.parse_args()
    port = next(one for one in range(17_447, 18_000) if ports.is_free(one))
    endpoint = f"tcp/127.0.0.1:{port}"
    trolley = str(Path(sys.executable).with_name("trolley"))
    command = [trolley, "mcp", "--connect", endpoint, "--robot", ROBOT]
    near, far = multiprocessing.Pipe()
    playing = multiprocessing.get_context("spawn").Process(
        target=_play_robot, args=(endpoint, far), daemon=True
    )
    playing.start()
    near.recv()
    anyio.run(_measure_client, command, near, options.calls)
    _measure_lines(command, near, options.calls)
    near.send(False)
    playing.join()


if __name__ == "__main__":
    main()
