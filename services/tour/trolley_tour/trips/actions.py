"""What a trip asks its runner to do."""

import dataclasses

from trolley.messages.request_params import SendGoal


@dataclasses.dataclass(frozen=True, slots=True)
class Send:
    """Ask the planner for this goal."""

    goal: SendGoal


@dataclasses.dataclass(frozen=True, slots=True)
class Cancel:
    """Ask the planner to cancel the goal of this id."""

    goal_id: str


@dataclasses.dataclass(frozen=True, slots=True)
class Pause:
    """Ask the planner to pause the goal of this id."""

    goal_id: str


Action = Send | Cancel | Pause
