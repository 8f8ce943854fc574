"""The viewer as a service: browsers on one side, the robots' streams and requests on the other.

viser serves the browsers on threads of its own; whatever happens there is handed over by
`call_soon`. A robot's streams are subscribed to only while a browser follows it.
"""

from functools import partial

import viser

from trolley import requests, teleop, topics
from trolley.codes import Refused
from trolley.config import RobotConfig
from trolley.messages import BaseState
from trolley.messages.request_params import Nothing
from trolley.ports import is_loopback_host
from trolley.runtime.service import Service
from trolley_viz.features.past.keeper import Keeper
from trolley_viz.features.people.names import Names
from trolley_viz.features.people.people import People
from trolley_viz.foxglove import open_bridge
from trolley_viz.joystick.teleop import Teleop
from trolley_viz.overlays.pages import OverlayPages
from trolley_viz.pages.open_pages import OpenPages
from trolley_viz.pages.page import Shared
from trolley_viz.robots.fleet import Fleet, Robots
from trolley_viz.robots.stop_presses import Answered, StopPresses
from trolley_viz.server.access import FILE as ACCESS_FILE
from trolley_viz.server.access import AccessControl, AccessTokens
from trolley_viz.server.lines import Line, Lines
from trolley_viz.server.links import links_of
from trolley_viz.server.messages import Said
from trolley_viz.server.photos import Photos
from trolley_viz.server.web_server import PortTaken, WebServer, close_scene, open_scene
from trolley_viz.session.browser_store import BrowserStore
from trolley_viz.session.hub import Hub
from trolley_viz.session.robot_scene import RobotScenes

TICK_S = teleop.PERIOD_S
"""How often the scene is drawn, and joysticks are heard: on average a scan waits half as long."""
PANEL_PERIOD_NS = 200_000_000
BEAT_PERIOD_NS = 250_000_000
"""A page that has heard nothing for 1.5 s says so: four beats in a row may be late."""
DRAWN_BY_NS = 500_000_000
"""What is to be drawn waits no longer than this behind what has arrived, or it is lost."""
WAITING_S = 1.0
"""How often all of it is done where pages may come back, but nobody has one open now."""


class VizService(Service):
    """The web viewer: one page for all robots of the network."""

    name = "viz"
    all_robots = True
    one_per_host = True

    hub: Hub | None = None
    """What all browsers share; there is none before `start`."""
    pages: OpenPages

    def __init__(self, config: RobotConfig) -> None:
        self._config = config.viz
        self._robots = Robots(config.robot.name)
        self._fleet = Fleet(
            self._robots,
            lambda topic: self.watch(topic, robot="*"),
            self.close_watch,
            lambda robot: self.time_of(robot).now(self.monotonic_ns),
        )
        self.past = Keeper(self, config.robot.name)
        self.parts = (self.past,)
        self._panels_due_ns = self._beat_due_ns = 0
        self._drawn_by_ns = 0
        """When what is to be drawn is asked for again: in a flood it may have been dropped."""

    # Life.
    def start(self) -> None:
        """Open the web page."""
        browsers = BrowserStore(self)
        people = People(Names(browsers.names, browsers.save_names, self._robot_titles))
        self.joystick = Teleop(self, self._robots, people.driven_by)
        tokens = self._tokens()
        self._scene = open_scene()
        lines = Lines(
            partial(self.call_soon, kept=True), self.open_line, self._hear, self._close_line
        )
        try:
            access = self._access_control(tokens)
            self._web = WebServer(self._config, access, lines, self._scene, Photos(self).fetch)
        except PortTaken as taken:
            # Nothing to trace: the sentence says it all, so it is no exception in the log.
            self.log.error("The viewer cannot start", why=str(taken))  # noqa: TRY400
            close_scene(self._scene)
            raise SystemExit(1) from taken
        self._next_tick = self.deadline(self.tick)
        self._robot_watch = self.watch(topics.ROBOT, robot="*")
        self.past.start()
        self.hub = Hub(
            service=self,
            server=self._scene,
            robots=self._robots,
            stops=StopPresses(self._ask_stop),
            scenes=RobotScenes(self, self._scene, self._robots),
            browsers=browsers,
            let_go=self.joystick.let_go,
            people=people,
            links=links_of(self._config, tokens),
            past=self.past,
        )
        self.pages = OpenPages(self.hub, Shared(self.joystick, OverlayPages(self)))
        self._bridge = open_bridge(self, self._config)

        # async, and only handing over: these run on the thread of viser's server.
        async def connected(client: viser.ClientHandle) -> None:
            self.call_soon(lambda: self.pages.open_scene(client))

        async def disconnected(client: viser.ClientHandle) -> None:
            self.call_soon(lambda: self.pages.close_scene(client.client_id))

        self._scene.on_client_connect(connected)
        self._scene.on_client_disconnect(disconnected)
        self.log.info("The viewer is ready", url=f"http://{self._config.host}:{self._config.port}")
        if not is_loopback_host(self._config.host):
            self.log.info(
                "Browsers need a token: `trolley viewer-link` prints links that contain one"
            )

    def stop(self) -> None:
        """Close the web page."""
        if self.hub is not None:
            self.past.stop()
            self._web.close()
            close_scene(self._scene)
            if self._bridge is not None:
                self._bridge.close()

    # Pages.
    def open_line(self, line: Line) -> None:
        """Connect a page, or one that was gone for a moment, and tell it everything at once."""
        if self.hub is not None:  # else it is starting
            self.pages.open_line(line)
            self._panels_due_ns = 0
            self._next_tick.set(0.0)

    # What it does repeatedly.
    def tick(self) -> None:
        """Drive, draw and say what changed: again and again while any page is open.

        Where nobody has opened the viewer nothing wakes it for this, unless a robot has yet to
        answer a press of Stop, or to hear that a joystick was let go.
        """
        hub = self.hub
        if hub is None:
            return
        now_ns = self.monotonic_ns
        hub.stops.tick(now_ns)
        is_driving = self.joystick.drive()
        if self.pages.give_up_the_silent(now_ns):
            self._forget_robots(hub, now_ns)
        if self.pages.is_any_seen or is_driving or hub.stops.num_waiting:
            self._next_tick.repeat(TICK_S)
        elif self.pages.all:
            self._next_tick.set(WAITING_S)
        if self.pages.all and now_ns >= self._drawn_by_ns:
            self._drawn_by_ns = now_ns + DRAWN_BY_NS
            self.call_soon(self._draw)  # after what has arrived by now

    def _forget_robots(self, hub: Hub, now_ns: int) -> None:
        """Follow no robot: nobody looks."""
        self._fleet.update(now_ns, is_watched=False)
        hub.scenes.update({}, ())
        hub.people.stoppers.keep(set())
        self.past.follow(set())

    def _draw(self) -> None:
        """Draw and say what changed."""
        self._drawn_by_ns = 0
        hub, now_ns = self.hub, self.monotonic_ns
        if hub is None or not self.pages.all:
            return
        self._robots.update(self._robot_watch.by_parts)
        self._fleet.update(now_ns, is_watched=True)
        scenes = hub.scenes.by_robot
        with hub.server.atomic():  # viser sends all of it at once
            hub.scenes.update(self.pages.layers_by_robot(), self._fleet.members)
        hub.people.stoppers.keep(scenes.keys())
        self.past.follow(scenes.keys())
        for page in self.pages.all:
            page.session.update_scene(scenes.keys())
        if now_ns >= self._panels_due_ns:
            self._panels_due_ns = now_ns + PANEL_PERIOD_NS
            self.pages.update()
        if now_ns >= self._beat_due_ns:
            self._beat_due_ns = now_ns + BEAT_PERIOD_NS
            self.pages.beat(now_ns)

    # Inside.
    def _tokens(self) -> AccessTokens:
        """The tokens that are saved, or new ones."""
        tokens = self.state.read(ACCESS_FILE, AccessTokens)
        if tokens is None:
            tokens = AccessTokens.new()
            self.save(ACCESS_FILE, tokens, is_secret=True)
        return tokens

    def _access_control(self, tokens: AccessTokens) -> AccessControl:
        """Who is let in."""
        config = self._config
        return AccessControl(
            config.port, config.origins, always_ask=config.always_ask, tokens=tokens
        )

    def _hear(self, line: Line, said: Said) -> None:
        self.pages.hear(line, said)

    def _close_line(self, line: Line) -> None:
        self.pages.close_line(line)

    def _ask_stop(self, robot: str, answered: Answered) -> None:
        def finish(reply: BaseState | Refused) -> None:
            if self.hub is not None and not isinstance(reply, Refused):
                self.hub.people.stoppers.answered(robot, reply.stamp_ns)
            answered(not isinstance(reply, Refused))

        self.request(requests.BASE_STOP, Nothing(), finish, timeout_s=1.0, robot=robot)

    def _robot_titles(self) -> list[str]:
        """What the robots are called, each by both of its names."""
        names = self._robots.names()
        known = [robot for name in names if (robot := self._robots.get(name)) is not None]
        return [*names, *(robot.title for robot in known)]
