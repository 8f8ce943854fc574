"""What a robot can run into: walls, furniture, people, and other robots."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from trolley.gridmap import GridMap
from trolley_base.world.gaps import Things
from trolley_base.world.people import Walk, Walker
from trolley_base.world.rays import Scene
from trolley_base.world.scene import build_segments, build_walls, pieces_of, polyline
from trolley_base.world.spec import WorldSpec

Floats = NDArray[np.float64]

FAR_AWAY_M = 1000.0
"""Where people who have left the world are put [m]."""


@dataclass(frozen=True, slots=True, eq=False)
class OtherRobot:
    """Another robot of the same world: its name and its outline (n, 2) [m] in `map`."""

    name: str
    outline: Floats


class Solids:
    """The bodies of a world, each with its number: the place of its name in `names`.

    Args:
        spec: the world file.
        grid: its map.
        rng: says where people walk at first.
    """

    def __init__(self, spec: WorldSpec, grid: GridMap, rng: np.random.Generator) -> None:
        self.walls = build_walls(grid)
        self._fixed, self.names = build_segments(spec)
        self._segments = self._fixed
        # Circles that no beam meets come first, people last.
        standing = sorted(enumerate(spec.circle), key=lambda numbered: numbered[1].seen)
        self._num_unseen = sum(not circle.seen for circle in spec.circle)
        circles = [[one.x, one.y, one.radius_m] for _, one in standing]
        bodies = [len(self.names) + i for i in range(len(circles))]
        self.names += [one.name or f"circle {number}" for number, one in standing]
        self._walkers: list[tuple[int, slice, Walker]] = []
        for index, person in enumerate(spec.person):
            walker = Walker(person, rng)
            place = slice(len(circles), len(circles) + walker.num_circles)
            self._walkers.append((len(self.names), place, walker))
            circles += walker.circles().tolist()
            bodies += [len(self.names)] * walker.num_circles
            self.names.append(person.name or f"person {index}")
        self._circles = np.array(circles, dtype=np.float64).reshape(-1, 3)
        self._circle_body = np.array(bodies, dtype=np.int64)
        self._num_own = len(self.names)

    @property
    def people(self) -> set[int]:
        """Which bodies are people."""
        return {body for body, _, _ in self._walkers}

    @property
    def things(self) -> Things:
        """All bodies but the walls, as they stand now."""
        return Things(self._segments.points, self._segments.body, self._circles, self._circle_body)

    def scene(self, outline: Floats) -> Scene:
        """What beams meet, the robot's own outline (n, 2) [m] too."""
        segments = self._segments
        return Scene(
            self.walls.frame,
            self.walls.solid,
            segments.points,
            segments.kinds,
            segments.echoes,
            self._circles[self._num_unseen :],
            outline,
        )

    def set_others(self, others: list[OtherRobot]) -> None:
        """Say where the other robots are; they stay there until the next call."""
        names = self.names[: self._num_own]
        self._segments = self._fixed
        for other in others:
            outline = polyline(np.asarray(other.outline, dtype=np.float64), closed=True)
            self._segments = self._segments.joined(pieces_of(outline, len(names)))
            names.append(other.name)
        self.names = names

    def keep_people_off(self, outline: Floats, rng: np.random.Generator) -> None:
        """Have nobody begin in the robot's outline (n, 2) [m]."""
        for _, place, walker in self._walkers:
            walker.keep_off(outline, rng)
            self._circles[place] = walker.circles()

    def move_people(self, seconds: float, outline: Floats) -> list[int]:
        """Move the people; return the bodies of those who walked into the robot's outline."""
        touched: list[int] = []
        for body, place, walker in self._walkers:
            if walker.step(seconds, outline) is Walk.TOUCHED:
                touched.append(body)
            self._circles[place] = walker.circles()
        return touched

    def remove_people(self) -> None:
        """Take everybody out of the world."""
        for _, place, _ in self._walkers:
            self._circles[place, :2] = FAR_AWAY_M
        self._walkers.clear()
