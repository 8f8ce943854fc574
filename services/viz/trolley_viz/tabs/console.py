"""All controls of one browser: the robots on top, the tabs below."""

from collections.abc import Sequence

from trolley_viz.controls.controls import Controls
from trolley_viz.controls.markup import note
from trolley_viz.features.past.bar import PastBar
from trolley_viz.features.people.links import LinkCard
from trolley_viz.features.robot_list.panel import RobotsPanel
from trolley_viz.features.setup.panel import SetupPanel
from trolley_viz.features.touch.card import Leads, TouchCard
from trolley_viz.features.touch.touched import Touched
from trolley_viz.robots.view import View
from trolley_viz.session.session import Session
from trolley_viz.tabs.go_tab import GoTab
from trolley_viz.tabs.map_tab import MapTab
from trolley_viz.tabs.more_tab import MoreTab
from trolley_viz.tabs.tours_tab import TourTab
from trolley_viz.tabs.view_bar import ViewBar
from trolley_viz.words.sentences import StatusLine

UNSEEN_PERIOD_NS = 1_000_000_000
"""How often a tab is brought up to date that is behind another."""


class Console:
    """The controls of one browser; a viewer's has those only that cannot move anything."""

    def __init__(self, gui: Controls, session: Session) -> None:
        self._session = session
        self._robots = RobotsPanel(gui, session.folder, session.follow, session.press_stop_all)
        if not session.may_drive:
            gui.add_html(note("You may look, but not drive. STOP works."))
        self._go: GoTab | None = None
        self._map: MapTab | None = None
        self._card: TouchCard | None = None
        self._view_bar = ViewBar(gui, session)
        self._link_card: LinkCard | None = None
        self._past_bar = PastBar(gui, session.past)
        self._setup = SetupPanel(
            gui,
            session.hub.service,
            lambda: session.robot,
            session.tell,
            may_answer=session.may_drive,
        )
        tabs = self._tabs = gui.add_tabs()
        tabs.on_open(session.touching.close)
        self._unseen_due_ns = 0
        if session.may_drive:
            with tabs.add_tab("Go", "steering-wheel") as tab:
                self._go = GoTab(gui, tab, session)
        with tabs.add_tab("Tours", "route") as tab:
            self._tours = TourTab(gui, tab, session)
        if session.may_drive:
            with tabs.add_tab("Map", "map-2") as tab:
                self._map = MapTab(gui, tab, session)
            self._card = self._add_card(gui, self._map)
            self._link_card = LinkCard(gui, session.hub.links)
        with tabs.add_tab("More", "dots") as tab:
            self._more = MoreTab(gui, tab, session, self._show_link)

    def update(self, view: View, lines: Sequence[StatusLine]) -> None:
        """Say what is; `lines` are those of the robot's state."""
        session, tabs = self._session, self._tabs
        are_due = view.now_ns >= self._unseen_due_ns
        if are_due:
            self._unseen_due_ns = view.now_ns + UNSEEN_PERIOD_NS
        self._setup.update(view.setup)
        tabs.visible = view.setup is None
        self._robots.update(view.fleet, session.robot_labels(), session.robot)
        for one in (self._go, self._tours, self._map):
            if one is not None and (are_due or tabs.is_open(one.tab)):
                one.update(view)
        if self._card is not None:
            self._card.update(view)
        self._view_bar.update()
        self._past_bar.update()
        self._more.follow(view)
        if are_due or tabs.is_open(self._more.tab):
            self._more.update(view, lines)
        if self._link_card is not None:
            if session.touching.touched is not None:
                self._link_card.hide()
            self._link_card.update(view.now_ns)

    def close(self) -> None:
        """Stop following what only this browser shows."""
        self._more.close_plot()

    # Inside.
    def _add_card(self, gui: Controls, of_map: MapTab) -> TouchCard:
        """Add the card of what is touched, with ways to the tabs where there is more to do."""

        def edit_place(name: str) -> None:
            self._tabs.open(of_map.tab)
            of_map.edit_place(name)

        def edit_zone(name: str) -> None:
            self._tabs.open(of_map.tab)
            of_map.edit_zone(name)

        def add_to_tour(one: Touched) -> None:
            self._tabs.open(self._tours.tab)
            self._tours.add_touched(one)

        session = self._session
        session.take_tap = self._take_tap
        return TouchCard(
            gui,
            session.touching,
            Leads(edit_place, edit_zone, add_to_tour, session.follow, session.window.look_at),
        )

    def _show_link(self, what: str) -> None:
        """Show a link, in place of what was touched: one card is seen at a time."""
        self._session.touching.close()
        if self._link_card is not None:
            self._link_card.show(what)

    def _take_tap(self, one: Touched) -> bool:
        """While a tour is edited, places and points that are touched are added to it."""
        is_wanted = self._tabs.is_open(self._tours.tab) and self._tours.is_editing
        if is_wanted and one.what in ("place", "floor"):
            self._tours.add_touched(one)
            return True
        return False
