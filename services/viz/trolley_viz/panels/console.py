"""All controls of one browser: Stop over the scene, the state on top, the tabs below."""

from typing import TYPE_CHECKING

import viser

from trolley import topics
from trolley_viz.page import overlays_html, pad_html
from trolley_viz.panels.drive import DrivePanel
from trolley_viz.panels.more import MorePanel
from trolley_viz.panels.robots import RobotsPanel
from trolley_viz.panels.status import StatusPanel
from trolley_viz.panels.stop_bar import StopBar
from trolley_viz.panels.tours import TourTab
from trolley_viz.panels.zones import ZonePanel
from trolley_viz.scene.layer import View
from trolley_viz.scene.places import current_places
from trolley_viz.words import AWAY, Words, base_words, goal_words, position_words, trip_words

if TYPE_CHECKING:
    from trolley_viz.session import Session


class Console:
    """The controls of one browser; a viewer's has those only that cannot move anything."""

    def __init__(self, gui: viser.GuiApi, session: "Session") -> None:
        self._session = session
        hub, actions, post = session.hub, session.actions, session.post
        self._status = StatusPanel(gui, session.follow, post)
        self._robots = RobotsPanel(gui, session.follow, session.press_stop_all, post)
        self._drive: DrivePanel | None = None
        self._zones: ZonePanel | None = None
        tabs = gui.add_tab_group()
        if session.may_drive:
            with tabs.add_tab("Drive", viser.Icon.STEERING_WHEEL):
                self._drive = DrivePanel(gui, actions, session.pointing, post)
        with tabs.add_tab("Tours", viser.Icon.ROUTE):
            self._tours = TourTab(gui, session)
        if session.may_drive:
            with tabs.add_tab("Map", viser.Icon.MAP_2):
                self._zones = ZonePanel(gui, session.zones, session.dismiss, post)
        with tabs.add_tab("More", viser.Icon.DOTS):
            self._more = MorePanel(gui, session)
        self._stop_bar = StopBar(
            gui,
            lambda: hub.call_soon(session.press_stop, urgent=True),
            (lambda: post(session.press_resume)) if session.may_drive else None,
        )
        if session.may_drive:
            gui.add_html(pad_html(session.client.client_id))
        gui.add_html(overlays_html(session.client.client_id))

    def update(self, view: View) -> None:
        """Say what is."""
        session, feeds = self._session, view.feeds
        base, goal = feeds.latest(topics.BASE), feeds.latest(topics.GOAL)
        is_stopped = base is not None and base.mode == "stopped" and not view.is_away
        stop_line = session.hub.stops.line(session.robot, view.now_ns)
        self._stop_bar.show(stop_line, is_stopped=is_stopped)
        self._stop_bar.show_hint(session.zones.hint or session.actions.hint)
        self._status.update(session.robot_labels(), session.robot, state_words(view))
        self._robots.update(view.fleet, session.robot)
        if self._drive is not None:
            tool = session.pointing.tool
            self._drive.update(goal, current_places(view), None if tool is None else tool.name)
        self._tours.update(view)
        if self._zones is not None:
            self._zones.update(session.suspects.offered)
        self._more.update(view)

    def close_plot(self) -> None:
        """Stop following what is plotted, as for another robot."""
        self._more.close_plot()


def state_words(view: View) -> list[Words]:
    """The lines of the state: position, what holds it, where it is going, the trip."""
    if view.robot_ns is None:
        return [AWAY]
    feeds = view.feeds
    estimate, saved = feeds.latest(topics.POSE), feeds.latest(topics.POSES)
    tours, trip = feeds.latest(topics.TOURS), feeds.latest(topics.TOUR)
    age_s = None if estimate is None else (view.robot_ns - estimate.stamp_ns) * 1e-9
    stored = [] if tours is None or trip is None else tours.tours
    tour = next((one for one in stored if trip is not None and one.name == trip.name), None)
    lines = [
        position_words(estimate, age_s),
        base_words(feeds.latest(topics.BASE)),
        goal_words(feeds.latest(topics.GOAL), [] if saved is None else saved.poses),
        trip_words(trip, tour),
    ]
    return [line for line in lines if line is not None]
