"""The situations of a home that the planner is judged in: walls, robot, goals; all in frame `map`.

Walls lie on borders of the map's cells unless a scene is moved off them. The seed chooses where the
doors are, where the robot starts and how it stands.
"""

import math
from collections.abc import Callable
from dataclasses import dataclass, replace
from itertools import pairwise
from typing import Literal

import numpy as np
from bench.planner.all_poses import Box, Reach, Speeds, Target
from bench.planner.crowds import Crowd
from numpy.typing import NDArray

from trolley.geometry import Pose2D
from trolley.gridmap import FREE, OCCUPIED, UNKNOWN, GridMap

CELL_M = 0.05
WALL_M = 0.1
SPEED_MPS, TURN_RADPS = 0.5, 1.5
SPEEDS = Speeds(SPEED_MPS, TURN_RADPS)
XY_M, YAW_RAD = 0.05, 0.05
TOUCHING_M = 0.005
"""What the ideal keeps from walls."""
PLANNED_M = 0.03
"""A way that keeps this must be found."""


@dataclass(frozen=True)
class Body:
    """A robot's outline: corners (x, y) in `base_link` [m]."""

    corners: tuple[tuple[float, float], ...]

    @classmethod
    def box(cls, length: float, width: float, behind: float | None = None) -> "Body":
        """A rectangle whose axle lies `behind` ahead of its back; in the middle if not given."""
        back = -0.5 * length if behind is None else -behind
        front, side = back + length, 0.5 * width
        return cls(((front, side), (back, side), (back, -side), (front, -side)))

    @property
    def array(self) -> NDArray[np.float64]:
        """The corners (n, 2)."""
        return np.array(self.corners)


HOBBY = Body.box(0.35, 0.30)
SQUARE = Body.box(0.60, 0.60)
REAR = Body.box(0.60, 0.42, behind=0.10)
ARM = Body.box(0.65, 0.30, behind=0.175)
"""Reaches 0.3 m farther ahead than the first."""


@dataclass(frozen=True)
class Scene:
    """What one drive is about."""

    name: str
    boxes: tuple[Box, ...]
    """Everything solid: x, y of the centre, length along x, width along y [m]."""
    start: Pose2D
    goals: tuple[Pose2D, ...]
    """Driven to one after the other."""
    body: Body = HOBBY
    frame: Literal["map", "odom"] = "map"
    grid_shift: tuple[float, float] = (0.0, 0.0)
    """How far the map's cells lie off the walls [m]."""
    grid_turn: float = 0.0
    """Angle by which the map's cells are turned against the walls [rad]."""
    things: tuple[Box, ...] = ()
    """As solid as the boxes, but not on the map."""
    crowd: Callable[[], Crowd] | None = None
    """Makes the people, who begin to walk with the first goal."""
    forgives: Literal["", "standing", "all"] = ""
    """Contacts with people that are counted but do not make the drive a failure."""
    xy: float = XY_M
    yaw: float = YAW_RAD
    """Tolerances of the goals [m, rad]; pi: any heading."""
    least_s: float = 0.0
    """With people, the ideal time is no shorter: the time that somebody ahead needs [s]."""

    def ideal_s(self, margin_m: float = TOUCHING_M) -> float:
        """Shortest time of the footprint at full speed, turning included [s]; inf: no way."""
        reach = Reach(self.body.array, (*self.boxes, *self.things), margin_m)
        places = (self.start, *self.goals)
        return sum(
            reach.seconds(begin, Target(end, self.xy, self.yaw), SPEEDS)
            for begin, end in pairwise(places)
        )

    def straight(self) -> tuple[float, float]:
        """Time [s] and length [m] straight from goal to goal at full speed."""
        places = (self.start, *self.goals)
        length = sum(begin.distance_to(end) for begin, end in pairwise(places))
        return length / SPEED_MPS, length

    def map(self) -> GridMap:
        """The map: a cell is occupied where its centre lies in something solid."""
        rows = np.array(self.boxes)
        low, high = rows[:, :2] - 0.5 * rows[:, 2:], rows[:, :2] + 0.5 * rows[:, 2:]
        (left, down), (right, up) = low.min(axis=0), high.max(axis=0)
        turned = Pose2D(0.0, 0.0, self.grid_turn)
        ends = np.array([(left, down), (right, down), (left, up), (right, up)])
        within = turned.inverse().transform_points(ends)
        corner = within.min(axis=0) - self.grid_shift
        cols, lines = np.ceil((within.max(axis=0) - corner) / CELL_M - 1e-6).astype(int).tolist()
        x, y = corner.tolist()
        origin = turned @ Pose2D(x, y, 0.0)
        col, line = np.meshgrid(np.arange(cols), np.arange(lines))
        centres = CELL_M * (np.stack([col, line], axis=-1).reshape(-1, 2) + 0.5)
        places = origin.transform_points(centres).reshape(lines, cols, 1, 2)
        cells = np.full((lines, cols), FREE, dtype=np.int8)
        is_inside = (places[:, :, 0] > (left, down)) & (places[:, :, 0] < (right, up))
        cells[~is_inside.all(axis=-1)] = UNKNOWN
        cells[((places > low) & (places < high)).all(axis=-1).any(axis=-1)] = OCCUPIED
        return GridMap("home", CELL_M, origin, cells)


@dataclass(frozen=True)
class Row:
    """A row of the table.

    Attributes:
        name: what the table calls it.
        group: what `--row` chooses it by.
        scene: makes the scene of a seed.
        limit: wanted time / ideal time.
        reached: wanted share of drives without failure.
    """

    name: str
    group: str
    scene: Callable[[int], Scene]
    limit: float = math.inf
    reached: float = 1.0


def room(low: tuple[float, float], high: tuple[float, float]) -> tuple[Box, ...]:
    """Four walls around what lies between two corners [m]."""
    (left, down), (right, up) = low, high
    middle, centre = 0.5 * (left + right), 0.5 * (down + up)
    long, tall = right - left + 2.0 * WALL_M, up - down + 2.0 * WALL_M
    off = 0.5 * WALL_M
    return (
        (middle, down - off, long, WALL_M),
        (middle, up + off, long, WALL_M),
        (left - off, centre, WALL_M, tall),
        (right + off, centre, WALL_M, tall),
    )


def between(low: tuple[float, float], high: tuple[float, float]) -> Box:
    """A box by two corners [m]."""
    (left, down), (right, up) = low, high
    return (0.5 * (left + right), 0.5 * (down + up), right - left, up - down)


def on_cells(value: float) -> float:
    """The nearest border of a cell [m]."""
    return round(value / CELL_M) * CELL_M


def door(seed: int, width_m: float, body: Body = HOBBY) -> Scene:
    """Two rooms of 3 x 3 m with a door between them, through it and back."""
    rng = np.random.default_rng((11, seed))
    side, wall = 3.0, 3.0
    middle = on_cells(rng.uniform(0.8, side - 0.8))
    # An odd number of cells has its middle half a cell on.
    low = on_cells(middle - 0.5 * width_m)
    boxes = (
        *room((0.0, 0.0), (2.0 * side + WALL_M, side)),
        between((wall, 0.0), (wall + WALL_M, low)),
        between((wall, low + width_m), (wall + WALL_M, side)),
    )
    start = Pose2D(
        float(rng.uniform(0.7, 1.8)), float(rng.uniform(0.7, 2.3)), float(rng.uniform(-3.1, 3.1))
    )
    goal = Pose2D(
        float(rng.uniform(4.3, 5.4)), float(rng.uniform(0.7, 2.3)), float(rng.uniform(-3.1, 3.1))
    )
    return Scene("door", boxes, start, (goal, start), body)


def corner_door(seed: int, width_m: float) -> Scene:
    """Two rooms with a door whose one side is the wall of both."""
    scene, side = door(seed, width_m), 3.0
    wall = between((3.0, width_m), (3.0 + WALL_M, side))
    return replace(scene, boxes=(*scene.boxes[:-2], wall))


def corridor_door(seed: int, width_m: float) -> Scene:
    """A door at the end of a corridor 0.9 m wide and 1.5 m long, off its middle."""
    scene, side, long = door(seed, width_m), 3.0, 1.5
    middle = door_of(scene)[1]
    off = float(np.random.default_rng((17, seed)).uniform(-0.2, 0.2))
    low, high = on_cells(middle + off - 0.45), on_cells(middle + off + 0.45)
    walls = (
        between((3.0 - long, 0.0), (3.0, low)),
        between((3.0 - long, high), (3.0, side)),
    )
    start = Pose2D(0.7, scene.start.y, scene.start.yaw)
    return replace(
        scene, boxes=(*scene.boxes[:-2], *walls, *scene.boxes[-2:]), start=start,
        goals=(scene.goals[0], start),
    )  # fmt: skip


def door_of(scene: Scene) -> tuple[float, float]:
    """The middle of the door of a scene [m]."""
    below, above = scene.boxes[-2:]
    return below[0], 0.5 * (below[1] + 0.5 * below[3] + above[1] - 0.5 * above[3])


def goal_in_door(seed: int) -> Scene:
    """To the middle of a door 20 cm wider than the robot, and back."""
    scene = door(seed, 0.50)
    goal = Pose2D(*door_of(scene), math.pi * (seed % 2))
    return replace(scene, goals=(goal, scene.start))


def beside_wall(seed: int) -> Scene:
    """A room of 3 x 3 m; a goal 2 to 5 cm beside a wall and along it, and away again."""
    rng = np.random.default_rng((12, seed))
    gap = float(rng.uniform(0.02, 0.05))
    half = max(y for _, y in HOBBY.corners)
    yaw = math.pi if seed % 2 else 0.0
    start = Pose2D(
        float(rng.uniform(0.6, 2.4)), float(rng.uniform(1.2, 2.4)), float(rng.uniform(-3.1, 3.1))
    )
    goal = Pose2D(float(rng.uniform(0.8, 2.2)), gap + half, yaw)
    return Scene("wall", room((0.0, 0.0), (3.0, 3.0)), start, (goal, start))


def corner(seed: int) -> Scene:
    """The same, in a corner: front and side 5 cm from the walls."""
    rng = np.random.default_rng((13, seed))
    front, half = HOBBY.corners[0]
    start = Pose2D(
        float(rng.uniform(0.6, 1.8)), float(rng.uniform(1.2, 2.4)), float(rng.uniform(-3.1, 3.1))
    )
    goal = Pose2D(3.0 - 0.05 - front, 0.05 + half, 0.0)
    return Scene("corner", room((0.0, 0.0), (3.0, 3.0)), start, (goal, start))


def dead_end(seed: int, width_m: float, *, faces_out: bool) -> Scene:
    """A dead end 1.2 m deep beside a room of 3 x 3 m: to its end, and out again."""
    rng = np.random.default_rng((14, seed))
    side, deep = 3.0, 1.2
    low = on_cells(rng.uniform(0.6, side - 0.6 - width_m))
    boxes = (
        *room((0.0, 0.0), (side + deep, side)),
        between((side, 0.0), (side + deep, low)),
        between((side, low + width_m), (side + deep, side)),
    )
    start = Pose2D(
        float(rng.uniform(0.6, 1.8)), float(rng.uniform(0.6, 2.4)), float(rng.uniform(-3.1, 3.1))
    )
    back = Pose2D(
        float(rng.uniform(0.6, 1.8)), float(rng.uniform(0.6, 2.4)), float(rng.uniform(-3.1, 3.1))
    )
    # In the end the robot's front or back is 10 cm from the wall.
    end = Pose2D(side + deep - 0.1 - 0.5 * 0.35, low + 0.5 * width_m, math.pi if faces_out else 0.0)
    return Scene("dead end", boxes, start, (end, back))


def out_of_dead_end(seed: int) -> Scene:
    """From the end of a dead end 0.55 m wide, looking in, to a goal outside, looking away."""
    there = dead_end(seed, 0.55, faces_out=False)
    end = there.goals[0]
    outside = Pose2D(end.x - 2.0, end.y, math.pi)
    return replace(there, start=end, goals=(outside,))


def behind(seed: int) -> Scene:
    """A corridor 7 to 10 m long; a goal behind the robot, looking as it does, and back."""
    rng = np.random.default_rng((18, seed))
    half = 0.5 * float(rng.choice([0.8, 1.0, 1.5, 2.0]))
    long = on_cells(float(rng.uniform(7.0, 10.0)))
    y, yaw = rng.choice([0.0, 1.0]) * rng.uniform(-0.1, 0.1, 2)
    start, goal = Pose2D(2.0, float(y), math.pi + float(yaw)), Pose2D(long - 0.6, 0.0, math.pi)
    return Scene("behind", room((0.0, -half), (long, half)), start, (goal, start))


def bend(seed: int, *, is_z: bool) -> Scene:
    """A corridor 0.60 to 0.70 m wide with one bend or two, between two rooms.

    Widths in which an exhaustive search finds no way that keeps 3 cm are drawn again.
    """
    rng = np.random.default_rng((15 + is_z, seed))
    while True:
        scene = _draw_bend(rng, float(rng.choice([0.60, 0.65, 0.70])), is_z=is_z)
        if math.isfinite(scene.ideal_s(PLANNED_M)):
            return scene


def _draw_bend(rng: np.random.Generator, wide: float, *, is_z: bool) -> Scene:
    """A room on the left; a corridor from it to the right, up, and with a Z to the right again."""
    first, up, last = (on_cells(float(rng.uniform(1.2, 1.8))) for _ in range(3))
    left, low = 2.0, 0.6
    knee = left + first
    top = low + wide + up
    if is_z:
        end = knee + wide + last
        high = top + wide
        # Above the first piece, right of the second, above the third is where the room ends.
        boxes = (
            *room((0.0, 0.0), (end, high)),
            between((left, 0.0), (end, low)),
            between((left, low + wide), (knee, high)),
            between((knee + wide, low), (end, top)),
        )
        goal = Pose2D(end - 0.65, top + 0.5 * wide, 0.0)
    else:
        end, high = knee + wide, top
        boxes = (
            *room((0.0, 0.0), (end, high)),
            between((left, 0.0), (end, low)),
            between((left, low + wide), (knee, high)),
        )
        goal = Pose2D(knee + 0.5 * wide, top - 0.65, 0.5 * math.pi)
    start = Pose2D(0.9, float(rng.uniform(0.8, high - 0.9)), float(rng.uniform(-0.8, 0.8)))
    return Scene("Z" if is_z else "L", boxes, start, (goal, start), REAR)


STATIC = (
    Row("door +5 cm", "door", lambda seed: door(seed, 0.35), 2.0),
    Row("door +10 cm", "door", lambda seed: door(seed, 0.40), 2.0),
    Row("door +15 cm", "door", lambda seed: door(seed, 0.45), 2.0),
    Row("door +10 cm in a corner", "doors", lambda seed: corner_door(seed, 0.40), 2.0),
    Row("door +10 cm after a corridor", "doors", lambda seed: corridor_door(seed, 0.40), 2.0),
    Row("door +10 cm, axle at the rear", "doors", lambda seed: door(seed, 0.52, REAR), 2.0),
    Row("0.60 x 0.60, door 0.70", "square", lambda seed: door(seed, 0.70, SQUARE), 2.0),
    Row("goal in a door +20 cm", "odd", goal_in_door, 2.0),
    Row("arm ahead, door +15 cm", "odd", lambda seed: door(seed, 0.45, ARM), 2.0),
    Row("2-5 cm beside a wall", "wall", beside_wall, 1.8),
    Row("corner, 5 cm", "corner", corner, 1.8),
    Row("dead end 0.55, facing out", "dead-end",
        lambda seed: dead_end(seed, 0.55, faces_out=True), 2.5),
    Row("dead end 0.55, from its end", "dead-end", out_of_dead_end, 2.5),
    Row("dead end 0.40, out again", "dead-end",
        lambda seed: dead_end(seed, 0.40, faces_out=False), 2.5),
    Row("goal behind it in a corridor", "behind", behind, 1.5),
    Row("L, axle at the rear", "bend", lambda seed: bend(seed, is_z=False), 2.5),
    Row("Z, axle at the rear", "bend", lambda seed: bend(seed, is_z=True), 2.5),
)  # fmt: skip
