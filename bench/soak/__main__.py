"""Leave the robot driving for hours while its services die and come back: does anything wear out?

    python -m bench.soak lockstep --hours 8 [--world real --view 180]
    python -m bench.soak processes --minutes 30
    python -m bench.soak --write

In lock-step the simulated hours pass as fast as they can be computed, and the same seed gives the
same drive. `processes` runs the real processes in real time. Both keep their readings in
`out/soak-*.jsonl` as they go; `--write` puts what they hold into docs/soak.md.
"""

import argparse
import signal
import sys
import tempfile
import time
from pathlib import Path

from bench.harness.figures import Figure, show
from bench.harness.paths import OUT
from bench.soak.lockstep import Soak, soak
from bench.soak.processes import soak_processes
from bench.soak.report import lockstep_figures, process_figures, read_last_run, write_page

MEMORY = Path("/dev/shm")
READING_EVERY_S = 600.0


def run_lockstep(hours: float, seed: int, world: str, view_deg: float) -> list[Figure]:
    """Drive for so long; what came of it."""
    out = _new_file("lockstep" if world == "apartment" else f"lockstep-{world}-{view_deg:.0f}")
    # State is saved in memory: disks are tested by another program.
    where = MEMORY if MEMORY.is_dir() else None
    with tempfile.TemporaryDirectory(dir=where) as folder:
        robot = Soak(Path(folder), seed, world, view_deg)
        soak(robot, hours, seed, min(READING_EVERY_S, hours * 3600.0 / 6.0), out)
    return lockstep_figures(read_last_run(out))


def run_processes(minutes: float, seed: int) -> list[Figure]:
    """Drive and kill for so long; what came of it."""
    out = _new_file("processes")
    soak_processes(minutes, seed, out)
    return process_figures(read_last_run(out))


def _new_file(name: str) -> Path:
    OUT.mkdir(exist_ok=True)
    out = OUT / f"soak-{name}.jsonl"
    out.unlink(missing_ok=True)
    return out


def main() -> int:
    """Run what is asked for; 1 where a target was missed."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").partition("\n")[0])
    parser.add_argument("mode", nargs="?", choices=("lockstep", "processes"), default="lockstep")
    parser.add_argument("--hours", type=float, default=0.1, help="simulated hours in lock-step")
    parser.add_argument("--minutes", type=float, default=2.0, help="minutes of real processes")
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--world", choices=("apartment", "real"), default="apartment")
    parser.add_argument("--view", type=float, default=360.0, help="of the lidar, in degrees")
    parser.add_argument("--write", action="store_true", help="only write docs/soak.md")
    options = parser.parse_args()
    signal.signal(signal.SIGTERM, signal.default_int_handler)  # so that nothing is left behind
    if options.write:
        write_page(OUT)
        return 0
    began_s = time.monotonic()
    if options.mode == "lockstep":
        figures = run_lockstep(options.hours, options.seed, options.world, options.view)
    else:
        figures = run_processes(options.minutes, options.seed)
    show(figures)
    print(f"took {time.monotonic() - began_s:.0f} s")
    return 1 if any(one.is_met is False for one in figures) else 0


if __name__ == "__main__":
    sys.exit(main())
