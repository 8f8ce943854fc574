"""A planner of one's own in place of Trolley's: it turns to the goal and drives straight there.

Run the others without it, and this beside them:

    trolley up --without planner
    python examples/own_planner.py

Whatever it commands, `base` keeps to its limits and stop field, and stops the robot if this dies.
"""

import math

from trolley import codes, requests, topics
from trolley.codes import Refused
from trolley.config import RobotConfig
from trolley.geometry import Pose2D, Twist2D, wrap_angle
from trolley.messages import GoalStatus, PoseEstimate, VelocityCommand
from trolley.messages.request_params import SendGoal, WhichGoal
from trolley.runtime.service import Service, answers, every, on

SPEED, TURN = 0.2, 0.6
"""How fast it drives [m/s] and turns [rad/s]."""
AIMED = 0.2
"""It drives once the goal is this straight ahead [rad]."""


class StraightPlanner(Service):
    """Owns the goal; its name makes it the planner for all others."""

    name = "planner"

    def __init__(self, config: RobotConfig) -> None:
        self._pose: PoseEstimate | None = None
        self._goal = GoalStatus(stamp_ns=0, id=None, state="idle")
        self._tolerance = 0.05

    def start(self) -> None:
        """Say that there is no goal; the runtime answers who asks for it later."""
        self.publish(topics.GOAL, self._goal)

    @on(topics.POSE)
    def on_pose(self, pose: PoseEstimate) -> None:
        """Keep where the robot is."""
        self._pose = pose

    @answers(requests.GOAL_SEND)
    def send_goal(self, params: SendGoal) -> GoalStatus:
        """Drive to a pose of the map."""
        if params.pose is None:
            raise Refused(codes.UNKNOWN_NAME, "This planner knows no places: give x and y.")
        self._tolerance = params.xy_tolerance
        return self._set("driving", params.id or self.new_id(), params.pose)

    @answers(requests.GOAL_CANCEL)
    def cancel_goal(self, params: WhichGoal) -> GoalStatus:
        """End the goal."""
        if self._goal.state != "driving" or params.id not in (None, self._goal.id):
            raise Refused(codes.NOT_CURRENT)
        return self._set("canceled", self._goal.id, self._goal.pose, codes.CANCELED)

    @every(0.1)
    def drive(self) -> None:
        """Command the velocity for this moment."""
        goal, estimate = self._goal.pose, self._pose
        if self._goal.state != "driving" or goal is None or self.now_ns is None:
            return
        if estimate is None or estimate.pose is None or estimate.state != "localized":
            return  # never drive lost
        away = estimate.pose.distance_to(goal)
        if away <= self._tolerance:
            self._set("arrived", self._goal.id, goal)
            return
        here = estimate.pose
        turn = wrap_angle(math.atan2(goal.y - here.y, goal.x - here.x) - here.yaw)
        ahead = min(SPEED, away) if abs(turn) < AIMED else 0.0
        twist = Twist2D(ahead, 0.0, max(-TURN, min(TURN, 2.0 * turn)))
        self._command(twist)
        self.publish(topics.GOAL, self._goal)

    def _command(self, twist: Twist2D) -> None:
        command = VelocityCommand(stamp_ns=self.stamp_ns, twist=twist, valid_for=0.25)
        self.publish(topics.COMMAND, command, "planner")

    def _set(self, state: str, goal: str | None, pose: Pose2D | None, why: str = "") -> GoalStatus:
        self._goal = GoalStatus(
            stamp_ns=self.stamp_ns,
            id=goal,
            state=state,  # pyrefly: ignore[bad-argument-type]
            pose=pose,
            reason=why,
        )
        self.publish(topics.GOAL, self._goal)
        if state != "driving":
            self._command(Twist2D(0.0, 0.0, 0.0))  # it stands because it is told to, not for want
        return self._goal


if __name__ == "__main__":
    from trolley.runtime.process import main

    main(StraightPlanner)
