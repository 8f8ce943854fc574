"""How well the planner knows where people are and how they walk, compared with the truth.

    python -m bench.planner.people_tracks [--crowd cross dense] [--seeds 2] [--seconds 30]

The crowds of `home.py` walk around a robot that stands in the middle of them, as discs and as legs:
whatever the planner makes of its scans, the next scan is the same, so that two versions of it can
be compared sight by sight. Each scan, everybody within 3 m of the robot is compared with the disc
that the planner reckons with at that moment.

    seen       share of the sights in which a disc lies within 0.45 m of them
    place      how far away it lies [m]: median, 90 %
    velocity   how far its velocity is from theirs [m/s]: median, 90 %
    turning    the same of those whose velocity changed by over 0.5 m/s in the last 0.8 s
    hidden     the same of those of whom somebody nearer hides the middle
    nobody's   share of the discs with nobody within 0.45 m
"""

import argparse
import math
import tempfile
from collections import deque
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np
from bench.harness.figures import table
from bench.planner.among_people import CROWDS, HALL, crowded
from bench.planner.people_judge import PeopleJudge
from bench.planner.situations import Scene
from bench.planner.visit import SETTLE_S, TruePose, config_of, world_of
from numpy.typing import NDArray

from trolley.geometry import Pose2D
from trolley.runtime.lockstep import Lockstep
from trolley_base.description import footprint_of
from trolley_base.service import BaseService
from trolley_planner import navigator
from trolley_planner.service import PlannerService

Floats = NDArray[np.float64]
SCAN_S = 0.1
NEAR_M, SAME_M = 3.0, 0.45
TURNED_MPS, TURNED_S = 0.5, 0.8
BEFORE_M = 0.2
"""Who is nearer by less hides nobody [m]."""


@dataclass
class Sights:
    """What was found of whom."""

    rows: list[tuple[bool, bool, float, float]] = field(default_factory=list)
    """Of each sight: whether they turned, whether they are hidden, then how far away the disc lies
    [m] and how far off its velocity is [m/s], infinite where there is none."""
    discs: int = 0
    nobodys: int = 0

    def add(self, discs: Floats, people: tuple[Floats, Floats], before: Floats) -> None:
        """Compare discs with people, both from the robot's place on.

        Args:
            discs: (n, 4) x, y [m], velocity [m/s].
            people: (m, 2) where they are [m], and their velocities [m/s].
            before: (m, 2) what these were before [m/s].
        """
        at, velocity = people
        near = np.flatnonzero(np.hypot(*at.T) < NEAR_M)
        apart = np.hypot(*(discs[:, None, :2] - at[None]).T)  # (people, discs)
        for index in near.tolist():
            has_turned = math.dist(velocity[index], before[index]) > TURNED_MPS
            best = int(apart[index].argmin()) if len(discs) else -1
            place = velocity_off = math.inf
            if best >= 0 and apart[index, best] < SAME_M:
                place = float(apart[index, best])
                velocity_off = math.dist(discs[best, 2:], velocity[index])
            self.rows.append((has_turned, _is_hidden(at, index), place, velocity_off))
        around = np.hypot(*discs[:, :2].T) < NEAR_M
        self.discs += int(around.sum())
        self.nobodys += int((apart[:, around].min(axis=0) > SAME_M).sum())

    def figures(self) -> list[str]:
        """Return the columns of the table."""
        rows = np.array(self.rows)
        turned, hidden = rows[:, 0] > 0.0, rows[:, 1] > 0.0
        return [
            f"{len(rows)}",
            f"{100.0 * np.isfinite(rows[:, 2]).mean():.0f} %",
            _spread(rows[:, 2]),
            _spread(rows[:, 3]),
            _spread(rows[turned, 3]),
            _spread(rows[hidden, 3]),
            f"{100.0 * self.nobodys / max(self.discs, 1):.1f} %",
        ]


def _is_hidden(at: Floats, index: int) -> bool:
    """Say whether somebody stands between the robot, at 0, and somebody's middle."""
    far = float(np.hypot(*at[index]))
    ahead = at[index] / max(far, 1e-9)
    along, beside = at @ ahead, np.abs(at @ (-ahead[1], ahead[0]))
    return bool(((along > 0.0) & (along < far - BEFORE_M) & (beside < BEFORE_M)).any())


def _spread(values: Floats) -> str:
    """Return median and 90 % of what is finite."""
    some = values[np.isfinite(values)]
    return "-" if len(some) == 0 else "{:.2f}, {:.2f}".format(*np.percentile(some, [50, 90]))


def watch(scene: Scene, seed: int, seconds: float, sights: Sights) -> None:
    """Let a crowd walk around a robot that stands in the middle of the hall."""
    # It looks at each scan, as a robot does that has somewhere to go.
    navigator.IDLE_SCAN_S = 0.0
    (left, low), (right, high) = HALL
    scene = replace(scene, start=Pose2D(0.5 * (left + right), 0.5 * (low + high), 0.0))
    with tempfile.TemporaryDirectory() as folder, Lockstep("trolley", seed) as lockstep:
        config = config_of(scene, seed, "360", Path(folder))
        base = lockstep.add(BaseService(config))
        lockstep.add(TruePose(scene.map()))
        planner = lockstep.add(PlannerService(config))
        if scene.crowd is None:
            raise ValueError(f"{scene.name}: nobody walks there")
        crowd, world = scene.crowd(), world_of(base)
        judge = PeopleJudge(crowd, world, footprint_of(config))
        lockstep.run(SETTLE_S)
        before = deque([crowd.velocity.copy()], maxlen=round(TURNED_S / SCAN_S))
        next_s = lockstep.now_s + SCAN_S

        def has_ended() -> bool:
            nonlocal next_s
            judge.update(lockstep.now_s)
            if lockstep.now_s >= next_s:
                next_s += SCAN_S
                costmap = planner.navigator.costmap_manager.require_context().costmap
                pose = world.truth().pose
                base_T_grid = pose.inverse() @ costmap.frame_T_grid
                discs = costmap.moving.walkers_at(lockstep.now_ns)[:, :4]
                turned = Pose2D(0.0, 0.0, base_T_grid.yaw), Pose2D(0.0, 0.0, -pose.yaw)
                seen = (base_T_grid.transform_points(discs[:, :2]),
                        turned[0].transform_points(discs[:, 2:]))  # fmt: skip
                velocity = turned[1].transform_points(crowd.velocity)
                people = pose.inverse().transform_points(crowd.at), velocity
                sights.add(np.column_stack(seen), people, turned[1].transform_points(before[0]))
                before.append(crowd.velocity.copy())
            return False

        lockstep.run_until(has_ended, seconds)


def main(argv: list[str] | None = None) -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--crowd", nargs="+", choices=[*CROWDS], default=[*CROWDS])
    parser.add_argument("--seeds", type=int, default=2)
    parser.add_argument("--seconds", type=float, default=30.0)
    given = parser.parse_args(argv)
    rows: list[list[str]] = []
    for name in given.crowd:
        for legs in (False, True):
            sights = Sights()
            for seed in range(given.seeds):
                watch(crowded(seed, name, legs=legs), seed, given.seconds, sights)
            rows.append([f"{name}, {'legs' if legs else 'discs'}", *sights.figures()])
    head = ["crowd", "sights", "seen", "place", "velocity", "turning", "hidden", "nobody's"]
    table(head, rows)


if __name__ == "__main__":
    main()
