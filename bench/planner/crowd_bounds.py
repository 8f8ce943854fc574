"""What is possible among the crowds and movers of `home`: the best, and the simplest robots.

    python -m bench.planner.crowd_bounds [--seeds 4] [--row movers]

`all-knowing` knows where everybody will be, and moves in any direction at 0.5 m/s: the shortest
time of a disc as large as the robot's circumscribed circle that nobody comes nearer to than
`keeps`, by a flood over place and time. `straight` drives to the goal as if nobody were there;
`stops` does so, too, but stands while anybody's body is nearer to its circumscribed circle than it
says. These two turn at once and see everybody, and are judged as in `home`.

Time / straight: as a multiple of the straight way's at full speed, infinite if somewhere there is
no way. Contacts are those of one crossing in the mean, people as discs.
"""

import argparse
import itertools
import math
from collections.abc import Callable
from functools import partial
from typing import NamedTuple

import numpy as np
from bench.harness.figures import table
from bench.planner.among_people import CROWDS, MOVERS, crowded, movers
from bench.planner.crowds import Seen
from bench.planner.people_judge import PEOPLE_S, PeopleJudge
from bench.planner.situations import SPEED_MPS, Scene
from bench.planner.visit import LIMIT_S
from numpy.typing import NDArray

from trolley.geometry import Pose2D, Twist2D
from trolley_base.world.simulation import OtherRobot

CELL_M = 0.1
STEP_S = CELL_M / SPEED_MPS
BEYOND_M = 2.0
"""The all-knowing robot may leave the straight way's box by so much."""
KEEPS_M = (0.0, 0.2)
STOPS_M = (0.3, 0.6, 1.0)
SPEED_UP_MPS2, BRAKE_MPS2 = 0.6, 0.9
NEAR_M = 0.05
FAR = Seen(Pose2D(-1000.0, -1000.0, 0.0), 0.2)
"""Where a robot is that nobody sees."""


class Driven(NamedTuple):
    """Where the robot is, and how it moves."""

    pose: Pose2D
    twist: Twist2D


class Ride:
    """A robot on its straight way.

    Args:
        scene: what it crosses.
    """

    def __init__(self, scene: Scene) -> None:
        begin, end = scene.start, scene.goals[0]
        self._pose = Pose2D(begin.x, begin.y, math.atan2(end.y - begin.y, end.x - begin.x))
        self._speed = 0.0

    def truth(self) -> Driven:
        """Return its pose and velocity."""
        return Driven(self._pose, Twist2D(self._speed, 0.0, 0.0))

    def set_others(self, others: list[OtherRobot]) -> None:
        """Nobody is solid here: they walk through it."""

    def step(self, wanted: float) -> None:
        """Drive on for `PEOPLE_S`, towards a speed [m/s]."""
        slower, faster = -BRAKE_MPS2 * PEOPLE_S, SPEED_UP_MPS2 * PEOPLE_S
        self._speed += min(max(wanted - self._speed, slower), faster)
        self._pose = self._pose @ Pose2D(self._speed * PEOPLE_S, 0.0, 0.0)


def straight(scene: Scene, stop_m: float) -> list[float]:
    """Drive straight on; return time / straight, contacts moving, standing, closed, and near.

    Args:
        scene: a crowd.
        stop_m: it stands while somebody is nearer; -inf: never.
    """
    if scene.crowd is None:
        raise ValueError("a crowd has people")
    crowd, ride, goal = scene.crowd(), Ride(scene), scene.goals[0]
    radius = _radius(scene)
    judge, now_s = PeopleJudge(crowd, ride, scene.body.array), 0.0
    while ride.truth().pose.distance_to(goal) > NEAR_M and now_s < LIMIT_S:
        pose = ride.truth().pose
        gaps = np.hypot(*(crowd.at - (pose.x, pose.y)).T) - crowd.radius_m - radius
        ride.step(0.0 if gaps.min() < stop_m else SPEED_MPS)
        now_s += PEOPLE_S
        judge.update(now_s)
    moving = sum(hit.is_moving for hit in judge.hits)
    closed = sum(hit.is_by_robot for hit in judge.hits)
    near = judge.near_s / max(judge.seconds, PEOPLE_S)
    return [now_s / scene.straight()[0], moving, len(judge.hits) - moving, closed, near]


def all_knowing(scene: Scene, keeps_m: float) -> float:
    """Return the least time / straight without a contact; infinite if there is none.

    Args:
        scene: a crowd.
        keeps_m: kept from everybody.
    """
    if scene.crowd is None:
        raise ValueError("a crowd has people")
    crowd, begin, end, radius = scene.crowd(), scene.start, scene.goals[0], _radius(scene)
    low = np.minimum((begin.x, begin.y), (end.x, end.y)) - BEYOND_M
    high = np.maximum((begin.x, begin.y), (end.x, end.y)) + BEYOND_M
    cols, rows = np.ceil((high - low) / CELL_M).astype(int).tolist()
    x, y = np.meshgrid(
        low[0] + CELL_M * (np.arange(cols) + 0.5), low[1] + CELL_M * (np.arange(rows) + 0.5)
    )
    is_free = np.ones((rows, cols), dtype=np.bool_)
    for cx, cy, length, width in scene.boxes:
        off_x = np.maximum(np.abs(x - cx) - 0.5 * length, 0.0)
        off_y = np.maximum(np.abs(y - cy) - 0.5 * width, 0.0)
        is_free &= np.hypot(off_x, off_y) > radius
    first, last = (
        (int((one.y - low[1]) / CELL_M), int((one.x - low[0]) / CELL_M)) for one in (begin, end)
    )
    is_goal = np.hypot(x - end.x, y - end.y) <= scene.xy
    is_goal[last] = True
    is_reached = np.zeros_like(is_free)
    is_reached[first] = True
    for step in itertools.count(1):
        if step * STEP_S > LIMIT_S or not is_reached.any():
            return math.inf
        for _ in range(round(STEP_S / PEOPLE_S)):
            crowd.step(PEOPLE_S, FAR)
        is_reached = spread(is_reached, is_diagonal=step % 2 == 0) & is_free
        for at_x, at_y in crowd.at.tolist():
            away = np.hypot(x - at_x, y - at_y)
            is_reached &= away >= radius + crowd.radius_m + keeps_m
        if is_reached[is_goal].any():
            return step * STEP_S / scene.straight()[0]
    return math.inf


def spread(cells: NDArray[np.bool_], *, is_diagonal: bool) -> NDArray[np.bool_]:
    """Return cells and those beside them; every second time the diagonal ones: an octagon."""
    padded = np.pad(cells, 1)
    found, (rows, cols) = cells.copy(), cells.shape
    for row, col in itertools.product(range(3), range(3)):
        if is_diagonal or row == 1 or col == 1:
            found |= padded[row : row + rows, col : col + cols]
    return found


def _radius(scene: Scene) -> float:
    return float(np.hypot(*scene.body.array.T).max())


def main() -> None:
    """Print a table of all crowds and movers."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--seeds", type=int, default=4)
    parser.add_argument("--row", choices=("crowd", "movers"), nargs="*", help="all if not given")
    given = parser.parse_args()
    kinds: dict[str, Callable[[int], Scene]] = {}
    if not given.row or "crowd" in given.row:
        kinds |= {name: partial(crowded, name=name, legs=False) for name in CROWDS}
    if not given.row or "movers" in given.row:
        kinds |= {f"movers, {level}": partial(movers, level=level) for level in MOVERS}
    rows: list[list[str]] = []
    for name, scene_of in kinds.items():
        scenes = [scene_of(seed) for seed in range(given.seeds)]
        for keeps_m in KEEPS_M:
            times = [all_knowing(scene, keeps_m) for scene in scenes]
            mean = f"{np.mean(times):.2f}"
            rows.append([name, f"all-knowing, keeps {keeps_m:.1f} m", mean, "0", "0", "0", "-"])
        for stop_m in (-math.inf, *STOPS_M):
            found = np.mean([straight(scene, stop_m) for scene in scenes], axis=0).tolist()
            robot = f"stops at {stop_m:.1f} m" if stop_m > 0.0 else "straight"
            figures = [f"{value:.2f}" for value in found[:4]]
            rows.append([name, robot, *figures, f"{found[4]:.0%}"])
    table(("crowd", "robot", "time/straight", "moving", "standing", "closed", "near"), rows)


if __name__ == "__main__":
    main()
