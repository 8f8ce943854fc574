"""The demo as a user starts it, for tests: all services as child processes of `trolley demo`."""

import os
import signal
from pathlib import Path

from support.processes import Process, children_of, find_free_port
from support.waiting import PATIENCE_S, wait_until
from trolley import topics
from trolley.client import Robot
from trolley.messages import TourStatus, Truth
from trolley.runtime import codec
from trolley.runtime.bus import Sample
from trolley.runtime.zenoh_bus import ZenohBus, open_bus
from trolley.topics import Topic

PROGRAM = "from trolley.cli import main; main()"


class Demo:
    """A running demo on a port of its own."""

    def __init__(self, folder: Path, *arguments: str, name: str = "trolley") -> None:
        port = find_free_port()
        self.name = name
        self.endpoint = f"tcp/127.0.0.1:{port}"
        self.process = Process(
            [
                "-c",
                "from trolley.cli import main; main()",
                "demo",
                "--port",
                str(port),
                "--name",
                name,
                *arguments,
            ],
            folder / "demo.log",
            {"TROLLEY_STATE": str(folder / "state")},
        )

        try:
            with open_bus([self.endpoint], PATIENCE_S):  # its router is there
                pass
        except BaseException:
            self.process.kill()
            raise

    def children(self) -> dict[str, int]:
        """The pid of each service that runs now."""
        found: dict[str, int] = {}
        for pid in children_of(self.process.pid):
            try:
                command = Path(f"/proc/{pid}/cmdline").read_bytes().decode().split("\0")
            except FileNotFoundError:
                continue  # it has ended meanwhile
            for part in command:
                if part.startswith("trolley_"):
                    found[part.removeprefix("trolley_")] = pid
        return found

    def client(self) -> Robot:
        """A client of the robot, once it is there: the router is the first of its processes."""
        return Robot(self.name, self.endpoint, connect_timeout=PATIENCE_S)

    def kill_service(self, service: str) -> None:
        """SIGKILL a service; its supervisor brings it back."""
        os.kill(self.children()[service], signal.SIGKILL)

    def end(self) -> None:
        """End the demo and all its services."""
        if self.process.is_running:
            self.process.terminate()


class Latest:
    """The newest message of some topics, and all trip states seen, as a subscriber sees them."""

    def __init__(self, bus: ZenohBus, robot: str) -> None:
        self.truth: Truth | None = None
        self.tour: TourStatus | None = None
        self.truths: list[Truth] = []
        """All that came."""
        self.trip_states: list[str] = []
        self._subscribe(bus, robot, topics.SIM_TRUTH, "truth")
        self._subscribe(bus, robot, topics.TOUR, "tour")

    def _subscribe(self, bus: ZenohBus, robot: str, topic: Topic, field: str) -> None:
        def take(sample: Sample) -> None:
            message = codec.decode(topic.message, sample.payload, sample.encoding)
            setattr(self, field, message)
            if isinstance(message, Truth):
                self.truths.append(message)
            if isinstance(message, TourStatus):
                self.trip_states.append(message.state)

        bus.subscribe(topic.key(robot), take)

    @property
    def speed(self) -> float:
        """True speed of the robot [m/s], turning counted at 0.2 m."""
        assert self.truth is not None
        return speed_of(self.truth)

    def fastest_within(self, seconds: float) -> float:
        """Watch for so long by the robot's clock; the highest speed meanwhile [m/s]."""
        assert self.truth is not None
        begun_ns, begin = self.truth.stamp_ns, len(self.truths) - 1
        wait_until(
            lambda: self.truths[-1].stamp_ns >= begun_ns + round(seconds * 1e9),
            "the robot's time goes on",
        )
        return max(map(speed_of, self.truths[begin:]))

    def wait_for_driving(self) -> None:
        """Wait until the trip is under way and the robot moves."""
        wait_until(
            lambda: (
                self.tour is not None
                and self.tour.state == "driving"
                and self.truth is not None
                and self.speed > 0.2
            ),
            "the robot drives its trip",
        )

    def wait_for_trip(self, state: str) -> TourStatus:
        """Wait until the trip is in this state."""
        wait_until(lambda: self.tour and self.tour.state == state, lambda: f"the trip is {state}")
        assert self.tour is not None
        return self.tour


def speed_of(truth: Truth) -> float:
    """True speed of a robot [m/s], turning counted at 0.2 m."""
    return abs(truth.twist.vx) + 0.2 * abs(truth.twist.wz)
