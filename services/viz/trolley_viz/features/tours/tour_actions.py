"""What the tour editor does: tours saved and deleted, each of which can be undone."""

import itertools
from collections.abc import Callable, Sequence

from msgspec import structs

from trolley import requests, topics
from trolley.messages import Tour
from trolley_viz.controls.undo import Change
from trolley_viz.features.driving.robot_actions import RobotActions
from trolley_viz.features.driving.stored_things import StoredThings
from trolley_viz.robots.view import View

_LONGEST_NAME = 64


class TourActions:
    """Requests about stored tours on behalf of one browser.

    Args:
        actions: asks the robot, and remembers what can be taken back.
        view: what is known of it.
    """

    def __init__(self, actions: RobotActions, view: Callable[[], View]) -> None:
        self._actions = actions

        def stored(name: str) -> Tour | None:
            tours = view().streams.latest(topics.TOURS)
            return next((one for one in tours.tours if one.name == name), None) if tours else None

        self._things = StoredThings(
            actions, "tour", requests.TOURS_PUT, requests.TOURS_DELETE, stored
        )

    def save(self, tour: Tour, before: Tour | None, saved: Callable[[], None]) -> None:
        """Save a tour.

        Args:
            tour: the tour.
            before: what it was, None for a new one; one of another name is deleted.
            saved: called when it is saved.
        """

        def done(_: Tour) -> None:
            self._actions.tell("Saved", f"The tour {tour.name} is saved.", "good")
            saved()

        title = f"Save the tour {tour.name}"
        self._things.change(title, Change(before, tour), "Not saved", done)

    def delete(self, tour: Tour) -> None:
        """Delete a stored tour."""
        title = f"Delete the tour {tour.name}"
        self._things.change(title, Change(tour, None), "Not deleted")

    def duplicate(self, tour: Tour, tours: Sequence[Tour]) -> None:
        """Save the same tour under another name; times of day are not copied."""
        name = copy_name(tour.name, {one.name for one in tours})
        copy = structs.replace(tour, name=name, schedule=[])
        self.save(copy, None, lambda: None)


def free_name(taken: set[str]) -> str:
    """Name a new tour, with the first free number: “Tour 1”."""
    return next(name for i in itertools.count(1) if (name := f"Tour {i}") not in taken)


def copy_name(name: str, taken: set[str]) -> str:
    """Find a free name for a copy: "round 2"."""
    number = 2
    while True:
        ending = f" {number}"
        found = name[: _LONGEST_NAME - len(ending)].rstrip() + ending
        if found not in taken:
            return found
        number += 1
