"""What a service says about itself: state, message, counters and load, at 1 Hz and on change."""

from collections.abc import Callable
from typing import Literal

import msgspec

from trolley import topics
from trolley.messages import Health
from trolley.runtime.context import Context
from trolley.runtime.serving import Server

State = Literal["starting", "ok", "degraded", "failed"]


class HealthReporter:
    """Publishes `health/<label>`; `usage` gives the share of a core and the resident bytes."""

    def __init__(
        self,
        context: Context,
        server: Server,
        label: str,
        usage: Callable[[], tuple[float, int]],
        run: str,
    ) -> None:
        self.latest = Health(stamp_ns=0, state="starting", run=run)
        """What was published last, or is to be published first."""
        self._context = context
        self._server = server
        self._label = label
        self._usage = usage
        self._began_ns = context.inbox.now_ns()

    def set(self, state: State, message: str = "") -> None:
        """Set state and message; a change is published at once."""
        if (self.latest.state, self.latest.message) != (state, message):
            self.latest = msgspec.structs.replace(self.latest, state=state, message=message)
            self._publish()

    def measure(self) -> None:
        """Measure the load and publish."""
        cpu, rss = self._usage()
        self.latest = msgspec.structs.replace(self.latest, cpu=cpu, rss=rss)
        self._publish()

    def _publish(self) -> None:
        context = self._context
        counters = dict(context.counters)
        if context.inbox.dropped:
            counters["inbox/dropped"] = context.inbox.dropped
        now_ns = context.inbox.now_ns()
        self.latest = msgspec.structs.replace(
            self.latest,
            stamp_ns=context.clocks.own.now(now_ns) or 0,
            counters=counters,
            up=round((now_ns - self._began_ns) * 1e-9, 3),
            figures=dict(context.figures),
        )
        self._server.publish(topics.HEALTH, self.latest, (self._label,))
