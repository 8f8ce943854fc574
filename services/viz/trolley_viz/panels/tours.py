"""The tab of the tours: start one, steer it, and see what came of each stop."""

from collections.abc import Sequence

import viser

from trolley.messages import Tour, TourStatus
from trolley_viz.actions import Actions
from trolley_viz.panels.control import GREEN, Post, handler, set_options
from trolley_viz.panels.markup import note, row
from trolley_viz.words import UNDER_WAY, Words, result_words, trip_words

NO_TOURS: str = "none stored yet"
TRIP_ACTIONS = ("Pause", "Resume", "Skip", "End")
MAX_RESULTS = 12


class TourPanel:
    """One trip at a time."""

    def __init__(self, gui: viser.GuiApi, actions: Actions, post: Post) -> None:
        self._tour = gui.add_dropdown("Tour", (NO_TOURS,))
        self._start = gui.add_button("Start", icon=viser.Icon.PLAYER_PLAY, color=GREEN)
        self._steer = gui.add_button_group("Trip", TRIP_ACTIONS)
        self._progress = gui.add_html("")
        self._start.on_click(handler(post, lambda _, __: actions.start_tour(self._tour.value)))
        self._steer.on_click(handler(post, lambda _, action: actions.steer_tour(action)))

    def update(self, tours: Sequence[Tour], trip: TourStatus | None) -> None:
        """Show the stored tours and how the trip goes."""
        names = sorted(one.name for one in tours)
        set_options(self._tour, names, NO_TOURS)
        self._start.disabled = not names
        self._steer.visible = trip is not None and trip.state in UNDER_WAY
        self._progress.content = progress(tours, trip)


def progress(tours: Sequence[Tour], trip: TourStatus | None) -> str:
    """The trip, what came of its stops, and those to come, as HTML."""
    if trip is None:
        return note("The tour service has not said anything yet.")
    tour = next((one for one in tours if one.name == trip.name), None)
    words = trip_words(trip, tour)
    if words is None:
        return note("No trip is under way.")
    lines = [words, *(result_words(one) for one in trip.results[-MAX_RESULTS:])]
    if tour is not None and trip.stop is not None and trip.state in UNDER_WAY:
        lines += [
            Words(f"{stop.name or f'stop {i}'} to come", "idle")
            for i, stop in enumerate(tour.stops[trip.stop + 1 :][:MAX_RESULTS], trip.stop + 2)
        ]
    return "".join(map(row, lines))
