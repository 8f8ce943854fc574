"""The tab for everybody: where to go, and what is under way."""

from trolley import topics
from trolley.messages import GoalStatus, SavedPose, TourStatus
from trolley.under_way import GOAL_UNDER_WAY, TRIP_UNDER_WAY, what_is_under_way
from trolley_viz.controls.controls import Container, Controls
from trolley_viz.controls.markup import heading, note
from trolley_viz.controls.shared import show_undo
from trolley_viz.controls.tiles import Tiles
from trolley_viz.features.driving.aiming import GO_TO, LEAVE, POINT_GOAL, POINT_POSE, SET_POSE
from trolley_viz.features.driving.goal_queue_panel import GoalQueuePanel
from trolley_viz.robots.view import View
from trolley_viz.scene.places import current_places
from trolley_viz.session.session import Session
from trolley_viz.words.sentences import goal_name

NO_PLACES = "No places saved yet. Drive to one and save it under “Map”."


class GoTab:
    """Big buttons: pause and cancel while it goes, one for each place and for each tour."""

    def __init__(self, gui: Controls, tab: Container, session: Session) -> None:
        self.tab = tab
        actions, aiming = session.actions, session.aiming
        self._actions, self._aiming = actions, aiming
        with gui.add_tiles():
            self._pause = gui.add_button("Pause", icon="player-pause", colour="amber")
            self._go_on = gui.add_button("Continue", icon="player-play", colour="green")
            self._cancel = gui.add_button("Cancel", icon="x")
        for button in (self._pause, self._go_on, self._cancel):
            button.on_press(lambda action=button.label: actions.steer(action))
        self._places_title = gui.add_html(heading("Go to"))
        self._no_places = gui.add_html(note(NO_PLACES))
        self._places = Tiles(gui, "map-pin", "purple", actions.choose_place)
        self._tours_title = gui.add_html(heading("Tours"))
        self._tours = Tiles(gui, "route", "teal", actions.start_tour)
        gui.add_html(heading("On the map"))
        with gui.add_tiles():
            self._point = gui.add_button(POINT_GOAL, icon="map-pin", colour="green")
            self._set = gui.add_button(POINT_POSE, icon="current-location", colour="teal")
            self._find = gui.add_button("Find position", icon="search")
            self._follow = gui.add_button("Follow somebody", icon="walk")
            self._undo = gui.add_button("Undo", icon="arrow-back-up")
        self._point.on_press(lambda: aiming.toggle(GO_TO))
        self._set.on_press(lambda: aiming.toggle(SET_POSE))
        self._find.on_press(actions.find)
        self._follow.on_press(actions.follow_person)
        self._undo.on_press(lambda: actions.history.undo("drive"))
        with session.folder("Several places in a row"):
            self._goal_queue = GoalQueuePanel(gui, actions, aiming)

    def update(self, view: View) -> None:
        """Show what there is to choose, and what is under way."""
        streams = view.streams
        goal, trip = streams.latest(topics.GOAL), streams.latest(topics.TOUR)
        tours = streams.latest(topics.TOURS)
        self._show_steering(goal, trip, is_halted=view.is_halted)
        places = current_places(view)
        self._no_places.visible = not places and not view.is_away
        self._places_title.visible = bool(places) or self._no_places.visible
        can_go = view.can_go
        going_to = _going_to(goal, places)
        is_collecting = self._actions.goal_queue.is_collecting
        icons = {one.name: one.icon for one in places}
        self._places.show(icons, going_to, can=can_go or is_collecting)
        on_map = None if view.map is None else view.map.name
        offered = [] if tours is None else [one for one in tours.tours if one.is_for(on_map)]
        driven = trip.name if trip is not None and trip.state in TRIP_UNDER_WAY else None
        self._tours_title.visible = bool(offered)
        self._tours.show({one.name: "" for one in offered}, driven, can=view.can_tour)
        self._follow.disabled = not can_go
        self._find.disabled = self._set.disabled = view.is_away
        self._point.disabled = not (can_go or self._aiming.armed == GO_TO)
        self._point.label = LEAVE if self._aiming.armed == GO_TO else POINT_GOAL
        self._set.label = LEAVE if self._aiming.armed == SET_POSE else POINT_POSE
        show_undo(self._undo, self._actions.history, "drive")
        self._goal_queue.update(trip, can=view.can_tour)

    def _show_steering(
        self, goal: GoalStatus | None, trip: TourStatus | None, *, is_halted: bool
    ) -> None:
        """Offer to pause or to go on, and to cancel, what is under way."""
        what = what_is_under_way(goal, trip)
        status = trip if what == "trip" else goal
        is_paused = bool(what) and status is not None and status.state == "paused"
        # Always there, so that nothing moves under a finger.
        self._pause.visible, self._go_on.visible = not is_paused, is_paused
        self._pause.disabled = self._cancel.disabled = not what
        # What was stopped goes on by “Drive on”, and by nothing else.
        self._go_on.disabled = is_halted


def _going_to(goal: GoalStatus | None, places: list[SavedPose]) -> str | None:
    """The name of the place that the robot is on its way to."""
    if goal is None or goal.state not in GOAL_UNDER_WAY:
        return None
    return goal_name(goal, places)
