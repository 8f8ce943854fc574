"""Requests to store, change and delete zones from one browser, with undo."""

from collections.abc import Callable, Sequence

from trolley import requests
from trolley.messages import Zone
from trolley_viz.controls.undo import Change
from trolley_viz.features.driving.robot_actions import RobotActions
from trolley_viz.features.driving.stored_things import StoredThings


class ZoneRequests:
    """Asks the robot's localizer for one change at a time.

    Args:
        actions: asks the robot, and remembers what can be undone.
        zones: what is stored now.
        map_name: of the map that the zones belong to; "" while it is not known.
    """

    def __init__(
        self,
        actions: RobotActions,
        zones: Callable[[], Sequence[Zone]],
        map_name: Callable[[], str],
    ) -> None:
        self._actions = actions
        self._zones = zones
        self._things = StoredThings(
            actions,
            "zone",
            requests.ZONES_PUT,
            requests.ZONES_DELETE,
            self._stored,
            map_name=map_name,
        )

    @property
    def is_busy(self) -> bool:
        """Whether a change has not been answered yet."""
        return self._things.is_busy

    def ask(
        self,
        change: Change[Zone],
        done: Callable[[Zone], None],
        refused: Callable[[], None] = lambda: None,
    ) -> None:
        """Make a change that can be undone; `done` gets the zone as it was saved, or deleted."""
        problem = self._problem(change)
        if problem:
            self._actions.tell("Not saved", problem, "warn")
            refused()
        else:
            self._things.change(_title(change), change, "Not saved", done, refused=refused)

    # Inside.
    def _stored(self, name: str) -> Zone | None:
        return next((zone for zone in self._zones() if zone.name == name), None)

    def _problem(self, change: Change[Zone]) -> str:
        """Why a change cannot be asked for now; "" if it can."""
        before, after = change.before, change.after
        if self.is_busy:
            return "The last change has not been saved yet."
        if after is None or (before is not None and before.name == after.name):
            return ""
        taken = self._stored(after.name) is not None
        return f"There is already a zone called “{after.name}”." if taken else ""


def _title(change: Change[Zone]) -> str:
    """Name a change for the undo button, such as “Delete “hall””."""
    what = "Add" if change.before is None else "Delete" if change.after is None else "Change"
    zone = change.after or change.before
    return f"{what} “{'' if zone is None else zone.name}”"
