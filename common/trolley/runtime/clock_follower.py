"""Follows the clocks of robots; what cannot be true is not believed without asking their bases."""

from collections.abc import Callable, Iterable

from trolley import topics
from trolley.messages import Clock
from trolley.runtime import codec
from trolley.runtime.bus import Reply
from trolley.runtime.context import Context

ANSWER_S = 1.0
"""How long base may take to answer for a message."""
ASK_AGAIN_NS = 100_000_000
"""After a message that proved wrong, base is not asked again for this long [ns]."""

IMPLAUSIBLE = "clock/implausible"
"""Counts the messages that were not believed."""


class ClockFollower:
    """Takes in `clock` messages: those that follow from the ones before, others after asking.

    A message of another epoch or rate, or one that would move robot time by more than 2 s against
    what arrival times allow, counts only if base itself, asked for its clock, gives the same.

    Args:
        context: the service's.
        began: called with the robot and its new epoch when one began.
    """

    def __init__(self, context: Context, began: Callable[[str, int], None]) -> None:
        self._context = context
        self._began = began
        self._wrong_ns: dict[str, int] = {}
        self._asking: set[str] = set()

    def hear(self, robot: str, clock: Clock, arrived_ns: int) -> None:
        """Take in a message of a robot, at once or when its base has answered."""
        followed = self._context.clocks.followed(robot)
        if followed.follows(clock, arrived_ns):
            before_ns = followed.now(arrived_ns)
            followed.update(clock, arrived_ns)  # of the epoch that is known
            if followed.now(arrived_ns) != before_ns:
                self._context.timers.look_again()
        elif robot in self._asking:
            return
        elif arrived_ns - self._wrong_ns.get(robot, arrived_ns - ASK_AGAIN_NS) < ASK_AGAIN_NS:
            self._context.count(IMPLAUSIBLE)
        else:
            self._ask(robot, clock, arrived_ns)

    def _ask(self, robot: str, clock: Clock, arrived_ns: int) -> None:
        self._asking.add(robot)

        def finish(replies: list[Reply], timed_out: bool) -> None:
            self._asking.discard(robot)
            self._settle(robot, clock, arrived_ns, replies, timed_out)

        key = topics.CLOCK.key(robot)
        if "?" in key or "#" in key:  # no such robot can be asked
            finish([], False)
        else:
            self._context.ask(f"{key}?format=msgpack", ANSWER_S, finish)

    def _settle(
        self, robot: str, clock: Clock, arrived_ns: int, replies: list[Reply], timed_out: bool
    ) -> None:
        followed, now_ns = self._context.clocks.followed(robot), self._context.inbox.now_ns()
        settled = followed.settle(clock, arrived_ns, told(replies), now_ns, timed_out=timed_out)
        self._context.timers.look_again()
        if settled.began:
            self._began(robot, followed.epoch)
        if settled.is_believed:
            return
        self._wrong_ns[robot] = now_ns
        self._context.count(IMPLAUSIBLE)
        self._context.log.limited(
            IMPLAUSIBLE,
            "Dropped",
            key=topics.CLOCK.key(robot),
            why="robot time cannot have jumped like this, and base does not confirm it",
            stamp_ns=clock.stamp_ns,
            epoch=clock.epoch,
            rate=clock.rate,
        )


def told(replies: Iterable[Reply]) -> list[Clock]:
    """What bases said of their clocks."""
    return [clock for reply in replies if (clock := _decoded(reply)) is not None]


def _decoded(reply: Reply) -> Clock | None:
    if reply.is_error or topics.CLOCK.match(reply.key) is None:
        return None
    try:
        return codec.decode(Clock, reply.payload, reply.encoding)
    except codec.BadPayload:
        return None
