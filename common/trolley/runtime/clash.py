"""The clash rule: of two processes of one service, the one that was there first stays.

Each shows a liveliness token that names host, process and start, and reads those of the others of
its name; who has seen an older one asks it, and ends when it answers.
"""

import dataclasses
import os
import re
import socket
import threading
import time
from collections.abc import Callable

from trolley import topics
from trolley.messages import Health
from trolley.runtime import codec
from trolley.runtime.bus import Query, Reply
from trolley.runtime.zenoh_bus import ZenohBus

ASK_S = 1.0
"""How long an older process may take to answer."""
ASK_AGAIN_S = 2.0
"""Who shows a token and does not answer is asked again after this long."""
SHOWN_S = 0.5
"""How long the router may take to say who shows a token; then it is asked again."""
TOLD_S = 1.5
"""One that starts waits at most this long for the router to say it."""
ANSWER_S = 5.0
"""One that starts waits this long for those that show a token to answer for it."""


@dataclasses.dataclass(frozen=True, order=True)
class Run:
    """A process of a service; of two that both start, or both serve, the smaller stays.

    It began first, unless the clocks of their hosts differ.
    """

    started_ms: int
    host: str
    pid: int

    @classmethod
    def here(cls) -> "Run":
        """This process."""
        return cls(time.time_ns() // 1_000_000, host_name(), os.getpid())

    @classmethod
    def parse(cls, text: str) -> "Run | None":
        """Read `<host>-<pid>-<start>`, None where it is something else."""
        match = re.fullmatch(r"(.+)-([0-9]{1,18})-([0-9]{1,18})", text)
        return None if match is None else cls(int(match[3]), match[1], int(match[2]))

    def __str__(self) -> str:
        return f"{self.host}-{self.pid}-{self.started_ms}"


def host_name() -> str:
    """This host's name as it may stand in a key."""
    return re.sub(r"[^A-Za-z0-9_.-]", "-", socket.gethostname())[:32] or "host"


def label_of(service: str, *, one_per_host: bool) -> str:
    """The name in `health` and in the liveliness token: that of the host too where it matters."""
    return f"{service}-{host_name()}" if one_per_host else service


def is_one_per_host(label: str) -> bool:
    """Whether a label is that of a service which each host may run, such as a viewer."""
    return "-" in label


class OlderRuns:
    """The processes of this service that are alive now and came before this one.

    A token proves nothing: anybody can show one. A process counts only once it has answered `get`
    of `health/<label>` with its run, or without one, as Trolley did before it told runs. One that
    serves came before one that starts, whatever the clocks of their hosts say.

    Args:
        bus: Where tokens are shown.
        label: The service's name in keys.
        run: This process.
        met: Called, on any thread, when an older one appears or answers.
    """

    def __init__(
        self, bus: ZenohBus, robot: str, label: str, run: Run, met: Callable[[], None]
    ) -> None:
        self._bus = bus
        self._run = run
        self._met = met
        self._lock = threading.Lock()
        self._shown: dict[Run, float] = {}
        """Those that show a token, and since when (local monotonic time)."""
        self._answered: dict[str, bool] = {}
        """By run, whether it serves."""
        self._serves = False
        self._are_all_known = False
        """Whether the router has told of all that were there before, or has had the time to."""
        self._known_by_s = time.monotonic() + TOLD_S
        self._ask_at_s = 0.0
        self._key = topics.HEALTH.key(robot, label)
        self._early = bus.serve(self._key, self._answer)
        self._tokens = topics.ALIVE.key(robot, label, "*")
        bus.declare_token(topics.ALIVE.key(robot, label, str(run)))

    def serves(self) -> None:
        """Note that the service itself answers for its health from now on."""
        self._serves = True
        self._early.close()

    def _ask_router(self) -> None:
        """Ask the router who shows a token, until it has answered once; waits for the answer.

        Only then are they watched: of what is watched Zenoh tells at once who is there as far as it
        has heard by then, which is nobody, without asking the router.
        """
        if self._are_all_known:
            return
        began_s = time.monotonic()
        for key in self._bus.alive(self._tokens, SHOWN_S):
            self._see(key, True)
        now_s = time.monotonic()
        self._are_all_known = now_s - began_s < SHOWN_S or now_s >= self._known_by_s
        if self._are_all_known:
            self._bus.watch_tokens(self._tokens, self._see)

    def ask(self) -> None:
        """Ask those that show a token for their run, where that is due; never waits."""
        if not self._shown:
            return
        now_s = time.monotonic()
        with self._lock:
            if not self._shown or now_s < self._ask_at_s:
                return
            self._ask_at_s = now_s + ASK_AGAIN_S
        self._bus.get(f"{self._key}?format=msgpack", b"", "", ASK_S, self._hear, lambda: None)

    def oldest(self) -> Run | None:
        """The oldest of them that has answered, None if there is none."""
        if not self._shown:
            return None
        with self._lock:
            return min(filter(self._came_before, self._shown), default=None)

    def settle(self) -> bool:
        """Whether everybody who shows a token has answered for it, or has had the time to.

        Asks the router who does, and waits for its answer.
        """
        self._ask_router()
        if not self._are_all_known:
            return False
        now_s = time.monotonic()
        with self._lock:
            return "" in self._answered or all(
                str(run) in self._answered or now_s - since_s > ANSWER_S
                for run, since_s in self._shown.items()
            )

    def _came_before(self, other: Run) -> bool:
        serves = self._answered.get(str(other), self._answered.get(""))
        if serves is None:
            return False
        return other < self._run if serves == self._serves else serves

    def _see(self, key: str, is_there: bool) -> None:
        other = Run.parse(key.rpartition("/")[2])
        if other is None or other == self._run:
            return
        with self._lock:
            if is_there:
                self._shown.setdefault(other, time.monotonic())
                self._ask_at_s = 0.0
            else:
                self._shown.pop(other, None)
                self._answered.pop(str(other), None)
                self._answered.pop("", None)
        if is_there:
            self._met()

    def _answer(self, query: Query) -> None:
        """Answer for this run, on a thread of the bus: the service itself is not up yet."""
        fmt = codec.format_asked(codec.parse_parameters(query.parameters), "json")
        health = Health(stamp_ns=0, state="starting", run=str(self._run))
        query.reply(self._key, codec.encode(health, fmt), codec.MIME[fmt])
        query.finish()

    def _hear(self, reply: Reply) -> None:
        if reply.is_error:
            return
        try:
            health = codec.decode(Health, reply.payload, reply.encoding)
        except codec.BadPayload:
            return
        if health.run == str(self._run):
            return
        with self._lock:
            self._answered[health.run] = health.state != "starting"
        self._met()
