"""Storing, changing and deleting zones for the person at one browser, and taking it back."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

from trolley import codes, requests
from trolley.codes import Refused
from trolley.messages import Zone
from trolley.messages.asking import Named
from trolley.requests import Request
from trolley.runtime.service import Service
from trolley_viz.words import Tone

MAX_UNDO = 50

Tell = Callable[[str, str, Tone], None]


@dataclass(frozen=True)
class Change:
    """One zone before and after; None where there is none."""

    before: Zone | None
    after: Zone | None

    @property
    def name(self) -> str:
        """The zone's name, for people."""
        zone = self.after or self.before
        return "" if zone is None else zone.name

    def reversed(self) -> "Change":
        """The change that takes this one back."""
        return Change(self.after, self.before)


class ZoneWishes:
    """Asks the robot's localizer, one change after the other.

    Args:
        service: asks.
        robot: whom.
        zones: what is stored now.
        tell: tells the person.
    """

    def __init__(
        self,
        service: Service,
        robot: Callable[[], str],
        zones: Callable[[], Sequence[Zone]],
        tell: Tell,
    ) -> None:
        self._service = service
        self._robot = robot
        self._zones = zones
        self._tell = tell
        self._undo: list[Change] = []
        self.is_busy = False
        """Whether an answer is awaited."""

    @property
    def last(self) -> str:
        """The name of the zone that undo would change back; "" where there is nothing to undo."""
        return self._undo[-1].name if self._undo else ""

    def forget(self) -> None:
        """Forget what could be undone, as on another map."""
        self._undo.clear()

    def ask(
        self,
        change: Change,
        done: Callable[[Zone | None], None],
        refused: Callable[[], None] = lambda: None,
    ) -> None:
        """Make a change that can be undone; `done` gets the zone as it was saved."""
        robot = self._robot()

        def made(saved: Zone) -> None:
            after = None if change.after is None else saved
            if robot == self._robot():
                self._undo.append(Change(change.before, after))
                del self._undo[:-MAX_UNDO]
            done(after)

        self._make(change, made, refused)

    def undo(self) -> None:
        """Take the last change back, unless somebody changed that zone again."""
        if not self._undo or self.is_busy:
            return
        change = self._undo[-1]
        if self._stored(change.name if change.after is not None else "") != change.after:
            self._undo.pop()
            self._tell("Not undone", f"Somebody else changed “{change.name}” since.", "warn")
            return
        self._make(change.reversed(), lambda _: self._undo.remove(change), lambda: None)

    def _stored(self, name: str) -> Zone | None:
        return next((zone for zone in self._zones() if zone.name == name), None)

    def _make(
        self, change: Change, made: Callable[[Zone], None], refused: Callable[[], None]
    ) -> None:
        before, after = change.before, change.after
        problem = self._problem(change)
        if problem:
            self._tell("Not saved", problem, "warn")
            refused()
        elif after is not None and (before is None or before.name == after.name):
            self._send(requests.ZONES_PUT, after, made, refused)
        elif after is None and before is not None:
            self._send(requests.ZONES_DELETE, Named(name=before.name), made, refused)
        elif after is not None and before is not None:
            # The new one first: a mirror that is there twice does no harm, one that is gone does.
            old = Named(name=before.name)
            self._send(
                requests.ZONES_PUT,
                after,
                lambda saved: self._send(
                    requests.ZONES_DELETE, old, lambda _: made(saved), refused
                ),
                refused,
            )

    def _problem(self, change: Change) -> str:
        """Why a change cannot be asked for now; "" if it can."""
        before, after = change.before, change.after
        if self.is_busy:
            return "The last change is not saved yet."
        if after is None or (before is not None and before.name == after.name):
            return ""
        taken = self._stored(after.name) is not None
        return f"There is a zone called “{after.name}” already." if taken else ""

    def _send(
        self,
        request: Request[Any, Zone],
        params: Any,
        done: Callable[[Zone], None],
        refused: Callable[[], None],
    ) -> None:
        self.is_busy = True

        def finish(reply: Zone | Refused) -> None:
            self.is_busy = False
            if isinstance(reply, Refused):
                self._service.log.info("Refused", request=request.name, code=reply.code)
                self._tell("Not saved", reply.message or codes.SENTENCES[reply.code], "bad")
                refused()
            else:
                done(reply)

        self._service.request(request, params, finish, robot=self._robot())
