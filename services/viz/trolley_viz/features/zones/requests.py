"""Requests to store, change and delete zones from one browser, with undo."""

from collections.abc import Callable, Sequence
from typing import Any

from trolley import requests
from trolley.codes import Refused
from trolley.messages import Zone
from trolley.messages.request_params import Named
from trolley.requests import Request
from trolley.runtime.service import Service
from trolley_viz.controls.undo import Change, History, Step
from trolley_viz.words.sentences import Tell, refusal


class ZoneRequests:
    """Asks the robot's localizer for one change at a time.

    Args:
        robot: whom.
        zones: what is stored now.
        map_name: of the map that the zones belong to; "" while it is not known.
        history: what the person can take back.
    """

    def __init__(
        self,
        service: Service,
        robot: Callable[[], str],
        zones: Callable[[], Sequence[Zone]],
        map_name: Callable[[], str],
        history: History,
        tell: Tell,
    ) -> None:
        self._service = service
        self._robot = robot
        self._zones = zones
        self._map_name = map_name
        self._history = history
        self._tell = tell
        self.is_busy = False
        """Whether an answer is awaited."""

    def ask(
        self,
        change: Change[Zone],
        done: Callable[[Zone | None], None],
        refused: Callable[[], None] = lambda: None,
    ) -> None:
        """Make a change that can be undone; `done` gets the zone as it was saved."""
        robot = self._robot()

        def made(saved: Zone) -> None:
            after = None if change.after is None else saved
            if robot == self._robot():
                self._remember(Change(change.before, after))
            done(after)

        self._make(change, made, refused)

    # Inside.
    def _remember(self, change: Change[Zone]) -> None:
        """Let the person take a change back, as long as there is the same map."""
        map_name = self._map_name()

        def undo() -> None:
            self._take_back(change, step)

        step = Step("zone", _title(change), undo, lambda: self._map_name() in ("", map_name))
        self._history.add(step)

    def _take_back(self, change: Change[Zone], step: Step) -> None:
        """Take a change back, unless somebody changed that zone again."""
        if self.is_busy or not change.is_overtaken(self._stored, self._tell):
            # What is refused can be tried again.
            self._make(
                change.reversed(self._stored), lambda _: None, lambda: self._history.add(step)
            )

    def _stored(self, name: str) -> Zone | None:
        return next((zone for zone in self._zones() if zone.name == name), None)

    def _make(
        self, change: Change[Zone], made: Callable[[Zone], None], refused: Callable[[], None]
    ) -> None:
        before, after = change.before, change.after
        robot = self._robot()  # for both requests: another may be followed when the second is sent
        problem = self._problem(change)
        if problem:
            self._tell("Not saved", problem, "warn")
            refused()
        elif after is not None and (before is None or before.name == after.name):
            self._send(requests.ZONES_PUT, after, made, refused, robot)
        elif after is None and before is not None:
            self._send(requests.ZONES_DELETE, Named(name=before.name), made, refused, robot)
        elif after is not None and before is not None:
            # The new one first: a mirror stored twice does no harm, a missing one does.
            old = Named(name=before.name)
            self._send(
                requests.ZONES_PUT,
                after,
                lambda saved: self._send(
                    requests.ZONES_DELETE, old, lambda _: made(saved), refused, robot
                ),
                refused,
                robot,
            )

    def _problem(self, change: Change[Zone]) -> str:
        """Why a change cannot be asked for now; "" if it can."""
        before, after = change.before, change.after
        if self.is_busy:
            return "The last change has not been saved yet."
        if after is None or (before is not None and before.name == after.name):
            return ""
        taken = self._stored(after.name) is not None
        return f"There is already a zone called “{after.name}”." if taken else ""

    def _send(
        self,
        request: Request[Any, Zone],
        params: Any,
        done: Callable[[Zone], None],
        refused: Callable[[], None],
        robot: str,
    ) -> None:
        self.is_busy = True

        def finish(reply: Zone | Refused) -> None:
            self.is_busy = False
            if isinstance(reply, Refused):
                self._service.log.info("Refused", request=request.name, code=reply.code)
                self._tell("Not saved", refusal(reply), "bad")
                refused()
            else:
                done(reply)

        self._service.request(request, params, finish, robot=robot)


def _title(change: Change[Zone]) -> str:
    """Name a change for the undo button, such as “Delete “hall””."""
    what = "Add" if change.before is None else "Delete" if change.after is None else "Change"
    zone = change.after or change.before
    return f"{what} “{'' if zone is None else zone.name}”"
