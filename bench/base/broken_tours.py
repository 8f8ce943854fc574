"""How soon base finds out that a wheel is broken while the robot drives tours.

    python -m bench.base.broken_tours [--breaks 40] [--world real --view 180] [--seed 1]

The whole robot drives an endless tour in lock-step, with people about. At moments drawn at random
the run is copied; in each copy something breaks, and the time until base says so is measured. What
the planner tells the broken wheel meanwhile decides how soon that can be: a wheel that is told
nothing cannot be seen to stand. So the table also says how fast the wheel was to turn.
"""

import argparse
import json
import math
import os
import random
import re
import sys
import tempfile
from collections import Counter
from dataclasses import dataclass
from pathlib import Path

import msgspec
import numpy as np
from bench.harness.figures import table
from bench.soak.lockstep import Soak

from trolley import codes, requests, topics
from trolley.messages import BaseState, VelocityCommand
from trolley.runtime.bus import Sample
from trolley_base.differential import sides_of
from trolley_base.service import BaseService
from trolley_base.simulation.simulated_hardware import HALF_TRACK_M, SimulatedChassis
from trolley_base.world.faulty_wheels import BOTH, LEFT, RIGHT, Trouble

PATIENCE_S, STEP_S = 8.0, 0.02
BETWEEN_S = (1.0, 8.0)
MOVING_MPS = 0.03
TURNING_MPS = 0.05
"""A wheel that is told less may stand: a dead band, or hardly any way [m/s]."""
HEADS = ("what breaks", "found", "after", "90 %", "at most", "told to turn for", "90 %", "at most")


@dataclass(frozen=True)
class Break:
    """What breaks, and whose speed decides how soon that shows."""

    trouble: Trouble
    side: int | None = None
    """0: left, 1: right, None: both."""
    is_stopped: bool = False


BREAKS = {
    "left motor dead": Break(Trouble(dead_motors=frozenset((LEFT,))), 0),
    "right motor dead": Break(Trouble(dead_motors=frozenset((RIGHT,))), 1),
    "left encoder stuck": Break(Trouble(stuck_encoders=frozenset((LEFT,))), 0),
    "motors without power": Break(Trouble(dead_motors=BOTH)),
    "ignores a stop": Break(Trouble(goes_on=True), is_stopped=True),
}


@dataclass(frozen=True)
class Found:
    """What came of a break.

    Attributes:
        after_s: until base said so; None: it did not.
        turning_s: in how much of that time the broken side was told to turn.
        says: in which words.
    """

    after_s: float | None
    turning_s: float
    says: str


class Tour:
    """A robot on its endless tour, whose wheels can be broken."""

    def __init__(self, folder: Path, seed: int, world: str, view_deg: float) -> None:
        self.robot = Soak(folder, seed, world, view_deg)
        self.robot.leave_alone()
        self._told: list[tuple[float, float]] = []
        self._state: BaseState | None = None
        bus, name = self.robot.lockstep.bus, self.robot.lockstep.robot
        bus.subscribe(topics.CMD_VEL.key(name), self._hear_command)
        bus.subscribe(topics.BASE.key(name), self._hear_state)

    def _hear_state(self, sample: Sample) -> None:
        self._state = msgspec.msgpack.decode(sample.payload, type=BaseState)

    def _hear_command(self, sample: Sample) -> None:
        twist = msgspec.msgpack.decode(sample.payload, type=VelocityCommand).twist
        self._told.append(sides_of(twist, HALF_TRACK_M))

    def is_moving(self) -> bool:
        """Whether the robot is told to move."""
        return bool(self._told) and max(map(abs, self._told[-1])) > MOVING_MPS

    def broken(self, what: Break) -> Found:
        """Break it in a copy of this process; return what came of it."""
        reading, writing = os.pipe()
        child = os.fork()
        if child == 0:
            try:  # whatever happens, the copy ends here
                with os.fdopen(writing, "w") as file:
                    json.dump(msgspec.to_builtins(self._break(what)), file)
            finally:
                os._exit(0)
        os.close(writing)
        with os.fdopen(reading) as file:
            found = msgspec.convert(json.load(file), Found)
        os.waitpid(child, 0)
        return found

    def _break(self, what: Break) -> Found:
        lockstep = self.robot.lockstep
        base = self.robot.services["base"]
        assert isinstance(base, BaseService)
        chassis = base.hardware.chassis
        assert isinstance(chassis, SimulatedChassis)
        began_s, turning_s = lockstep.now_s, 0.0
        chassis.wheels.trouble = what.trouble
        if what.is_stopped:
            lockstep.ask(requests.BASE_STOP)
        while lockstep.now_s - began_s < PATIENCE_S:
            lockstep.run(STEP_S)
            state = self._state
            seconds = lockstep.now_s - began_s
            sides = self._told[-1]
            told = max(map(abs, sides)) if what.side is None else abs(sides[what.side])
            turning_s += STEP_S if told > TURNING_MPS else 0.0
            if state is not None and state.reason == codes.DOES_NOT_OBEY:
                return Found(seconds, turning_s, state.message)
        return Found(None, turning_s, "")


def row(name: str, found: list[Found]) -> list[str]:
    """Return a row of the table."""
    times = [one.after_s for one in found if one.after_s is not None]
    turning = [one.turning_s for one in found]
    percents = [
        f"{value:.2f} s"
        for values in (times or [math.nan], turning)
        for value in np.percentile(values, [50, 90, 100])
    ]
    return [name, f"{len(times)} of {len(found)}", *percents]


def main() -> int:
    """Drive, break, and print how soon each was found."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").partition("\n")[0])
    parser.add_argument("--breaks", type=int, default=40, help="of each kind")
    parser.add_argument("--world", choices=("apartment", "real"), default="real")
    parser.add_argument("--view", type=float, default=360.0, help="of the lidar, in degrees")
    parser.add_argument("--seed", type=int, default=1)
    options = parser.parse_args()
    rng = random.Random(options.seed)
    found: dict[str, list[Found]] = {name: [] for name in BREAKS}
    said: dict[str, Counter[str]] = {name: Counter() for name in BREAKS}
    with tempfile.TemporaryDirectory() as folder:
        tour = Tour(Path(folder), options.seed, options.world, options.view)
        for _ in range(options.breaks):
            tour.robot.run(rng.uniform(*BETWEEN_S))
            while not tour.is_moving():
                tour.robot.run(0.5)
            for name, what in BREAKS.items():
                one = tour.broken(what)
                found[name].append(one)
                said[name][re.sub("[0-9.]+ (m|rad)/s", "… \\1/s", one.says)] += 1
        tour.robot.close()
    table(HEADS, [row(name, one) for name, one in found.items()])
    for name, sentences in said.items():
        for sentence, number in sentences.most_common():
            print(f"{name}: {number} x {sentence or 'nothing'}")
    return 0


if __name__ == "__main__":
    sys.exit(main())
