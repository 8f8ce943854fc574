"""One browser: its controls, its tool, the robot that it follows and the layers that it shows."""

import math
from collections.abc import Callable, Mapping, Set
from dataclasses import dataclass

import msgspec
import viser

from trolley.geometry import Pose2D
from trolley.messages import MapChange, SuspectLine
from trolley_viz.actions.aiming import Aiming
from trolley_viz.actions.place_actions import PlaceActions
from trolley_viz.actions.robot_actions import RobotActions
from trolley_viz.actions.touching import Touching
from trolley_viz.controls.controls import Controls, Folder
from trolley_viz.drawing.canvas import Canvas
from trolley_viz.drawing.map_changes import ChangeMarks, ChangeRequests
from trolley_viz.drawing.suspected_mirrors import SuspectLines
from trolley_viz.drawing.zone_editor import ZoneEditor, stored_zones
from trolley_viz.drawing.zone_requests import ZoneRequests
from trolley_viz.graphics.camera import NORTH, Look
from trolley_viz.languages.catalogue import ENGLISH, known_language
from trolley_viz.map_editing.map_editor import MapEditor
from trolley_viz.map_editing.map_preview import MapPreview
from trolley_viz.overlays.pages import File
from trolley_viz.past.looking import Looking
from trolley_viz.pointing.drags import Drags
from trolley_viz.pointing.picture import Picture
from trolley_viz.pointing.pointer import Pointer
from trolley_viz.robots.view import View
from trolley_viz.scene.map_layers import MapLayer
from trolley_viz.scene.past import HIDDEN
from trolley_viz.scene.scene import shown_layers
from trolley_viz.scene.touch import Touched, touched
from trolley_viz.sentences import Tone
from trolley_viz.server.messages import Notice, Told
from trolley_viz.server.visitors import Visitor
from trolley_viz.session.browser_scene import BrowserScene
from trolley_viz.session.hub import Hub
from trolley_viz.session.viewport import Viewport
from trolley_viz.settings import MAX_DISMISSED, Choices, Dismissed

FRAME = "frame:"
"""Begins the keys under which the choices hold the frames whose axes are shown."""


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
        self.picture = Picture()
        """Where it draws what is its own."""
        self.visitor = page.visitor
        self._page = page
        self._hub = hub
        service = hub.service
        self._choices = choices
        self._layers = shown_layers(choices.layers)
        self._robot = choices.robot or hub.robots.own
        self.drags = Drags(
            self._post_while_open, lambda: hub.service.monotonic_ns, self._tell_unconfirmed
        )
        self.pointing = Pointer(self.picture, self.drags)
        self.actions = RobotActions(
            service, lambda: self._robot, lambda: self.view, self.tell, self._note_sent
        )
        self.past = Looking(service, hub.past, lambda: self._robot, self.tell)
        """Whether it looks at what is, or at a moment of the past."""
        self.actions.before_ask = self.past.asks
        self.aiming = Aiming(
            service, self.pointing, self.actions, lambda: self._robot, lambda: self.view
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
        self.zone_editor = ZoneEditor(
            Canvas(self.picture, self.drags),
            ZoneRequests(
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
            Canvas(self.picture, self.drags),
            MapPreview(self.picture),
            service,
            lambda: self._robot,
            lambda: self.view,
            self.tell,
            self._begin_map_tool,
        )
        self.suspected_mirrors = SuspectLines(self.picture)
        self.change_marks = ChangeMarks(self.picture)
        self.change_requests = ChangeRequests(
            service, self.actions, lambda: self._robot, self._map_name
        )
        self.scene: BrowserScene | None = None
        """What this browser alone has in its scene; None while it has no picture."""
        self._viewport: Viewport | None = None
        self.look = Look()
        """How its person wants to see the map."""
        self.take_tap: Callable[[Touched], bool] | None = None
        """Takes what is touched, as while a tour is made of it; says whether it did."""
        self._prefers_dark = False
        self._device_language = ""
        self._size: tuple[float, float] | None = None
        """Width and height of the picture [px of the page], once the page has told."""

    # Its picture.
    def attach(self, client: viser.ClientHandle) -> None:
        """Draw in a picture that is new; what is under way there goes on."""
        self.detach()
        self.picture.client = client
        self._set_look()
        self.scene = BrowserScene(client.scene)
        self._viewport = Viewport(client, self._size, self.look)
        self.pointing.show()
        self.zone_editor.show()
        self.map_editor.show()

    def detach(self) -> None:
        """Go without a picture, as while viser's part of the page loads."""
        if self.picture.client is not None:
            self.drags.cancelled()
            self.pointing.hide()
            self.zone_editor.hide()
            self.map_editor.hide()
            self.picture.client = self.scene = self._viewport = None

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
    def choices(self) -> Choices:
        """What was chosen here."""
        return self._choices

    @property
    def is_dark(self) -> bool:
        """Whether it has the dark look."""
        chosen = self._choices
        return chosen.dark or (self._prefers_dark and not chosen.light)

    @property
    def language(self) -> str:
        """The code of the language in which its page is."""
        return known_language(self._choices.language) or self._device_language or ENGLISH

    @property
    def has_letters(self) -> bool:
        """Whether keys that are single letters do something."""
        return not self._choices.no_letters

    @property
    def view(self) -> View:
        """What is known of the robot."""
        return self._hub.scenes.of(self._robot).view

    @property
    def hint(self) -> str:
        """What the armed tool waits for, "" where there is none."""
        return self.zone_editor.hint or self.map_editor.hint or self.aiming.hint

    def robot_labels(self) -> dict[str, str]:
        """What to call each robot in a list, to its name."""
        hub = self._hub
        return hub.robots.labels(self._robot, lambda name: hub.robot_ns(name) is None)

    def layers(self) -> Mapping[str, bool]:
        """Which layers are shown, by key."""
        return self._layers

    def frames_on(self) -> list[str]:
        """The frames whose axes are shown."""
        chosen = self._choices.layers.items()
        return [key.removeprefix(FRAME) for key, is_on in chosen if is_on and key.startswith(FRAME)]

    # What the panels ask for.
    def folder(self, title: str, *, is_open: bool = False) -> Folder:
        """Add a folder of controls: as its person left it, else open or not as is said here."""
        folder = self._page.controls.add_folder(
            title, is_open=self._choices.folders.get(title, is_open)
        )
        folder.on_fold(lambda is_open: self._remember_folder(title, is_open=is_open))
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
            self.put_tools_away()
            self.map_editor.leave()
            self.actions.forget()
            self.past.close()
            self._hub.let_go(self._page.number)
            self._robot = robot
            self._choose(msgspec.structs.replace(self._choices, robot=robot))

    def switch_letters(self, *, is_on: bool) -> None:
        """Let keys that are single letters do something or not, and remember it."""
        self._choose(msgspec.structs.replace(self._choices, no_letters=not is_on))

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
        """Stop suspecting a mirror here."""
        grid = self.view.map
        if grid is not None:
            one = Dismissed(map=grid.name, points=suspect.points)
            dismissed = [*self._choices.dismissed, one][-MAX_DISMISSED:]
            self._choose(msgspec.structs.replace(self._choices, dismissed=dismissed))

    def put_off(self, changes: list[MapChange]) -> None:
        """Do not offer some changes of the map here for now."""
        self.change_marks.put_off(self._map_name(), changes)

    def resized(self, size: tuple[float, float]) -> None:
        """Note the width and height of the picture [px of the page]."""
        self._size = size
        if self._viewport is not None:
            self._viewport.resized(size, self._hub.service.monotonic_ns)

    def choose_look(self, *, dark: bool, light: bool) -> None:
        """Change the look, and remember it; neither: as the device is set."""
        self._choose(msgspec.structs.replace(self._choices, dark=dark, light=light))
        self._set_look()

    def prefer_dark(self, *, is_dark: bool) -> None:
        """Note how the device is set."""
        self._prefers_dark = is_dark
        self._set_look()

    def look_at(self, x: float, y: float) -> None:
        """Show a place in the world [m] from near."""
        if self._viewport is not None:
            self._viewport.look_at(x, y)

    def change_look(self, look: Look) -> None:
        """See the map from elsewhere."""
        self.look = look
        if self._viewport is not None:
            self._viewport.change(look, self.view)

    def choose_language(self, code: str) -> None:
        """Change the language, and remember it; "": as the device is set."""
        self._choose(msgspec.structs.replace(self._choices, language=code))

    def prefer_language(self, tag: str) -> None:
        """Note the language of the device, if it is one of ours."""
        self._device_language = known_language(tag)

    def fit_view(self) -> None:
        """Show the whole map, and follow nobody."""
        self.change_look(Look(is_flat=self.look.is_flat))
        if self._viewport is not None:
            self._viewport.fit(self.view)

    # What the service asks for.
    def update_scene(self, robots: Set[str]) -> None:
        """Show what this browser wants to see of the robots in the scene, and nothing else."""
        layers, view = self.layers(), self.view
        self.drags.tick()
        self._tick_past()
        self.aiming.tick()
        if self.scene is not None and self._viewport is not None:
            hidden = {MapLayer.key} if self.map_editor.hides_map else set[str]()
            hidden |= HIDDEN if self.past.is_past else set[str]()
            shown = layers
            if hidden:
                shown = {key: is_on and key not in hidden for key, is_on in layers.items()}
            self.scene.show_robot(self._robot, robots, shown)
            self.scene.move_root(self._robot, self.map_editor.new_T_old)
            markers = self._hub.scenes.of(self._robot).markers
            self.scene.draw(
                view,
                layers,
                preview=self.aiming.preview or self.touching.preview,
                queue=self.actions.goal_queue.items,
                icons=markers.icons if layers[markers.key] else [],
                frames=self.frames_on(),
                eye=self._viewport.eye,
                touched=self.touching.touched,
            )
            self.scene.past.draw(self.past.picture, view)
            self._viewport.update(view, self._robot)
        self._keep_one_tool()
        self.zone_editor.update()
        self.map_editor.update()
        self.suspected_mirrors.update(view, self._choices.dismissed, is_shown=layers["zones"])
        self.change_marks.update(view, is_shown=layers["zones"])

    def step_cursor(self, right: float, up: float, turn: float = 0.0) -> None:
        """Move what arrow keys point at, as seen in the picture [m], or turn it [rad]."""
        heading = NORTH if self._viewport is None else self._viewport.up
        here = self.view.placement.world_T_base or Pose2D.identity()
        x = up * math.cos(heading) + right * math.sin(heading)
        y = up * math.sin(heading) - right * math.cos(heading)
        self.pointing.step(here, Pose2D(x, y, turn))

    def tapped(self, at: tuple[float, float]) -> None:
        """Take a tap on the picture, unless a tool waits for it: shares of its width and height."""
        if self.hint or self._viewport is None or not self.may_drive:
            return
        one = touched(self.view, self._viewport.eye, at)
        if one is None or not (self.take_tap and self.take_tap(one)):
            self.touching.touch(one)

    def put_tools_away(self) -> None:
        """End all pointing and drawing."""
        self.touching.close()
        self.aiming.put_away()
        self.zone_editor.leave()
        self.map_editor.choose("look")

    # Inside.
    def _note_sent(self, robot: str, sent: str) -> None:
        """Note that a goal or trip was sent from here."""
        people = self._hub.people
        people.senders.note(robot, sent, people.names.of(self.visitor))

    def _set_look(self) -> None:
        client = self.picture.client
        if client is not None:
            client.gui.configure_theme(
                dark_mode=self.is_dark, show_logo=False, show_share_button=False
            )

    def _tick_past(self) -> None:
        """Let the past go on; a tool that waits for the pointer is about what is now."""
        if self.hint:
            self.past.return_to_now()
        self.past.tick()

    def _remember_folder(self, title: str, *, is_open: bool) -> None:
        folders = {**self._choices.folders, title: is_open}
        self._choose(msgspec.structs.replace(self._choices, folders=folders))

    def _post_while_open(self, fn: Callable[[], None]) -> None:
        """Call on the service's thread what a pointer did, unless its browser is gone."""

        def call() -> None:
            client = self.picture.client
            if client is not None and self._hub.is_open(client.client_id):
                fn()

        self._hub.service.call_soon(call)

    def _begin_zone(self) -> None:
        """Put away what else draws on the map: zones belong to the map that is stored."""
        self.aiming.put_away()
        self.map_editor.leave()

    def _begin_map_tool(self) -> None:
        self.aiming.put_away()
        self.zone_editor.leave()

    def _keep_one_tool(self) -> None:
        """Put away what else takes the pointer while something is pointed out."""
        if self.pointing.tool is None:
            return
        if self.zone_editor.mode != "idle":
            self.zone_editor.leave()
        self.map_editor.choose("look")

    def _map_name(self) -> str:
        grid = self.view.map
        return "" if grid is None else grid.name

    def _tell_unconfirmed(self) -> None:
        """Say that a release was not confirmed by the page."""
        self.tell("Nothing was done", "The page is slow to respond. Please point again.", "warn")

    def _choose(self, choices: Choices) -> None:
        self._choices = choices
        self._layers = shown_layers(choices.layers)
        self._hub.remember(self.visitor.browser, choices)
