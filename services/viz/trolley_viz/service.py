"""The viewer as a service: browsers on one side, the robots' streams and requests on the other.

viser serves the browsers on threads of its own; whatever happens there is handed over by
`call_soon`. A robot's streams are subscribed to only while a browser follows it.
"""

from dataclasses import dataclass

import viser

from trolley import requests, teleop, topics
from trolley.codes import Refused
from trolley.config import RobotConfig
from trolley.messages.request_params import Nothing
from trolley.runtime.service import Service, every
from trolley_viz.foxglove import open_bridge
from trolley_viz.joystick.teleop import Teleop
from trolley_viz.overlays.cards import Moment
from trolley_viz.overlays.pages import OverlayPages, ShownOverlays
from trolley_viz.panels.console import Console
from trolley_viz.pointing.gestures import Gestures
from trolley_viz.robots.fleet import Fleet, Robots
from trolley_viz.robots.stop_presses import Answered, StopPresses
from trolley_viz.scene.overlays import OverlayLayer
from trolley_viz.server import visitors
from trolley_viz.server.access import FILE as ACCESS_FILE
from trolley_viz.server.access import AccessControl, AccessTokens, is_loopback_host
from trolley_viz.server.visitors import Visitor
from trolley_viz.server.web_server import PortTaken, close_server, open_server
from trolley_viz.session.hub import Hub
from trolley_viz.session.robot_scene import RobotScenes
from trolley_viz.session.session import Session
from trolley_viz.settings import FILE, Choices, ViewerSettings

DRAW_PERIOD_S = 0.05
"""On average a scan waits half as long before it is drawn."""
PANEL_PERIOD_NS = 200_000_000
JOYSTICK_PATH, OVERLAYS_PATH, GESTURES_PATH = "/joystick", "/overlays", "/gestures"


@dataclass(frozen=True)
class Browser:
    """An open browser: what it shows and may do, and the controls of its page."""

    session: Session
    console: Console


class VizService(Service):
    """The web viewer: one page for all robots of the network."""

    name = "viz"
    all_robots = True
    one_per_host = True

    hub: Hub | None = None
    """What all browsers share; there is none before `start`."""

    def __init__(self, config: RobotConfig) -> None:
        self._config = config.viz
        self._robots = Robots(config.robot.name)
        self._fleet = Fleet(
            self._robots,
            lambda topic: self.watch(topic, robot="*"),
            self.close_watch,
            lambda robot: self.time_of(robot).now(self.monotonic_ns),
        )
        self.browsers: dict[int, Browser] = {}
        """The browsers that are open, by viser's number for each."""
        self._panels_due_ns = 0

    # Life.
    def start(self) -> None:
        """Open the web page."""
        self.joystick = Teleop(self, self._robots, self._driven_by)
        self.overlays = OverlayPages(self, self._shown_overlays)
        self.gestures = Gestures(self.call_soon, self._session)
        sockets = {
            JOYSTICK_PATH: self.joystick.sockets.serve,
            OVERLAYS_PATH: self.overlays.sockets.serve,
            GESTURES_PATH: self.gestures.sockets.serve,
        }
        try:
            server = open_server(self._config, self._access_control(), sockets)
        except PortTaken as taken:
            # Nothing to trace: the sentence says it all, so it is no exception in the log.
            self.log.error("The viewer cannot start", why=str(taken))  # noqa: TRY400
            raise SystemExit(1) from taken
        self._settings = self.state.read(FILE, ViewerSettings) or ViewerSettings()
        self._robot_watch = self.watch(topics.ROBOT, robot="*")
        self.hub = Hub(
            service=self,
            server=server,
            robots=self._robots,
            stops=StopPresses(self._ask_stop),
            scenes=RobotScenes(self, server, self._robots),
            remember=self._remember,
            let_go=self.joystick.let_go,
        )
        self._bridge = open_bridge(self, self._config)

        # async, and only handing over: these run on the thread of the web server.
        async def connected(client: viser.ClientHandle) -> None:
            visitor = visitors.present.get()
            self.call_soon(lambda: self.open_browser(client, visitor))

        async def disconnected(client: viser.ClientHandle) -> None:
            self.call_soon(lambda: self.close_browser(client.client_id))

        server.on_client_connect(connected)
        server.on_client_disconnect(disconnected)
        self.log.info("The viewer is ready", url=f"http://{self._config.host}:{self._config.port}")
        if not is_loopback_host(self._config.host):
            self.log.info(
                "Browsers need a token: `trolley viewer-link` prints links that contain one"
            )

    def stop(self) -> None:
        """Close the web page."""
        if self.hub is not None:
            close_server(self.hub.server)
            if self._bridge is not None:
                self._bridge.close()

    def open_browser(self, client: viser.ClientHandle, visitor: Visitor) -> None:
        """Give a browser its controls."""
        if self.hub is None:
            return
        choices = self._settings.browsers.get(visitor.browser, Choices())
        session = Session(self.hub, client, visitor, choices)
        self.browsers[client.client_id] = Browser(session, Console(client.gui, session))
        self._panels_due_ns = 0

    def close_browser(self, client_id: int) -> None:
        """Forget a browser that is gone."""
        browser = self.browsers.pop(client_id, None)
        if browser is not None:
            browser.session.put_tools_away()
            browser.console.close()
        if not self.browsers and self.hub is not None:
            self._fleet.update(is_watched=False)
            self.hub.scenes.update({}, ())

    # What it does again and again.
    @every(DRAW_PERIOD_S, clock="local")
    def draw(self) -> None:
        """Draw and say what changed, while any browser is open."""
        hub = self.hub
        if hub is None:
            return
        hub.stops.tick(self.monotonic_ns)
        if not self.browsers:
            return
        self._robots.update(self._robot_watch.by_parts)
        self._fleet.update(is_watched=True)
        with hub.server.atomic():  # viser's thread is woken once for all of it
            hub.scenes.update(self._layers_by_robot(), self._fleet.members)
        scenes = hub.scenes.by_robot
        for browser in self.browsers.values():
            browser.session.update_scene(scenes.keys())
        hub.server.flush()  # viser would wait for more to send together
        if self.monotonic_ns >= self._panels_due_ns:
            self._panels_due_ns = self.monotonic_ns + PANEL_PERIOD_NS
            for browser in self.browsers.values():
                browser.console.update(browser.session.view)
            self.overlays.send_changes()
            self.joystick.send_states({name: one.view for name, one in scenes.items()})

    @every(teleop.PERIOD_S, clock="local")
    def send_commands(self) -> None:
        """Send what the joysticks want."""
        self.joystick.drive()

    # Inside.
    def _access_control(self) -> AccessControl:
        """Who is let in: with the tokens that are saved, or new ones."""
        tokens = self.state.read(ACCESS_FILE, AccessTokens)
        if tokens is None:
            tokens = AccessTokens.new()
            self.save(ACCESS_FILE, tokens, is_secret=True)
        config = self._config
        return AccessControl(
            config.port, config.origins, always_ask=config.always_ask, tokens=tokens
        )

    def _session(self, client_id: int) -> Session | None:
        browser = self.browsers.get(client_id)
        return None if browser is None else browser.session

    def _layers_by_robot(self) -> dict[str, set[str]]:
        """The layers that somebody wants to see of each robot that is followed."""
        shown: dict[str, set[str]] = {}
        for browser in self.browsers.values():
            on = {key for key, is_on in browser.session.layers().items() if is_on}
            shown.setdefault(browser.session.robot, set()).update(on)
        return shown

    def _shown_overlays(self, client_id: int) -> ShownOverlays | None:
        """The overlays that a browser shows."""
        session = self._session(client_id)
        if self.hub is None or session is None or not session.layers()[OverlayLayer.key]:
            return None
        scene = self.hub.scenes.by_robot.get(session.robot)
        if scene is None:
            return None
        moment = Moment(self.monotonic_ns, is_away=scene.view.is_away)
        return ShownOverlays(session.robot, scene.overlays, moment)

    def _driven_by(self, client_id: int) -> str | None:
        """The robot that a browser may drive by hand."""
        session = self._session(client_id)
        return session.robot if session is not None and session.may_drive else None

    def _ask_stop(self, robot: str, answered: Answered) -> None:
        self.request(
            requests.BASE_STOP,
            Nothing(),
            lambda reply: answered(not isinstance(reply, Refused)),
            timeout_s=1.0,
            robot=robot,
        )

    def _remember(self, browser: str, choices: Choices) -> None:
        """Save a browser's choices; one without a name is not remembered."""
        if browser:
            self._settings = self._settings.with_choices(browser, choices)
            self.save(FILE, self._settings)
