"""Driving the shown robot with the joystick: commands to it, words to the browsers."""

from collections.abc import Callable

from trolley import teleop, topics
from trolley.messages import BaseState, GoalStatus, VelocityCommand
from trolley.runtime.service import Service
from trolley_viz.joystick.grips import Grip, Joystick
from trolley_viz.joystick.sockets import Sockets, Word
from trolley_viz.robots import Robots
from trolley_viz.words import AWAY, Words, base_words, goal_words

SOMEBODY_ELSE = Words("Somebody else drives", "warn", "Let go and press again when they are done.")


class ByHand:
    """The joystick as part of the viewer.

    Args:
        service: publishes, and knows the time.
        robots: the robot that is shown is the one that is driven.
        robot_ns: the time of a robot [ns], None while its clock is silent.
    """

    def __init__(
        self, service: Service, robots: Robots, robot_ns: Callable[[str], int | None]
    ) -> None:
        self._service = service
        self._robots = robots
        self._robot_ns = robot_ns
        self._joystick = Joystick()
        self._hand = teleop.Hand()
        self._driven = ""
        """The robot that the hand drives, or drove last."""
        self._stamp_ns = 0
        self.sockets = Sockets(service.call_soon, self._said, self._joystick.leave)

    def drop(self) -> None:
        """Take the joystick out of whoever's hand, as when another robot is shown."""
        self._joystick.drop()

    def drive(self) -> None:
        """Send what the joystick wants now; called at the rate of commands."""
        now_ns = self._service.monotonic_ns
        if not self._can_drive():
            self._joystick.drop()
        robot = self._robots.robot
        wanted = None if robot is None else self._joystick.wanted(robot, now_ns)
        if wanted is not None:
            self._driven = self._robots.selected
        twist = self._hand.step(wanted, now_ns)
        stamp_ns = None if twist is None else self._robot_ns(self._driven)
        if twist is None or stamp_ns is None:
            return
        self._stamp_ns = max(stamp_ns, self._stamp_ns + 1)  # base drops what is not newer
        command = VelocityCommand(stamp_ns=self._stamp_ns, twist=twist, valid_for=teleop.VALID_S)
        self._service.publish(topics.COMMAND, command, teleop.SOURCE, robot=self._driven)

    def tell(self, base: BaseState | None, goal: GoalStatus | None) -> None:
        """Tell the browsers whether they may drive, and what keeps the robot from it."""
        can, holder = self._can_drive(), self._joystick.holder
        robot = self._robots.robot
        for who in self.sockets.who():
            is_taken = holder not in (None, who)
            words = AWAY if not can else SOMEBODY_ELSE if is_taken else self._words(base, goal)
            word = Word(
                can=can and not is_taken,
                mine=holder == who,
                max_speed=0.0 if robot is None else robot.max_speed,
                text="" if words is None else f"{words.headline}. {words.detail}",
                tone="idle" if words is None else words.tone,
            )
            self.sockets.tell(who, word)

    def _can_drive(self) -> bool:
        is_known = self._robots.robot is not None
        return is_known and self._robot_ns(self._robots.selected) is not None

    def _words(self, base: BaseState | None, goal: GoalStatus | None) -> Words | None:
        words = base_words(base)
        if words is None and goal is not None and goal.state == "paused":
            return goal_words(goal, [])
        return words

    def _said(self, who: int, grip: Grip) -> None:
        self._joystick.hear(who, grip, self._service.monotonic_ns)
