"""Starts with a wrong start pose, and how old the saved pose is.

    python -m bench.localizer.start [--starts 6] [--full]

The robot stands somewhere in the apartment and is told that it stands elsewhere: within a metre, or
anywhere. It may turn in place to find itself. A third of the furniture has been moved in every
other start. "Sure of a wrong place": `localized` for 2 s with an error over 0.5 m or 20 degrees.
Then the robot drives, and its file is looked at ten times a second.
"""

import argparse
import math
import tempfile
import tomllib
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from bench.harness.figures import Figure, at_least, at_most, show
from bench.harness.houses import free_poses
from bench.harness.wandering import APARTMENT, IN_THE_WAY, START, Wanderer, write_world

from trolley.geometry import Pose2D
from trolley.gridmap import GridMap, load_map
from trolley_localizer.start_pose import LAST_POSE_FILE

WAIT_S, UNNOTICED_S, NEAR_M, NEAR_RAD = 20.0, 2.0, 1.0, math.radians(45.0)


@dataclass(frozen=True)
class Start:
    """The outcome of one."""

    right_s: float
    """Until it was `localized` where it is for good; infinite if not at the end."""
    fooled_s: float
    """How long at a time it was sure of another place."""


def begin(seed: int, is_near: bool, is_moved: bool) -> Start:
    """Start a robot with a wrong pose and wait."""
    grid = load_map(APARTMENT)
    rng = np.random.default_rng(seed)
    with tempfile.TemporaryDirectory() as folder:
        world = write_world(Path(folder), moved_seed=seed if is_moved else None)
        true = START
        # Moved furniture leaves the world's own start free, so that is where the robot stands.
        while not is_moved:
            true = free_poses(grid, 0.3, 1, rng)[0]
            if all(math.hypot(true.x - x, true.y - y) > reach for x, y, reach in IN_THE_WAY):
                break
        told = next(
            pose
            for pose in (wrong_pose(true, is_near, rng, grid) for _ in range(1000))
            if pose is not None
        )
        robot = Wanderer(world, seed, told, true)
        robot.run(WAIT_S)
        track = robot.track()
        robot.close()
    is_right = track.is_known & ~track.is_far
    since = int(np.flatnonzero(~is_right)[-1]) + 1 if not is_right.all() else 0
    right_s = math.inf
    if since < len(is_right):
        right_s = float(track.stamps_s[since] - track.stamps_s[0])
    fooled = track.episodes(track.is_known & track.is_far, UNNOTICED_S)
    return Start(right_s, max(fooled, default=0.0))


def wrong_pose(
    true: Pose2D, is_near: bool, rng: np.random.Generator, grid: GridMap
) -> Pose2D | None:
    """A pose on free floor, near or far; None if the one tried is not."""
    if not is_near:
        pose = free_poses(grid, 0.2, 1, rng)[0]
        return pose if pose.distance_to(true) > NEAR_M else None
    way, far = rng.uniform(-math.pi, math.pi), rng.uniform(0.3, NEAR_M)
    pose = Pose2D(
        true.x + far * math.cos(way),
        true.y + far * math.sin(way),
        true.yaw + float(rng.uniform(-NEAR_RAD, NEAR_RAD)),
    )
    is_free = grid.values_at(np.array([[pose.x, pose.y]]))[0] == 0
    return pose if is_free else None


def report_starts(name: str, starts: list[Start]) -> None:
    """Print how many were right in the end, and how many were sure of a wrong place."""
    right = np.array([one.right_s for one in starts])
    known = right[np.isfinite(right)]
    show(
        [
            at_least(f"{name}: right after {WAIT_S:g} s", known.size, len(starts), digits=0),
            Figure(
                f"{name}: right for good, median and latest",
                f"{np.median(known):.1f}, {known.max():.1f} s" if known.size else "-",
            ),
            at_most(
                f"{name}: sure of a wrong place for 2 s",
                sum(one.fooled_s > 0.0 for one in starts),
                0,
                digits=0,
            ),
        ]
    )


def saved_age(seconds: float) -> list[Figure]:
    """Drive and compare the saved pose with where the robot said it was."""
    with tempfile.TemporaryDirectory() as folder:
        robot = Wanderer(write_world(Path(folder)), 1)
        robot.run_until(lambda: robot.is_known, 20.0)
        file = robot.lockstep.state / robot.lockstep.robot / LAST_POSE_FILE
        ages: list[float] = []

        def look() -> bool:
            if file.exists():
                saved = tomllib.loads(file.read_text())["pose"]
                near = [
                    k
                    for k in range(max(0, len(robot.poses) - 100), len(robot.poses))
                    if (pose := robot.poses[k].pose) is not None
                    and math.hypot(pose.x - saved["x"], pose.y - saved["y"]) < 1e-6
                ]
                moves = robot.truths[-1].twist.speed > 0.1
                if near and moves:
                    age_ns = robot.latest.stamp_ns - robot.poses[near[-1]].stamp_ns
                    ages.append(age_ns * 1e-9)
            return False

        robot.run_until(look, seconds)
        robot.close()
    return [
        Figure("saved pose: looks while moving", str(len(ages))),
        at_most("saved pose: oldest while moving", max(ages), 2.0, "s", 2),
    ]


def main() -> None:
    """Start wrongly, then watch the file."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--starts", type=int, default=3)
    parser.add_argument("--full", action="store_true", help="50 starts of each kind")
    options = parser.parse_args()
    count = 50 if options.full else options.starts
    for name, is_near in (("told nearby", True), ("told anywhere", False)):
        for what, is_moved in (("", False), (", furniture moved", True)):
            report_starts(name + what, [begin(seed, is_near, is_moved) for seed in range(count)])
    show(saved_age(60.0))


if __name__ == "__main__":
    main()
