"""The tab of the tours: the trip under way, the stored tours and their editor, past trips."""

from trolley import topics
from trolley.geometry.frames import MAP
from trolley.messages import PastTrip, Tour
from trolley_viz.controls.controls import Container, Controls
from trolley_viz.features.touch.touched import Touched
from trolley_viz.features.tours.draft import Draft, Editing
from trolley_viz.features.tours.editor import TourEditor
from trolley_viz.features.tours.layer import (
    TourDrawing,
    edited_colours,
    path_of,
    pins_of,
    place_finder,
    tour_of,
)
from trolley_viz.features.tours.past_trips import PastTripsPanel
from trolley_viz.features.tours.stored import TourList
from trolley_viz.features.tours.tour_actions import TourActions, free_name
from trolley_viz.features.tours.trip import TripPanel
from trolley_viz.robots.view import View
from trolley_viz.session.session import Session


class TourTab:
    """All about tours in one browser; who only looks sees the trip and past trips."""

    def __init__(self, gui: Controls, tab: Container, session: Session) -> None:
        self.tab = tab
        self._session = session
        actions = session.actions
        self._stored = TourActions(actions, lambda: session.view)
        self._edited_on = ""
        """The robot whose tour is edited."""
        self._drawing = TourDrawing(
            lambda: session.window.picture.scene, "/edited_tour", raised=0.02
        )
        steer = actions.steer_tour if session.may_drive else None
        self._trip = TripPanel(gui, steer)
        self._list: TourList | None = None
        self._editor: TourEditor | None = None
        if session.may_drive:
            self._list = TourList(gui, self, actions.history)
            self._editor = TourEditor(
                gui, session.folder, session.aiming, lambda: session.view, session.tell, self._save
            )
        self._past = PastTripsPanel(
            gui,
            self._has_record,
            session.past.show_trip,
            lambda: session.preferences.time_zone,
        )

    def update(self, view: View) -> None:
        """Show what is."""
        trip, stored = view.streams.latest(topics.TOUR), view.streams.latest(topics.TOURS)
        editing = self._edited_here()
        tour = None if trip is None else tour_of(trip, view)
        self._trip.update(
            trip,
            tour,
            view.overdue_s(topics.TOUR),
            with_last=editing is None,
            is_halted=view.is_halted,
        )
        self._past.update(view.robot_name, view.past, trip, view.now_ns, is_shown=editing is None)
        if self._list is not None and self._editor is not None:
            tours = None if stored is None else stored.tours
            on_map = None if view.map is None else view.map.name
            self._list.update(tours, on_map, is_open=editing is None, can_start=view.can_tour)
            self._editor.update(view, tours or [], is_shown=editing is not None)
        self._draw(view, editing)

    def _has_record(self, trip: PastTrip) -> bool:
        return self._session.hub.past.has_trip(self._session.robot, trip.trip)

    def _edited_here(self) -> Editing | None:
        """What is edited of the robot that is followed now."""
        is_here = self._editor is not None and self._edited_on == self._session.robot
        return self._editor.editing if is_here and self._editor is not None else None

    # What people do with the stored tours.
    def start(self, tour: Tour) -> None:
        """Start it."""
        self._session.actions.start_tour(tour.name)

    def edit(self, tour: Tour | None) -> None:
        """Edit it, or make a new one."""
        if self._editor is not None:
            self._edited_on = self._session.robot
            self._editor.open(self._new() if tour is None else Editing.open(tour))

    def _new(self) -> Editing:
        """Begin a tour, under a name that is free: so it can be saved without typing."""
        tours = self._session.view.streams.latest(topics.TOURS)
        taken = {tour.name for tour in ([] if tours is None else tours.tours)}
        return Editing(None, Draft(name=free_name(taken)))

    @property
    def is_editing(self) -> bool:
        """Whether a tour of this robot is edited."""
        return self._edited_here() is not None

    def add_touched(self, one: Touched) -> None:
        """Add what was touched on the map to the tour that is edited, or to a new one."""
        if self._editor is not None:
            if not self.is_editing:
                self.edit(None)
            self._editor.add_touched(one)

    def copy(self, tour: Tour) -> None:
        """Save it once more, under another name."""
        tours = self._session.view.streams.latest(topics.TOURS)
        self._stored.duplicate(tour, [] if tours is None else tours.tours)

    def delete(self, tour: Tour) -> None:
        """Delete it."""
        self._stored.delete(tour)

    def _save(self, tour: Tour, before: Tour | None) -> None:
        editor = self._editor
        if editor is not None:
            edited = editor.editing

            def saved() -> None:
                if editor.editing is edited:
                    editor.close()

            self._stored.save(tour, before, saved)

    def _draw(self, view: View, editing: Editing | None) -> None:
        if editing is None:
            self._drawing.show((), (), None)
            return
        find, draft = place_finder(view), editing.draft
        pins = pins_of(draft, find, edited_colours(editing.chosen))
        self._drawing.show(pins, path_of(draft, find), view.placement.world_T(MAP))
