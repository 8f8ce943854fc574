"""One browser: its controls, its tool, the robot that it follows and the layers that it shows."""

from collections.abc import Callable, Set
from typing import Protocol

import msgspec
import viser

from trolley import topics
from trolley.geometry import Pose2D
from trolley.messages import MapChange, SuspectLine
from trolley.runtime.service import Service
from trolley_viz.actions import Actions
from trolley_viz.aiming import Aiming
from trolley_viz.drags import Drags
from trolley_viz.drawing.board import Board
from trolley_viz.drawing.changes import ChangeMarks, ChangeWishes
from trolley_viz.drawing.editor import ZoneEditor, stored_zones
from trolley_viz.drawing.suspects import SuspectLines
from trolley_viz.drawing.wishes import ZoneWishes
from trolley_viz.map_editing.editor import MapEditor
from trolley_viz.map_editing.picture import Picture
from trolley_viz.overlays.readings import Readings
from trolley_viz.panels.console import Console
from trolley_viz.place_actions import PlaceActions
from trolley_viz.pointing import Pointing
from trolley_viz.robots import Robots
from trolley_viz.scene.axes import FrameAxes
from trolley_viz.scene.errands import Pins
from trolley_viz.scene.ground import MapLayer
from trolley_viz.scene.icons import Icons
from trolley_viz.scene.layer import View
from trolley_viz.scene.names import Names
from trolley_viz.scene.places import PlaceLayer, current_places, place_names
from trolley_viz.scene.routes import PreviewLine
from trolley_viz.scene.scene import ROOT, shown_layers
from trolley_viz.server import configure_look
from trolley_viz.settings import MAX_DISMISSED, Choices, Dismissed
from trolley_viz.shapes import place
from trolley_viz.sight import Sight
from trolley_viz.stage import Stage
from trolley_viz.stopping import StopPresses
from trolley_viz.visitors import Visitor
from trolley_viz.words import Tone, goal_name

FRAME = "frame:"
"""Begins the keys under which the choices hold the frames whose axes are shown."""
NOTICE_S: dict[Tone, float] = {"good": 4.0, "busy": 4.0, "idle": 5.0, "warn": 8.0, "bad": 8.0}
MAX_NOTICES = 2
"""They lie over the map."""
NOTICE_COLOURS: dict[Tone, tuple[int, int, int]] = {
    "good": (30, 158, 80),
    "busy": (47, 111, 224),
    "warn": (217, 138, 0),
    "bad": (214, 51, 51),
    "idle": (128, 136, 148),
}


class Hub(Protocol):
    """What all browsers share."""

    @property
    def robots(self) -> Robots:
        """The robots of the network."""
        ...

    @property
    def stops(self) -> StopPresses:
        """The presses of Stop that are not answered."""
        ...

    @property
    def monotonic_ns(self) -> int:
        """Local monotonic time [ns]."""
        ...

    def call_soon(self, fn: Callable[[], None], *, urgent: bool = False) -> None:
        """Call on the service's thread."""
        ...

    def is_open(self, client_id: int) -> bool:
        """Whether a browser is still connected."""
        ...

    def stage(self, robot: str) -> Stage:
        """The robot's share of the scene."""
        ...

    def readings(self, robot: str) -> Readings:
        """Follow values of a robot's topics."""
        ...

    def robot_ns(self, robot: str) -> int | None:
        """The time of a robot [ns], None while its clock is silent."""
        ...

    def remember(self, browser: str, choices: Choices) -> None:
        """Keep a browser's choices."""
        ...

    def let_go(self, client_id: int) -> None:
        """Take the joystick out of a browser's hand."""
        ...


class Session:
    """What one browser sees and may do.

    Args:
        service: asks the robots.
        hub: what all browsers share.
        client: viser's handle of the browser.
        visitor: who it is.
        choices: what was chosen there before.
    """

    def __init__(
        self,
        service: Service,
        hub: Hub,
        client: viser.ClientHandle,
        visitor: Visitor,
        choices: Choices,
    ) -> None:
        self.client = client
        self.visitor = visitor
        self._hub = hub
        self._choices = choices
        self._robot = choices.robot or hub.robots.own
        self._notices: list[viser.NotificationHandle] = []
        self._folders: dict[str, viser.GuiFolderHandle] = {}
        self._shadows: dict[str, dict[str, viser.FrameHandle]] = {}
        """What this browser's scene has in place of the roots of robots and of their layers."""
        self._turned_by = Pose2D.identity()
        self.drags = Drags(self._post_while_open, lambda: hub.monotonic_ns, self._tell_unheard)
        self.pointing = Pointing(client, self.drags)
        self.actions = Actions(service, lambda: self._robot, lambda: self.view, self.tell)
        self.aiming = Aiming(
            service, self.pointing, self.actions, lambda: self._robot, lambda: self.view
        )
        self.places = PlaceActions(self.actions, self.aiming, lambda: self.view)
        self.zones = ZoneEditor(
            Board(client, self.drags),
            ZoneWishes(
                service,
                lambda: self._robot,
                lambda: stored_zones(self.view),
                self._map_name,
                self.actions.history,
                self.tell,
            ),
            lambda: self.view,
            self.tell,
            self._begin_zone,
        )
        self.map_editor = MapEditor(
            Board(client, self.drags),
            Picture(client),
            service,
            lambda: self._robot,
            lambda: self.view,
            self.tell,
            self._begin_map_tool,
        )
        self.suspects = SuspectLines(client.scene)
        self.change_marks = ChangeMarks(client.scene)
        self.changes = ChangeWishes(service, self.actions, lambda: self._robot, self._map_name)
        self._axes = FrameAxes(client.scene)
        configure_look(client.gui, dark=choices.dark)
        self._preview = PreviewLine(client.scene)
        self._pins = Pins(client.scene)
        self._icons = Icons(client.scene)
        self._names = Names(client.scene)
        self._sight = Sight(client)
        self.console = Console(client.gui, self)

    # What the panels read.
    @property
    def hub(self) -> Hub:
        """What all browsers share."""
        return self._hub

    @property
    def may_drive(self) -> bool:
        """Whether its person may do more than look and press Stop."""
        return self.visitor.role == "operator"

    @property
    def robot(self) -> str:
        """The name of the robot that it follows."""
        return self._robot

    @property
    def choices(self) -> Choices:
        """What was chosen here."""
        return self._choices

    @property
    def view(self) -> View:
        """What is known of the robot."""
        return self._hub.stage(self._robot).view

    def robot_labels(self) -> dict[str, str]:
        """What to call each robot in a list, to its name."""
        hub = self._hub
        return hub.robots.labels(self._robot, lambda name: hub.robot_ns(name) is None)

    def layers(self) -> dict[str, bool]:
        """Which layers are shown, by key."""
        return shown_layers(self._choices.layers)

    def frames_on(self) -> list[str]:
        """The frames whose axes are shown."""
        chosen = self._choices.layers.items()
        return [key.removeprefix(FRAME) for key, is_on in chosen if is_on and key.startswith(FRAME)]

    # What the panels ask for.
    def folder(self, title: str, *, is_open: bool = False) -> viser.GuiFolderHandle:
        """Add a folder of controls: as its person left it, else open or not as is said here."""
        is_open = self._choices.folders.get(title, is_open)
        folder = self._folders[title] = self.client.gui.add_folder(title, expand_by_default=is_open)
        return folder

    def post(self, fn: Callable[[], None]) -> None:
        """Call on the service's thread."""
        self._hub.call_soon(fn)

    def tell(self, title: str, text: str, tone: Tone) -> None:
        """Show its person a title and a sentence."""
        notice = self.client.add_notification(
            title, text, auto_close_seconds=NOTICE_S[tone], color=NOTICE_COLOURS[tone]
        )
        self._notices.append(notice)
        while len(self._notices) > MAX_NOTICES:
            self._notices.pop(0).remove()

    def press_stop(self) -> None:
        """Stop the robot."""
        self._hub.stops.press(self._robot, self._hub.monotonic_ns)

    def press_stop_all(self) -> None:
        """Stop all robots, those that are away too: each as soon as it can be."""
        for name in self._hub.robots.names(self._robot):
            self._hub.stops.press(name, self._hub.monotonic_ns)

    def press_resume(self) -> None:
        """Let it drive again."""
        self._hub.stops.release(self._robot)
        self.actions.resume()

    def follow(self, robot: str) -> None:
        """Show another robot."""
        if robot != self._robot:
            self.put_tools_away()
            self.map_editor.leave()
            self.actions.forget()
            self._hub.let_go(self.client.client_id)
            self._robot = robot
            self._choose(msgspec.structs.replace(self._choices, robot=robot))

    def switch_layer(self, key: str, *, is_on: bool) -> None:
        """Show or hide a layer, and remember it."""
        layers = {**self._choices.layers, key: is_on}
        self._choose(msgspec.structs.replace(self._choices, layers=layers))

    def switch_frame(self, frame: str, *, is_on: bool) -> None:
        """Show or hide the axes of a frame, and remember it."""
        others = {key: on for key, on in self._choices.layers.items() if key != FRAME + frame}
        layers = {**others, FRAME + frame: True} if is_on else others
        self._choose(msgspec.structs.replace(self._choices, layers=layers))

    def dismiss(self, suspect: SuspectLine) -> None:
        """Do not suspect a mirror here any more."""
        grid = self.view.map
        if grid is not None:
            one = Dismissed(map=grid.name, points=suspect.points)
            dismissed = [*self._choices.dismissed, one][-MAX_DISMISSED:]
            self._choose(msgspec.structs.replace(self._choices, dismissed=dismissed))

    def put_off(self, changes: list[MapChange]) -> None:
        """Do not offer some changes of the map here for now."""
        self.change_marks.put_off(self._map_name(), changes)

    def resized(self, size: tuple[float, float]) -> None:
        """Take note of the width and height of the picture [px of the page]."""
        self._sight.resized(size, self._hub.monotonic_ns)

    def remember_folder(self, title: str, *, is_open: bool) -> None:
        """Take note that its person opened or closed a folder, and remember it."""
        folder = self._folders.get(title)
        if folder is not None:  # a page may say anything
            folder.expand_by_default = is_open  # as the page makes it anew with its tab
            folders = {**self._choices.folders, title: is_open}
            self._choose(msgspec.structs.replace(self._choices, folders=folders))

    def set_dark(self, *, is_dark: bool) -> None:
        """Change the look, and remember it."""
        configure_look(self.client.gui, dark=is_dark)
        self._choose(msgspec.structs.replace(self._choices, dark=is_dark))

    def fit_view(self) -> None:
        """Show the whole map."""
        self._sight.fit(self.view)

    # What the service asks for.
    def update_scene(self, robots: Set[str]) -> None:
        """Show what this browser wants to see of the robots in the scene, and nothing else."""
        for robot in self._shadows.keys() - robots:
            self._shadows.pop(robot)[""].remove()  # and all below it
        for robot in robots:
            self._shadow(robot, "", is_on=robot == self._robot)
        layers = self.layers()
        hidden = {MapLayer.key} if self.map_editor.hides_map else set[str]()
        for key, is_on in layers.items():
            self._shadow(self._robot, f"/{key}", is_on=is_on and key not in hidden)
        self._turn_scene()
        self.drags.tick()
        self.aiming.look_ahead()
        self._preview.draw(self.aiming.preview, self.view.placement)
        self._pins.draw(self.actions.errands.items, self.view.placement)
        markers = self._hub.stage(self._robot).markers
        icons = markers.icons if layers[markers.key] else []
        self._icons.show(icons, self.client.camera.wxyz)
        self._show_names(is_on=layers[PlaceLayer.key])
        if self.pointing.tool is not None and self.zones.mode != "idle":
            self.zones.leave()  # one tool at a time
        if self.pointing.tool is not None:
            self.map_editor.choose("look")
        self.zones.update()
        self.map_editor.update()
        self.suspects.update(self.view, self._choices.dismissed, is_shown=layers["zones"])
        self.change_marks.update(self.view, is_shown=layers["zones"])
        self._axes.draw(self.view.placement, self.frames_on())
        self._sight.update(self.view, self._robot)

    def put_tools_away(self) -> None:
        """End what somebody began to point at or to draw."""
        self.aiming.put_away()
        self.zones.leave()
        self.map_editor.choose("look")
        self.console.close_plot()

    # Inside.
    def _post_while_open(self, fn: Callable[[], None]) -> None:
        """Call on the service's thread what a pointer did, unless its browser is gone."""

        def call() -> None:
            if self._hub.is_open(self.client.client_id):
                fn()

        self._hub.call_soon(call)

    def _begin_zone(self) -> None:
        """Put away what else draws on the map: zones belong to the map that is stored."""
        self.aiming.put_away()
        self.map_editor.leave()

    def _begin_map_tool(self) -> None:
        self.aiming.put_away()
        self.zones.leave()

    def _turn_scene(self) -> None:
        """Let robot, zones and places lie where they will on a map that is being turned."""
        root = self._shadows.get(self._robot, {}).get("")
        pose = self.map_editor.new_T_old
        if root is not None and self._turned_by != pose:
            self._turned_by = pose
            place(root, pose, 0.0)

    def _show_names(self, *, is_on: bool) -> None:
        """Write the names of the places, as many as there is room for."""
        view = self.view
        goal = view.feeds.latest(topics.GOAL)
        self._names.show(
            place_names(view) if is_on else [],
            "" if goal is None else goal_name(goal, current_places(view)),
            self._sight.eye,
        )

    def _map_name(self) -> str:
        grid = self.view.map
        return "" if grid is None else grid.name

    def _tell_unheard(self) -> None:
        """Own up to a release that was seen by viser alone."""
        self.tell("Nothing done", "The page is slow to answer. Point once more.", "warn")

    def _choose(self, choices: Choices) -> None:
        self._choices = choices
        self._hub.remember(self.visitor.browser, choices)

    def _shadow(self, robot: str, below: str, *, is_on: bool) -> None:
        """Show or hide a part of the scene in this browser alone."""
        frames = self._shadows.setdefault(robot, {})
        if below not in frames:
            path = f"{ROOT}/{robot}{below}"
            frames[below] = self.client.scene.add_frame(path, show_axes=False, visible=is_on)
        elif frames[below].visible != is_on:
            frames[below].visible = is_on
