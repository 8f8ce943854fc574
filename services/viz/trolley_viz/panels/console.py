"""All controls of one browser: the robots on top, the tabs below."""

from collections.abc import Sequence

from trolley_viz.controls.controls import Controls
from trolley_viz.panels.go_tab import GoTab
from trolley_viz.panels.links import LinksPanel
from trolley_viz.panels.map_tab import MapTab
from trolley_viz.panels.markup import note, row
from trolley_viz.panels.more_tab import MoreTab
from trolley_viz.panels.people import PeoplePanel
from trolley_viz.panels.robots import RobotsPanel
from trolley_viz.panels.shortcuts import add_shortcuts
from trolley_viz.panels.tours_tab import TourTab
from trolley_viz.robots.view import View
from trolley_viz.sentences import StatusLine
from trolley_viz.session.session import Session


class Console:
    """The controls of one browser; a viewer's has those only that cannot move anything."""

    def __init__(self, gui: Controls, session: Session) -> None:
        self._session = session
        self._robots = RobotsPanel(gui, session.folder, session.follow, session.press_stop_all)
        if not session.may_drive:
            gui.add_html(note("You may look, but not drive. STOP works."))
        self._go: GoTab | None = None
        self._map: MapTab | None = None
        self._links: LinksPanel | None = None
        tabs = gui.add_tabs()
        if session.may_drive:
            with tabs.add_tab("Go", "steering-wheel"):
                self._go = GoTab(gui, session)
        with tabs.add_tab("Tours", "route"):
            self._tours = TourTab(gui, session)
        if session.may_drive:
            with tabs.add_tab("Map", "map-2"):
                self._map = MapTab(gui, session)
        with tabs.add_tab("More", "dots"):
            self._more = MoreTab(gui, session)
            self._people = PeoplePanel(gui, session)
            if session.may_drive:
                self._links = LinksPanel(gui, session.folder, session.hub.links)
            with session.folder("State"):
                self._state = gui.add_html("")
            with session.folder("Keys"):
                gui.add_html(add_shortcuts(gui, session))

    def update(self, view: View, lines: Sequence[StatusLine]) -> None:
        """Say what is; `lines` are those of the robot's state."""
        session = self._session
        self._robots.update(view.fleet, session.robot_labels(), session.robot)
        if self._go is not None:
            self._go.update(view)
        self._tours.update(view)
        if self._map is not None:
            self._map.update(view)
        self._state.content = "".join(map(row, lines))
        self._more.update(view)
        self._people.update(view.now_ns)
        if self._links is not None:
            self._links.update(view.now_ns)

    def close(self) -> None:
        """Stop following what only this browser shows."""
        self._more.close_plot()
