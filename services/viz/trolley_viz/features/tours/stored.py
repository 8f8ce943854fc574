"""The stored tours: start, edit, copy or delete one, and undo that."""

from collections.abc import Callable, Sequence
from typing import Protocol

from trolley.messages import Tour
from trolley_viz.controls.controls import Choice, Container, Controls, Html
from trolley_viz.controls.markup import card, note
from trolley_viz.controls.shared import show_undo
from trolley_viz.controls.undo import History
from trolley_viz.features.tours.draft import days_text, stay_text
from trolley_viz.words.sentences import stops_text

MAX_CARDS = 40
SEARCH_FROM = 8
"""With fewer tours nobody needs to search."""
START, EDIT, COPY, DELETE = "Start", "Edit", "Copy", "Delete"


class TourChoices(Protocol):
    """The callbacks for the buttons of a stored tour's card."""

    def start(self, tour: Tour) -> None:
        """Start it."""
        ...

    def edit(self, tour: Tour | None) -> None:
        """Edit it, or make a new one."""
        ...

    def copy(self, tour: Tour) -> None:
        """Save it once more."""
        ...

    def delete(self, tour: Tour) -> None:
        """Delete it."""
        ...


class TourList:
    """A card for each stored tour."""

    def __init__(self, gui: Controls, choices: TourChoices, history: History) -> None:
        self._gui = gui
        self._choices = choices
        self._history = history
        self._tours: dict[str, Tour] = {}
        self._cards: dict[str, tuple[Container, Html, Choice]] = {}
        self._folder = gui.add_folder()
        with self._folder:
            self._search = gui.add_text("Search", "", visible=False)
            self._list = gui.add_folder()
            self._rest = gui.add_html("")
            new = gui.add_button("New tour", icon="plus", colour="green")
            self._undo = gui.add_button("Undo", icon="arrow-back-up", visible=False)
        new.on_press(lambda: choices.edit(None))
        self._undo.on_press(lambda: history.undo("tour"))

    def update(
        self,
        tours: Sequence[Tour] | None,
        map_name: str | None,
        *,
        is_open: bool,
        can_start: bool,
    ) -> None:
        """Show the tours (None: not known yet) and what can be undone, or hide all that.

        One of another map than the robot's can neither be started nor edited: its points lie there.
        """
        self._folder.visible = is_open
        if not is_open:
            return
        self._tours = {tour.name: tour for tour in tours or ()}
        self._search.visible = len(self._tours) >= SEARCH_FROM
        wanted = self._search.value.strip().casefold()
        found = sorted(name for name in self._tours if wanted in name.casefold())
        shown = found[:MAX_CARDS]
        for name in self._cards.keys() - set(shown):
            folder, _, _ = self._cards.pop(name)
            folder.remove()
        for order, name in enumerate(shown):
            if name not in self._cards:
                self._cards[name] = self._add(name)
            folder, text, choice = self._cards[name]
            tour = self._tours[name]
            is_here = tour.is_for(map_name)
            choice.turn_off(*([START, EDIT] if not is_here else [] if can_start else [START]))
            folder.order = order
            names = {stop.name for stop in tour.stops if stop.name}
            text.content = card(name, summary(tour, map_name), names)
        self._rest.content = self._rest_text(tours, len(found))
        show_undo(self._undo, self._history, "tour")

    def _rest_text(self, tours: Sequence[Tour] | None, num_found: int) -> str:
        if tours is None:
            return note("The tour service is still starting.")
        if not tours:
            return note("No tours saved yet. A tour takes the robot from place to place.")
        if num_found > MAX_CARDS:
            return note(f"{num_found - MAX_CARDS} more: search for them.")
        return "" if num_found else note("No tour has that name.")

    def _add(self, name: str) -> tuple[Container, Html, Choice]:
        acts: dict[str, Callable[[Tour], None]] = {
            START: self._choices.start,
            EDIT: self._choices.edit,
            COPY: self._choices.copy,
            DELETE: self._choices.delete,
        }
        with self._list, self._gui.add_folder() as folder:
            text = self._gui.add_html("")
            choice = self._gui.add_choice("", tuple(acts))
        # By name, not by position: what is pressed is what was read.
        choice.on_press(lambda action: acts[action](self._tours[name]))
        return folder, text, choice


def summary(tour: Tour, map_name: str | None = None) -> str:
    """Say what a tour is in a line: its places, on which other map, how often, when."""
    parts = [stops_text([stop.name for stop in tour.stops])]
    if not tour.is_for(map_name):
        parts.append(f"on the map “{tour.map}”")
    if tour.there_and_back:
        parts.append("there and back")
    if tour.repeat != 1:
        parts.append(f"{tour.repeat} rounds" if tour.repeat else "repeats forever")
    stay = sum(stop.dwell for stop in tour.stops)
    if stay:
        parts.append(f"stays {stay_text(stay)} in total")
    parts += [f"{entry.at} {days_text(entry.days)}" for entry in tour.schedule[:3]]
    return " · ".join(parts)
