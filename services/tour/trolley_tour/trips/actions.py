"""What a trip asks its service to do, and the limits it keeps."""

import dataclasses

from trolley.messages.request_params import SendGoal


@dataclasses.dataclass(frozen=True)
class Send:
    """Ask the planner for this goal."""

    goal: SendGoal


@dataclasses.dataclass(frozen=True)
class Cancel:
    """Ask the planner to give up the goal of this id."""

    goal_id: str


@dataclasses.dataclass(frozen=True)
class Pause:
    """Ask the planner to pause the goal of this id."""

    goal_id: str


Action = Send | Cancel | Pause


@dataclasses.dataclass(frozen=True)
class Limits:
    """What the configuration says about trips."""

    stop_timeout_s: float = 300.0
    retry_wait_s: float = 2.0
