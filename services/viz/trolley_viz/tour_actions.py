"""What the tour editor does: tours saved and deleted, each of which can be undone."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass

from msgspec import structs

from trolley import requests
from trolley.messages import Tour
from trolley.messages.asking import Named
from trolley_viz.actions import Actions
from trolley_viz.words import Tone

MAX_UNDOS = 20
_LONGEST_NAME = 64


@dataclass(frozen=True)
class Undo:
    """How things were before somebody saved or deleted a tour here."""

    robot: str
    text: str
    put: Tour | None
    """What is saved again."""
    delete: str | None
    """What is deleted again."""


class TourActions:
    """Requests about stored tours on behalf of one browser.

    Args:
        actions: asks the robot.
        robot: the robot that the browser follows.
        tell: shows people a title and a sentence.
    """

    def __init__(
        self, actions: Actions, robot: Callable[[], str], tell: Callable[[str, str, Tone], None]
    ) -> None:
        self._actions = actions
        self._robot = robot
        self._tell = tell
        self._undos: list[Undo] = []

    def save(self, tour: Tour, before: Tour | None, saved: Callable[[], None]) -> None:
        """Save a tour.

        Args:
            tour: the tour.
            before: what it was, None for a new one; one of another name is deleted.
            saved: called when it is saved.
        """
        robot, renamed = self._robot(), before is not None and before.name != tour.name

        def done(_: Tour) -> None:
            if before is not None and renamed and self._robot() == robot:
                self._actions.ask(
                    requests.TOURS_DELETE, Named(name=before.name), "The old name is still there"
                )
            added = tour.name if before is None or renamed else None
            self._remember(Undo(robot, f"saving {tour.name}", before, added))
            self._tell("Saved", f"The tour {tour.name} is saved.", "good")
            saved()

        self._actions.ask(requests.TOURS_PUT, tour, "Not saved", done)

    def delete(self, tour: Tour) -> None:
        """Delete a stored tour."""
        robot = self._robot()

        def done(was: Tour) -> None:
            self._remember(Undo(robot, f"deleting {was.name}", was, None))

        self._actions.ask(requests.TOURS_DELETE, Named(name=tour.name), "Not deleted", done)

    def duplicate(self, tour: Tour, tours: Sequence[Tour]) -> None:
        """Save the same tour under another name; times of day are not copied."""
        name = copy_name(tour.name, {one.name for one in tours})
        copy = structs.replace(tour, name=name, schedule=[])
        self.save(copy, None, lambda: None)

    @property
    def undo_text(self) -> str:
        """What the next undo undoes, "" where there is nothing."""
        undo = self._newest()
        return "" if undo is None else undo.text

    def undo(self) -> None:
        """Make it as it was before the last change made here."""
        undo = self._newest()
        if undo is None:
            return
        self._undos.remove(undo)
        if undo.put is not None:
            self._actions.ask(requests.TOURS_PUT, undo.put, "Not undone")
        if undo.delete is not None:
            self._actions.ask(requests.TOURS_DELETE, Named(name=undo.delete), "Not undone")

    def _remember(self, undo: Undo) -> None:
        self._undos = [*self._undos, undo][-MAX_UNDOS:]

    def _newest(self) -> Undo | None:
        """The last change of the robot that is followed now."""
        own = [undo for undo in self._undos if undo.robot == self._robot()]
        return own[-1] if own else None


def copy_name(name: str, taken: set[str]) -> str:
    """Find a free name for a copy: "round 2"."""
    number = 2
    while True:
        ending = f" {number}"
        found = name[: _LONGEST_NAME - len(ending)].rstrip() + ending
        if found not in taken:
            return found
        number += 1
