"""The viewer as a service: browsers on one side, the robots' streams and requests on the other.

viser serves the browsers on threads of its own; whatever happens there is handed over by
`call_soon`. A robot's streams are subscribed to only while a browser is open.
"""

from typing import Any

import msgspec
import viser

from trolley import teleop, topics
from trolley.config import RobotConfig
from trolley.runtime.service import Service, Watch, every
from trolley.topics import Topic
from trolley_viz import camera
from trolley_viz.actions import Actions
from trolley_viz.feeds import Feeds
from trolley_viz.joystick.by_hand import ByHand
from trolley_viz.joystick.page import pad_html
from trolley_viz.panels.console import Console
from trolley_viz.placement import Placement
from trolley_viz.pointing import Pointing
from trolley_viz.robots import Robots
from trolley_viz.scene.ground import map_bounds
from trolley_viz.scene.layer import View
from trolley_viz.scene.scene import Scene
from trolley_viz.server import LocalServer, PortTaken, close_server, configure_look, open_server
from trolley_viz.settings import FILE, ViewerSettings
from trolley_viz.stopping import StopPresses
from trolley_viz.words import Tone

PANEL_PERIOD_NS = 200_000_000
JOYSTICK_PATH = "/joystick"
NOTICE_S = 8.0
NOTICE_COLOURS: dict[Tone, tuple[int, int, int]] = {
    "good": (30, 158, 80),
    "busy": (47, 111, 224),
    "warn": (217, 138, 0),
    "bad": (214, 51, 51),
    "idle": (128, 136, 148),
}


class VizService(Service):
    """The web viewer: one page for all robots of the network."""

    name = "viz"
    all_robots = True

    _server: LocalServer | None = None

    def __init__(self, config: RobotConfig) -> None:
        self._config = config.viz
        self._robots = Robots(config.robot.name)
        self._placement = Placement()
        self._clients: dict[int, viser.ClientHandle] = {}
        self._fitted: dict[int, str] = {}
        """The map that each client's camera was last moved for."""
        self._panels_due_ns = 0
        self._epoch = 0

    # Life.
    def start(self) -> None:
        """Open the web page."""
        self._by_hand = ByHand(self, self._robots, self.robot_ns)
        sockets = {JOYSTICK_PATH: self._by_hand.sockets.serve}
        try:
            server = self._server = open_server(self._config, sockets)
        except PortTaken as taken:
            # Nothing to trace: the sentence says it all, so it is no exception in the log.
            self.log.error("The viewer cannot start", why=str(taken))  # noqa: TRY400
            raise SystemExit(1) from taken
        self._settings = self.state.read(FILE, ViewerSettings) or ViewerSettings()
        configure_look(server, dark=self._settings.dark)
        self._robot_watch = self.watch(topics.ROBOT, robot="*")
        self._feeds = Feeds(self._open_watch, self.close_watch)
        self._pointing = Pointing(server, self.call_soon)
        self._actions = Actions(self, lambda: self._robots.selected, self._view, self._tell)
        self._stops = StopPresses(self._actions.ask_stop)
        self._scene = Scene(server, self._settings.layers)
        self._console = Console(server.gui, self, self._scene, dark=self._settings.dark)
        server.gui.add_html(pad_html())

        # async, and only handing over: these run on the thread of the web server.
        async def came(client: viser.ClientHandle) -> None:
            self.call_soon(lambda: self._client_came(client))

        async def left(client: viser.ClientHandle) -> None:
            self.call_soon(lambda: self._client_left(client.client_id))

        server.on_client_connect(came)
        server.on_client_disconnect(left)
        self.log.info("The viewer is ready", url=f"http://{self._config.host}:{self._config.port}")

    def stop(self) -> None:
        """Close the web page."""
        if self._server is not None:
            close_server(self._server)

    @every(0.05, clock="local")
    def look(self) -> None:
        """Draw and say what changed, while anybody looks."""
        self._stops.tick(self.monotonic_ns)
        if not self._clients:
            return
        self._robots.update(self._robot_watch.by_parts)
        self._follow_epoch()
        self._feeds.want(self._scene.wanted())
        self._placement.update(
            self._feeds.by_parts(topics.TF),
            self._feeds.history(topics.ODOM),
            has_map=self._feeds.latest(topics.MAP) is not None,
        )
        view = self._view()
        self._fit_new(view)
        self._scene.update(view)
        if self.monotonic_ns >= self._panels_due_ns:
            self._panels_due_ns = self.monotonic_ns + PANEL_PERIOD_NS
            self._console.update(view)
            self._by_hand.tell(view.feeds.latest(topics.BASE), view.feeds.latest(topics.GOAL))

    @every(teleop.PERIOD_S, clock="local")
    def drive_by_hand(self) -> None:
        """Send what the joystick wants."""
        self._by_hand.drive()

    # What the panels read.
    @property
    def robots(self) -> Robots:
        """The robots of the network."""
        return self._robots

    @property
    def actions(self) -> Actions:
        """What the buttons do."""
        return self._actions

    @property
    def pointing(self) -> Pointing:
        """The tool that waits for a gesture."""
        return self._pointing

    @property
    def stops(self) -> StopPresses:
        """The presses of Stop that are not answered."""
        return self._stops

    def is_away(self, robot: str) -> bool:
        """Whether a robot's clock is silent."""
        return self.robot_ns(robot) is None

    def robot_ns(self, robot: str) -> int | None:
        """The time of a robot [ns], None while its clock is silent."""
        return self.time_of(robot).now(self.monotonic_ns)

    # What the panels ask for.
    def press_stop(self) -> None:
        """Stop the robot that is shown."""
        self._stops.press(self._robots.selected, self.monotonic_ns)

    def press_resume(self) -> None:
        """Let it drive again."""
        self._stops.release(self._robots.selected)
        self._actions.resume()

    def select_robot(self, name: str) -> None:
        """Show another robot."""
        if name != self._robots.selected:
            self._pointing.disarm()
            self._actions.put_away()
            self._by_hand.drop()
            self._robots.selected = name
            self._forget()

    def switch_layer(self, key: str, *, is_on: bool) -> None:
        """Show or hide a layer, and remember it."""
        for layer in self._scene.layers:
            if layer.key == key:
                layer.switch(is_on)
        self._remember(msgspec.structs.replace(self._settings, layers=self._scene.choices()))

    def set_dark(self, *, is_dark: bool) -> None:
        """Change the look, and remember it."""
        if self._server is not None:
            configure_look(self._server, dark=is_dark)
        self._remember(msgspec.structs.replace(self._settings, dark=is_dark))

    def fit_view(self, client: viser.ClientHandle) -> None:
        """Show a client the whole map."""
        bounds = map_bounds(self._view())
        if bounds is not None:
            camera.fit(client, bounds, is_new=False)

    # Inside.
    def _client_came(self, client: viser.ClientHandle) -> None:
        if not self._clients:
            self._forget()
        self._clients[client.client_id] = client
        self._panels_due_ns = 0

    def _client_left(self, client_id: int) -> None:
        self._clients.pop(client_id, None)
        self._fitted.pop(client_id, None)
        if self._pointing.client_id == client_id:
            self._pointing.disarm()
            self._actions.put_away()
        if not self._clients:
            self._feeds.drop_all()

    def _open_watch(self, topic: Topic[Any], seconds: float) -> Watch[Any]:
        return self.watch(topic, seconds=seconds, robot=self._robots.selected)

    def _view(self) -> View:
        return View(
            feeds=self._feeds,
            placement=self._placement,
            robot=self._robots.robot,
            now_ns=self.monotonic_ns,
            is_away=self.is_away(self._robots.selected),
            work=self.work,
            preview=self._actions.preview,
        )

    def _follow_epoch(self) -> None:
        """Drop what an earlier run of the robot's base measured."""
        epoch = self.time_of(self._robots.selected).epoch
        if epoch != self._epoch:
            self._epoch = epoch
            self._forget()

    def _forget(self) -> None:
        """Subscribe and draw anew."""
        self._feeds.drop_all()
        self._scene.forget()

    def _fit_new(self, view: View) -> None:
        """Move the cameras of those who have not seen this map yet."""
        grid = view.feeds.latest(topics.MAP)
        if grid is None or self._server is None:
            return
        waiting = [one for one in self._clients if self._fitted.get(one) != grid.name]
        bounds = map_bounds(view) if waiting else None
        if bounds is None:
            return
        camera.set_initial(self._server, bounds)
        for client_id in waiting:
            camera.fit(self._clients[client_id], bounds, is_new=client_id not in self._fitted)
            self._fitted[client_id] = grid.name

    def _tell(self, title: str, text: str, tone: Tone) -> None:
        for client in self._clients.values():
            client.add_notification(
                title, text, auto_close_seconds=NOTICE_S, color=NOTICE_COLOURS[tone]
            )

    def _remember(self, settings: ViewerSettings) -> None:
        if settings == self._settings:
            return
        self._settings = settings

        def write() -> str:
            try:
                self.state.write(FILE, settings)
            except OSError as error:
                return str(error.strerror)
            return ""

        self.work(write, self._remembered)

    def _remembered(self, problem: str) -> None:
        if problem:
            self.log.warning("The viewer's settings were not saved", why=problem)
