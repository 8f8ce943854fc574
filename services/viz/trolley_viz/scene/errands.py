"""The places that one person has lined up: numbered pins that nobody else sees."""

from collections.abc import Sequence

import viser

from trolley.geometry.frames import MAP
from trolley_viz.errands import Errand
from trolley_viz.placement import Placement
from trolley_viz.scene.layer import Z_LABEL, Z_PLACE
from trolley_viz.shapes import arrow_outline, flat, place

PIN_COLOUR = (225, 95, 0)
Z_PIN = Z_LABEL + 0.1


class Pins:
    """An arrow with its number for each of them."""

    def __init__(self, scene: viser.SceneApi) -> None:
        self._scene = scene
        self._nodes: list[viser.SceneNodeHandle] = []
        self._drawn: tuple[object, ...] = ()

    def draw(self, errands: Sequence[Errand], placement: Placement) -> None:
        """Draw them anew when one changed."""
        world_T_map = placement.world_T(MAP) if errands else None
        drawn = (tuple(errands), world_T_map)
        if drawn == self._drawn:
            return
        self._drawn = drawn
        for node in self._nodes:
            node.remove()
        self._nodes.clear()
        if world_T_map is None:
            return
        for i, errand in enumerate(errands, 1):
            pose = world_T_map @ errand.pose
            arrow = self._scene.add_mesh_simple(
                f"/errands/arrow{i}",
                *flat(arrow_outline(0.42, 0.3)),
                color=PIN_COLOUR,
                side="double",
                cast_shadow=False,
            )
            place(arrow, pose, Z_PLACE + 0.005)
            number = self._scene.add_label(
                f"/errands/number{i}",
                str(i),
                position=(pose.x, pose.y, Z_PIN),
                anchor="center-center",
                depth_test=False,
            )
            self._nodes += [arrow, number]
