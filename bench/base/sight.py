"""What it costs base to drive only where it has seen, beside what the stop field costs.

    python -m bench.base.sight [--seconds 30]

Base drives through the office in lock-step. Printed is the processor time of its parts per
simulated second, for lidars of several views, and how much of base that is.
"""

import argparse
import cProfile
import math
import pstats
import tempfile
import time
from pathlib import Path

import msgspec
from bench.harness.paths import WORLDS

from trolley import topics
from trolley.config import RobotConfig
from trolley.geometry import Twist2D
from trolley.messages import VelocityCommand
from trolley.runtime.lockstep import Lockstep
from trolley_base.service import BaseService

PARTS = {
    "stop field": ("stop_field.py", "scale"),
    "observed space": ("observed_space.py", "update"),
    "sight distance": ("sight_distance.py", "look"),
    "lidar view": ("lidar_view.py", "update"),
}
OWN = ("observed space", "sight distance", "lidar view")


def _drive(lockstep: Lockstep, base: BaseService, seconds: float) -> None:
    for step in range(round(seconds * 10)):
        twist = Twist2D(0.3, 0.0, 0.5 if step % 40 < 20 else -0.5)
        command = VelocityCommand(stamp_ns=base.stamp_ns, twist=twist, valid_for=0.3)
        lockstep.publish(topics.COMMAND, command, "teleop")
        lockstep.run(0.1)


def measure(view_deg: float, seconds: float) -> str:
    """Return a line of the table."""
    with tempfile.TemporaryDirectory() as folder:
        text = (
            (WORLDS / "office.toml").read_text().replace('"office.yaml"', f'"{WORLDS}/office.yaml"')
        )
        beams = f"beams = {round(450 * view_deg / 360.0)}\nfield_of_view = {math.radians(view_deg)}"
        world = Path(folder) / "office.toml"
        world.write_text(text.replace("beams = 450", beams))
        plain = {
            "robot": {"name": "trolley", "footprint": {"length_m": 0.3, "width_m": 0.24}},
            "base": {"simulated": {"world": str(world)}},
        }
        with Lockstep("trolley", 1, Path(folder) / "state") as lockstep:
            base = lockstep.add(BaseService(msgspec.convert(plain, RobotConfig)))
            _drive(lockstep, base, 3.0)
            started_s = time.process_time()
            _drive(lockstep, base, seconds)
            whole_s = (time.process_time() - started_s) / seconds
            profile = cProfile.Profile(time.process_time)
            started_s = time.process_time()
            profile.runcall(_drive, lockstep, base, seconds)
            # The profile itself costs more than half of what it measures.
            share = whole_s / ((time.process_time() - started_s) / seconds)
    stats = pstats.Stats(profile).stats  # pyrefly: ignore[missing-attribute]
    found = {
        name: share
        / seconds
        * sum(
            one[3]
            for (path, _, function), one in stats.items()
            if path.endswith(file) and function == called
        )
        for name, (file, called) in PARTS.items()
    }
    own = sum(found[name] for name in OWN)
    cells = "  ".join(f"{name} {1e3 * found[name]:5.2f} ms" for name in PARTS)
    return (
        f"{view_deg:3.0f}°  base {1e3 * whole_s:5.1f} ms  {cells}  all of sight: "
        f"{own / found['stop field']:.2f} of the stop field, +{own / (whole_s - own):.0%} of base"
    )


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--seconds", type=float, default=30.0)
    options = parser.parse_args()
    for view_deg in (360.0, 270.0, 180.0):
        print(measure(view_deg, options.seconds), flush=True)


if __name__ == "__main__":
    main()
