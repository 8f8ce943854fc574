"""How soon base says that a motor board ignores a stop: the whole service, in lock-step.

python -m bench.base.ignored_stop [--runs 60] [--first 0] [--measured]

Random speeds, brake limits, and boards that report 20 to 50 times a second. The board follows until
base is asked to stop, and then drives on at the same speed. Counted is robot time from the stop to
the first state that says `does_not_obey`. Exits with 1 if one is not found within 0.5 s.
"""

import argparse
import dataclasses
import sys
import tempfile
from pathlib import Path

import msgspec
import numpy as np

from trolley import codes, requests, topics
from trolley.config import RobotConfig
from trolley.geometry import Pose2D, Twist2D
from trolley.gridmap import FREE, OCCUPIED, GridMap, save_map
from trolley.messages import BaseState, VelocityCommand
from trolley.runtime.lockstep import Lockstep
from trolley_base.drivers import ChassisReading, MotionSample
from trolley_base.drivers.real_device import LONGEST_DELAY_S
from trolley_base.service import BaseService
from trolley_base.simulation.simulated_hardware import SimulatedChassis
from trolley_base.world.faulty_wheels import Trouble

ASKED_S = 0.5
HALL = GridMap("hall", 0.05, Pose2D(-5.1, -5.1, 0.0), np.full((204, 204), OCCUPIED, dtype=np.int8))
HALL.cells[2:-2, 2:-2] = FREE


class SlowReports:
    """Joins what the wheels measure to reports that come at a board's own pace."""

    def __init__(self, chassis: SimulatedChassis, period_s: float) -> None:
        self._read, self._period_ns = chassis.read, round(period_s * 1e9)
        self._waiting: list[MotionSample] = []
        self._due_ns = 0

    def read(self) -> ChassisReading:
        """Return what a board would have reported by now."""
        reading = self._read()
        self._waiting += reading.motions
        motions: tuple[MotionSample, ...] = ()
        if self._waiting and self._waiting[-1].stamp_ns >= self._due_ns:
            last = self._waiting[-1]
            moved = Pose2D.identity()
            for one in self._waiting:
                moved = moved @ one.previous_T_base
            motions = (MotionSample(last.stamp_ns, moved, last.twist),)
            self._due_ns = max(self._due_ns, last.stamp_ns - self._period_ns) + self._period_ns
            self._waiting = []
        return dataclasses.replace(reading, motions=motions)


def run(seed: int, folder: Path, *, is_measured: bool) -> tuple[float, str]:
    """Return how soon an ignored stop was found [s], and the robot in words."""
    rng = np.random.default_rng(seed)
    speed, braking = float(rng.uniform(0.05, 0.5)), float(rng.uniform(0.7, 2.0))
    rate, turns = float(rng.uniform(20.0, 50.0)), bool(rng.random() < 0.25)
    wz = float(rng.uniform(0.3, 1.5)) if turns else 0.0
    delay_s = 0.1 if is_measured else LONGEST_DELAY_S
    save_map(HALL, folder / "hall.yaml")
    start = "start = {x = 0.0, y = 0.0, yaw = 0.0}"
    world = f'map = "hall.yaml"\n{start}\n[motors]\ndelay_s = {delay_s}\n'
    (folder / "hall.toml").write_text(world)
    plain = {
        "robot": {"name": "trolley", "footprint": {"length_m": 0.3, "width_m": 0.24}},
        "base": {
            "simulated": {"world": "hall", "seed": seed},
            "limits": {"deceleration_mps2": braking},
        },
        "folder": str(folder),
    }
    lockstep = Lockstep("trolley", state=folder / "state")
    try:
        states: list[BaseState] = lockstep.record(topics.BASE)
        base = lockstep.add(BaseService(msgspec.convert(plain, RobotConfig)))
        lockstep.run(0.2)
        chassis = base.hardware.chassis
        assert isinstance(chassis, SimulatedChassis)
        chassis.read = SlowReports(chassis, 1.0 / rate).read  # type: ignore[method-assign]
        for _ in range(20 + int(rng.integers(10))):
            command = VelocityCommand(
                stamp_ns=base.stamp_ns,
                twist=Twist2D(0.0 if turns else speed, 0.0, wz),
                valid_for=0.3,
            )
            lockstep.publish(topics.COMMAND, command, "teleop")
            lockstep.run(0.1)
        assert not [one for one in states if one.reason == codes.DOES_NOT_OBEY], "a false alarm"
        lockstep.run(float(rng.uniform(0.0, 0.1)))
        asked_ns = base.stamp_ns
        chassis.wheels.trouble = Trouble(goes_on=True)
        lockstep.ask(requests.BASE_STOP)
        lockstep.run(1.5)
    finally:
        lockstep.close()
    found = [one for one in states if one.reason == codes.DOES_NOT_OBEY]
    after_s = (found[0].stamp_ns - asked_ns) * 1e-9 if found else float("inf")
    how = f"{wz:.2f} rad/s" if turns else f"{speed:.2f} m/s"
    return after_s, f"{how}, brakes at {braking:.1f} m/s^2, {rate:.0f} reports a second"


def main() -> int:
    """Print how soon, and the slowest."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").partition("\n")[0])
    parser.add_argument("--runs", type=int, default=60)
    parser.add_argument("--first", type=int, default=0)
    parser.add_argument("--measured", action="store_true", help="base knows a delay of 0.1 s")
    options = parser.parse_args()
    found: list[tuple[float, str]] = []
    for seed in range(options.first, options.first + options.runs):
        with tempfile.TemporaryDirectory() as folder:
            found.append(run(seed, Path(folder), is_measured=options.measured))
    times_s = [after_s for after_s, _ in found]
    few, median, most = np.percentile(times_s, [5, 50, 95])
    print(
        f"{options.runs} ignored stops: 5% {few:.2f} s, median {median:.2f} s, 95% {most:.2f} s, "
        f"at most {max(times_s):.2f} s ({max(found)[1]})"
    )
    return 1 if max(times_s) > ASKED_S else 0


if __name__ == "__main__":
    sys.exit(main())
