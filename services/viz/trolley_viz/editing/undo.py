"""Undo: what was done last in one browser, and how to take it back."""

from collections.abc import Callable
from dataclasses import dataclass

MAX_STEPS = 30


@dataclass(frozen=True)
class Step:
    """Something that was done.

    Args:
        title: what was done, in a few words.
        undo: takes it back.
        holds: whether it can be taken back still; what has been overtaken cannot.
    """

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

    @property
    def last(self) -> Step | None:
        """The step that `undo` takes back; those that have been overtaken are dropped."""
        while self._steps and not self._steps[-1].holds():
            self._steps.pop()
        return self._steps[-1] if self._steps else None

    def undo(self) -> None:
        """Take the last step back."""
        if (step := self.last) is not None:
            self._steps.pop()
            step.undo()
