"""A robot that somebody looks at: its streams, where its frames are, and its part of the scene."""

from collections.abc import Callable, Sequence, Set
from dataclasses import replace
from typing import Any, cast

import viser

from trolley.messages import Robot
from trolley.runtime.service import Watch
from trolley.topics import Topic
from trolley_viz.feeds import Feeds
from trolley_viz.fleet import Member
from trolley_viz.overlays.board import Board
from trolley_viz.overlays.layer import OverlayLayer
from trolley_viz.overlays.readings import Readings
from trolley_viz.past_trips import Answered, PastTrips
from trolley_viz.placement import Placement
from trolley_viz.scene.body import RobotLayer
from trolley_viz.scene.layer import View
from trolley_viz.scene.markers import MarkerLayer
from trolley_viz.scene.scene import Scene

Work = Callable[[Callable[[], Any], Callable[[Any], None]], None]


class Stage:
    """One robot's share of the scene; all browsers that follow the robot share it.

    Args:
        server: its scene.
        robot: the robot's name.
        open_watch: subscribes to a topic of a robot.
        close_watch: ends that.
        work: runs a slow function aside.
        readings: follows the values that overlays show.
        ask_history: asks for the newest so many past trips of a robot.
    """

    def __init__(
        self,
        server: viser.ViserServer,
        robot: str,
        open_watch: Callable[[Topic[Any], float, str], Watch[Any]],
        close_watch: Callable[[Watch[Any]], None],
        work: Work,
        readings: Readings,
        ask_history: Callable[[int, str, Answered], None],
    ) -> None:
        self.placement = Placement()
        self.feeds = Feeds(lambda topic, seconds: open_watch(topic, seconds, robot), close_watch)
        self.scene = Scene(server, robot)
        self.board = Board(readings)
        self._epoch = 0
        self._seen_map = ""
        self.view = View(
            robot_name=robot,
            feeds=self.feeds,
            placement=self.placement,
            robot=None,
            now_ns=0,
            robot_ns=None,
            work=work,
            past=PastTrips(lambda limit, then: ask_history(limit, robot, then)),
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
            epoch: the run of its base; what an earlier one measured is dropped.
            fleet: all robots, where there are several.
        """
        if epoch != self._epoch:
            self._epoch = epoch
            self.feeds.drop_all()
            self.scene.forget()
            self.board.drop_all()
        self.feeds.want(self.scene.wanted(shown))
        self.view = replace(self.view, robot=robot, now_ns=now_ns, robot_ns=robot_ns, fleet=fleet)
        self.view.place_frames()
        self.scene.update(self.view, shown)
        if OverlayLayer.key in shown:
            self.board.update(self.view)
        else:
            self.board.drop_all()

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
        self.feeds.drop_all()
        self.board.drop_all()
        self.scene.remove()
