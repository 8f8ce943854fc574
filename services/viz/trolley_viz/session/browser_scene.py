"""What one browser alone has in its scene: which robot and layers it shows, labels, pins, axes."""

from collections.abc import Mapping, Sequence, Set

import viser

from trolley import topics
from trolley.geometry import Pose2D
from trolley.geometry.frames import MAP
from trolley.messages import Path
from trolley_viz.features.driving.goal_pins import GoalPins
from trolley_viz.features.driving.goal_queue import QueuedGoal
from trolley_viz.features.past.drawing import PastDrawing
from trolley_viz.features.touch.mark import TouchMark
from trolley_viz.features.touch.touched import Touched
from trolley_viz.graphics.shapes import place
from trolley_viz.robots.view import View
from trolley_viz.scene.frame_axes import FrameAxes
from trolley_viz.scene.layer import is_same
from trolley_viz.scene.markers.icons import Icon, Icons
from trolley_viz.scene.place_labels import Eye, PlaceLabels, PlaceName
from trolley_viz.scene.places import PlaceLayer, current_places, place_names
from trolley_viz.scene.routes import PreviewLine
from trolley_viz.session.scene import ROOT
from trolley_viz.words.sentences import goal_name


class BrowserScene:
    """The scene of one browser, as far as it differs from what all browsers share.

    Every robot has its layers in the shared scene below a root of its own. A browser shows or hides
    a root or a layer with a frame of the same path in its own scene, which takes its place there.
    """

    def __init__(self, scene: viser.SceneApi) -> None:
        self._scene = scene
        self._overrides: dict[str, dict[str, viser.FrameHandle]] = {}
        """By robot and by path below its root ("" is the root itself)."""
        self._shown: tuple[object, ...] = ()
        """What `show_robot` was asked for last."""
        self._named: tuple[object, ...] = ()
        """What the names of places were made of."""
        self._names: tuple[list[PlaceName], str] = ([], "")
        """Those, and the one that comes first."""
        self._root_pose = Pose2D.identity()
        self._preview = PreviewLine(scene)
        self._goal_pins = GoalPins(scene)
        self._icons = Icons(scene)
        self._labels = PlaceLabels(scene)
        self._axes = FrameAxes(scene)
        self._touch_mark = TouchMark(scene)
        self.past = PastDrawing(scene)
        """The moment that its person looks at."""

    def show_robot(self, robot: str, robots: Set[str], layers: Mapping[str, bool]) -> None:
        """Show one of the robots in the shared scene, and of its layers those that are on."""
        asked = robot, set(robots), layers
        if asked == self._shown:
            return
        self._shown = asked
        for gone in self._overrides.keys() - robots:
            self._overrides.pop(gone)[""].remove()  # and all below it
        for one in robots:
            self._override(one, "", is_visible=one == robot)
        for key, is_on in layers.items():
            self._override(robot, f"/{key}", is_visible=is_on)

    def is_visible(self, robot: str, layer: str = "") -> bool:
        """Whether this browser shows a robot, or one of its layers; without a frame it does."""
        frame = self._overrides.get(robot, {}).get(f"/{layer}" if layer else "")
        return frame is None or frame.visible

    def move_root(self, robot: str, pose: Pose2D) -> None:
        """Move a robot with its zones and places, as while its map is being turned."""
        root = self._overrides.get(robot, {}).get("")
        if root is not None and self._root_pose != pose:
            self._root_pose = pose
            place(root, pose, 0.0)

    def draw(
        self,
        view: View,
        layers: Mapping[str, bool],
        *,
        preview: Path | None,
        queue: Sequence[QueuedGoal],
        icons: list[Icon],
        frames: list[str],
        eye: Eye,
        touched: Touched | None,
    ) -> None:
        """Draw what is this browser's own.

        Args:
            view: the robot.
            layers: which layers are on.
            preview: the path to where the pointer is.
            queue: the goals that its person has queued.
            icons: the pictograms of programs, to be turned towards its camera.
            frames: the frames whose axes are shown.
            eye: its camera.
            touched: what its person touched.
        """
        self._touch_mark.draw(touched)
        self._preview.draw(preview, view.placement)
        self._goal_pins.draw(queue, view.placement)
        self._icons.show(icons, eye.wxyz)
        self._labels.show(*self._place_names(view, is_shown=layers[PlaceLayer.key]), eye)
        self._axes.draw(view.placement, frames)

    def _place_names(self, view: View, *, is_shown: bool) -> tuple[list[PlaceName], str]:
        """The names of the places, and that of the one that the robot drives to."""
        streams, world_T_map = view.streams, view.placement.world_T(MAP)
        goal = streams.latest(topics.GOAL)
        made_of = (streams.latest(topics.POSES), view.map, goal)
        if is_same((*made_of, world_T_map, is_shown), self._named):
            return self._names
        self._named = (*made_of, world_T_map, is_shown)
        names = place_names(view) if is_shown else []
        self._names = names, "" if goal is None else goal_name(goal, current_places(view))
        return self._names

    def _override(self, robot: str, below: str, *, is_visible: bool) -> None:
        """Show or hide a part of the shared scene in this browser alone."""
        frames = self._overrides.setdefault(robot, {})
        if below not in frames:
            path = f"{ROOT}/{robot}{below}"
            frames[below] = self._scene.add_frame(path, show_axes=False, visible=is_visible)
        elif frames[below].visible != is_visible:
            frames[below].visible = is_visible
