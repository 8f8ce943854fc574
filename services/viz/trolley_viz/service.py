"""The viewer as a service: browsers on one side, the robots' streams and requests on the other.

viser serves the browsers on threads of its own; whatever happens there is handed over by
`call_soon`. A robot's streams are subscribed to only while a browser follows it.
"""

from collections.abc import Callable
from typing import Any

import viser

from trolley import requests, teleop, topics
from trolley.codes import Refused
from trolley.config import RobotConfig
from trolley.messages.request_params import AskHistory, Nothing
from trolley.runtime.service import Service, Watch, every
from trolley.topics import Topic
from trolley_viz import camera, visitors
from trolley_viz.fleet import Fleet
from trolley_viz.foxglove import open_bridge
from trolley_viz.gate import FILE as ACCESS_FILE
from trolley_viz.gate import Access, Gate, is_loopback_host
from trolley_viz.gestures.in_pages import Gestures
from trolley_viz.joystick.by_hand import ByHand
from trolley_viz.overlays.cards import Moment
from trolley_viz.overlays.in_pages import InPages, Shown
from trolley_viz.overlays.layer import OverlayLayer
from trolley_viz.overlays.readings import Readings
from trolley_viz.past_trips import Answered as HistoryAnswered
from trolley_viz.robots import Robots
from trolley_viz.scene.ground import map_bounds
from trolley_viz.server import LocalServer, PortTaken, close_server, open_server
from trolley_viz.session import Session
from trolley_viz.settings import FILE, Choices, ViewerSettings
from trolley_viz.stage import Stage
from trolley_viz.stopping import Answered, StopPresses
from trolley_viz.visitors import Visitor

LOOK_PERIOD_S = 0.05
"""A scan waits for half of it on average."""
PANEL_PERIOD_NS = 200_000_000
JOYSTICK_PATH, OVERLAYS_PATH, GESTURES_PATH = "/joystick", "/overlays", "/gestures"
EVERY_MESSAGE_S = 0.05
"""A watch that keeps the last of a stream, however little, is told of every message."""


class VizService(Service):
    """The web viewer: one page for all robots of the network."""

    name = "viz"
    all_robots = True
    one_per_host = True

    _server: LocalServer | None = None

    def __init__(self, config: RobotConfig) -> None:
        self._config = config.viz
        self._robots = Robots(config.robot.name)
        self._stops = StopPresses(self._ask_stop)
        self._fleet = Fleet(
            self._robots,
            lambda topic: self.watch(topic, robot="*"),
            self.close_watch,
            self.robot_ns,
        )
        self._sessions: dict[int, Session] = {}
        """The browsers that are open, by viser's number for each."""
        self._stages: dict[str, Stage] = {}
        """The robots that somebody follows."""
        self._panels_due_ns = 0

    # Life.
    def start(self) -> None:
        """Open the web page."""
        self._by_hand = ByHand(self, self._robots, self.robot_ns, self._driven_by)
        self._overlays = InPages(self, self._shown)
        self._gestures = Gestures(self.call_soon, self._sessions.get)
        sockets = {
            JOYSTICK_PATH: self._by_hand.sockets.serve,
            OVERLAYS_PATH: self._overlays.sockets.serve,
            GESTURES_PATH: self._gestures.sockets.serve,
        }
        try:
            server = self._server = open_server(self._config, self._gate(), sockets)
        except PortTaken as taken:
            # Nothing to trace: the sentence says it all, so it is no exception in the log.
            self.log.error("The viewer cannot start", why=str(taken))  # noqa: TRY400
            raise SystemExit(1) from taken
        self._settings = self.state.read(FILE, ViewerSettings) or ViewerSettings()
        self._robot_watch = self.watch(topics.ROBOT, robot="*")
        self._bridge = open_bridge(self, self._config)

        # async, and only handing over: these run on the thread of the web server.
        async def came(client: viser.ClientHandle) -> None:
            visitor = visitors.present.get()
            self.call_soon(lambda: self._client_came(client, visitor))

        async def left(client: viser.ClientHandle) -> None:
            self.call_soon(lambda: self._client_left(client.client_id))

        server.on_client_connect(came)
        server.on_client_disconnect(left)
        self.log.info("The viewer is ready", url=f"http://{self._config.host}:{self._config.port}")
        if not is_loopback_host(self._config.host):
            self.log.info("It asks for a token: `trolley viewer-link` prints links that hold one")

    def stop(self) -> None:
        """Close the web page."""
        if self._server is not None:
            close_server(self._server)
            if self._bridge is not None:
                self._bridge.close()

    @every(LOOK_PERIOD_S, clock="local")
    def look(self) -> None:
        """Draw and say what changed, while anybody looks."""
        self._stops.tick(self.monotonic_ns)
        if not self._sessions:
            return
        self._robots.update(self._robot_watch.by_parts)
        self._fleet.update(is_watched=True)
        if self._server is not None:
            with self._server.atomic():  # viser's thread is woken once for all of it
                self._update_stages()
            for session in self._sessions.values():
                session.update_scene(self._stages.keys())
            self._server.flush()  # viser would wait for more to send together
        if self.monotonic_ns >= self._panels_due_ns:
            self._panels_due_ns = self.monotonic_ns + PANEL_PERIOD_NS
            for session in self._sessions.values():
                session.console.update(session.view)
            self._overlays.tell()
            self._by_hand.tell({name: stage.view for name, stage in self._stages.items()})

    @every(teleop.PERIOD_S, clock="local")
    def drive_by_hand(self) -> None:
        """Send what the joystick wants."""
        self._by_hand.drive()

    # What the browsers share.
    @property
    def robots(self) -> Robots:
        """The robots of the network."""
        return self._robots

    @property
    def stops(self) -> StopPresses:
        """The presses of Stop that are not answered."""
        return self._stops

    def is_open(self, client_id: int) -> bool:
        """Whether a browser is still connected; viser knows before it says that it is gone."""
        return self._server is not None and client_id in self._server.get_clients()

    def stage(self, robot: str) -> Stage:
        """Return a robot's share of the scene; there is one from the first time it is asked for."""
        stage = self._stages.get(robot)
        if stage is None:
            assert self._server is not None  # sessions come from the server
            stage = self._stages[robot] = Stage(
                self._server,
                robot,
                self._open_watch,
                self.close_watch,
                self.work,
                self.readings(robot),
                self._ask_history,
            )
        return stage

    def readings(self, robot: str) -> Readings:
        """Follow values of a robot's topics; the caller drops them in the end."""

        def listen(topic: Topic[Any], parts: tuple[str, ...], then: Callable[..., None]) -> Any:
            return self.watch(topic, *parts, seconds=EVERY_MESSAGE_S, robot=robot, then=then)

        return Readings(listen, self.close_watch, lambda: self.arrived_ns)

    def robot_ns(self, robot: str) -> int | None:
        """The time of a robot [ns], None while its clock is silent."""
        return self.time_of(robot).now(self.monotonic_ns)

    def remember(self, browser: str, choices: Choices) -> None:
        """Save a browser's choices; those of nobody in particular are forgotten."""
        if not browser:
            return
        settings = self._settings = self._settings.with_choices(browser, choices)

        def write() -> str:
            try:
                self.state.write(FILE, settings)
            except OSError as error:
                return str(error.strerror)
            return ""

        self.work(write, self._remembered)

    def let_go(self, client_id: int) -> None:
        """Take the joystick out of a browser's hand."""
        self._by_hand.let_go(client_id)

    # Inside.
    def _gate(self) -> Gate:
        """Who is let in: with the tokens that are kept, or new ones."""
        access = self.state.read(ACCESS_FILE, Access)
        if access is None:
            access = Access.new()
            try:
                self.state.write(ACCESS_FILE, access, is_secret=True)
            except OSError as error:
                self.log.warning("The viewer's tokens were not saved", why=error.strerror)
        config = self._config
        return Gate(config.port, config.origins, always_ask=config.always_ask, access=access)

    def _client_came(self, client: viser.ClientHandle, visitor: Visitor) -> None:
        choices = self._settings.browsers.get(visitor.browser, Choices())
        self._sessions[client.client_id] = Session(self, self, client, visitor, choices)
        self._panels_due_ns = 0

    def _client_left(self, client_id: int) -> None:
        session = self._sessions.pop(client_id, None)
        if session is not None:
            session.put_tools_away()
        if not self._sessions:
            self._fleet.update(is_watched=False)
            self._update_stages()

    def _update_stages(self) -> None:
        """Draw the robots that somebody follows, and leave those that nobody does."""
        shown: dict[str, set[str]] = {}
        for session in self._sessions.values():
            on = {key for key, is_on in session.layers().items() if is_on}
            shown.setdefault(session.robot, set()).update(on)
        for name in self._stages.keys() - shown.keys():
            self._stages.pop(name).close()
        for name, layers in shown.items():
            self.stage(name).update(
                self._robots.get(name),
                layers,
                now_ns=self.monotonic_ns,
                robot_ns=self.robot_ns(name),
                epoch=self.time_of(name).epoch,
                fleet=self._fleet.members,
            )
        self._set_initial_camera()

    def _set_initial_camera(self) -> None:
        """Let the next browser begin above the map of the viewer's own robot."""
        own = self._stages.get(self._robots.own)
        if own is not None and self._server is not None and own.has_new_map():
            bounds = map_bounds(own.view)
            if bounds is not None:
                camera.set_initial(self._server, bounds)

    def _open_watch(self, topic: Topic[Any], seconds: float, robot: str) -> Watch[Any]:
        return self.watch(topic, seconds=seconds, robot=robot)

    def _shown(self, client_id: int) -> Shown | None:
        """The overlays that a browser shows."""
        session = self._sessions.get(client_id)
        stage = None if session is None else self._stages.get(session.robot)
        if session is None or stage is None or not session.layers()[OverlayLayer.key]:
            return None
        when = Moment(self.monotonic_ns, is_away=stage.view.is_away)
        return Shown(session.robot, stage.board, when)

    def _ask_history(self, limit: int, robot: str, then: HistoryAnswered) -> None:
        self.request(requests.TOUR_HISTORY, AskHistory(limit=limit), then, robot=robot)

    def _driven_by(self, client_id: int) -> str | None:
        """The robot that a browser may drive by hand."""
        session = self._sessions.get(client_id)
        return session.robot if session is not None and session.may_drive else None

    def _ask_stop(self, robot: str, answered: Answered) -> None:
        self.request(
            requests.BASE_STOP,
            Nothing(),
            lambda reply: answered(not isinstance(reply, Refused)),
            timeout_s=1.0,
            robot=robot,
        )

    def _remembered(self, problem: str) -> None:
        if problem:
            self.log.warning("The viewer's settings were not saved", why=problem)
