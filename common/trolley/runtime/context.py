"""What the parts of a service's wire share: bus, inbox, timers, clocks, log and counters."""

import dataclasses
from collections.abc import Callable

from trolley.runtime.bus import Bus, Reply
from trolley.runtime.inbox import Inbox
from trolley.runtime.log import Log
from trolley.runtime.replies import Replies
from trolley.runtime.robot_time import RobotClocks
from trolley.runtime.timers import Timers


@dataclasses.dataclass(frozen=True)
class Context:
    """One service on one bus."""

    robot: str
    bus: Bus
    inbox: Inbox
    log: Log
    clocks: RobotClocks
    timers: Timers = dataclasses.field(default_factory=Timers)
    counters: dict[str, int] = dataclasses.field(default_factory=dict[str, int])
    figures: dict[str, float] = dataclasses.field(default_factory=dict[str, float])

    def count(self, name: str, number: int = 1) -> None:
        """Add to a counter."""
        self.counters[name] = self.counters.get(name, 0) + number

    def after(self, seconds: float, call: Callable[[], None]) -> None:
        """Call once, in `seconds` of local time."""
        self.timers.at(self.inbox.now_ns() + int(seconds * 1e9), call)

    def ask(
        self,
        selector: str,
        timeout_s: float,
        finish: Callable[[list[Reply], bool], None],
        payload: bytes = b"",
        encoding: str = "",
    ) -> None:
        """Get from the bus; `finish` hears the replies, and whether time ran out before the last.

        `finish` is called once, on the service's thread.
        """
        replies = Replies(self.inbox, finish)
        self.after(timeout_s, lambda: replies.finish(timed_out=True))
        self.bus.get(selector, payload, encoding, timeout_s, replies.add, replies.complete)
