"""A map being edited by one person: the operations so far, and the resulting map."""

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from trolley.codes import Refused
from trolley.geometry import Pose2D
from trolley.gridmap import GridMap
from trolley.map_editing import apply
from trolley.messages import MapOp, Merge, Turn


@dataclass(frozen=True, eq=False)
class Drawn:
    """A map with the edits so far applied.

    Attributes:
        ops: what was done.
        grid: what came of it.
        new_T_old: maps points of the stored map to this one.
        walls: (n, 2) points x, y [m] of walls that a merge brings along; the mapper has the rest.
    """

    ops: tuple[MapOp, ...]
    grid: GridMap
    new_T_old: Pose2D
    walls: NDArray[np.float64]


@dataclass(frozen=True)
class Draft:
    """The operations so far; `walls` are those of the maps merged, by the operation's place."""

    ops: tuple[MapOp, ...] = ()
    walls: tuple[tuple[int, tuple[tuple[float, float], ...]], ...] = ()

    def add(self, op: MapOp) -> "Draft":
        """Do one more; turns that follow each other about the same point are one."""
        return replace(self, ops=(*self.ops, op))

    def add_merged(self, op: Merge, walls: list[tuple[float, float]]) -> "Draft":
        """Lay another map beside this one, whose walls are shown as points."""
        return replace(self.add(op), walls=(*self.walls, (len(self.ops), tuple(walls))))

    def turned(self, angle: float, about: tuple[float, float]) -> "Draft":
        """Set the angle of the last turn [rad], or turn about a point if there is none."""
        last = self.ops[-1] if self.ops else None
        if isinstance(last, Turn):
            before = self.take_back()
            return before if angle == 0.0 else before.add(Turn(angle=angle, about=last.about))
        return self if angle == 0.0 else self.add(Turn(angle=angle, about=about))

    @property
    def last_turn(self) -> float:
        """The angle of the turn that was done last of all [rad], 0 if it was something else."""
        last = self.ops[-1] if self.ops else None
        return last.angle if isinstance(last, Turn) else 0.0

    def take_back(self) -> "Draft":
        """Drop the last operation."""
        return self.cut(len(self.ops) - 1)

    def cut(self, count: int) -> "Draft":
        """Keep so many operations, the first ones."""
        return Draft(self.ops[:count], tuple(one for one in self.walls if one[0] < count))


def draw(base: GridMap, draft: Draft, before: Drawn | None = None) -> Drawn | Refused:
    """Return the map that a draft gives (to be run aside: large maps take a second).

    Args:
        base: the stored map.
        draft: what is done to it.
        before: of the same base, drawn earlier: what is the same is not done again.
    """
    start = Drawn((), base, Pose2D.identity(), np.zeros((0, 2)))
    if before is not None and draft.ops[: len(before.ops)] == before.ops:
        start = before
    grid, new_T_old, walls = start.grid, start.new_T_old, start.walls
    merged = dict(draft.walls)
    try:
        for i in range(len(start.ops), len(draft.ops)):
            op = draft.ops[i]
            if isinstance(op, Merge):
                walls = np.concatenate([walls, np.array(merged.get(i, ())).reshape(-1, 2)])
                continue
            grid, old_T_new = apply(grid, op)
            step = old_T_new.inverse()
            new_T_old, walls = step @ new_T_old, step.transform_points(walls)
    except Refused as refused:
        return refused
    return Drawn(draft.ops, grid, new_T_old, walls)
