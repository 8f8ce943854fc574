"""The emergency-stop latch: whether somebody stopped the robot, on disk as in memory."""

from collections.abc import Callable
from typing import NamedTuple

from trolley.runtime.service import Service, every
from trolley.state_file import reason_of
from trolley_base.persistence import LATCH_FILE, SavedLatch

Then = Callable[[], None]

LONGEST_SAVE_NS = 1_000_000_000
"""A stop is answered after this long even where the disk is slower: the robot stands anyway."""
LATE_S = 0.1
"""Period at which such late answers are looked for."""
SAVE_AGAIN_S = 5.0
"""Period at which what the disk did not take is tried again: it may have room by now."""


class _Waiter(NamedTuple):
    deadline_ns: int
    then: Then


class EstopLatch:
    """Keeps the newest value on disk with one write at a time, so that no flood makes a queue.

    Args:
        service: base, whose state folder holds the value.
    """

    def __init__(self, service: Service) -> None:
        self.is_set = False
        """Whether the robot is stopped; changed first, and saved then."""
        self._service = service
        self._saved: bool | None = False
        """What the disk holds; None where that is not known."""
        self._why_not_saved = ""
        self._is_writing = False
        self._served: list[_Waiter] = []
        """Who waits for the write that is under way."""
        self._waiting: list[_Waiter] = []
        """Who waits for a later write."""

    @property
    def problem(self) -> str:
        """Say why a restart of base would forget the stop; "" if it is saved or there is none."""
        if not self.is_set or not self._why_not_saved:
            return ""
        return (
            "The stop holds now, but would be forgotten if base restarted, since it could not be "
            f"saved: {self._why_not_saved}."
        )

    def load(self) -> None:
        """Take over what the last run saved; an unreadable file may have said "stopped"."""
        state = self._service.state
        saved = state.read(LATCH_FILE, SavedLatch)
        is_unreadable = LATCH_FILE in state.problems
        self.is_set = is_unreadable if saved is None else saved.stopped
        self._saved = None if is_unreadable else self.is_set

    def save(self, then: Then | None = None) -> None:
        """Save the value; `then` is called once the disk holds it or a later one, or fails."""
        if then is not None:
            if self._saved == self.is_set and not self._is_writing:
                then()
                return
            self._waiting.append(_Waiter(self._service.monotonic_ns + LONGEST_SAVE_NS, then))
        self._write()

    @every(LATE_S, clock="local")
    def answer_late(self) -> None:
        """Answer stops whose saving takes long."""
        now_ns = self._service.monotonic_ns
        late = [one for one in (*self._served, *self._waiting) if now_ns >= one.deadline_ns]
        self._served = [one for one in self._served if one not in late]
        self._waiting = [one for one in self._waiting if one not in late]
        if late:
            self._why_not_saved = "the disk does not answer"
        for one in late:
            one.then()

    @every(SAVE_AGAIN_S, clock="local")
    def save_again(self) -> None:
        """Save what the disk does not hold yet."""
        self._write()

    def _write(self) -> None:
        if self._is_writing or self._saved == self.is_set:
            return
        value = self.is_set
        self._served, self._waiting = self._waiting, []
        self._is_writing = True

        def written(error: OSError | None) -> None:
            self._is_writing = False
            self._saved = value if error is None else None
            self._why_not_saved = "" if error is None else reason_of(error)
            if error is not None:
                self._service.count("state/not_saved")
                self._service.log.limited(
                    LATCH_FILE, "Not saved", file=LATCH_FILE, why=self._why_not_saved
                )
            served, self._served = self._served, []
            for one in served:
                one.then()
            if self._waiting or (error is None and self.is_set != value):
                self._write_next()

        self._service.save(LATCH_FILE, SavedLatch(stopped=value), written)

    def _write_next(self) -> None:
        if self._saved == self.is_set:  # it was changed, and changed back
            waiting, self._waiting = self._waiting, []
            for one in waiting:
                one.then()
        self._write()
