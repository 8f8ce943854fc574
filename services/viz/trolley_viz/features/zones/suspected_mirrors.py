"""Mirrors that the localizer suspects: drawn dashed, and offered for confirmation."""

import itertools
import math
from collections.abc import Callable, Sequence

import numpy as np
import viser
from numpy.typing import NDArray

from trolley import topics
from trolley.messages import SuspectLine
from trolley_viz.features.zones.dismissed import Dismissed
from trolley_viz.pointing.canvas import outline_of
from trolley_viz.pointing.picture import Picture
from trolley_viz.pointing.sketch import Point
from trolley_viz.robots.view import View
from trolley_viz.scene.layer import WALL_HEIGHT, Z_LABEL
from trolley_viz.scene.places import SUSPECT_COLOUR

SAME_M = 0.4
"""Lines whose ends are this near are the same suspect, seen from elsewhere."""
DASH_M, GAP_M = 0.14, 0.14
MAX_SHOWN = 20


class SuspectLines:
    """The suspected mirrors that have not been dismissed in this browser.

    Args:
        picture: where they are drawn.
        in_language: puts an English text into the language of the page.
    """

    def __init__(self, picture: Picture, in_language: Callable[[str], str]) -> None:
        self._picture = picture
        self._in_language = in_language
        self._nodes: list[viser.SceneNodeHandle] = []
        self._drawn: tuple[object, ...] = ()
        self.offered: list[SuspectLine] = []
        """The surest first."""

    def update(self, view: View, dismissed: Sequence[Dismissed], *, is_shown: bool) -> None:
        """Draw what changed."""
        message, grid = view.streams.latest(topics.SUSPECTS), view.map
        world_T_map = view.placement.world_T("map")
        name = None if grid is None else grid.name
        label = self._in_language("mirror?")
        inputs = (self._picture.scene, message, name, tuple(dismissed), is_shown, label)
        if inputs == self._drawn or world_T_map is None:
            return
        self._drawn = inputs
        self.remove()
        if message is None or grid is None:
            return
        self.offered = [
            line
            for line in sorted(message.lines, key=lambda line: -line.score)[:MAX_SHOWN]
            if len(line.points) > 1
            and not any(
                one.map == grid.name and is_same(one.points, line.points) for one in dismissed
            )
        ]
        scene = self._picture.scene
        if scene is None or not is_shown:
            return
        for i, line in enumerate(self.offered):
            points = world_T_map.transform_points(np.array(line.points))
            self._nodes += [
                scene.add_line_segments(
                    f"/suspects/line{i}",
                    dashes(points, DASH_M, GAP_M, WALL_HEIGHT + 0.02),
                    SUSPECT_COLOUR,
                    thickness=0.05,
                ),
                scene.add_label(
                    f"/suspects/name{i}",
                    label,
                    position=(*points.mean(axis=0).tolist(), Z_LABEL),
                    anchor="bottom-center",
                    depth_test=False,
                ),
            ]

    def remove(self) -> None:
        """Take them out of the scene."""
        for node in self._nodes:
            node.remove()
        self._nodes.clear()
        self.offered = []


def is_same(one: Sequence[Point], other: Sequence[Point]) -> bool:
    """Whether two lines have nearly the same ends, either way round."""
    ends, others = (outline_of(line)[:: max(len(line) - 1, 1)] for line in (one, other))
    return any(
        all(math.dist(a, b) <= SAME_M for a, b in zip(ends, turned, strict=False))
        for turned in (others, others[::-1])
    )


def dashes(points: NDArray[np.float64], dash: float, gap: float, z: float) -> NDArray[np.float32]:
    """Cut a polyline (n, 2) [m] into dashes: line segments (k, 2, 3), each piece beginning one."""
    out: list[list[tuple[float, float, float]]] = []
    for start, end in itertools.pairwise(points):
        length = float(np.hypot(*(end - start)))
        count = min(max(round((length + gap) / (dash + gap)), 1), 500)
        # Whole dashes only, stretched a little, so that both ends are seen.
        step = (length + gap) / count if count > 1 else length
        for i in range(count):
            first = i * step
            last = min(first + (step - gap if count > 1 else length), length)
            ends = (start + (end - start) * (s / length if length else 0.0) for s in (first, last))
            out.append([(float(x), float(y), z) for x, y in ends])
    return np.array(out, np.float32).reshape(-1, 2, 3)
