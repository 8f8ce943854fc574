"""The other robots that are on the same map."""

import numpy as np
import viser

from trolley.geometry import Pose2D
from trolley.messages import Robot
from trolley_viz.graphics.shapes import arrow_outline, flat, place, prism
from trolley_viz.robots.view import View
from trolley_viz.scene.layer import Z_LABEL, Layer
from trolley_viz.scene.robot_body import AWAY_COLOUR, BODY_COLOURS
from trolley_viz.words.sentences import STALE_S, age_text

HEIGHT_M = 0.12
KNOWN = ("localized", "unsure", "mapping")
"""States in which a robot's pose says where it is."""


class _Body:
    """The nodes of one other robot."""

    def __init__(self, scene: viser.SceneApi, path: str, robot: Robot) -> None:
        self.robot = robot
        self.frame = scene.add_frame(path, show_axes=False)
        points = np.array(robot.footprint)
        self.body = scene.add_mesh_simple(
            f"{path}/body", *prism(points, 0.03, HEIGHT_M), color=AWAY_COLOUR, flat_shading=True
        )
        size = np.ptp(points, axis=0)
        length = 0.6 * float(size[0])
        arrow = scene.add_mesh_simple(
            f"{path}/heading",
            *flat(arrow_outline(length, 0.6 * float(size[1]))),
            color=(255, 255, 255),
            side="double",
            cast_shadow=False,
        )
        middle = 0.5 * float(points[:, 0].max() + points[:, 0].min())
        place(arrow, Pose2D(middle - 0.5 * length, 0.0, 0.0), HEIGHT_M + 0.006)
        self.label = scene.add_label(
            f"{path}/name",
            robot.title or robot.name,
            position=(0.0, 0.0, Z_LABEL),
            anchor="bottom-center",
        )


class OthersLayer(Layer):
    """Where the other robots are that use the same map."""

    key, title = "others", "Other robots"
    group = "Robot"
    period_s = 0.1

    def __init__(self, server: viser.ViserServer, above: str) -> None:
        super().__init__(server, above)
        self._bodies: dict[str, _Body] = {}

    def draw(self, view: View) -> None:
        """Move the others, and take away those that are not on this map any more."""
        world_T_map, grid = view.placement.world_T("map"), view.map
        seen: dict[str, tuple[Pose2D, Robot, tuple[int, int, int], str]] = {}
        for one in view.fleet:
            pose, robot = one.pose, one.robot
            is_here = grid is not None and pose is not None and pose.map == grid.name
            if one.name == view.robot_name or not is_here or world_T_map is None:
                continue
            if robot is None or pose is None or pose.pose is None or pose.state not in KNOWN:
                continue
            age_s = one.pose_age_s
            is_old = one.is_away or (age_s is not None and age_s > STALE_S)
            colour = AWAY_COLOUR if is_old else BODY_COLOURS[pose.state]
            age = f" · {age_text(age_s, 0.0)}" if is_old and age_s is not None else ""
            name = (robot.title or robot.name) + age
            seen[one.name] = world_T_map @ pose.pose, robot, colour, name
        for name in self._bodies.keys() - seen.keys():
            self._bodies.pop(name).frame.remove()
        with self.server.atomic():
            for name, (pose, robot, colour, label) in seen.items():
                body = self._show(name, pose, robot, colour)
                if body.label.text != label:
                    body.label.text = label

    def _show(self, name: str, pose: Pose2D, robot: Robot, colour: tuple[int, int, int]) -> _Body:
        body = self._bodies.get(name)
        if body is None or body.robot != robot:
            if body is not None:
                body.frame.remove()
            body = self._bodies[name] = _Body(self.scene, self.path(name), robot)
        if tuple(body.body.color) != colour:
            body.body.color = colour
        place(body.frame, pose, 0.0)
        return body
