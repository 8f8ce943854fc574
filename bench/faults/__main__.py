"""Breaks everything on a robot that can break, one thing after another, and prints a table.

    python -m bench.faults [--only killed frozen router] [--named "base frozen"]
    python -m bench.faults --write

The robot is the whole stack as real processes on an emulated board and lidar, and drives a tour
without an end. For each fault: what happened, how long until the robot stood, how long until it
drove again, and what was lost of what is saved, which must be nothing. Exits with 1 when something
is not as required. What each group found last is kept in `out/faults`; `--write` puts it into
docs/faults.md, in place of the rows of the same faults. Disks, memory and priorities need root, the
clock a C compiler, the power cut strace; what cannot be tried is said.
"""

import argparse
import signal
import sys
import tempfile
import time
from collections.abc import Callable, Iterable
from pathlib import Path

from bench.faults import door as fault_door
from bench.faults import host as fault_host
from bench.faults import messages as fault_messages
from bench.faults.cases import FAULTS, Fault, Outcome, disturb
from bench.faults.page import keep_outcomes, write_page
from bench.faults.power_cut import cut_everywhere
from bench.faults.robot import Missing, Rig, describe
from bench.harness.figures import table

HEADS = ("fault", "what happens", "stopped after", "drives again after", "lost", "verdict")
Group = Callable[[str], list[Outcome]]
"""Tries its faults, or those whose name contains a text if it can try them one by one."""


def _one_by_one(make: Callable[[], list[Fault]]) -> Group:
    """Break one thing after another on one robot."""

    def run(named: str) -> list[Outcome]:
        with tempfile.TemporaryDirectory() as folder, Rig(Path(folder)) as rig:
            rig.prepare()
            return [_said(disturb(rig, fault)) for fault in make() if named in fault.name]

    return run


def _with_rig(act: Callable[[Rig], Iterable[Outcome]]) -> Group:
    def run(_: str) -> list[Outcome]:
        with tempfile.TemporaryDirectory() as folder, Rig(Path(folder)) as rig:
            rig.prepare()
            found: list[Outcome] = []
            try:
                for outcome in act(rig):
                    found.append(_said(outcome))
            except Missing as missing:
                wrong = [f"{missing} ({describe(rig)})"]
                found.append(Outcome(act.__name__, "could not be tried to its end", wrong=wrong))
            return found

    return run


def _whole(act: Callable[[], list[Outcome]]) -> Group:
    return lambda _: act()


def _said(outcome: Outcome) -> Outcome:
    print(" | ".join(outcome.cells), flush=True)
    return outcome


def _power() -> list[Outcome]:
    outcome = Outcome("power cut at each write point of the state files", "", has_robot=False)
    num_cuts, faults = cut_everywhere()
    outcome.happened = f"{num_cuts} disks after a cut: each file is the old or the new one"
    outcome.lost = faults
    return [outcome] if num_cuts else [Outcome(outcome.fault, "not tried: strace is missing")]


GROUPS: dict[str, Group] = {
    **{name: _one_by_one(make) for name, make in FAULTS.items()},
    "memory": _one_by_one(fault_host.starving),
    "disks": _whole(fault_host.disks),
    "power": _whole(_power),
    "clocks": _whole(fault_host.clocks),
    "cpus": _whole(fault_host.cpus),
    "malformed": _with_rig(fault_messages.malformed),
    "oversized": _with_rig(fault_messages.oversized),
    "foreign": _with_rig(fault_messages.foreign),
    "floods": _with_rig(fault_messages.flood_standing),
    "flooded": _with_rig(fault_messages.flood_driving),
    "door": fault_door.strangers,
}


def main() -> int:
    """Break what is asked for."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").partition("\n")[0])
    parser.add_argument("--only", nargs="+", choices=[*GROUPS], default=[*GROUPS])
    parser.add_argument("--named", default="", help="only faults whose name contains this text")
    parser.add_argument("--write", action="store_true", help="only write docs/faults.md")
    options = parser.parse_args()
    signal.signal(signal.SIGTERM, signal.default_int_handler)  # so that nothing is left behind
    if options.write:
        write_page([*GROUPS])
        return 0
    outcomes: list[Outcome] = []
    for name in options.only:
        began_s = time.monotonic()
        found = GROUPS[name](options.named)
        keep_outcomes(name, found)
        outcomes += found
        table(HEADS, [one.cells for one in found])
        print(f"{name}: {time.monotonic() - began_s:.0f} s", flush=True)
    return 1 if any(one.lost or one.wrong for one in outcomes) else 0


if __name__ == "__main__":
    sys.exit(main())
