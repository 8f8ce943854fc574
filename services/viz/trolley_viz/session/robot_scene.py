"""A robot that somebody looks at: its streams, where its frames are, and its part of the scene."""

from collections.abc import Callable, Mapping, Sequence, Set
from dataclasses import replace
from typing import Any, cast

import viser

from trolley import requests, topics
from trolley.messages import Robot
from trolley.messages.request_params import AskHistory
from trolley.runtime.service import Service
from trolley.topics import Topic
from trolley_viz.graphics import camera
from trolley_viz.overlays.overlay_set import OverlaySet
from trolley_viz.overlays.readings import Readings
from trolley_viz.robots.ages import LastHeard
from trolley_viz.robots.fleet import Member, Robots
from trolley_viz.robots.lost_drive import LastDrive
from trolley_viz.robots.past_trips import Answered, PastTrips
from trolley_viz.robots.placement import Placement
from trolley_viz.robots.silence import SilentServices
from trolley_viz.robots.streams import Streams
from trolley_viz.robots.view import View
from trolley_viz.scene.map_layers import map_bounds
from trolley_viz.scene.markers.layer import MarkerLayer
from trolley_viz.scene.overlays import OverlayLayer
from trolley_viz.scene.robot_body import RobotLayer
from trolley_viz.session.scene import Scene

SILENT_PERIOD_NS = 200_000_000
"""How often it is looked whether a service has fallen silent."""
EVERY_MESSAGE_S = 0.05
"""A watch that keeps any history at all hears every message."""


class RobotScene:
    """One robot's share of the scene; all browsers that follow the robot share it.

    Args:
        service: whose subscriptions, requests and clocks are used.
    """

    def __init__(self, service: Service, server: viser.ViserServer, robot: str) -> None:
        self.streams = Streams(
            lambda topic, seconds: service.watch(topic, seconds=seconds, robot=robot),
            service.close_watch,
        )
        self.scene = Scene(server, robot)
        self.overlays = OverlaySet(follow_values(service, robot))
        self._last_heard = LastHeard()
        self._last_drive = LastDrive()
        self._silence = SilentServices()
        self._silent_due_ns = 0
        self._followed: Set[str] | None = None
        """The layers whose streams are followed; None: it follows nothing."""
        self._epoch = 0
        self._seen_map = ""

        def ask_history(limit: int, then: Answered) -> None:
            service.request(requests.TOUR_HISTORY, AskHistory(limit=limit), then, robot=robot)

        self.view = View(
            robot_name=robot,
            streams=self.streams,
            placement=Placement(),
            robot=None,
            now_ns=0,
            robot_ns=None,
            work=service.work,
            past=PastTrips(ask_history),
        )
        """What was drawn last."""

    def update(
        self,
        robot: Robot | None,
        shown: Set[str],
        *,
        now_ns: int,
        robot_ns: int | None,
        epoch: int,
        fleet: Sequence[Member],
    ) -> None:
        """Take in what arrived and draw what changed.

        Args:
            robot: what the robot says it is, None if it has not been heard of.
            shown: the keys of the layers that somebody wants to see.
            now_ns: local monotonic time [ns].
            robot_ns: the robot's time [ns], None while its clock is silent.
            epoch: the run of its base.
            fleet: all robots, where there are several.
        """
        if epoch != self._epoch:
            self._epoch = epoch
            self._silence = SilentServices()
            self._silent_due_ns = 0
            self.overlays.drop_all()
        if shown != self._followed:
            self._followed = frozenset(shown)
            self.streams.follow(self.scene.wanted(shown))
        self.view = replace(
            self.view,
            robot=robot,
            now_ns=now_ns,
            robot_ns=robot_ns,
            fleet=fleet,
            silent=self._silent(now_ns),
            away_s=self._last_heard.update(robot_ns, now_ns),
            lost_goal=self._last_drive.update(self.streams.latest(topics.GOAL)),
        )
        self.view.place_frames()
        self.scene.update(self.view, shown)
        if OverlayLayer.key in shown:
            self.overlays.update(self.view)
        else:
            self.overlays.drop_all()

    def _silent(self, now_ns: int) -> frozenset[str]:
        """The services that have fallen silent, as they were looked for lately."""
        if now_ns < self._silent_due_ns:
            return self.view.silent
        self._silent_due_ns = now_ns + SILENT_PERIOD_NS
        health = {name: one for (name,), one in self.streams.by_parts(topics.HEALTH).items()}
        return self._silence.update(health, now_ns)

    @property
    def markers(self) -> MarkerLayer:
        """The layer of markers, whose icons each browser draws."""
        return cast("MarkerLayer", self.scene.layer(MarkerLayer.key))

    @property
    def notes(self) -> list[str]:
        """What is not shown as it was meant, and why."""
        body = cast("RobotLayer", self.scene.layer(RobotLayer.key))
        return [*([body.problem] if body.problem else []), *self.markers.notes]

    def has_new_map(self) -> bool:
        """Whether there is another map than at the last call."""
        grid = self.view.map
        before, self._seen_map = self._seen_map, "" if grid is None else grid.name
        return self._seen_map not in ("", before)

    def close(self) -> None:
        """Unsubscribe, and take everything out of the scene."""
        self.streams.drop_all()
        self.overlays.drop_all()
        self.scene.remove()


class RobotScenes:
    """The robots that somebody follows, each with its share of the scene.

    Args:
        service: as for `RobotScene`.
    """

    def __init__(self, service: Service, server: viser.ViserServer, robots: Robots) -> None:
        self._service = service
        self._server = server
        self._robots = robots
        self._by_robot: dict[str, RobotScene] = {}

    @property
    def by_robot(self) -> Mapping[str, RobotScene]:
        """Those that are open now."""
        return self._by_robot

    def of(self, robot: str) -> RobotScene:
        """Return a robot's share of the scene; the first call opens it."""
        scene = self._by_robot.get(robot)
        if scene is None:
            scene = self._by_robot[robot] = RobotScene(self._service, self._server, robot)
        return scene

    def update(self, layers: Mapping[str, Set[str]], fleet: Sequence[Member]) -> None:
        """Draw the robots that somebody follows, and close the scenes of the others.

        Args:
            layers: by robot, the keys of the layers that somebody wants to see.
            fleet: all robots, where there are several.
        """
        service = self._service
        for name in self._by_robot.keys() - layers.keys():
            self._by_robot.pop(name).close()
        for name, shown in layers.items():
            clock = service.time_of(name)
            self.of(name).update(
                self._robots.get(name),
                shown,
                now_ns=service.monotonic_ns,
                robot_ns=clock.now(service.monotonic_ns),
                epoch=clock.epoch,
                fleet=fleet,
            )
        self._set_initial_camera()

    def _set_initial_camera(self) -> None:
        """Let the next browser start above the map of the viewer's own robot."""
        own = self._by_robot.get(self._robots.own)
        if own is not None and own.has_new_map():
            bounds = map_bounds(own.view)
            if bounds is not None:
                camera.set_initial(self._server, bounds)


def follow_values(service: Service, robot: str) -> Readings:
    """Follow values of a robot's topics; the caller drops them in the end."""

    def listen(topic: Topic[Any], parts: tuple[str, ...], then: Callable[..., None]) -> Any:
        return service.watch(topic, *parts, seconds=EVERY_MESSAGE_S, robot=robot, then=then)

    return Readings(listen, service.close_watch, lambda: service.arrived_ns)
