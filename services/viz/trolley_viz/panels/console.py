"""All controls together: Stop over the scene, the state on top, the tabs below."""

from collections.abc import Callable
from typing import Protocol

import viser

from trolley import topics
from trolley_viz.actions import Actions
from trolley_viz.panels.drive import DrivePanel
from trolley_viz.panels.status import StatusPanel
from trolley_viz.panels.stop_bar import StopBar
from trolley_viz.panels.tours import TourPanel
from trolley_viz.panels.view import DetailPanel, ViewChoices, ViewPanel
from trolley_viz.pointing import Pointing
from trolley_viz.robots import Robots
from trolley_viz.scene.layer import View
from trolley_viz.scene.places import current_places
from trolley_viz.scene.scene import Scene
from trolley_viz.stopping import StopPresses
from trolley_viz.words import AWAY, Words, base_words, goal_words, position_words, trip_words


class Viewer(ViewChoices, Protocol):
    """What the controls need of the service."""

    @property
    def robots(self) -> Robots:
        """The robots of the network."""
        ...

    @property
    def actions(self) -> Actions:
        """What the buttons do."""
        ...

    @property
    def pointing(self) -> Pointing:
        """The tool that waits."""
        ...

    @property
    def stops(self) -> StopPresses:
        """The presses that wait."""
        ...

    def is_away(self, robot: str) -> bool:
        """Whether its clock is silent."""
        ...

    def robot_ns(self, robot: str) -> int | None:
        """Its time [ns]."""
        ...

    def press_stop(self) -> None:
        """Stop the robot."""
        ...

    def press_resume(self) -> None:
        """Let it drive again."""
        ...

    def select_robot(self, name: str) -> None:
        """Show another robot."""
        ...

    def call_soon(self, fn: Callable[[], None], *, urgent: bool = False) -> None:
        """Call on the service's thread."""
        ...


class Console:
    """The controls of the page; one set, shared by all browsers."""

    def __init__(self, gui: viser.GuiApi, viewer: Viewer, scene: Scene, *, dark: bool) -> None:
        self._viewer = viewer
        post = viewer.call_soon
        self._status = StatusPanel(gui, viewer.select_robot, post)
        tabs = gui.add_tab_group()
        with tabs.add_tab("Drive", viser.Icon.STEERING_WHEEL):
            self._drive = DrivePanel(gui, viewer.actions, viewer.pointing, post)
        with tabs.add_tab("Tour", viser.Icon.ROUTE):
            self._tours = TourPanel(gui, viewer.actions, post)
        with tabs.add_tab("View", viser.Icon.STACK_2):
            ViewPanel(gui, viewer, post, scene.layers, dark=dark)
        with tabs.add_tab("Details", viser.Icon.LIST_DETAILS):
            self._details = DetailPanel(gui)
        self._stop_bar = StopBar(
            gui,
            lambda: viewer.call_soon(viewer.press_stop, urgent=True),
            lambda: viewer.call_soon(viewer.press_resume),
        )

    def update(self, view: View) -> None:
        """Say what is."""
        viewer, feeds = self._viewer, view.feeds
        selected = viewer.robots.selected
        base, goal = feeds.latest(topics.BASE), feeds.latest(topics.GOAL)
        tours, trip = feeds.latest(topics.TOURS), feeds.latest(topics.TOUR)
        is_stopped = base is not None and base.mode == "stopped" and not view.is_away
        self._stop_bar.show(viewer.stops.line(selected, view.now_ns), is_stopped=is_stopped)
        self._stop_bar.show_hint(viewer.actions.hint)
        labels = viewer.robots.labels(viewer.is_away)
        self._status.update(labels, selected, self._state(view))
        tool = viewer.pointing.tool
        armed = None if tool is None else tool.name
        self._drive.update(goal, current_places(view), armed)
        self._tours.update([] if tours is None else tours.tours, trip)
        health = feeds.by_parts(topics.HEALTH)
        self._details.update(view.placement, viewer.robot_ns(selected), health)

    def _state(self, view: View) -> list[Words]:
        """The lines of the state: position, what holds it, where it is going, the trip."""
        if view.is_away:
            return [AWAY]
        feeds = view.feeds
        estimate, saved = feeds.latest(topics.POSE), feeds.latest(topics.POSES)
        tours, trip = feeds.latest(topics.TOURS), feeds.latest(topics.TOUR)
        robot_ns = self._viewer.robot_ns(self._viewer.robots.selected)
        age_s = None
        if estimate is not None and robot_ns is not None:
            age_s = (robot_ns - estimate.stamp_ns) * 1e-9
        stored = [] if tours is None or trip is None else tours.tours
        tour = next((one for one in stored if trip is not None and one.name == trip.name), None)
        lines = [
            position_words(estimate, age_s),
            base_words(feeds.latest(topics.BASE)),
            goal_words(feeds.latest(topics.GOAL), [] if saved is None else saved.poses),
            trip_words(trip, tour),
        ]
        return [line for line in lines if line is not None]
