"""Leave the robot driving for hours while its services die and come back: does anything wear out?

    python bench/soak.py lockstep --hours 8
    python bench/soak.py processes --minutes 30
    python bench/soak.py --write

In lock-step the simulated hours pass as fast as they can be computed, and the same seed gives the
same drive. With `processes` it is the real thing at real time. Both keep their readings in
`out/soak-*.jsonl` as they go; `--write` puts what is there into docs/soak.md.
"""

import argparse
import tempfile
import time
from pathlib import Path

from soak_lockstep import soak
from soak_report import lockstep_figures, read_last_run, write_page

OUT = Path(__file__).parents[1] / "out"
MEMORY = Path("/dev/shm")
READING_EVERY_S = 600.0


def run_lockstep(hours: float, seed: int) -> None:
    """Drive for so long, and print what came of it."""
    OUT.mkdir(exist_ok=True)
    out = OUT / "soak-lockstep.jsonl"
    out.unlink(missing_ok=True)
    # What is saved is saved in memory: the disk is another program's business.
    where = MEMORY if MEMORY.is_dir() else None
    began_s = time.monotonic()
    with tempfile.TemporaryDirectory(dir=where) as folder:
        soak(hours, seed, Path(folder), min(READING_EVERY_S, hours * 3600.0 / 6.0), out)
    print(f"took {time.monotonic() - began_s:.0f} s")
    lockstep_figures(read_last_run(out))


def main() -> None:
    """Run what is asked for."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").partition("\n")[0])
    parser.add_argument("mode", nargs="?", choices=("lockstep", "processes"), default="lockstep")
    parser.add_argument("--hours", type=float, default=0.1, help="simulated hours in lock-step")
    parser.add_argument("--minutes", type=float, default=2.0, help="minutes of real processes")
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--write", action="store_true", help="only write docs/soak.md")
    options = parser.parse_args()
    if options.write:
        write_page(OUT)
    elif options.mode == "lockstep":
        run_lockstep(options.hours, options.seed)


if __name__ == "__main__":
    main()
