"""What the tour editor does: tours saved and deleted, each of which can be undone."""

import itertools
from collections.abc import Callable, Sequence

from msgspec import structs

from trolley import requests
from trolley.messages import Tour
from trolley.messages.request_params import Named
from trolley_viz.controls.undo import Step
from trolley_viz.features.driving.robot_actions import RobotActions

_LONGEST_NAME = 64


class TourActions:
    """Requests about stored tours on behalf of one browser.

    Args:
        actions: asks the robot, and remembers what can be taken back.
    """

    def __init__(self, actions: RobotActions) -> None:
        self._actions = actions

    def save(self, tour: Tour, before: Tour | None, saved: Callable[[], None]) -> None:
        """Save a tour.

        Args:
            tour: the tour.
            before: what it was, None for a new one; one of another name is deleted.
            saved: called when it is saved.
        """
        renamed = before is not None and before.name != tour.name

        def undo() -> None:
            if before is not None:
                self._actions.ask(requests.TOURS_PUT, before, "Not undone")
            if before is None or renamed:
                self._actions.ask(requests.TOURS_DELETE, Named(name=tour.name), "Not undone")

        def done(_: Tour) -> None:
            if before is not None and renamed:
                old = Named(name=before.name)
                self._actions.ask(requests.TOURS_DELETE, old, "The old name was not deleted")
            self._actions.history.add(Step("tour", f"Save the tour {tour.name}", undo))
            self._actions.tell("Saved", f"The tour {tour.name} is saved.", "good")
            saved()

        self._actions.ask(requests.TOURS_PUT, tour, "Not saved", done)

    def delete(self, tour: Tour) -> None:
        """Delete a stored tour."""

        def done(was: Tour) -> None:
            def undo() -> None:
                self._actions.ask(requests.TOURS_PUT, was, "Not undone")

            self._actions.history.add(Step("tour", f"Delete the tour {was.name}", undo))

        self._actions.ask(requests.TOURS_DELETE, Named(name=tour.name), "Not deleted", done)

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
