"""How long a stop takes behind a flood of tool calls, and what an idle session costs.

    python -m bench.mcp.flood [--calls 1000]

Client, robot and router share this process: the figure is an upper bound.
"""

import argparse
import os
import sys
import time
from pathlib import Path

import anyio
from mcp import Client, StdioServerParameters

from trolley import ports, requests, topics
from trolley.messages import BaseState, Clock, PoseEstimate, SavedPoses
from trolley.messages.request_params import Nothing
from trolley.runtime.guest import guest
from trolley.runtime.service import Service, answers, every
from trolley.runtime.zenoh_bus import open_router

IDLE_S = 4.0


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
        """Note when the stop came."""
        self.stopped_s = self.stopped_s or time.monotonic()
        return BaseState(stamp_ns=0, mode="stopped")


def _cpu_s(pid: int) -> float:
    fields = Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()
    return (int(fields[11]) + int(fields[12])) / os.sysconf("SC_CLK_TCK")


def _child() -> int:
    (pid,) = Path(f"/proc/self/task/{os.getpid()}/children").read_text().split()
    return int(pid)


async def _measure(endpoint: str, robot: Robot, calls: int) -> None:
    server = StdioServerParameters(
        command=str(Path(sys.executable).with_name("trolley")),
        args=["mcp", "--connect", endpoint, "--robot", "bench"],
        env=dict(os.environ),
    )
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
            asked_s = time.monotonic()
            await client.call_tool("stop", {})
            answered_s = time.monotonic()
            assert robot.stopped_s is not None
            print(
                f"stop behind {calls} calls: at the robot after {robot.stopped_s - asked_s:.2f} s, "
                f"answered after {answered_s - asked_s:.2f} s"
            )


def main() -> None:
    """Measure."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--calls", type=int, default=1000)
    options = parser.parse_args()
    port = next(one for one in range(17_447, 18_000) if ports.is_free(one))
    endpoint, robot = f"tcp/127.0.0.1:{port}", Robot()
    with open_router([endpoint]), guest(robot, "bench", [endpoint]):
        anyio.run(_measure, endpoint, robot, options.calls)


if __name__ == "__main__":
    main()
