"""The goals that one person has queued: numbered pins that nobody else sees."""

from collections.abc import Sequence

import viser

from trolley.geometry.frames import MAP
from trolley_viz.features.driving.goal_queue import QueuedGoal
from trolley_viz.graphics.shapes import arrow_outline, flat, place
from trolley_viz.robots.placement import Placement
from trolley_viz.scene.layer import Z_LABEL, Z_PLACE

PIN_COLOUR = (225, 95, 0)
ASIDE_M = 0.22
"""How far the number stands to the left, where the icon of a place does not cover it."""


class GoalPins:
    """Draws a numbered arrow for each queued goal in one browser's scene."""

    def __init__(self, scene: viser.SceneApi) -> None:
        self._scene = scene
        self._nodes: list[viser.SceneNodeHandle] = []
        self._drawn: tuple[object, ...] = ()

    def draw(self, goal_queue: Sequence[QueuedGoal], placement: Placement) -> None:
        """Draw them again when one has changed."""
        world_T_map = placement.world_T(MAP) if goal_queue else None
        drawn = (tuple(goal_queue), world_T_map)
        if drawn == self._drawn:
            return
        self._drawn = drawn
        for node in self._nodes:
            node.remove()
        self._nodes.clear()
        if world_T_map is None:
            return
        for i, queued in enumerate(goal_queue, 1):
            pose = world_T_map @ queued.pose
            arrow = self._scene.add_mesh_simple(
                f"/goal_queue/arrow{i}",
                *flat(arrow_outline(0.42, 0.3)),
                color=PIN_COLOUR,
                side="double",
                cast_shadow=False,
            )
            place(arrow, pose, Z_PLACE + 0.005)
            number = self._scene.add_label(
                f"/goal_queue/number{i}",
                str(i),
                position=(pose.x - ASIDE_M, pose.y, Z_LABEL),
                anchor="center-right",
                depth_test=False,
                font_screen_scale=1.7,
            )
            self._nodes += [arrow, number]
