"""One browser: its controls, its tool, the robot that it follows and the layers that it shows."""

from collections.abc import Callable, Set
from dataclasses import dataclass
from functools import partial

import viser

from trolley.geometry import Pose2D
from trolley.geometry.frames import MAP
from trolley.messages import MapChange, SuspectLine
from trolley_viz.controls.controls import Controls, Folder
from trolley_viz.features.driving.aiming import Aiming
from trolley_viz.features.driving.robot_actions import RobotActions
from trolley_viz.features.map_changes.changes import ChangeMarks, ChangeRequests
from trolley_viz.features.map_editing.editor import MapEditor
from trolley_viz.features.map_editing.preview import MapPreview
from trolley_viz.features.past.drawing import HIDDEN
from trolley_viz.features.past.looking import Looking
from trolley_viz.features.places.place_actions import PlaceActions
from trolley_viz.features.touch.touched import Touched, place_at, touched
from trolley_viz.features.touch.touching import Touching
from trolley_viz.features.zones.editor import ZoneEditor, stored_zones
from trolley_viz.features.zones.requests import ZoneRequests
from trolley_viz.features.zones.suspected_mirrors import SuspectLines
from trolley_viz.overlays.pages import File
from trolley_viz.pointing.canvas import Canvas
from trolley_viz.pointing.drags import Drags
from trolley_viz.pointing.pointer import Pointer
from trolley_viz.robots.view import View
from trolley_viz.scene.map_layers import MapLayer
from trolley_viz.server.messages import Notice, Told
from trolley_viz.server.visitors import Visitor
from trolley_viz.session.browser_choices import Choices
from trolley_viz.session.drawing import Drawing
from trolley_viz.session.hub import Hub
from trolley_viz.session.preferences import Preferences
from trolley_viz.session.window import Window
from trolley_viz.words.sentences import Tone


@dataclass(frozen=True)
class PagePort:
    """The page of a browser, as its session uses it."""

    number: int
    """Tells it from all others."""
    visitor: Visitor
    """Who it is."""
    controls: Controls
    """What its person can press."""
    say: Callable[[Told], None]
    """Tells the page something."""


class Session:
    """What one browser sees and may do.

    Args:
        hub: what all browsers share.
        page: its page.
        choices: what was chosen there before.
    """

    def __init__(self, hub: Hub, page: PagePort, choices: Choices) -> None:
        self.visitor = page.visitor
        self._page = page
        self._hub = hub
        service = hub.service
        self.preferences = Preferences(
            choices, partial(hub.browsers.remember, page.visitor.browser)
        )
        """What its person has chosen."""
        self._robot = choices.robot or hub.robots.own
        self.window = Window(lambda: self.view, lambda: service.monotonic_ns)
        """What it shows of the scene."""
        picture = self.window.picture
        self.drags = Drags(
            self._post_while_open, lambda: hub.service.monotonic_ns, self._tell_unconfirmed
        )
        self.pointing = Pointer(picture, self.drags)
        self.actions = RobotActions(
            service, lambda: self._robot, lambda: self.view, self.tell, self._note_sent
        )
        self.past = Looking(
            service,
            hub.past,
            lambda: self._robot,
            lambda: self.preferences.time_zone,
            self.tell,
        )
        """Whether it looks at what is, or at a moment of the past."""
        self.actions.before_ask = self.past.asks
        self.aiming = Aiming(
            service,
            self.pointing,
            self.actions,
            lambda: self._robot,
            lambda: self.view,
            self._place_at,
        )
        self.place_actions = PlaceActions(self.actions, self.aiming, lambda: self.view)
        self.touching = Touching(
            service,
            self.actions,
            self.aiming,
            self.place_actions,
            lambda: self._robot,
            lambda: self.view,
        )
        self.drawing = Drawing(
            ZoneEditor(
                Canvas(picture, self.drags),
                ZoneRequests(self.actions, lambda: stored_zones(self.view), self._map_name),
                lambda: self.view,
                self.tell,
                lambda: self.drawing.begin_zone(self._robot),
            ),
            MapEditor(
                Canvas(picture, self.drags),
                MapPreview(picture),
                service,
                lambda: self._robot,
                lambda: self.view,
                self.tell,
                lambda: self.drawing.begin_map_tool(),
            ),
            self.aiming,
        )
        self.suspected_mirrors = SuspectLines(picture, self.preferences.in_language)
        self.change_marks = ChangeMarks(picture)
        self.change_requests = ChangeRequests(
            service, self.actions, lambda: self._robot, self._map_name
        )
        self.take_tap: Callable[[Touched], bool] | None = None
        """Takes what is touched, as while a tour is made of it; says whether it did."""

    # Its picture.
    def attach(self, client: viser.ClientHandle) -> None:
        """Draw in a picture that is new; what is under way there goes on."""
        self.detach()
        self.window.open(client)
        self._set_look()
        self.pointing.show()
        self.drawing.show()

    def detach(self) -> None:
        """Go without a picture, as while viser's part of the page loads."""
        if self.window.picture.client is not None:
            self.drags.cancelled()
            self.pointing.hide()
            self.drawing.hide()
            self.window.shut()

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
    def number(self) -> int:
        """Tells its page from all others."""
        return self._page.number

    @property
    def robot(self) -> str:
        """The name of the robot that it follows."""
        return self._robot

    @property
    def view(self) -> View:
        """What is known of the robot."""
        return self._hub.scenes.of(self._robot).view

    @property
    def hint(self) -> str:
        """What the armed tool waits for, "" where there is none."""
        return self.drawing.hint or self.aiming.hint

    def robot_labels(self) -> dict[str, str]:
        """What to call each robot in a list, to its name."""
        hub = self._hub
        return hub.robots.labels(self._robot, lambda name: hub.robot_ns(name) is None)

    # What the panels ask for.
    def folder(self, title: str, *, is_open: bool = False) -> Folder:
        """Add a folder of controls: as its person left it, else open or not as is said here."""
        chosen = self.preferences
        folder = self._page.controls.add_folder(title, is_open=chosen.is_open(title, is_open))
        folder.on_fold(lambda is_open: chosen.fold(title, is_open=is_open))
        return folder

    def post(self, fn: Callable[[], None]) -> None:
        """Call on the service's thread."""
        self._hub.service.call_soon(fn)

    def tell(self, title: str, text: str, tone: Tone) -> None:
        """Show a notice: a title and a sentence."""
        self._page.say(Told(notice=Notice(title=title, text=text, tone=tone)))

    def save_file(self, name: str, text: str) -> None:
        """Let the browser save a file."""
        self._page.say(Told(file=File(name, text)))

    def press_stop(self) -> None:
        """Stop the robot."""
        self._hub.press_stop(self._robot, self.visitor)

    def press_stop_all(self) -> None:
        """Stop all robots, also those that are away: each as soon as it answers."""
        for name in self._hub.robots.names(self._robot):
            self._hub.press_stop(name, self.visitor)

    def follow(self, robot: str) -> None:
        """Show another robot."""
        if robot != self._robot:
            self.drawing.put_aside(self._robot)
            self.put_tools_away()
            self.actions.forget()
            self.past.close()
            self._hub.let_go(self._page.number)
            self._robot = robot
            self.preferences.choose_robot(robot)

    def dismiss(self, suspect: SuspectLine) -> None:
        """Stop suspecting a mirror here."""
        grid = self.view.map
        if grid is not None:
            self.preferences.dismiss(grid.name, suspect)

    def put_off(self, changes: list[MapChange]) -> None:
        """Do not offer some changes of the map here for now."""
        self.change_marks.put_off(self._map_name(), changes)

    def choose_look(self, *, dark: bool, light: bool) -> None:
        """Change the look, and remember it; neither: as the device is set."""
        self.preferences.choose_look(dark=dark, light=light)
        self._set_look()

    def prefer_dark(self, *, is_dark: bool) -> None:
        """Note how the device is set."""
        self.preferences.device_is_dark = is_dark
        self._set_look()

    # What the service asks for.
    def update_scene(self, robots: Set[str]) -> None:
        """Show what this browser wants to see of the robots in the scene, and nothing else."""
        layers, view = self.preferences.layers, self.view
        self.drags.tick()
        self._tick_past()
        self.aiming.tick()
        self.actions.search.update(self.view)
        scene, eye = self.window.scene, self.window.eye
        if scene is not None and eye is not None:
            hidden = {MapLayer.key} if self.drawing.map_editor.hides_map else set[str]()
            hidden |= HIDDEN if self.past.is_past else set[str]()
            shown = layers
            if hidden:
                shown = {key: is_on and key not in hidden for key, is_on in layers.items()}
            scene.show_robot(self._robot, robots, shown)
            scene.move_root(self._robot, self.drawing.map_editor.new_T_old)
            markers = self._hub.scenes.of(self._robot).markers
            scene.draw(
                view,
                layers,
                preview=self.aiming.preview or self.touching.preview,
                queue=self.actions.goal_queue.items,
                icons=markers.icons if layers[markers.key] else [],
                frames=self.preferences.frames,
                eye=eye,
                touched=self.touching.touched,
            )
            scene.past.draw(self.past.picture, view)
            self.window.update(self._robot)
        if self.pointing.tool is not None:
            self.drawing.yield_pointer()
        if view.map is not None and view.placement.world == MAP:
            self.drawing.take_up(self._robot)
        self.drawing.update()
        dismissed = self.preferences.choices.dismissed
        self.suspected_mirrors.update(view, dismissed, is_shown=layers["zones"])
        self.change_marks.update(view, is_shown=layers["zones"])

    def step_cursor(self, right: float, up: float, turn: float = 0.0) -> None:
        """Move what arrow keys point at, as seen in the picture [m], or turn it [rad]."""
        here = self.view.placement.world_T_base or Pose2D.identity()
        self.pointing.step(here, Pose2D(*self.window.offset(right, up), turn))

    def released(self, at: tuple[float, float], *, is_tap: bool) -> None:
        """Take note that a pointer was let go on the picture.

        Args:
            at: shares of its width and height.
            is_tap: whether it came down there shortly before: touches what is there, unless a
                tool waits for it.
        """
        eye, is_for_tool = self.window.eye, bool(self.hint)
        ray = (eye.position, eye.direction(at)) if is_tap and eye is not None else None
        self.drags.released(at, ray)
        if not is_tap or is_for_tool or eye is None or not self.may_drive:
            return
        one = touched(self.view, eye, at)
        if one is None or not (self.take_tap and self.take_tap(one)):
            self.touching.touch(one)

    def put_tools_away(self) -> None:
        """End all pointing and drawing."""
        self.touching.close()
        self.aiming.put_away()
        self.drawing.put_away()

    # Inside.
    def _note_sent(self, robot: str, sent: str) -> None:
        """Note that a goal or trip was sent from here."""
        people = self._hub.people
        people.senders.note(robot, sent, people.names.of(self.visitor))

    def _set_look(self) -> None:
        client = self.window.picture.client
        if client is not None:
            client.gui.configure_theme(
                dark_mode=self.preferences.is_dark, show_logo=False, show_share_button=False
            )

    def _tick_past(self) -> None:
        """Let the past go on; a tool that waits for the pointer is about what is now."""
        if self.hint:
            self.past.return_to_now()
        self.past.tick()

    def _post_while_open(self, fn: Callable[[], None]) -> None:
        """Call on the service's thread what a pointer did, unless its browser is gone."""

        def call() -> None:
            client = self.window.picture.client
            if client is not None and self._hub.is_open(client.client_id):
                fn()

        self._hub.service.call_soon(call)

    def _place_at(self, x: float, y: float) -> str | None:
        """The name of the place that a finger at a point of the world [m] touches."""
        eye = self.window.eye
        return None if eye is None else place_at(self.view, eye, (x, y))

    def _map_name(self) -> str:
        grid = self.view.map
        return "" if grid is None else grid.name

    def _tell_unconfirmed(self) -> None:
        """Say that a release was not confirmed by the page."""
        self.tell("Nothing was done", "The page is slow to respond. Please point again.", "warn")
