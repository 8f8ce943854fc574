"""Driving with the joystick on the screen: commands to the robots, their state to the pads."""

from collections.abc import Callable
from dataclasses import replace

from msgspec import Struct

from trolley import teleop, topics
from trolley.messages import VelocityCommand
from trolley.runtime.service import Service
from trolley_viz.joystick.joystick import Grip, Joystick
from trolley_viz.robots.fleet import Robots
from trolley_viz.robots.view import View
from trolley_viz.words.sentences import StatusLine, Tone, aged, away_line, base_line, goal_line

SOMEBODY_ELSE = StatusLine(
    "Somebody else is driving", "warn", "Let go, and press again when they are done."
)


class PadState(Struct, frozen=True, kw_only=True):
    """What a browser is sent: whether it may drive, how fast [m/s], and a sentence."""

    can: bool
    mine: bool
    max_speed: float
    text: str
    tone: Tone


class _DrivenRobot:
    """A robot that a joystick drives or may drive: who holds it, and the ramp of its speed."""

    def __init__(self) -> None:
        self.joystick = Joystick()
        self.ramp = teleop.Hand()
        self.stamp_ns = 0


class Teleop:
    """The joysticks of all browsers: each drives the robot that its browser follows.

    Args:
        service: publishes, and knows the time.
        driven_by: by whom it is driven at a page, "" where there is nothing to tell it by.
    """

    def __init__(self, service: Service, robots: Robots, driven_by: Callable[[int], str]) -> None:
        self._service = service
        self._robots = robots
        self._driven_by = driven_by
        self._driven: dict[str, _DrivenRobot] = {}
        self._held: dict[int, str] = {}
        """The pages that hold their pad: for which robot they pressed it, "" once it was taken."""

    def hear(self, who: int, robot: str, grip: Grip) -> None:
        """Take what a page says of its joystick, which is that of a robot."""
        now_ns = self._service.monotonic_ns
        driven = self._driven.setdefault(robot, _DrivenRobot())
        if not grip.held:
            self._held.pop(who, None)
            for one in self._driven.values():
                one.joystick.hear(who, grip, now_ns)
        elif self._held.setdefault(who, robot) == robot:
            driven.joystick.hear(who, grip, now_ns)

    def let_go(self, who: int) -> None:
        """Take the joystick out of a page's hand, as when it follows another robot."""
        if who not in self._held:
            return
        self._held[who] = ""
        for driven in self._driven.values():
            driven.joystick.bar(who)

    def leave(self, who: int) -> None:
        """Forget a page that is gone."""
        self._held.pop(who, None)
        for driven in self._driven.values():
            driven.joystick.leave(who)

    def drive(self) -> bool:
        """Send what the joysticks want now; called at the rate of commands while this is true."""
        wants = [self._drive(robot, driven) for robot, driven in self._driven.items()]
        return any(wants)  # each has had its turn

    def _drive(self, name: str, driven: _DrivenRobot) -> bool:
        """Send what one joystick wants; returns whether it wants anything."""
        now_ns, robot = self._service.monotonic_ns, self._robots.get(name)
        if not self._can_drive(name):
            driven.joystick.drop()
        wanted = None if robot is None else driven.joystick.wanted(robot, now_ns)
        twist = driven.ramp.step(wanted, now_ns)
        stamp_ns = None if twist is None else self._robot_ns(name)
        if twist is None or stamp_ns is None:
            return twist is not None
        driven.stamp_ns = max(stamp_ns, driven.stamp_ns + 1)  # base drops what is not newer
        command = VelocityCommand(stamp_ns=driven.stamp_ns, twist=twist, valid_for=teleop.VALID_S)
        self._service.publish(topics.COMMAND, command, teleop.SOURCE, robot=name)
        return True

    def state(self, who: int, view: View) -> PadState:
        """Say whether a page may drive the robot that it sees, and what keeps it from that."""
        name = view.robot_name
        can, robot = self._can_drive(name), self._robots.get(name)
        driven = self._driven.get(name)
        holder = None if driven is None else driven.joystick.holder
        taken = None if holder is None or holder == who else self._taken_by(holder)
        words = away_line(view.away_s) if not can else taken or _obstacle(view)
        return PadState(
            can=can and taken is None,
            mine=holder == who,
            max_speed=0.0 if robot is None else robot.max_speed,
            text="" if words is None else f"{words.headline}. {words.detail}",
            tone="idle" if words is None else words.tone,
        )

    def _robot_ns(self, name: str) -> int | None:
        """The time of a robot [ns], None while its clock is silent."""
        return self._service.time_of(name).now(self._service.monotonic_ns)

    def _taken_by(self, holder: int) -> StatusLine:
        who = self._driven_by(holder)
        return replace(SOMEBODY_ELSE, headline=f"Driven {who}") if who else SOMEBODY_ELSE

    def _can_drive(self, name: str) -> bool:
        return self._robots.get(name) is not None and self._robot_ns(name) is not None


def _obstacle(view: View) -> StatusLine | None:
    """What keeps the robot from driving."""
    base, goal = view.streams.latest(topics.BASE), view.streams.latest(topics.GOAL)
    words = base_line(base, goes_on=True)
    if words is not None:
        return aged(words, view.overdue_s(topics.BASE))
    if goal is not None and goal.state == "paused":
        return goal_line(goal, [])
    return None
