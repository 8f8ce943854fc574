"""Drives to a goal 10 m ahead through worlds that nobody has mapped, beside a plain DWA.

    python -m bench.planner.unknown_worlds [--worlds cylinders] [--count 20] [--full] [--fast]
        [--folder PATH]

Prints success, collisions, time-outs, time, score, closest approach, jerk and processor time, for
the planner and for the reference of `dwa.py`, which drives the same worlds. `--full` drives all 300
fields of cylinders and 30 of each other kind; `--fast` lets the planner drive at up to 2 m/s, too;
`--folder` reads worlds (see `fields.load_worlds`) instead of making them. The base's stop field is
off, unless `--stop-field` is given: the planner must not need it.

A run is a success within 1 m of the goal, without touching anything, within 100 s. The score is
the public one: success * OT / clip(t, 2 OT, 8 OT), where OT is the shortest path at 2 m/s.
"""

import argparse
import multiprocessing
import sys
from collections.abc import Sequence
from concurrent.futures import ProcessPoolExecutor
from dataclasses import replace
from pathlib import Path

import numpy as np
from bench.harness.figures import Figure, at_least, at_most, show, table
from bench.planner.crossing import Crossing, Setup, cross
from bench.planner.fields import KINDS, SETS, WORLDS_IN_A_SET, World, load_worlds

SLOW = Setup("0.5 m/s")
FAST = Setup("2 m/s", 2.0, 4.0, 3.0, "acceleration_mps2 = 2.0\nmax_turn_radps = 3.0\n"
             "angular_acceleration_radps2 = 6.0\n")  # fmt: skip
REFERENCE = Setup("DWA", planner=None)
ALL_CYLINDERS, FULL_COUNT = SETS * WORLDS_IN_A_SET, 30
# What is published for the same kind of worlds: success, time [s], score.
PUBLISHED = {"DWA 0.5 m/s": (0.85, 33.0, 0.159), "Nav2 MPPI 0.5 m/s": (0.76, 48.0, 0.105)}


def main() -> None:
    """Drive, and print the figures."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--worlds", choices=sorted(KINDS), nargs="*", default=["cylinders"])
    parser.add_argument("--count", type=int, help="how many of each kind")
    parser.add_argument("--folder", type=Path, help="worlds to read instead")
    parser.add_argument("--only", type=int, nargs="*", help="numbers of worlds")
    parser.add_argument("--full", action="store_true")
    parser.add_argument("--fast", action="store_true", help="up to 2 m/s as well")
    parser.add_argument("--setups", nargs="*", help="names of the setups to drive")
    parser.add_argument("--controller", choices=("mppi", "pursuit"))
    parser.add_argument("--stop-field", action="store_true")
    parser.add_argument("--processes", type=int, default=1)
    parser.add_argument("--each", action="store_true", help="a line for each run")
    given = parser.parse_args()
    setups = [
        _given(setup, given)
        for setup in (REFERENCE, SLOW, FAST)
        if (setup.name in given.setups if given.setups else given.fast or setup is not FAST)
    ]
    for kind, worlds in _worlds(given).items():
        runs = _drive(worlds, setups, given)
        print(f"{kind}: {len(worlds)} worlds")
        _report(kind, setups, runs)


def _given(setup: Setup, given: argparse.Namespace) -> Setup:
    """The setup with what the command line changes."""
    planner = setup.planner
    if planner is not None and given.controller is not None:
        planner += f'controller = "{given.controller}"\n'
    return replace(setup, planner=planner, has_stop_field=given.stop_field)


def _worlds(given: argparse.Namespace) -> dict[str, list[tuple[int, World]]]:
    """Numbered worlds of each kind."""
    if given.folder is not None:
        loaded = list(enumerate(load_worlds(given.folder)))
        chosen = loaded[: given.count] if given.count else loaded
        return {given.folder.name: [one for one in chosen if _is_asked(one[0], given)]}
    kinds = sorted(KINDS) if given.full else given.worlds
    found: dict[str, list[tuple[int, World]]] = {}
    for kind in kinds:
        total = ALL_CYLINDERS if kind == "cylinders" else FULL_COUNT
        count = given.count or (total if given.full else 20)
        numbers = given.only or np.linspace(0, total - 1, count).round().astype(int).tolist()
        found[kind] = [(number, KINDS[kind](number)) for number in numbers]
    return found


def _is_asked(number: int, given: argparse.Namespace) -> bool:
    return given.only is None or number in given.only


def _drive(
    worlds: Sequence[tuple[int, World]], setups: Sequence[Setup], given: argparse.Namespace
) -> list[Crossing]:
    """Drive every setup through every world, several at a time."""
    jobs = [(world, setup, number) for number, world in worlds for setup in setups]
    runs: list[Crossing] = []
    context = multiprocessing.get_context("spawn")
    with ProcessPoolExecutor(given.processes, mp_context=context) as pool:
        for run in pool.map(cross, *zip(*jobs, strict=True)):
            runs.append(run)
            if given.each or sys.stderr.isatty():
                print(_line(run), file=sys.stdout if given.each else sys.stderr, flush=True)
    return runs


def _line(run: Crossing) -> str:
    return (
        f"{run.world:16} {run.setup:8} {run.ending:10} {run.reason:10} {run.seconds:6.1f} s "
        f"score {run.score:.3f} closest {run.closest_m:.3f} m jerk {run.jerk_mps3:.1f}"
    )


def _report(kind: str, setups: Sequence[Setup], runs: Sequence[Crossing]) -> None:
    """Print a table of all setups and the figures that have a target."""
    rows = [_row(setup.name, [run for run in runs if run.setup == setup.name]) for setup in setups]
    if kind == "cylinders":
        rows += [
            [f"published {name}", f"{success:.0%}", "", "", "", f"{time:.1f}", f"{score:.3f}"]
            + [""] * 7
            for name, (success, time, score) in PUBLISHED.items()
        ]
    heads = ["", "success", "hit", "late", "gave up", "time s", "score", "closest m",
             "jerk m/s3", "turn rad/s3", "ms/command", "Hz", "core",
             "controller"]  # fmt: skip
    table(heads, rows)
    show(_figures(kind, setups, runs))


def _row(name: str, runs: Sequence[Crossing]) -> list[str]:
    endings = [run.ending for run in runs]
    counts = [endings.count(one) for one in ("collision", "time-out", "failed")]
    reached = [run.seconds for run in runs if run.ending == "success"]
    commands, seconds = sum(run.commands for run in runs), sum(run.seconds for run in runs)
    planner_s = sum(run.planner_s for run in runs)
    controller_s = sum(run.controller_s for run in runs)
    return [
        name,
        f"{endings.count('success') / len(runs):.1%}",
        *(str(count) for count in counts),
        f"{np.mean(reached) if reached else float('nan'):.1f}",
        f"{np.mean([run.score for run in runs]):.3f}",
        f"{min(run.closest_m for run in runs):.3f}",
        f"{np.mean([run.jerk_mps3 for run in runs]):.1f}",
        f"{np.mean([run.turn_jerk_radps3 for run in runs]):.1f}",
        f"{1e3 * planner_s / max(commands, 1):.2f}",
        f"{commands / max(seconds, 1e-9):.0f}",
        f"{planner_s / max(seconds, 1e-9):.1%}",
        f"{controller_s / max(seconds, 1e-9):.1%}",
    ]


def _seconds(runs: Sequence[Crossing]) -> float:
    """Mean time of those that reached the goal."""
    return float(np.mean([run.seconds for run in runs if run.ending == "success"] or [np.nan]))


def _figures(kind: str, setups: Sequence[Setup], runs: Sequence[Crossing]) -> list[Figure]:
    found: list[Figure] = []
    of = {setup.name: [run for run in runs if run.setup == setup.name] for setup in setups}
    for setup in setups:
        mine = of[setup.name]
        if setup.planner is None:
            continue
        success = float(np.mean([run.ending == "success" for run in mine]))
        score = float(np.mean([run.score for run in mine]))
        hits = sum(run.ending == "collision" for run in mine)
        share = sum(run.controller_s for run in mine) / max(sum(run.seconds for run in mine), 1e-9)
        if setup.speed_mps > 1.0:
            found.append(at_least(f"{setup.name}: score", score, 0.45))
        else:
            found.append(at_least(f"{setup.name}: success", 100.0 * success, 98.0, "%", 1))
        found.append(at_most(f"{setup.name}: collisions", float(hits), 0.0, digits=0))
        found.append(
            at_most(f"{setup.name}: controller's share of a core", 100.0 * share, 15.0, "%", 1)
        )
        reference = of.get(REFERENCE.name)
        if reference and setup.speed_mps <= REFERENCE.speed_mps:
            ratio = score / max(float(np.mean([run.score for run in reference])), 1e-9)
            found.append(at_least(f"{setup.name}: score / that of the DWA", ratio, 1.0, digits=2))
            if kind == "people":
                ratio = _seconds(mine) / _seconds(reference)
                found.append(
                    at_most(f"{setup.name}: time / that of the DWA", ratio, 1.15, digits=2)
                )
    return found


if __name__ == "__main__":
    main()
