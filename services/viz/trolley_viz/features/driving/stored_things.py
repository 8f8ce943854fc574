"""What one browser stores by name, renames and deletes; each change can be undone."""

from collections.abc import Callable, Sequence
from functools import partial
from typing import Any, Generic, TypeVar

from trolley import requests
from trolley.messages import SavedPose, Tour, Zone
from trolley.messages.request_params import Named
from trolley.requests import Request
from trolley_viz.controls.undo import Change, Kind, Step
from trolley_viz.features.driving.robot_actions import RobotActions

T = TypeVar("T", bound=SavedPose | Tour | Zone)


class StoredThings(Generic[T]):
    """What the robot keeps of one kind, by name.

    Args:
        actions: asks the robot, and remembers what can be undone.
        kind: what the steps for Undo are about.
        put: stores one.
        delete: deletes one.
        stored: what is stored under a name now.
        follow: the tours as they have to be once the first has become the second.
        map_name: of the map on which a change can be undone; "" for any.
        also: other requests that change one.
    """

    def __init__(
        self,
        actions: RobotActions,
        kind: Kind,
        put: Request[T, T],
        delete: Request[Named, T],
        stored: Callable[[str], T | None],
        follow: Callable[[T, T], Sequence[Tour]] = lambda before, after: (),
        map_name: Callable[[], str] = lambda: "",
        also: Sequence[Request[Any, Any]] = (),
    ) -> None:
        self._actions, self._kind = actions, kind
        self._put, self._delete = put, delete
        self._stored, self._follow, self._map_name = stored, follow, map_name
        self._changing = (put, delete, *also)

    @property
    def is_busy(self) -> bool:
        """Whether a change has not been answered yet."""
        return self._actions.is_asking(*self._changing)

    def change(
        self,
        title: str,
        change: Change[T],
        failed: str,
        done: Callable[[T], None] | None = None,
        robot: str = "",
        refused: Callable[[], None] = lambda: None,
    ) -> None:
        """Make a change that can be undone.

        Args:
            title: says what is done.
            change: what there is before and after.
            failed: says that it was not done.
            done: gets it as it was saved, if the same robot is selected still.
            robot: whose; that of the selected one if "".
            refused: called if nothing was done, and the same robot is selected still.
        """

        def changed(saved: T) -> None:
            deleted = change.after is None
            self.remember(title, Change(saved, None) if deleted else Change(change.before, saved))
            if done is not None:
                done(saved)

        self._make(change, failed, changed, robot, refused)

    def remember(self, title: str, change: Change[T]) -> None:
        """Let the person take a change back; what is refused can be tried again."""
        map_name = self._map_name()

        def undo() -> None:
            if self.is_busy:
                self._actions.tell("Not undone", "The last change has not been saved yet.", "warn")
                offer()
            elif not change.is_overtaken(self._stored, self._actions.tell):
                self._make(change.reversed(self._stored), "Not undone", refused=offer)

        step = Step(self._kind, title, undo, lambda: self._map_name() in ("", map_name))
        offer = partial(self._actions.history.add, step)
        offer()

    def _make(
        self,
        change: Change[T],
        failed: str,
        done: Callable[[T], None] = lambda _: None,
        robot: str = "",
        refused: Callable[[], None] = lambda: None,
    ) -> None:
        before, after, ask = change.before, change.after, self._actions.ask
        if before is None or after is None or before.name == after.name:
            if after is not None:
                ask(self._put, after, failed, done, robot=robot, refused=refused)
            elif before is not None:
                old = Named(name=before.name)
                ask(self._delete, old, failed, done, robot=robot, refused=refused)
            return
        old, tours = Named(name=before.name), self._follow(before, after)

        def put(saved: T, robot: str) -> None:
            for tour in tours:
                ask(requests.TOURS_PUT, tour, f"“{tour.name}” was not changed", robot=robot)
            failed = "The old name was not deleted"
            ask(self._delete, old, failed, lambda _: done(saved), robot=robot)

        # The new one first: a mirror stored twice does no harm, a missing one does.
        ask(self._put, after, failed, then=put, robot=robot, refused=refused)
