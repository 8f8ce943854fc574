"""The sockets of the door: who comes, what they say first, and the bytes of those inside."""

import asyncio
import errno
import itertools
import signal
import socket
import time
from collections import Counter
from collections.abc import Callable, Sequence
from typing import cast

from trolley.runtime.door.admission import Admission, Guest, Limits, Stage, address_of
from trolley.runtime.door.hello import LONGEST_HELLO, is_hello
from trolley.runtime.log import Log
from trolley.supervision import Supervision

UNANSWERED_ALERT = 64
"""More bytes than TLS needs to send somebody away, once it has answered the hello."""
LONGEST_RETRY = 512
"""No `HelloRetryRequest` has more bytes, and no answer with a certificate has fewer: only to the
second does a guest reply with something of its own."""
ACCEPTED_AT_ONCE = 64
BREATH_S = 0.02
"""After so many the others have their turn: 3,200 connections a second cost an eighth of a core."""
WITHOUT_FILES_S = 0.2
TURN_S = 0.1
WAITING_BYTES = 64 * 1024
"""No more than this waits here for a slow link: what is old is of no use to a robot."""
TOLD_EVERY_S = 60.0
MOST_ADDRESSES = 1000
"""No more are counted from one report to the next."""
_IN_PASSING = {errno.ECONNABORTED, errno.EINTR, errno.EPROTO, errno.EPERM}
"""Troubles of one connection, not of this process (accept(2))."""
_AT_ONCE = b"\x01\x00\x00\x00\x00\x00\x00\x00"
"""`SO_LINGER` on, 0 s: closing frees everything now."""


_WHY = {
    Stage.SILENT: "silent",
    Stage.GREETED: "too_many",
    Stage.UNPROVEN: "no_certificate",
    Stage.PROVEN: "gone",
}
"""Fields of the log: why somebody was turned away."""


class _Visit:
    """A guest's connection: at first its socket and its first bytes, then both ends of a relay."""

    def __init__(self, guest: Guest, link: socket.socket) -> None:
        self.guest = guest
        self.link: socket.socket | None = link
        self.said = b""
        self.ends: list[_End] = []
        self.num_answered = 0
        self.num_after_reply = 0


class _End(asyncio.Protocol):
    """One end of a relay: what it receives goes out at the other, no faster than that takes it."""

    def __init__(self, received: Callable[[int], None], ended: Callable[[], None]) -> None:
        self.transport: asyncio.Transport | None = None
        self.other: _End | None = None
        self.is_lost = False
        self._received = received
        self._ended = ended

    @property
    def is_open(self) -> bool:
        return self.transport is not None and not self.transport.is_closing()

    def connection_made(self, transport: asyncio.BaseTransport) -> None:
        self.transport = cast(asyncio.Transport, transport)
        self.transport.set_write_buffer_limits(high=WAITING_BYTES)

    def data_received(self, data: bytes) -> None:
        self._received(len(data))
        if self.other is not None and self.other.transport is not None:
            self.other.transport.write(data)

    def pause_writing(self) -> None:
        if self.other is not None and self.other.transport is not None:
            self.other.transport.pause_reading()

    def resume_writing(self) -> None:
        if self.other is not None and self.other.transport is not None:
            self.other.transport.resume_reading()

    def connection_lost(self, exc: Exception | None) -> None:
        self.is_lost = True
        if self.other is not None and self.other.transport is not None:
            if exc is None:
                self.other.transport.close()
            else:
                self.other.transport.abort()
        self._ended()


class Door:
    """Stands at a listening socket and leads guests to the router.

    Args:
        listener: Listens for other hosts already.
        inside: Host and port of each of the router's own TLS endpoints, taken in turn.
        limits: How much room there is.
    """

    def __init__(
        self,
        listener: socket.socket,
        inside: Sequence[tuple[str, int]],
        limits: Limits | None = None,
    ) -> None:
        self._listener = listener
        self._inside = itertools.cycle(inside)
        self._admission = Admission(limits)
        self._visits: dict[Guest, _Visit] = {}
        self._tasks: set[asyncio.Task[None]] = set()
        self._loop = asyncio.get_running_loop()
        self._log = Log("door")
        self._turned_away: Counter[str] = Counter()
        self._from: Counter[str] = Counter()
        self._told_s = -TOLD_EVERY_S

    async def run(self) -> None:
        """Let guests in until SIGTERM comes."""
        supervision = Supervision()
        end = asyncio.Event()
        self._loop.add_signal_handler(signal.SIGTERM, end.set)
        self._listener.setblocking(False)
        self._loop.add_reader(self._listener.fileno(), self._accept)
        supervision.ready()
        next_alive_s = 0.0
        try:
            while not end.is_set():
                now_s = time.monotonic()
                if supervision.period_s is not None and now_s >= next_alive_s:
                    supervision.alive()
                    next_alive_s = now_s + supervision.period_s
                self._admission.drop_overdue(now_s)
                self._let_in()
                self._tell(now_s)
                await asyncio.sleep(TURN_S)
        finally:
            self._loop.remove_reader(self._listener.fileno())
            for visit in [*self._visits.values()]:
                self._end(visit)

    def _accept(self) -> None:
        for _ in range(ACCEPTED_AT_ONCE):
            try:
                link, where = self._listener.accept()
            except BlockingIOError:
                return
            except OSError as problem:
                if problem.errno in _IN_PASSING:
                    continue
                self._log.limited("accept", "Cannot take more connections", why=problem.strerror)
                self._pause(WITHOUT_FILES_S)
                return
            link.setblocking(False)
            guest = self._admission.arrive(address_of(where[0]), time.monotonic())
            self._visits[guest] = _Visit(guest, link)
            self._loop.add_reader(link.fileno(), self._listen_to, self._visits[guest])
            self._show_out()
            # What waited to be taken has mostly greeted by now: heard only later, it would have to
            # go as a silent one for those who are taken with it.
            if guest in self._visits:
                self._listen_to(self._visits[guest])
        self._pause(BREATH_S)

    def _pause(self, seconds: float) -> None:
        self._loop.remove_reader(self._listener.fileno())
        self._loop.call_later(seconds, self._loop.add_reader, self._listener.fileno(), self._accept)

    def _listen_to(self, visit: _Visit) -> None:
        """Hear what a guest says that is not inside yet."""
        if visit.link is None:
            return
        try:
            said = visit.link.recv(LONGEST_HELLO + 1 - len(visit.said))
        except BlockingIOError:
            return
        except OSError:
            said = b""
        visit.said += said
        is_whole = is_hello(visit.said) if len(visit.said) <= LONGEST_HELLO else False
        if not said:
            self._end(visit)
        elif is_whole is False:
            self._note_turned_away(visit.guest, "no_tls")
            self._end(visit)
        elif is_whole and visit.guest.stage is Stage.SILENT:
            self._admission.greet(visit.guest, time.monotonic())
            self._let_in()

    def _let_in(self) -> None:
        while self._admission.num_greeted:
            guest = self._admission.let_in(time.monotonic())
            if guest is None:
                break
            task = self._loop.create_task(self._lead(self._visits[guest]))
            self._tasks.add(task)
            task.add_done_callback(self._tasks.discard)
        self._show_out()

    def _show_out(self) -> None:
        ignored, self._admission.ignored = self._admission.ignored, []
        for guest in ignored:
            visit = self._visits[guest]
            self._note_turned_away(guest, _WHY[Stage.UNPROVEN if visit.ends else Stage.GREETED])
            self._part(visit)
        dropped, self._admission.dropped = self._admission.dropped, []
        for guest in dropped:
            if guest.stage is not Stage.IGNORED:  # else it has been noted
                self._note_turned_away(guest, _WHY[guest.stage])
            self._end(self._visits[guest])

    async def _lead(self, visit: _Visit) -> None:
        """Connect a guest with the router and hand on what it has said."""
        link = visit.link
        if link is None:
            return
        self._loop.remove_reader(link.fileno())
        visit.link = None
        inner = _End(lambda num: self._answered(visit, num), lambda: self._lost(visit))
        outer = _End(lambda _: self._heard(visit), lambda: self._lost(visit))
        inner.other, outer.other = outer, inner
        visit.ends = [inner, outer]
        try:
            towards = await self._reach_router()
            transport, _ = await self._loop.create_connection(lambda: inner, sock=towards)
            transport.write(visit.said)
            visit.said = b""
            transport.pause_reading()
            await self._loop.connect_accepted_socket(lambda: outer, link)
            transport.resume_reading()
        except OSError as problem:
            link.close()
            self._log.limited("router", "The router takes nobody in", why=problem.strerror)
        is_ignored = visit.guest.stage is Stage.IGNORED
        if visit.guest not in self._visits or not (inner.is_open and outer.is_open) or is_ignored:
            self._end(visit)

    async def _reach_router(self) -> socket.socket:
        towards = socket.socket()
        try:
            towards.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, WAITING_BYTES)
            towards.setblocking(False)
            await self._loop.sock_connect(towards, next(self._inside))
        except OSError:
            towards.close()
            raise
        return towards

    def _heard(self, visit: _Visit) -> None:
        guest = visit.guest
        if guest.stage is Stage.IGNORED:  # it speaks after all, and may come again at once
            self._end(visit)
        guest.heard_s = time.monotonic()
        guest.has_replied = guest.has_replied or visit.num_answered > LONGEST_RETRY

    def _answered(self, visit: _Visit, num_bytes: int) -> None:
        """The router certainly speaks with a guest if it says much after the guest's reply."""
        visit.num_answered += num_bytes
        is_asked = visit.guest in self._visits and visit.guest.stage is Stage.UNPROVEN
        if is_asked and visit.guest.has_replied:
            visit.num_after_reply += num_bytes
            if visit.num_after_reply > UNANSWERED_ALERT:
                self._admission.prove(visit.guest, time.monotonic())

    def _part(self, visit: _Visit) -> None:
        """End what leads a guest to the router; its own connection stays."""
        for end in visit.ends:
            end.other = None
        if visit.ends and visit.ends[0].transport is not None:
            visit.ends[0].transport.abort()

    def _lost(self, visit: _Visit) -> None:
        """One end of a relay has closed; the other may still have something to say."""
        if all(end.is_lost for end in visit.ends):
            if visit.guest.stage is Stage.UNPROVEN and visit.guest in self._visits:
                self._note_turned_away(visit.guest, _WHY[Stage.UNPROVEN])
            self._end(visit)

    def _end(self, visit: _Visit) -> None:
        """Close what is open of a visit at once; may be called again."""
        self._admission.leave(visit.guest)
        self._visits.pop(visit.guest, None)
        if visit.link is not None:
            self._loop.remove_reader(visit.link.fileno())
            visit.link.setsockopt(socket.SOL_SOCKET, socket.SO_LINGER, _AT_ONCE)
            visit.link.close()
            visit.link = None
        for end in visit.ends:
            if end.transport is not None:
                end.transport.abort()

    def _note_turned_away(self, guest: Guest, why: str) -> None:
        self._turned_away[why] += 1
        if guest.address in self._from or len(self._from) < MOST_ADDRESSES:
            self._from[guest.address] += 1

    def _tell(self, now_s: float) -> None:
        """Say now and then how many were turned away."""
        if not self._turned_away or now_s - self._told_s < TOLD_EVERY_S:
            return
        self._told_s = now_s
        address, count = self._from.most_common(1)[0]
        self._log.warning(
            "Connections from outside were turned away",
            most=f"{count} from {address}",
            **self._turned_away,
        )
        self._turned_away.clear()
        self._from.clear()
