"""Messages of the planner: the goal and how it goes, the path, the trajectory."""

from typing import Annotated, Literal

from msgspec import Meta, Struct

from trolley.geometry.pose import Pose2D
from trolley.messages.types import Count, NonNegative, Point, StampNs, check_floats

GoalId = Annotated[str, Meta(pattern=r"\A[a-z0-9-]{1,36}\Z")]
GoalState = Literal[
    "idle", "planning", "driving", "recovering", "paused", "arrived", "failed", "canceled"
]


class GoalStatus(Struct, frozen=True, kw_only=True):
    """The state of the current goal. Owned by `planner`, on change and at 5 Hz while it drives.

    `pose` is the goal in `frame`; `distance_remaining` [m] along the path, `eta` and `elapsed` [s];
    `recoveries` counts attempts to get free; `blocked` are the points [m] in `frame` that are in
    the way. If the robot is following somebody, `person` is where they were last seen, in `frame`,
    and `pose`, the spot behind them that it drives to, moves with them. `warning` is the code of an
    objection to a goal that the robot drives to all the same: `in_passage`.
    """

    stamp_ns: StampNs
    id: str | None
    state: GoalState
    reason: str = ""
    message: str = ""
    frame: str = "map"
    pose: Pose2D | None = None
    distance_remaining: NonNegative | None = None
    eta: NonNegative | None = None
    elapsed: NonNegative = 0.0
    recoveries: Count = 0
    blocked: list[Point] = []
    person: Point | None = None
    warning: str = ""


class Path(Struct, frozen=True, kw_only=True):
    """Poses float32 (N, 3) x, y, yaw in `frame`; `dt` [s] from one to the next, 0 = no times."""

    stamp_ns: StampNs
    frame: str
    poses: memoryview
    dt: NonNegative = 0.0

    def __post_init__(self) -> None:
        """Refuse poses that are not float32 triples."""
        check_floats("Path", "poses", self.poses, 3)
