"""Which connections the door lets in, when, and which it closes; without sockets and clocks.

A guest is silent, then has greeted (a whole TLS hello), then is inside (its bytes go to the router)
and finally proven: the router, which checks certificates, talks to it.

The newest that has greeted is let in first. One that hangs is no legitimate host: it greets and
says no more, or has waited longer than a router does before it gives up. From then on it is ignored
instead of sent away, since whoever is sent away comes again, and may be newer than a legitimate
host that waits. If there are too many, the oldest of those that are ignored or have got least far
are closed.
"""

import dataclasses
import ipaddress
from collections import OrderedDict
from enum import Enum


@dataclasses.dataclass(frozen=True)
class Limits:
    """How much room there is; times in seconds. Set by hand where nothing else is said."""

    guests: int = 4096
    """At the door and inside, in all."""
    guests_per_address: int = 2560
    inside: int = 64
    """Less than the 100 that Zenoh accepts at once, so that a place for local programs is left."""
    inside_per_address: int = 32
    unproven_per_address: int = 24
    """Guests from one address that are inside but not yet proven."""
    hello_s: float = 4.0
    """Time for the hello; a router that connects gives up after as long (`OPEN_TIMEOUT_MS`), so
    that whoever has greeted and still hangs on later is no router."""
    ignored_s: float = 300.0
    """Time for which such a one is kept."""
    proof_s: float = 4.0
    """Time for the rest of the handshake."""
    patience_s: float = 1.5
    """Time for which an unproven guest may stay even if others want its place."""
    idle_s: float = 15.0
    """Silence after which a proven guest has gone: Zenoh says something every 2.5 s."""
    burst: int = 32
    """Number of guests that are let in one after another without a pause."""
    entries_per_s: float = 64.0
    """Number of guests that are let in each second after such a burst: each that fails costs 0.1 s
    at one of the router's entrances."""
    remembered: int = 256
    """Number of addresses with a proven guest that are let in before unknown ones."""
    own_files: int = 64
    """Open files of the door's own, besides one for each guest and another for each inside."""

    def within(self, files: int) -> "Limits":
        """Return limits that so many open files are enough for."""
        guests = max(1, min(self.guests, files - self.own_files - self.inside))
        return dataclasses.replace(self, guests=guests)


class Stage(Enum):
    """How far a guest has come."""

    SILENT = "silent"
    GREETED = "greeted"
    IGNORED = "ignored"
    UNPROVEN = "unproven"
    PROVEN = "proven"


class Guest:
    """A connection from another host."""

    def __init__(self, address: str, now_s: float) -> None:
        self.address = address
        self.stage = Stage.SILENT
        self.since_s = now_s
        """When its stage began."""
        self.heard_s = now_s
        """When it last said something."""
        self.has_replied = False
        """Whether it has said something after the router's answer to its hello."""


def address_of(host: str) -> str:
    """What counts as one address: a host's own in IPv4, its network (/64) in IPv6."""
    address = ipaddress.ip_address(host.partition("%")[0])
    if isinstance(address, ipaddress.IPv4Address):
        return str(address)
    if address.ipv4_mapped is not None:
        return str(address.ipv4_mapped)
    return str(ipaddress.ip_network((address, 64), strict=False))


class _Memory:
    """When something last happened to each of the addresses to which it happened last."""

    def __init__(self, most: int) -> None:
        self._most = most
        self._when_s: OrderedDict[str, float] = OrderedDict()

    def keep(self, address: str, now_s: float) -> None:
        self._when_s[address] = now_s
        self._when_s.move_to_end(address)
        if len(self._when_s) > self._most:
            self._when_s.popitem(last=False)

    def when(self, address: str) -> float | None:
        return self._when_s.get(address)


class Admission:
    """The list of guests.

    Attributes:
        dropped: Those who have to go, in order; whoever asks empties it.
        ignored: Those who are ignored from now on: what leads them to the router has to end;
            whoever asks empties it.
    """

    def __init__(self, limits: Limits | None = None) -> None:
        self.dropped: list[Guest] = []
        self.ignored: list[Guest] = []
        self._limits = limits or Limits()
        self._guests: dict[Stage, OrderedDict[Guest, None]] = {
            stage: OrderedDict() for stage in Stage
        }
        self._of: dict[tuple[str, Stage], OrderedDict[Guest, None]] = {}
        self._num_entries = float(self._limits.burst)
        self._entries_s = 0.0
        self._known = _Memory(self._limits.remembered)
        self._served = _Memory(self._limits.guests)

    @property
    def num_guests(self) -> int:
        """How many there are."""
        return sum(len(guests) for guests in self._guests.values())

    @property
    def num_greeted(self) -> int:
        """How many wait to be let in."""
        return len(self._guests[Stage.GREETED])

    def arrive(self, address: str, now_s: float) -> Guest:
        """Add a guest; it may itself be among the `dropped`."""
        limits = self._limits
        # Room is made before it comes in: else it were itself the oldest silent one.
        if self._count(address, *Stage) >= limits.guests_per_address:
            self._drop_oldest_outside(address)
        if self.num_guests >= limits.guests:
            self._drop_oldest_outside()
        guest = Guest(address, now_s)
        self._add(guest, Stage.SILENT)
        is_too_much = self._count(address, *Stage) > limits.guests_per_address
        if is_too_much or self.num_guests > limits.guests:
            self._drop(guest)
        return guest

    def greet(self, guest: Guest, now_s: float) -> None:
        """A silent guest has said its whole hello."""
        self._move(guest, Stage.GREETED, now_s)

    def let_in(self, now_s: float) -> Guest | None:
        """The next who may come in now, if any."""
        limits = self._limits
        earned = (now_s - self._entries_s) * limits.entries_per_s
        self._num_entries = min(limits.burst, self._num_entries + max(0.0, earned))
        self._entries_s = now_s
        if self._num_entries < 1.0:
            return None
        newest = (
            next(reversed(guests))
            for (_, stage), guests in self._of.items()
            if stage is Stage.GREETED
        )
        for guest in sorted(newest, key=self._turn):
            if self._make_room(guest.address, now_s):
                self._num_entries -= 1.0
                self._served.keep(guest.address, now_s)
                self._move(guest, Stage.UNPROVEN, now_s)
                return guest
        return None

    def prove(self, guest: Guest, now_s: float) -> None:
        """The router speaks with an unproven guest."""
        self._num_entries += 1.0
        self._known.keep(guest.address, now_s)
        self._move(guest, Stage.PROVEN, now_s)

    def leave(self, guest: Guest) -> None:
        """A guest has gone; nothing happens where it was not there any more."""
        if guest in self._guests[guest.stage]:
            del self._guests[guest.stage][guest]
            of_it = self._of[guest.address, guest.stage]
            del of_it[guest]
            if not of_it:
                del self._of[guest.address, guest.stage]

    def drop_overdue(self, now_s: float) -> None:
        """Drop or ignore those who have taken too long."""
        limits = self._limits
        while (hangs := self._oldest(Stage.GREETED)) and now_s - hangs.since_s > limits.hello_s:
            self._ignore(hangs, now_s)
        while (hangs := self._oldest(Stage.UNPROVEN)) and now_s - hangs.since_s > limits.proof_s:
            self._put_out(hangs, now_s)
        for stage, allowed_s in (
            (Stage.SILENT, limits.hello_s),
            (Stage.IGNORED, limits.ignored_s),
        ):
            while (oldest := self._oldest(stage)) and now_s - oldest.since_s > allowed_s:
                self._drop(oldest)
        for guest in [*self._guests[Stage.PROVEN]]:
            if now_s - guest.heard_s > limits.idle_s:
                self._drop(guest)

    def _turn(self, guest: Guest) -> tuple[bool, float]:
        """Known addresses first, then the one that had to wait longest."""
        is_unknown = self._known.when(guest.address) is None
        return is_unknown, self._served.when(guest.address) or 0.0

    def _make_room(self, address: str, now_s: float) -> bool:
        """Whether there is a place inside for this address, for which an unproven one may go."""
        limits = self._limits
        num_unproven = self._count(address, Stage.UNPROVEN)
        num_inside = num_unproven + self._count(address, Stage.PROVEN)
        if (
            num_unproven >= limits.unproven_per_address or num_inside >= limits.inside_per_address
        ) and not self._put_out_oldest(now_s, address):
            return False
        num_all = len(self._guests[Stage.UNPROVEN]) + len(self._guests[Stage.PROVEN])
        return num_all < limits.inside or self._put_out_oldest(now_s)

    def _put_out_oldest(self, now_s: float, address: str | None = None) -> bool:
        """Make room of the oldest unproven guest, if it has had its time."""
        oldest = self._oldest(Stage.UNPROVEN, address)
        if oldest is None or now_s - oldest.since_s < self._limits.patience_s:
            return False
        self._put_out(oldest, now_s)
        return True

    def _put_out(self, guest: Guest, now_s: float) -> None:
        """End an unproven guest's stay inside."""
        if guest.has_replied:
            self._drop(guest)
        else:
            self._ignore(guest, now_s)

    def _ignore(self, guest: Guest, now_s: float) -> None:
        self._move(guest, Stage.IGNORED, now_s)
        self.ignored.append(guest)

    def _drop_oldest_outside(self, address: str | None = None) -> None:
        for stage in (Stage.IGNORED, Stage.SILENT, Stage.GREETED):
            oldest = self._oldest(stage, address)
            if oldest is not None:
                self._drop(oldest)
                return

    def _oldest(self, stage: Stage, address: str | None = None) -> Guest | None:
        guests = self._guests[stage] if address is None else self._of.get((address, stage), ())
        return next(iter(guests), None)

    def _count(self, address: str, *stages: Stage) -> int:
        return sum(len(self._of.get((address, stage), ())) for stage in stages)

    def _drop(self, guest: Guest) -> None:
        self.leave(guest)
        self.dropped.append(guest)

    def _move(self, guest: Guest, stage: Stage, now_s: float) -> None:
        self.leave(guest)
        guest.since_s = now_s
        self._add(guest, stage)

    def _add(self, guest: Guest, stage: Stage) -> None:
        guest.stage = stage
        self._guests[stage][guest] = None
        self._of.setdefault((guest.address, stage), OrderedDict())[guest] = None
