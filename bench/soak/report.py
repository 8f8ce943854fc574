"""Summarizes the soaks' readings: figures on the screen, and tables in docs/soak.md."""

import json
from collections import Counter
from pathlib import Path
from typing import Any

import numpy as np
from bench.faults.page import put_between
from bench.harness.figures import Figure, at_least, at_most, show
from bench.harness.paths import DOCS

PAGE = DOCS / "soak.md"
MARKS = "<!-- {} -->", "<!-- end of {} -->"
# A run that leaks a particle cloud a minute would grow by this [MB / h].
GROWTH_MB_H = 2.0
# Python and the C library take this long to settle after a start [s].
SETTLED_S = 60.0


def read_last_run(path: Path) -> list[dict[str, Any]]:
    """Return the readings of a run."""
    return [json.loads(line) for line in path.read_text(encoding="utf-8").splitlines()]


def lockstep_figures(readings: list[dict[str, Any]]) -> list[Figure]:
    """Return the results of the hours in lock-step."""
    last = readings[-1]
    half = readings[len(readings) // 2 :]
    hours = [one["hours"] for one in half]
    grows = [one["memory_mb"] for one in half]
    growth = float(np.polyfit(hours, grows, 1)[0]) if len(half) > 1 else 0.0
    missed = _listed(last["missed"])
    return [
        Figure("simulated hours", f"{last['hours']:.2f}"),
        Figure("processor time", f"{last['cpu_s']:.0f} s"),
        Figure("distance driven", f"{last['driven_m'] / 1000.0:.2f} km"),
        Figure("tour stops reached", str(last["reached"])),
        Figure("tour stops missed, by reason", missed),
        Figure("services killed", _listed(last["restarts"])),
        Figure("trip paused until a person resumed it", _listed(last["pauses"])),
        Figure("stop pressed while driving", str(last["stops_pressed"])),
        at_most("longest time to stop", last["slowest_stop_s"], 1.5, "s", 2),
        at_most("false alarms of base", sum(last["false_alarms"].values()), 0, "", 0),
        at_most("collisions", last["collisions"], 0, "", 0),
        Figure("smallest distance to an obstacle", f"{last['closest_m']:.3f} m"),
        at_most("other problems", len(last["problems"]), 0, "", 0),
        Figure("memory at the end", f"{last['memory_mb']:.0f} MB"),
        at_most("growth in the second half", growth, GROWTH_MB_H, "MB/h", 2),
        Figure("seed, and hash of the true motion", f"seed {last['seed']}: `{last['truth']}`"),
    ]


def process_figures(lines: list[dict[str, Any]]) -> list[Figure]:
    """Return the results of the minutes with real processes."""
    result = lines[-1]["result"]
    readings = lines[:-1]
    figures = [
        Figure("minutes", f"{result['minutes']:.1f}"),
        at_least("processes killed", sum(result["kills"].values()), 1, "", 0),
        Figure("of which", _listed(result["kills"])),
        Figure("tour stops reached", str(result["reached"])),
        Figure("tour stops missed, by reason", _listed(result["missed"])),
        Figure("trip paused until a person resumed it", _listed(result["pauses"])),
        at_most("collisions", result["collisions"], 0, "", 0),
        at_most("saved data lost", len(result["lost"]), 0, "", 0),
        at_most("other problems", len(result["problems"]), 0, "", 0),
    ]
    for name in sorted({name for one in readings for name in one if name != "at_s"}):
        settled = [one[name][1] for one in readings if name in one and one[name][0] > SETTLED_S]
        if settled:
            text = f"{min(settled)} to {max(settled)} MB"
            figures.append(Figure(f"memory of {name} when settled", text))
    return figures


def _listed(counts: dict[str, int]) -> str:
    return ", ".join(f"{name} {count}" for name, count in Counter(counts).most_common()) or "none"


def write_page(out: Path) -> None:
    """Put the last runs' figures into the page."""
    for name, figures in (("lockstep", lockstep_figures), ("processes", process_figures)):
        file = out / f"soak-{name}.jsonl"
        if not file.exists():
            print(f"skipped: there is no {file}")
            continue
        found = figures(read_last_run(file))
        show(found)
        rows = [f"| {one.what} | {one.now} | {one.target} | {_verdict(one)} |" for one in found]
        head = "| | Measured | Target | |\n|---|---|---|---|"
        begin, end = (mark.format(name) for mark in MARKS)
        put_between(PAGE, head + "\n" + "\n".join(rows), begin, end)


def _verdict(figure: Figure) -> str:
    return {None: "", True: "met", False: "**missed**"}[figure.is_met]
