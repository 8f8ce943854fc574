"""The situations among people that the planner is judged in; all in frame `map` but where said."""

import math
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import get_args

import numpy as np
from bench.planner.crowds import (
    Chaser,
    Crowd,
    Manner,
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
from bench.planner.situations import (
    SPEED_MPS,
    WALL_M,
    Row,
    Scene,
    between,
    door,
    door_of,
    on_cells,
    room,
)

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
DOOR_S, CHASED_S = 15.0, 15.0
CLOSE_M = 0.7
CROSSING_S = 40.0
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
    """A person comes who sees the robot: they walk on at their right, wait there, or stand still.

    Who stands still does so in the middle of a corridor in which there is room beside them.
    """
    rng = np.random.default_rng((22, seed))
    how = get_args(Manner)[seed % 3]
    width = float(rng.choice([1.2, 1.5, 2.0] if how == "stands" else [1.0, 1.2, 1.5, 2.0]))
    begin = float(rng.uniform(7.0, 8.5))

    def crowd() -> Crowd:
        person = Polite((begin, 0.0), -1.5, ONCOMING_MPS, (0.5 * width, PERSON_M), how)
        return Crowd(person, PERSON_M, legs=seed // 3 % 2 == 1)

    return replace(corridor(width), crowd=crowd)


def ahead(seed: int) -> Scene:
    """A person walks slowly ahead in the same direction, and aside in the room at the end."""
    rng = np.random.default_rng((23, seed))
    width = float(rng.choice([1.0, 1.2, 1.5, 2.0]))
    begin = float(rng.uniform(1.6, 2.4))
    way = Route.at_speed(((begin, 0.0), (LONG_M + 0.8, 0.0), (LONG_M + 2.0, 1.2)), AHEAD_MPS)

    def crowd() -> Crowd:
        return Crowd(Paths((way,)), PERSON_M, legs=seed % 2 == 1)

    # The robot may stand on its goal as soon as the person has left it 0.6 m behind.
    return replace(corridor(width), crowd=crowd, least_s=(7.5 + 0.6 - begin) / AHEAD_MPS)


def in_the_door(seed: int, before_m: float | None = None) -> Scene:
    """Somebody stands in the only door, 0.9 m wide, for 15 s, and comes in.

    The robot begins anywhere in the room, or so far before them.
    """
    scene = door(seed, 0.9)
    x, y = door_of(scene)
    start = scene.start if before_m is None else Pose2D(x - before_m, y, scene.start.yaw)
    way = Route.at_speed(((x, y), (x - 0.8, y), (x - 1.0, 2.7 if y < 1.5 else 0.3)), 0.8, DOOR_S)

    def crowd() -> Crowd:
        return Crowd(Paths((way,)), PERSON_M, legs=seed % 2 == 1)

    least = DOOR_S + scene.goals[0].distance_to(Pose2D(x, y, 0.0)) / SPEED_MPS
    return replace(
        scene, start=start, goals=scene.goals[:1], crowd=crowd, forgives="standing", least_s=least
    )


def ten_in_the_door(seed: int) -> Scene:
    """Ten people come in one after the other through a door 0.9 m wide, and stay at the wall."""
    scene = door(seed, 0.9)
    x, y = door_of(scene)
    side = 2.7 if y < 1.5 else 0.3
    ways: list[Route] = []
    for index in range(10):
        far = x + 0.6 + 0.8 * index
        end = (0.3 + 0.26 * index, side)
        ways.append(Route.at_speed(((far, y), (x - 0.4, y), end), ONCOMING_MPS))

    def crowd() -> Crowd:
        return Crowd(Paths(ways), PERSON_M, legs=seed % 2 == 1)

    least = ways[-1].times[1] + scene.goals[0].distance_to(Pose2D(x, y, 0.0)) / SPEED_MPS
    start = Pose2D(1.5, y, 0.0)
    return replace(
        scene, start=start, goals=scene.goals[:1], crowd=crowd, forgives="standing", least_s=least
    )


def chased(seed: int) -> Scene:
    """In a room of 5 x 5 m somebody walks up to the robot for 15 s, wherever it goes."""
    rng = np.random.default_rng((25, seed))
    start, goal = Pose2D(0.7, 2.5, 0.0), Pose2D(4.3, float(rng.uniform(0.7, 4.3)), 0.0)
    begin = (4.3, float(rng.uniform(0.7, 4.3)))

    def crowd() -> Crowd:
        chaser = Chaser(begin, 0.6, PERSON_M + 0.3, CHASED_S)
        return Crowd(chaser, PERSON_M, legs=seed % 2 == 1)

    scene = Scene("chased", room((0.0, 0.0), (5.0, 5.0)), start, (goal,))
    return replace(scene, crowd=crowd)


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
    # Early enough that there is somebody to meet, if it is long enough.
    times = sights[:, 0]
    times = times[times <= max(float(times.max()) - CROSSING_S, float(np.median(times)))]
    low, high = np.quantile(sights[:, 1:], [0.1, 0.9], axis=0)
    along = seed % 2
    middle, half = 0.5 * (low + high), 0.5 * (high - low)
    for _ in range(1000):
        now = float(rng.choice(times))
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
    # Walls far outside what the lidar reaches give the map its size.
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
    Row("stands in the door, 15 s", "odd", in_the_door, 1.5),
    Row("stands there close before it", "odd", partial(in_the_door, before_m=CLOSE_M), 1.5),
    Row("ten come through the door", "odd", ten_in_the_door, 1.5),
    Row("walks up to the robot", "odd", chased),
    *crowd_rows(),
    *(
        Row(f"movers, {level}", "movers", partial(movers, level=level), reached=share)
        for level, share in WANTED.items()
    ),
    Row("20-30 m ahead in odom", "far", far_goal, 1.3),
)
