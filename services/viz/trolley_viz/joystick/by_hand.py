"""Driving with the joystick: commands to the robots, words to the browsers."""

from collections.abc import Callable, Mapping

from msgspec import Struct

from trolley import teleop, topics
from trolley.messages import VelocityCommand
from trolley.runtime.service import Service
from trolley_viz.joystick.grips import Grip, Joystick
from trolley_viz.robots import Robots
from trolley_viz.scene.layer import View
from trolley_viz.sockets import Sockets
from trolley_viz.words import AWAY, Tone, Words, base_words, goal_words

SOMEBODY_ELSE = Words("Somebody else drives", "warn", "Let go and press again when they are done.")


class Word(Struct, frozen=True, kw_only=True):
    """What a browser is told: whether it may drive, how fast [m/s], and what there is to say."""

    can: bool
    mine: bool
    max_speed: float
    text: str
    tone: Tone


class _Hand:
    """The hand on one robot."""

    def __init__(self) -> None:
        self.joystick = Joystick()
        self.hand = teleop.Hand()
        self.stamp_ns = 0


class ByHand:
    """The joysticks as part of the viewer: each browser drives the robot that it follows.

    Args:
        service: publishes, and knows the time.
        robots: what is known of each.
        robot_ns: the time of a robot [ns], None while its clock is silent.
        driven_by: the robot that a browser (viser's number for it) may drive, None for none.
    """

    def __init__(
        self,
        service: Service,
        robots: Robots,
        robot_ns: Callable[[str], int | None],
        driven_by: Callable[[int], str | None],
    ) -> None:
        self._service = service
        self._robots = robots
        self._robot_ns = robot_ns
        self._driven_by = driven_by
        self._hands: dict[str, _Hand] = {}
        self.sockets = Sockets(service.call_soon, Grip, self._said, self._left, operators_only=True)

    def let_go(self, client_id: int) -> None:
        """Take the joystick out of a browser's hand, as when it follows another robot."""
        for who, client in self.sockets.who().items():
            if client == client_id:
                for hand in self._hands.values():
                    hand.joystick.bar(who)

    def drive(self) -> None:
        """Send what the joysticks want now; called at the rate of commands."""
        for robot, hand in self._hands.items():
            self._drive(robot, hand)

    def tell(self, views: Mapping[str, View]) -> None:
        """Tell the browsers whether they may drive, and what keeps their robots from it."""
        for who, client_id in self.sockets.who().items():
            name = self._driven_by(client_id)
            view = None if name is None else views.get(name)
            if name is not None and view is not None:
                self.sockets.tell(who, self._word(who, name, view))

    def _drive(self, name: str, hand: _Hand) -> None:
        now_ns, robot = self._service.monotonic_ns, self._robots.get(name)
        if not self._can_drive(name):
            hand.joystick.drop()
        wanted = None if robot is None else hand.joystick.wanted(robot, now_ns)
        twist = hand.hand.step(wanted, now_ns)
        stamp_ns = None if twist is None else self._robot_ns(name)
        if twist is None or stamp_ns is None:
            return
        hand.stamp_ns = max(stamp_ns, hand.stamp_ns + 1)  # base drops what is not newer
        command = VelocityCommand(stamp_ns=hand.stamp_ns, twist=twist, valid_for=teleop.VALID_S)
        self._service.publish(topics.COMMAND, command, teleop.SOURCE, robot=name)

    def _word(self, who: int, name: str, view: View) -> Word:
        can, robot = self._can_drive(name), self._robots.get(name)
        hand = self._hands.get(name)
        holder = None if hand is None else hand.joystick.holder
        is_taken = holder not in (None, who)
        words = AWAY if not can else SOMEBODY_ELSE if is_taken else _obstacle(view)
        return Word(
            can=can and not is_taken,
            mine=holder == who,
            max_speed=0.0 if robot is None else robot.max_speed,
            text="" if words is None else f"{words.headline}. {words.detail}",
            tone="idle" if words is None else words.tone,
        )

    def _can_drive(self, name: str) -> bool:
        return self._robots.get(name) is not None and self._robot_ns(name) is not None

    def _said(self, who: int, client_id: int, grip: Grip) -> None:
        name = self._driven_by(client_id)
        if name is not None:
            hand = self._hands.setdefault(name, _Hand())
            hand.joystick.hear(who, grip, self._service.monotonic_ns)

    def _left(self, who: int) -> None:
        for hand in self._hands.values():
            hand.joystick.leave(who)


def _obstacle(view: View) -> Words | None:
    """What keeps the robot from driving."""
    words, goal = base_words(view.feeds.latest(topics.BASE)), view.feeds.latest(topics.GOAL)
    if words is None and goal is not None and goal.state == "paused":
        return goal_words(goal, [])
    return words
