"""People by JuPedSim, who see the robot: pedestrians that nobody wrote with this robot in mind.

They go about a home, a corridor or a hall for ever, each from place to place, and keep off the
robot as off each other. What they do in front of a robot that is in their way is up to them.

    pip install 'jupedsim>=1.4,<2'

Source:
    Tordeux, Chraibi, Seyfried, Collision-free speed model for pedestrian dynamics (2016), as in
    JuPedSim's `CollisionFreeSpeedModelV2`.
"""

import importlib
import math
from collections.abc import Callable, Sequence
from importlib.util import find_spec
from typing import Any

import numpy as np
from bench.planner.all_poses import Box
from bench.planner.crowds import Crowd, Floats, Point, Seen
from bench.planner.situations import Row, Scene, between, room

from trolley.geometry import Pose2D

PERSON_M = 0.2
STEP_S = 0.02
ARRIVED_M = 0.5
"""So near to a place they turn to the next one."""
NUM_PLACES = 12
APART_M, FROM_ROBOT_M = 0.6, 1.2
"""They begin this far from each other and from the robot."""
SLOWEST, FASTEST = 0.5, 1.4
DOOR_M = 0.9

Area = tuple[Point, Point]
"""Low and high corner [m]."""
Draw = Callable[[np.random.Generator], Point]


class Walkers:
    """People of JuPedSim.

    Args:
        floor: what they walk in.
        boxes: what is solid in it.
        ways: the places that each goes to one after the other, over and over; the first is where
            they begin.
        speeds: that they like [m/s].
    """

    def __init__(
        self, floor: Area, boxes: Sequence[Box], ways: Sequence[Sequence[Point]], speeds: Floats
    ) -> None:
        jps: Any = importlib.import_module("jupedsim")
        shapely: Any = importlib.import_module("shapely")  # which it brings
        solid = [shapely.box(x - w / 2, y - h / 2, x + w / 2, y + h / 2) for x, y, w, h in boxes]
        free = shapely.box(*floor[0], *floor[1]).difference(shapely.union_all(solid))
        if free.geom_type != "Polygon":  # the walls leave slivers outside
            free = max(free.geoms, key=lambda part: part.area)
        self._person: Any = jps.CollisionFreeSpeedModelV2AgentParameters
        self._people: Any = jps.Simulation(
            model=jps.CollisionFreeSpeedModelV2(), geometry=free, dt=STEP_S
        )
        self._ids: list[int] = []
        for way, speed in zip(ways, speeds.tolist(), strict=True):
            stages = [self._people.add_waypoint_stage(place, ARRIVED_M) for place in way]
            journey = jps.JourneyDescription(stages)
            for here, there in zip(stages, [*stages[1:], stages[0]], strict=True):
                to_next = jps.Transition.create_fixed_transition(there)
                journey.set_transition_for_stage(here, to_next)
            number = self._people.add_journey(journey)
            person = self._person(
                position=way[0], desired_speed=speed, radius=PERSON_M, journey_id=number,
                stage_id=stages[1],
            )  # fmt: skip
            self._ids.append(self._people.add_agent(person))
        self._led: int = self._people.add_direct_steering_stage()
        self._robots_way: int = self._people.add_journey(jps.JourneyDescription([self._led]))
        self._robot: Any = None
        self.at = self._places()
        self.velocity = np.zeros_like(self.at)

    def step(self, dt: float, robot: Seen) -> None:
        """Let `dt` seconds pass."""
        there = robot.pose.x, robot.pose.y
        if self._robot is None:
            self._robot = self._people.agent(self._add_robot(there, robot.radius))
        # One of them that goes where the robot is, and heeds nobody.
        self._robot.target = there
        self._robot.model.desired_speed = max(math.dist(self._robot.position, there) / dt, 1e-4)
        for _ in range(max(1, round(dt / STEP_S))):
            self._people.iterate()
        at = self._places()
        self.velocity = (at - self.at) / dt
        self.at = at

    def _add_robot(self, there: Point, radius_m: float) -> int:
        robot = self._person(
            position=there, desired_speed=1e-4, radius=radius_m, time_gap=0.1,
            strength_neighbor_repulsion=0.0, strength_geometry_repulsion=0.0,
            journey_id=self._robots_way, stage_id=self._led,
        )  # fmt: skip
        return self._people.add_agent(robot)

    def _places(self) -> Floats:
        return np.array([self._people.agent(number).position for number in self._ids])


def peopled(
    scene: Scene, floor: Area, count: int, draw: Draw, rng: np.random.Generator, seed: int
) -> Scene:
    """Return a scene with people who go from place to place.

    Args:
        scene: without them.
        floor: what they walk in.
        count: of people.
        draw: draws a place.
        rng: draws where they begin, where they go, and how fast.
        seed: an odd one makes them pairs of legs.
    """
    ways: list[list[Point]] = []
    begin = scene.start.x, scene.start.y
    while len(ways) < count:
        first = draw(rng)
        apart = min((math.dist(first, way[0]) for way in ways), default=math.inf)
        if math.dist(first, begin) > FROM_ROBOT_M and apart > APART_M:
            ways.append([first, *(draw(rng) for _ in range(NUM_PLACES - 1))])
    speeds = np.clip(rng.normal(0.9, 0.2, count), SLOWEST, FASTEST)

    def crowd() -> Crowd:
        walkers = Walkers(floor, scene.boxes, ways, speeds)
        return Crowd(walkers, PERSON_M, legs=seed % 2 == 1)

    return Scene(
        scene.name, scene.boxes, scene.start, scene.goals, crowd=crowd, forgives="standing"
    )


def anywhere(areas: Sequence[Area], keep_m: float = 0.5) -> Draw:
    """Draw places in some rooms, this far from their walls."""

    def draw(rng: np.random.Generator) -> Point:
        (left, low), (right, high) = areas[int(rng.integers(len(areas)))]
        x = rng.uniform(left + keep_m, right - keep_m)
        return float(x), float(rng.uniform(low + keep_m, high - keep_m))

    return draw


def _pose(rng: np.random.Generator, area: Area) -> Pose2D:
    x, y = anywhere([area])(rng)
    return Pose2D(x, y, float(rng.uniform(-math.pi, math.pi)))


def two_rooms(seed: int) -> Scene:
    """Two rooms of 4 x 4 m, a door between them, and two people who go through it all the time."""
    rng = np.random.default_rng((101, seed))
    y, half = float(rng.uniform(1.0, 3.0)), 0.5 * DOOR_M
    rooms: list[Area] = [((0.0, 0.0), (4.0, 4.0)), ((4.1, 0.0), (8.1, 4.0))]
    floor: Area = ((0.0, 0.0), (8.1, 4.0))
    boxes = (
        *room(*floor),
        between((4.0, 0.0), (4.1, y - half)),
        between((4.0, y + half), (4.1, 4.0)),
    )
    start, there, back = (_pose(rng, rooms[number]) for number in (0, 1, 0))
    scene = Scene("two-rooms", boxes, start, (there, back))
    return peopled(scene, floor, 2, anywhere(rooms), rng, seed)


def corridor(seed: int) -> Scene:
    """A corridor 8 m long and 1.5 or 2 m wide, along which four people go to and fro."""
    rng = np.random.default_rng((102, seed))
    half = 0.5 * float(rng.choice([1.5, 2.0]))
    floor: Area = ((-3.0, -1.5), (11.0, 1.5))
    ends: list[Area] = [((-3.0, -1.5), (0.0, 1.5)), ((8.0, -1.5), (11.0, 1.5))]
    boxes = (
        *room(*floor),
        between((0.0, -1.5), (8.0, -half)),
        between((0.0, half), (8.0, 1.5)),
    )
    start = Pose2D(-1.0, float(rng.uniform(-0.5, 0.5)), 0.0)
    goals = Pose2D(9.5, 0.0, 0.0), Pose2D(-1.0, 0.0, math.pi)
    number = 0

    def draw(rng: np.random.Generator) -> Point:
        nonlocal number
        number += 1
        return anywhere([ends[number % 2]])(rng)

    return peopled(Scene("long-corridor", boxes, start, goals), floor, 4, draw, rng, seed)


def flat(seed: int) -> Scene:
    """Four rooms along a corridor 1.2 m wide, and two people who go from room to room."""
    rng = np.random.default_rng((103, seed))
    floor: Area = ((0.0, 0.0), (8.0, 7.2))
    rooms: list[Area] = [
        ((left, low), (left + 3.9, low + 2.9)) for low in (0.0, 4.3) for left in (0.0, 4.0)
    ]
    boxes = [*room(*floor), between((3.9, 0.0), (4.0, 3.0)), between((3.9, 4.2), (4.0, 7.2))]
    for left, right in ((0.0, 3.9), (4.0, 8.0)):
        for low, high in ((2.9, 3.0), (4.2, 4.3)):
            door = float(rng.uniform(left + 0.7, right - 0.7))
            boxes.append(between((left, low), (door - 0.5 * DOOR_M, high)))
            boxes.append(between((door + 0.5 * DOOR_M, low), (right, high)))
    start, *goals = (_pose(rng, rooms[number]) for number in rng.permutation(4).tolist())
    scene = Scene("flat", tuple(boxes), start, tuple(goals))
    return peopled(scene, floor, 2, anywhere(rooms), rng, seed)


def hall(seed: int) -> Scene:
    """A hall of 10 x 8 m with four tables, across which twelve people go in all directions."""
    rng = np.random.default_rng((104, seed))
    floor: Area = ((0.0, 0.0), (10.0, 8.0))
    tables = tuple(between((x, y), (x + 1.2, y + 0.8)) for x in (2.0, 6.5) for y in (1.5, 5.5))

    def draw(rng: np.random.Generator) -> Point:
        while True:
            x, y = anywhere([floor])(rng)
            if all(
                max(abs(x - box[0]) - box[2] / 2, abs(y - box[1]) - box[3] / 2) > 0.4
                for box in tables
            ):
                return x, y

    low, high = 0.6, 7.4
    start = Pose2D(0.6, float(rng.uniform(low, high)), 0.0)
    there = Pose2D(9.4, float(rng.uniform(low, high)), math.pi)
    back = Pose2D(0.6, float(rng.uniform(low, high)), 0.0)
    scene = Scene("tables", (*room(*floor), *tables), start, (there, back))
    return peopled(scene, floor, 12, draw, rng, seed)


STRANGERS: tuple[Row, ...] = (
    Row("strangers in two rooms", "strangers", two_rooms, 1.4),
    Row("strangers in a corridor", "strangers", corridor, 1.4),
    Row("strangers in a flat", "strangers", flat, 1.4),
    Row("strangers in a hall", "strangers", hall, 1.4),
) if find_spec("jupedsim") else ()  # fmt: skip
"""None where JuPedSim is missing."""
