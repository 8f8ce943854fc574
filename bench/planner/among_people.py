"""The situations among people that the planner is judged in; all in frame `map` but where said."""

import math
from dataclasses import replace
from functools import partial
from pathlib import Path

import numpy as np
from bench.planner.crowds import (
    Crowd,
    Paths,
    Polite,
    Recorded,
    Route,
    Seen,
    SocialForceCrowd,
    Stream,
    polynomial_path,
    read_tracks,
)
from bench.planner.situations import SPEED_MPS, WALL_M, Row, Scene, between, on_cells, room

from trolley.geometry import Pose2D, interpolate
from trolley_base.world.gaps import outline_to_point

PERSON_M = 0.2
"""Radius of a body, as in the worlds."""
ONCOMING_MPS, AHEAD_MPS = 0.8, 0.25
LONG_M, ROOM_M = 8.0, 3.0
FREE_M = 1.2
"""In a corridor at least so wide, nobody must be in a person's way."""
MOVER_M = 0.5
BLIND_S = 0.05
FIELD_M = 10.0
"""Half of the edge of the movers' square."""
FAR_GOAL_M = 20.0


def corridor(width_m: float, niche: bool = False) -> Scene:
    """A corridor 8 m long along x between two rooms, its middle at y = 0; from end to end.

    A niche is 0.7 m wide and 0.6 m deep, 2.2 m from the near end.
    """
    half, side = 0.5 * width_m, 0.5 * ROOM_M
    above = (
        (between((0.0, half), (2.2, side)), between((2.2, half + 0.6), (2.9, side)),
         between((2.9, half), (LONG_M, side)))
        if niche
        else (between((0.0, half), (LONG_M, side)),)
    )  # fmt: skip
    boxes = (
        *room((-ROOM_M, -side), (LONG_M + ROOM_M, side)),
        between((0.0, -side), (LONG_M, -half)),
        *above,
    )
    return Scene("corridor", boxes, Pose2D(0.5, 0.0, 0.0), (Pose2D(7.5, 0.0, 0.0),))


def oncoming(seed: int, width_m: float) -> Scene:
    """A person who does not see the robot comes along the corridor and walks on into the room."""
    rng = np.random.default_rng((21, seed))
    scene = corridor(width_m, niche=width_m < FREE_M)
    free = 0.5 * width_m - PERSON_M - 0.05
    y = float(rng.uniform(-1.0, 1.0)) * min(0.15, free if width_m >= FREE_M else 0.05)
    begin = float(rng.uniform(7.0, 8.5))
    way = Route.at_speed(((begin, y), (-1.2, y), (-2.6, math.copysign(1.2, y))), ONCOMING_MPS)

    def crowd() -> Crowd:
        return Crowd(Paths((way,)), PERSON_M, legs=seed % 2 == 1)

    return replace(scene, crowd=crowd, forgives="" if width_m >= FREE_M else "standing")


def polite(seed: int) -> Scene:
    """A person comes who sees the robot, keeps to their right and walks on, or waits there."""
    rng = np.random.default_rng((22, seed))
    width = float(rng.choice([1.0, 1.2, 1.5, 2.0]))
    begin = float(rng.uniform(7.0, 8.5))

    def crowd() -> Crowd:
        person = Polite(
            (begin, 0.0), -1.5, ONCOMING_MPS, 0.5 * width, PERSON_M, stops=seed // 2 % 2 == 1
        )
        return Crowd(person, PERSON_M, legs=seed % 2 == 1)

    return replace(corridor(width), crowd=crowd)


def ahead(seed: int) -> Scene:
    """A person walks slowly ahead in the same direction, and aside in the room at the end."""
    rng = np.random.default_rng((23, seed))
    width = float(rng.choice([1.0, 1.2, 1.5, 2.0]))
    begin = float(rng.uniform(1.6, 2.4))
    way = Route.at_speed(((begin, 0.0), (LONG_M + 0.8, 0.0), (LONG_M + 2.0, 1.2)), AHEAD_MPS)

    def crowd() -> Crowd:
        return Crowd(Paths((way,)), PERSON_M, legs=seed % 2 == 1)

    # The robot may stand on its goal as soon as the person has left it behind.
    return replace(corridor(width), crowd=crowd, least_s=(7.5 - begin) / AHEAD_MPS)


HALL = ((0.0, 0.0), (10.0, 6.0))
BEYOND_M = 6.0
"""People come from and go to so far outside."""


def _streams(kind: str, count: int) -> list[Stream]:
    """Who walks where in a hall of 10 x 6 m that is open on the sides where people walk."""
    (left, low), (right, high) = HALL
    west = ((left - BEYOND_M, low + 0.5), (left - 2.0, high - 0.5))
    east = ((right + 2.0, low + 0.5), (right + BEYOND_M, high - 0.5))
    south = ((left + 1.0, low - BEYOND_M), (right - 1.0, low - 2.0))
    north = ((left + 1.0, high + 2.0), (right - 1.0, high + BEYOND_M))
    half = count // 2
    if kind == "cross":
        quarter = count // 4
        pairs = ((west, east), (east, west), (south, north), (north, south))
        return [Stream(quarter, *pair) for pair in pairs]
    return [Stream(half, west, east), Stream(count - half, east, west)]


CROWDS = {
    "sparse": ("along", 8, "along"),
    "along": ("along", 16, "along"),
    "across": ("along", 16, "across"),
    "cross": ("cross", 16, "along"),
    "dense": ("cross", 28, "along"),
}
"""Scenes: how people walk, how many there are in 22 x 18 m, and how the robot crosses the hall."""


def crowded(seed: int, name: str, *, legs: bool, sees_robot: bool = False) -> Scene:
    """One crossing of a hall among people who walk by social forces."""
    number = tuple(CROWDS).index(name)
    kind, count, across = CROWDS[name]
    rng = np.random.default_rng((30 + number, seed))
    (left, low), (right, high) = HALL
    if across == "along":
        start = Pose2D(left + 0.6, float(rng.uniform(low + 1.0, high - 1.0)), 0.0)
        goal = Pose2D(right - 0.6, float(rng.uniform(low + 1.0, high - 1.0)), 0.0)
    else:
        start = Pose2D(float(rng.uniform(left + 2.0, right - 2.0)), low + 0.6, 0.5 * math.pi)
        goal = Pose2D(float(rng.uniform(left + 2.0, right - 2.0)), high - 0.6, 0.5 * math.pi)
    # Pillars are all that is solid in the open; walls on both sides where people walk along.
    edge = ((left - 9.0, low - 9.0), (right + 9.0, high + 9.0))
    boxes = room(*edge)
    if kind == "along":
        long = (left - 9.0, right + 9.0)
        boxes += (
            between((long[0], low - WALL_M), (long[1], low)),
            between((long[0], high), (long[1], high + WALL_M)),
        )
    else:
        boxes += tuple(
            between((x, y), (x + 0.4, y + 0.4))
            for x in (left + 3.0, right - 3.4)
            for y in (low + 1.5, high - 1.9)
        )

    def crowd() -> Crowd:
        motion = SocialForceCrowd(
            _streams(kind, count), np.array(boxes), PERSON_M,
            np.random.default_rng((40 + number, seed)), (start.x, start.y, 1.2),
            sees_robot=sees_robot,
        )  # fmt: skip
        return Crowd(motion, PERSON_M, legs=legs)

    return Scene(name, boxes, start, (goal,), crowd=crowd, forgives="all")


def recorded(seed: int, file: Path, second: float, *, legs: bool) -> Scene:
    """One crossing of the place where people were recorded, beginning at a random time.

    The robot crosses the middle 80 % of the place, from one side to the opposite one; there are no
    walls. It begins when nobody is within 1.2 m.
    """
    rng = np.random.default_rng((50, seed))
    tracks = read_tracks(file, second)
    sights = np.vstack(tracks)
    low, high = np.quantile(sights[:, 1:], [0.1, 0.9], axis=0)
    along = seed % 2
    middle, half = 0.5 * (low + high), 0.5 * (high - low)
    for _ in range(1000):
        now = float(rng.choice(sights[:, 0]))
        way = float(rng.choice([-1.0, 1.0]))
        begin = middle + half * rng.uniform(-0.8, 0.8, 2)
        end = middle + half * rng.uniform(-0.8, 0.8, 2)
        begin[along], end[along] = (
            middle[along] - way * half[along],
            middle[along] + way * half[along],
        )
        if np.hypot(*(Recorded(tracks, now).at - begin).T).min() > 1.2:
            break
    else:
        raise ValueError(f"{file}: there is always somebody where the robot would begin")
    yaw = math.atan2(*(end - begin)[::-1])
    start, goal = (Pose2D(float(at[0]), float(at[1]), yaw) for at in (begin, end))
    corner = [on_cells(float(value)) for value in (*(low - 12.0), *(high + 12.0))]
    # Walls far outside of what the lidar reaches give the map its size.
    boxes = room((corner[0], corner[1]), (corner[2], corner[3]))

    def crowd() -> Crowd:
        return Crowd(Recorded(tracks, now), PERSON_M, legs=legs)

    return Scene(file.stem, boxes, start, (goal,), crowd=crowd, forgives="all")


MOVERS = {
    "easy": ((5, 8), 1, (0.3, 1.0)),
    "medium": ((10, 14), 2, (0.3, 1.5)),
    "hard": ((18, 24), 3, (0.5, 2.0)),
}
"""How many movers, the highest order of their polynomials, and their speeds [m/s]."""
WANTED = {"easy": 0.95, "medium": 0.70, "hard": 0.45}
"""Wanted share of crossings without a contact; 70 % over all."""


def movers(seed: int, level: str) -> Scene:
    """18 m across a square of 20 x 20 m with round movers that see nobody; frame `odom`."""
    rng = np.random.default_rng((60 + tuple(MOVERS).index(level), seed))
    counts, order, speeds = MOVERS[level]
    start = Pose2D(-9.0, 0.0, 0.0)
    count = int(rng.integers(counts[0], counts[1] + 1))
    paths: list[Route] = []
    while len(paths) < count:
        path = polynomial_path(rng, int(rng.integers(1, order + 1)), speeds, FIELD_M)
        # Nobody comes upon the robot before it can have moved.
        soon = path.points[path.times < 3.0]
        if np.hypot(*(soon - (start.x, start.y)).T).min() > 2.0:
            paths.append(path)

    def crowd() -> Crowd:
        return Crowd(Paths(paths), MOVER_M, legs=False)

    boxes = room((-FIELD_M - 2.0, -FIELD_M - 2.0), (FIELD_M + 2.0, FIELD_M + 2.0))
    return Scene(
        level, boxes, start, (Pose2D(9.0, 0.0, 0.0),), frame="odom", crowd=crowd,
        xy=0.5, yaw=math.pi,
    )  # fmt: skip


def is_free_blindly(scene: Scene) -> bool:
    """Whether a robot that drives straight on at full speed meets nobody."""
    if scene.crowd is None:
        return True
    crowd, start, goal = scene.crowd(), scene.start, scene.goals[0]
    long = start.distance_to(goal)
    for step in range(round(long / SPEED_MPS / BLIND_S)):
        share = step * BLIND_S * SPEED_MPS / long
        pose = interpolate(start, goal, share)
        crowd.step(BLIND_S, Seen(pose, 0.0))
        outline = pose.transform_points(scene.body.array)
        for x, y in crowd.at.tolist():
            if outline_to_point(outline, x, y)[0] < crowd.radius_m:
                return False
    return True


def far_goal(seed: int) -> Scene:
    """A goal 20 to 30 m ahead in frame `odom`, in an open place with some pillars."""
    rng = np.random.default_rng((70, seed))
    far = float(rng.uniform(FAR_GOAL_M, 30.0))
    side = float(rng.uniform(-3.0, 3.0))
    pillars: list[tuple[float, float, float, float]] = []
    while len(pillars) < 12:
        x, y = float(rng.uniform(2.0, far - 2.0)), float(rng.uniform(-4.0, 4.0))
        if math.hypot(x - far, y - side) > 1.5:
            pillars.append((x, y, 0.4, 0.4))
    boxes = (*room((-3.0, -8.0), (34.0, 8.0)), *pillars)
    return Scene(
        "far", boxes, Pose2D(0.0, 0.0, 0.0), (Pose2D(far, side, 0.0),), frame="odom",
        xy=0.3, yaw=math.pi,
    )  # fmt: skip


def crowd_rows() -> tuple[Row, ...]:
    """Each crowd as discs and as legs, and one that sees the robot."""
    found: list[Row] = []
    for name in CROWDS:
        for legs in (False, True):
            scene = partial(crowded, name=name, legs=legs)
            found.append(Row(f"crowd {name}, {'legs' if legs else 'discs'}", "crowd", scene, 1.4))
    sees = partial(crowded, name="along", legs=True, sees_robot=True)
    found.append(Row("crowd along, sees the robot", "crowd", sees, 1.4))
    return tuple(found)


def recorded_rows(files: list[Path], second: float) -> tuple[Row, ...]:
    """Each recording as discs and as legs."""
    return tuple(
        Row(f"{file.stem}, {'legs' if legs else 'discs'}", "recorded",
            partial(recorded, file=file, second=second, legs=legs), 1.4)
        for file in files
        for legs in (False, True)
    )  # fmt: skip


PEOPLE = (
    *(
        Row(f"oncoming, {width:.1f} m wide", "oncoming", partial(oncoming, width_m=width))
        for width in (1.0, 1.2, 1.5, 2.0)
    ),
    Row("polite oncoming", "polite", polite, 1.3),
    Row("ahead at 0.25 m/s", "ahead", ahead, 1.3),
    *crowd_rows(),
    *(
        Row(f"movers, {level}", "movers", partial(movers, level=level), reached=share)
        for level, share in WANTED.items()
    ),
    Row("20-30 m ahead in odom", "far", far_goal, 1.3),
)
