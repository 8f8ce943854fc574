"""How soon a zero leaves on the serial line after what should stop the robot.

    python -m bench.base.zeros [--tries 5] [--board waveshare_ugv]
    python -m bench.base.zeros --board linorobot2 --udp 8899      # it calls this port

Base drives an emulated board, a linorobot if none is named, with an LD19 over pseudo-terminals.
What is counted is the time from the cause to the first zero on the line after which nothing else
comes; in each try also how late this machine came round to a thread that mostly sleeps, for that is
in the figure as well.
"""

import argparse
import signal
import sys
import tempfile
import threading
import time
from collections.abc import Callable
from pathlib import Path
from typing import Self

from bench.harness.figures import Figure, at_most, show
from bench.harness.paths import ROOT

sys.path.append(str(ROOT / "tests"))
from support.metal import Metal
from support.processes import RouterProcess, find_free_port

from trolley import codes
from trolley.geometry import Twist2D

AHEAD, BACK = Twist2D(0.3, 0.0, 0.0), Twist2D(-0.3, 0.0, 0.0)
AT_ONCE_S = 0.1
SILENCE_S = 0.5
"""Without a scan for so long, base holds."""
REVOLUTION_S = 0.1
"""A scan that had begun when the lidar fell silent may still be completed."""
SETTLED_S = 0.5


class Lateness:
    """How late this machine comes round to whoever is due, at worst."""

    def __init__(self) -> None:
        self.worst_s = 0.0
        self._end = threading.Event()
        self._thread = threading.Thread(target=self._watch)

    def __enter__(self) -> Self:
        self._thread.start()
        return self

    def __exit__(self, *_: object) -> None:
        self._end.set()
        self._thread.join()

    def _watch(self) -> None:
        while not self._end.is_set():
            before_s = time.monotonic()
            time.sleep(0.001)
            self.worst_s = max(self.worst_s, time.monotonic() - before_s - 0.001)


def first_zero_s(metal: Metal, cause_ns: int) -> float:
    """Seconds from a cause until a zero had come over the line, for good."""
    metal.wait_for_zero()
    metal.wait_for_standing()
    time.sleep(SETTLED_S)
    after = [one for one in metal.emulated.commands() if one.at_ns >= cause_ns]
    moving_ns = max((one.at_ns for one in after if not one.twist.is_zero), default=cause_ns)
    zeros_ns = [one.at_ns for one in after if one.at_ns >= moving_ns and one.twist.is_zero]
    return (min(zeros_ns) - cause_ns) * 1e-9


def stop(metal: Metal) -> float:
    """Somebody presses stop."""
    metal.start_driving(BACK)
    cause_ns = time.monotonic_ns()
    metal.robot.stop()
    delay_s = first_zero_s(metal, cause_ns)
    metal.hand.let_go()
    metal.robot.resume()
    metal.wait_for("ok")
    return delay_s


def lidar(metal: Metal, fault: str, twist: Twist2D) -> float:
    """The lidar fails."""
    metal.start_driving(twist)
    cause_ns = time.monotonic_ns()
    metal.emulated.fault(f"ld19:{fault}")
    metal.wait_for("held", codes.SCAN_LOST)
    delay_s = first_zero_s(metal, cause_ns)
    metal.hand.let_go()
    metal.emulated.fault("ld19:ok")
    metal.wait_for("ok")
    return delay_s


def end(metal: Metal) -> float:
    """Base is told to end."""
    metal.start_driving(AHEAD)
    assert metal.base is not None
    cause_ns = time.monotonic_ns()
    metal.base.send(signal.SIGTERM)
    metal.base.wait()
    delay_s = first_zero_s(metal, cause_ns)
    metal.hand.let_go()
    metal.start_base()
    metal.wait_for("ok")
    return delay_s


CAUSES: dict[str, tuple[float, Callable[[Metal], float]]] = {
    "base/stop": (AT_ONCE_S, stop),
    "lidar silent": (
        SILENCE_S + REVOLUTION_S + AT_ONCE_S,
        lambda metal: lidar(metal, "silence", AHEAD),
    ),
    "lidar unplugged": (AT_ONCE_S, lambda metal: lidar(metal, "unplug", BACK)),
    "SIGTERM to base": (AT_ONCE_S, end),
}


def main() -> None:
    """Measure each cause and print the table."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").partition("\n")[0])
    parser.add_argument("--tries", type=int, default=3)
    parser.add_argument("--board", default="linorobot")
    parser.add_argument("--udp", type=int, help="the port that the board calls over UDP")
    arguments = parser.parse_args()
    tries = arguments.tries
    figures: list[Figure] = []
    with tempfile.TemporaryDirectory() as folder:
        router = RouterProcess(find_free_port(), Path(folder) / "router.log")
        router.start()
        made = Metal(Path(folder), router.endpoint, arguments.board, "ld19", udp=arguments.udp)
        with made.running() as metal:
            metal.wait_for("ok")
            for cause, (limit_s, measure) in CAUSES.items():
                with Lateness() as lateness:
                    slowest_s = max(measure(metal) for _ in range(tries))
                figures.append(at_most(f"{cause}, slowest of {tries}", slowest_s, limit_s, "s"))
                figures.append(Figure("  this machine was late by", f"{lateness.worst_s:.3f} s"))
        router.stop()
    show(figures)


if __name__ == "__main__":
    main()
