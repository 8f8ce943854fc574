"""What an unmapped mirror does to the localizer, and whether it suspects mirrors where none are.

    python -m bench.localizer.mirror [--seeds 2] [--minutes 2] [--full]

The demo's tour, which leads straight at the hall's mirror, and drives to random goals, with the
mirror's zone deleted; then drives in the same world without the mirror. All in lock-step.
"""

import argparse
import math
import tempfile
from pathlib import Path

import numpy as np
from bench.harness.drives import CORRIDOR, ENTRANCE, KITCHEN, Drive, drive_tour, simulated
from bench.harness.figures import Figure, at_least, at_most, show
from bench.harness.paths import WORLDS
from bench.harness.wandering import APARTMENT, START, Wanderer, write_world

from trolley import requests, topics
from trolley.messages import BeamClasses, Suspects
from trolley.messages.request_params import Named
from trolley.messages.sensing import SUSPECTED, UNUSED
from trolley.runtime.lockstep import Lockstep

MIRROR = "hall mirror"
MIRROR_LINE = ((3.46, -1.15), (3.46, -2.25))
# A suspect lies on the mirror if both its ends are this near to it [m].
ON_MIRROR_M = 0.3
STOPS = {"corridor": CORRIDOR, "entrance": ENTRANCE, "kitchen": KITCHEN}


class Ear:
    """What the localizer suspects, as long as the robot drives."""

    def __init__(self, lockstep: Lockstep) -> None:
        """Listen from now on."""
        self._suspects: list[Suspects] = lockstep.record(topics.SUSPECTS)
        self._beams: list[BeamClasses] = lockstep.record(topics.BEAMS)

    @property
    def lines(self) -> list[list[tuple[float, float]]]:
        """All lines that were suspected at any time."""
        return [list(line.points) for message in self._suspects for line in message.lines]

    @property
    def found_mirror(self) -> bool:
        """Whether one of them is the hall's mirror."""
        return any(
            all(from_mirror_m(point) <= ON_MIRROR_M for point in line) for line in self.lines
        )

    @property
    def left_out(self) -> float:
        """Share of the beams with an echo that were suspected."""
        classes = np.concatenate([np.frombuffer(one.classes, np.uint8) for one in self._beams])
        return float(np.mean(classes[classes != UNUSED] == SUSPECTED))


def from_mirror_m(point: tuple[float, float]) -> float:
    """Distance of a point of the map from the hall's mirror [m]."""
    (x, y0), (_, y1) = MIRROR_LINE
    return math.hypot(point[0] - x, max(point[1] - y0, y1 - point[1], 0.0))


def tour(seed: int) -> tuple[Drive, Ear]:
    """The demo's tour with the mirror unmapped."""
    ears: list[Ear] = []
    config = simulated(WORLDS / "apartment.toml", APARTMENT, START, seed)
    drive = drive_tour(
        config,
        seed,
        STOPS,
        without_zones=(MIRROR,),
        on_ready=lambda lockstep: ears.append(Ear(lockstep)),
    )
    return drive, ears[0]


def report_tours(seeds: int) -> None:
    """Drive tours and print errors and suspicions."""
    drives, ears = zip(*(tour(seed) for seed in range(seeds)), strict=True)
    errors = np.concatenate([one.position_errors for one in drives])
    show(
        [
            Figure(
                "tours past the mirror: arrived", f"{sum(d.arrived for d in drives)} of {seeds}"
            ),
            Figure("tours: collisions", f"{sum(one.collisions for one in drives)}"),
            Figure("tours: error, median", f"{np.median(errors):.3f} m"),
            at_most("tours: greatest error", float(errors.max()), 0.15, "m"),
            at_least("tours: mirror suspected", sum(e.found_mirror for e in ears), seeds, digits=0),
            Figure("tours: beams left out", f"{100 * np.mean([e.left_out for e in ears]):.2f} %"),
        ]
    )


def report_wandering(name: str, has_mirror: bool, minutes: float, seed: int) -> None:
    """Drive to random goals and print errors and suspicions."""
    with tempfile.TemporaryDirectory() as folder:
        robot = Wanderer(write_world(Path(folder), mirror=has_mirror), seed)
        robot.lockstep.ask(requests.ZONES_DELETE, Named(name=MIRROR))
        ear = Ear(robot.lockstep)
        robot.run(60.0 * minutes)
        track = robot.track()
        stops = track.episodes(np.isin(track.states, ("lost", "searching")))
        figures = [
            Figure(f"{name}: minutes, goals", f"{minutes:g}, {robot.goals}"),
            Figure(f"{name}: error, median", f"{np.median(track.error_m):.3f} m"),
            at_most(f"{name}: greatest error", float(track.error_m.max()), 0.15, "m"),
            Figure(f"{name}: times lost or searching", f"{len(stops)}"),
            Figure(f"{name}: unsure", f"{100.0 * float(np.mean(track.states == 'unsure')):.1f} %"),
        ]
        if has_mirror:
            figures.append(at_least(f"{name}: mirror suspected", ear.found_mirror, 1, digits=0))
        wrong = [line for line in ear.lines if from_mirror_m(line[0]) > ON_MIRROR_M]
        suspects = len(wrong) if has_mirror else len(ear.lines)
        figures.append(at_most(f"{name}: suspects where no mirror is", suspects, 0, digits=0))
        robot.close()
    show(figures)


def main() -> None:
    """Drive past the mirror, then without one."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--seeds", type=int, default=2)
    parser.add_argument("--minutes", type=float, default=2.0)
    parser.add_argument("--full", action="store_true", help="20 tours, 10 minutes")
    options = parser.parse_args()
    minutes = 10.0 if options.full else options.minutes
    report_tours(20 if options.full else options.seeds)
    report_wandering("unmapped mirror", True, minutes, 1)
    report_wandering("no mirror", False, minutes, 2)


if __name__ == "__main__":
    main()
