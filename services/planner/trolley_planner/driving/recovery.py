"""Recovery behaviours in the order of their effort, for a robot that makes no progress.

Each is bounded; the robot gives up when none has helped.
"""

import math
from collections.abc import Callable
from dataclasses import dataclass
from enum import Enum

from trolley.config import PlannerConfig


@dataclass(frozen=True, slots=True)
class RecoveryParams:
    """Bounds of recovery; by hand."""

    free_after_m: float = 0.5
    """Progress beyond the best so far after which the behaviours start over."""
    detour_m: float = 2.0
    """Extra length from which on a new path is a detour; progress is then measured from there."""
    most_detours: int = 2
    """Number of detours per goal on which progress is measured from there."""
    most_actions: int = 15
    """Number of recovery behaviours per goal after which the goal fails."""
    excused_factor: int = 5
    """Multiple of `give_up_s` after which the goal fails even if the robot only stood for people.
    """


RECOVERY = RecoveryParams()


class RecoveryAction(Enum):
    """Recovery behaviours."""

    WAIT = "wait"
    CLEAR = "clear"
    BACK_UP = "back up"
    TURN = "turn"
    REROUTE = "another route"
    WAIT_LONGER = "wait longer"


RECOVERY_SEQUENCE = (
    RecoveryAction.WAIT,
    RecoveryAction.CLEAR,
    RecoveryAction.BACK_UP,
    RecoveryAction.TURN,
    RecoveryAction.REROUTE,
    RecoveryAction.WAIT_LONGER,
)
"""Recovery behaviours in the order in which they are tried; the last is repeated."""
MOVES = (RecoveryAction.BACK_UP, RecoveryAction.TURN, RecoveryAction.REROUTE)
"""Recovery behaviours that are skipped where the robot has no room for them."""


class Recovery:
    """Which recovery behaviour comes next, and when to give up."""

    def __init__(self, config: PlannerConfig) -> None:
        self.set_config(config)
        self._step = -1
        self._since_ns: int | None = None
        self._excused_ns = 0
        self._began_ns = 0
        self._best_m = self._left_m = math.inf
        self._num_detours = 0
        self._num_spent = 0
        self._goal_moves = self._goal_moved = False
        self.count = 0
        """Actions since the goal was sent, waits included."""
        self.current: RecoveryAction | None = None
        """What is being tried."""

    def set_config(self, config: PlannerConfig) -> None:
        """Apply other settings from now on."""
        self._give_up_ns = round(config.give_up_s * 1e9)
        self._patience_ns = round(config.patience_s * 1e9)

    def update_remaining(self, remaining_m: float) -> None:
        """Record the remaining length of the path: progress ends recovery."""
        self._left_m = remaining_m
        if remaining_m < self._best_m - RECOVERY.free_after_m:
            self._step, self._since_ns, self._excused_ns = -1, None, 0
            self._best_m = remaining_m
            if self._goal_moves:
                self._num_spent = self._num_detours = 0
        elif math.isinf(self._best_m):
            self._best_m = remaining_m

    def update_path_length(self, remaining_m: float) -> None:
        """Record the length of a new path; on a detour progress restarts there, a few times."""
        if self._goal_moved:
            self._goal_moved = False
            if math.isfinite(self._left_m):
                self._best_m += remaining_m - self._left_m
            return
        is_detour = remaining_m > self._best_m + RECOVERY.detour_m
        if is_detour and self._num_detours < RECOVERY.most_detours:
            self._num_detours += 1
            self._best_m = remaining_m

    def move_goal(self) -> None:
        """Note that the goal moves, as behind a person who walks on.

        What its next path is longer or shorter by is no step back and no progress. There is no end
        to such a goal, so that the bounds hold for each hold-up by itself.
        """
        self._goal_moves = self._goal_moved = True

    def begin_next(
        self, now_ns: int, is_possible: Callable[[RecoveryAction], bool]
    ) -> RecoveryAction | None:
        """Begin the next possible behaviour; None when it is time to give up.

        Args:
            now_ns: robot time.
            is_possible: asked before an action that moves the robot or changes its path.
        """
        if self._since_ns is None:
            self._since_ns = now_ns
        lasted_ns = now_ns - self._since_ns
        own_ns = lasted_ns - self._excused_ns
        longest_ns = RECOVERY.excused_factor * self._give_up_ns
        is_enough = own_ns > self._give_up_ns or lasted_ns > longest_ns
        if is_enough or self._num_spent >= RECOVERY.most_actions:
            return None
        self._step = min(self._step + 1, len(RECOVERY_SEQUENCE) - 1)
        while RECOVERY_SEQUENCE[self._step] in MOVES and not is_possible(
            RECOVERY_SEQUENCE[self._step]
        ):
            self._step += 1
        self._began_ns = now_ns
        self.count += 1
        self._num_spent += 1
        self.current = RECOVERY_SEQUENCE[self._step]
        return self.current

    def end(self) -> None:
        """End the current behaviour."""
        self.current = None

    def forgive(self, now_ns: int) -> None:
        """End a wait for something that went away by itself: neither it nor its time counts."""
        self._num_spent -= 1
        self._step -= 1
        self.excuse(now_ns - self._began_ns)
        self.end()

    def excuse(self, time_ns: int) -> None:
        """Leave out a time in which the robot stood for somebody."""
        if self._since_ns is not None:
            self._excused_ns += time_ns

    def elapsed_s(self, now_ns: int) -> float:
        """Return how long the current behaviour has lasted [s]."""
        return (now_ns - self._began_ns) * 1e-9

    def is_patient(self, now_ns: int) -> bool:
        """Say whether the current wait goes on."""
        factor = 2 if self.current is RecoveryAction.WAIT_LONGER else 1
        return now_ns - self._began_ns < factor * self._patience_ns
