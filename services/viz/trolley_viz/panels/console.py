"""All controls of one browser: Stop over the scene, the state on top, the tabs below."""

import viser

from trolley import topics
from trolley.messages import Health
from trolley_viz.panels.controls import READABLE, show
from trolley_viz.panels.go_tab import GoTab
from trolley_viz.panels.map_changes import ChangePanel
from trolley_viz.panels.map_editing import MapEditPanel
from trolley_viz.panels.mapping import MappingPanel
from trolley_viz.panels.markup import note, row
from trolley_viz.panels.more_tab import MoreTab
from trolley_viz.panels.places import PlacePanel
from trolley_viz.panels.robots import RobotsPanel
from trolley_viz.panels.shortcuts import add_shortcuts
from trolley_viz.panels.status import StatusPanel
from trolley_viz.panels.stop_bar import StopBar
from trolley_viz.panels.tiles import STYLE
from trolley_viz.panels.tours_tab import TourTab
from trolley_viz.panels.zones import ZonePanel
from trolley_viz.robots.stop_presses import DISOBEYED
from trolley_viz.robots.view import View
from trolley_viz.scene.tours import tour_of
from trolley_viz.sentences import AWAY, StatusLine, base_line, goal_line, position_line, trip_line
from trolley_viz.server.page_pieces import gestures_html, overlays_html, pad_html
from trolley_viz.session.session import Session
from trolley_viz.situation import RobotState, situation

SILENT_NS = 4_000_000_000
"""A service that says nothing of its health for so long is not running."""


class Console:
    """The controls of one browser; a viewer's has those only that cannot move anything."""

    def __init__(self, gui: viser.GuiApi, session: Session) -> None:
        self._session = session
        self._health: dict[tuple[str, str], tuple[Health, int]] = {}
        """The newest by robot and service, and when it was first seen (local monotonic [ns])."""
        hub, post = session.hub, session.post
        gui.add_html(STYLE + READABLE)
        self._status = StatusPanel(gui, session.follow, post)
        self._robots = RobotsPanel(
            gui, session.folder, session.follow, session.press_stop_all, post
        )
        if not session.may_drive:
            gui.add_html(note("You may look, but not drive. STOP works."))
        self._go: GoTab | None = None
        self._places: PlacePanel | None = None
        self._zones: ZonePanel | None = None
        self._mapping: MappingPanel | None = None
        self._changes: ChangePanel | None = None
        self._map_edit: MapEditPanel | None = None
        tabs = gui.add_tab_group()
        if session.may_drive:
            with tabs.add_tab("Go", viser.Icon.STEERING_WHEEL):
                self._go = GoTab(gui, session)
        with tabs.add_tab("Tours", viser.Icon.ROUTE):
            self._tours = TourTab(gui, session)
        if session.may_drive:
            with tabs.add_tab("Map", viser.Icon.MAP_2):
                self._changes = ChangePanel(gui, session)
                with session.folder("Places", is_open=True):
                    self._places = PlacePanel(gui, session)
                self._zones = ZonePanel(gui, session)
                self._mapping = MappingPanel(gui, session)
                self._map_edit = MapEditPanel(gui, session)
        with tabs.add_tab("More", viser.Icon.DOTS):
            self._more = MoreTab(gui, session)
            with session.folder("State"):
                self._state = gui.add_html("")
            with session.folder("Keys"):
                gui.add_html(add_shortcuts(gui, session))
        self._stop_bar = StopBar(
            gui,
            lambda: hub.service.call_soon(session.press_stop, urgent=True),
            (lambda: post(session.press_resume)) if session.may_drive else None,
        )
        if session.may_drive:
            gui.add_html(pad_html(session.client.client_id))
        gui.add_html(overlays_html(session.client.client_id))
        gui.add_html(gestures_html(session.client.client_id))

    def update(self, view: View) -> None:
        """Say what is."""
        session, streams = self._session, view.streams
        base = streams.latest(topics.BASE)
        is_stopped = base is not None and base.is_halted and not view.is_away
        stop_line = session.hub.stops.line(session.robot, view.now_ns)
        if stop_line is None and base is not None and base.not_stopped:
            stop_line = DISOBEYED
        self._stop_bar.show(stop_line, is_stopped=is_stopped)
        self._stop_bar.show_hint(
            session.zone_editor.hint or session.map_editor.hint or session.aiming.hint
        )
        known = robot_state(view, self._silent(view))
        lines = state_lines(known)
        self._status.update(session.robot_labels(), session.robot, situation(known), lines)
        self._robots.update(view.fleet, session.robot)
        if self._go is not None:
            self._go.update(view)
        self._tours.update(view)
        if self._places is not None:
            self._places.update(view)
        if self._changes is not None:
            self._changes.update(session.change_marks.offered)
        if self._zones is not None:
            self._zones.update(session.suspected_mirrors.offered)
        if self._mapping is not None:
            self._mapping.update(view)
        if self._map_edit is not None:
            self._map_edit.update()
        show(self._state, content="".join(map(row, lines)))
        self._more.update(view)

    def close(self) -> None:
        """Stop following what only this browser shows."""
        self._more.close_plot()

    def _silent(self, view: View) -> frozenset[str]:
        """The services of the robot that have fallen silent."""
        robot, now_ns = self._session.robot, view.now_ns
        for (name,), one in view.streams.by_parts(topics.HEALTH).items():
            before = self._health.get((robot, name))
            if before is None or before[0] is not one:
                self._health[robot, name] = (one, now_ns)
        return frozenset(
            name
            for (of, name), (_, since_ns) in self._health.items()
            if of == robot and now_ns - since_ns > SILENT_NS
        )


def robot_state(view: View, silent: frozenset[str]) -> RobotState:
    """Gather what the sentence about the robot depends on."""
    streams = view.streams
    estimate, saved = streams.latest(topics.POSE), streams.latest(topics.POSES)
    trip = streams.latest(topics.TOUR)
    robot_ns, age_s = view.robot_ns, None
    if robot_ns is not None and estimate is not None:
        age_s = (robot_ns - estimate.stamp_ns) * 1e-9
    return RobotState(
        is_away=view.is_away,
        base=streams.latest(topics.BASE),
        has_map=view.map is not None,
        estimate=estimate,
        estimate_age_s=age_s,
        goal=streams.latest(topics.GOAL),
        trip=trip,
        tour=None if trip is None else tour_of(trip, view),
        places=[] if saved is None else saved.poses,
        silent=silent,
        mapping=streams.latest(topics.MAPPING),
    )


def state_lines(known: RobotState) -> list[StatusLine]:
    """The lines of the state: position, what holds it, where it is going, the trip."""
    if known.is_away:
        return [AWAY]
    lines = [
        position_line(known.estimate, known.estimate_age_s),
        base_line(known.base),
        goal_line(known.goal, list(known.places)),
        trip_line(known.trip, known.tour),
    ]
    return [line for line in lines if line is not None]
