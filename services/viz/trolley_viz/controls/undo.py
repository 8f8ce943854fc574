"""Undo: what was done last in one browser, and how to take it back."""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Generic, Literal, TypeVar

from msgspec.structs import replace

from trolley.messages import SavedPose, Tour, Zone
from trolley_viz.words.sentences import Tell

MAX_STEPS = 30
Kind = Literal["drive", "map", "place", "tour", "zone"]
"""What a step is about; each is offered where the like is done."""
T = TypeVar("T", bound=SavedPose | Tour | Zone)


@dataclass(frozen=True)
class Change(Generic[T]):
    """Something that is stored by name, before and after; None where there is none."""

    before: T | None
    after: T | None

    def reversed(self, stored: Callable[[str], T | None]) -> "Change[T]":
        """The change that takes this one back; a place stays where the mapper has moved it to."""
        before, after = self.before, self.after
        if isinstance(before, SavedPose) and isinstance(after, SavedPose):
            now = stored(after.name)
            if isinstance(now, SavedPose) and before.pose == after.pose:
                before = replace(before, pose=now.pose, map=now.map)
        return Change(after, before)

    def is_overtaken(self, stored: Callable[[str], T | None], tell: Tell) -> bool:
        """Whether something else is stored since then; the person is told of it."""
        left: dict[str, T | None] = {}
        if self.before is not None:
            left[self.before.name] = None
        if self.after is not None:
            left[self.after.name] = self.after
        other = next((name for name, one in left.items() if not _is_same(stored(name), one)), None)
        if other is not None:
            tell("Not undone", f"Somebody else has changed “{other}” since then.", "warn")
        return other is not None


def _is_same(now: SavedPose | Tour | Zone | None, then: SavedPose | Tour | Zone | None) -> bool:
    """Whether nobody has changed it; the mapper moves places and keeps when they were saved."""
    if isinstance(now, SavedPose) and isinstance(then, SavedPose):
        return now == replace(then, pose=now.pose, map=now.map)
    return now == then


@dataclass(frozen=True, eq=False)
class Step:
    """Something that was done.

    Args:
        kind: what it is about.
        title: what was done, in a few words.
        undo: takes it back.
        holds: whether it can be taken back still; what has been overtaken cannot.
    """

    kind: Kind
    title: str
    undo: Callable[[], None]
    holds: Callable[[], bool] = lambda: True


class History:
    """What a person did; the last step is undone first."""

    def __init__(self) -> None:
        self._steps: list[Step] = []

    def add(self, step: Step) -> None:
        """Remember a step; the oldest are forgotten."""
        self._steps = [*self._steps[-(MAX_STEPS - 1) :], step]

    def clear(self) -> None:
        """Forget all, as when another robot is followed."""
        self._steps.clear()

    def last(self, kind: Kind | None = None) -> Step | None:
        """Return the step that `undo` takes back; those that have been overtaken are dropped."""
        while (step := self._newest(kind)) is not None and not step.holds():
            self._steps.remove(step)
        return step

    def undo(self, kind: Kind | None = None) -> None:
        """Take the last step back, or the last one of a kind."""
        if (step := self.last(kind)) is not None:
            self._steps.remove(step)
            step.undo()

    def _newest(self, kind: Kind | None) -> Step | None:
        fitting = (one for one in reversed(self._steps) if kind in (None, one.kind))
        return next(fitting, None)
