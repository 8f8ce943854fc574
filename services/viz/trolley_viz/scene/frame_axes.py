"""The axes of frames, for the one browser that wants to see them."""

import viser

from trolley.geometry import Pose2D
from trolley_viz.graphics.shapes import place
from trolley_viz.robots.placement import Placement
from trolley_viz.scene.layer import Z_FOOTPRINT, Z_LABEL

MAX_AXES = 40


class FrameAxes:
    """One node per frame that is switched on and has a place in the world."""

    def __init__(self, scene: viser.SceneApi) -> None:
        self._scene = scene
        self._axes: dict[str, viser.FrameHandle] = {}
        self._poses: dict[str, Pose2D] = {}
        self._count = 0

    def draw(self, placement: Placement, frames: list[str]) -> None:
        """Show these frames where they are now, and no others."""
        poses = {
            frame: pose
            for frame in frames[:MAX_AXES]
            if (pose := placement.world_T(frame)) is not None
        }
        for frame in self._axes.keys() - poses.keys():
            self._axes.pop(frame).remove()
        for frame, pose in poses.items():
            if frame not in self._axes:
                self._axes[frame] = self._add(frame)
            elif self._poses.get(frame) == pose:
                continue
            place(self._axes[frame], pose, Z_FOOTPRINT)
        self._poses = poses

    def _add(self, frame: str) -> viser.FrameHandle:
        self._count += 1  # a number, since a frame's name may hold any letter
        path = f"/axes/{self._count}"
        axes = self._scene.add_frame(path, axes_length=0.3, axes_radius=0.012, origin_radius=0.02)
        self._scene.add_label(
            f"{path}/name", frame, position=(0.0, 0.0, Z_LABEL), font_screen_scale=0.8
        )
        return axes
