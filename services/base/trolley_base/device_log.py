"""What the devices say to people: logged once, not twenty times a second."""

import re
from collections.abc import Callable, Mapping
from dataclasses import dataclass

from trolley.messages import Link
from trolley.runtime.log import Log
from trolley_base.drivers import Note

PERIOD_NS = {"info": 60_000_000_000, "warning": 5_000_000_000, "error": 5_000_000_000}
"""Notes of one kind are logged at most this often, and ever more rarely while they go on [ns]."""
LONGEST_PERIOD_NS = 600_000_000_000
PATIENCE_NS = 5_000_000_000
"""A device that is being searched for may turn up at any moment; its trouble is logged after this
long [ns]."""
MOST_KINDS = 64
"""Kinds may come from a board's own words; beyond this many, all others count as one."""
NUMBER = re.compile(r"\d+")


@dataclass(frozen=True, slots=True)
class _Logged:
    """When a kind of note was logged, and for how long it is not logged again."""

    at_ns: int
    pause_ns: int


class DeviceLog:
    """Logs links when they change, notes now and then, and counts.

    Args:
        log: of the service.
        count: adds to a counter of the service.
    """

    def __init__(self, log: Log, count: Callable[[str, int], None]) -> None:
        self._log = log
        self._count = count
        self._is_up: dict[str, bool] = {}
        self._lost_ns: dict[str, int] = {}
        self._reported: dict[str, str] = {}
        self._logged: dict[str, _Logged] = {}

    def add(
        self, now_ns: int, link: Link, notes: tuple[Note, ...], counts: Mapping[str, int]
    ) -> None:
        """Log what one device said since the last call."""
        self._add_link(now_ns, link)
        for note in notes:
            self._add_note(now_ns, link.name, note)
        for name, number in counts.items():
            self._count(name, number)

    def _add_link(self, now_ns: int, link: Link) -> None:
        name, was_up = link.name, self._is_up.get(link.name, True)
        self._is_up[name] = link.state == "up"
        if link.state == "up":
            if not was_up:
                self._log.info("Connected", device=name)
                for kind in [kind for kind in self._logged if kind.startswith(f"{name}/link/")]:
                    del self._logged[kind]
            self._lost_ns.pop(name, None)
            self._reported.pop(name, None)
            return
        lost_ns = self._lost_ns.setdefault(name, now_ns)
        if link.state == "searching" and now_ns - lost_ns < PATIENCE_NS:
            return
        if link.message != self._reported.get(name):
            self._reported[name] = link.message
            # A device that is tried repeatedly fails for the same reason each time.
            kind = f"link/{NUMBER.sub('#', link.message)}"
            self._add_note(now_ns, name, Note("warning", kind, link.message))

    def _add_note(self, now_ns: int, device: str, note: Note) -> None:
        kind = f"{device}/{note.kind}"
        if kind not in self._logged and len(self._logged) >= MOST_KINDS:
            kind = "other"
        logged = self._logged.get(kind)
        pause_ns = PERIOD_NS[note.level]
        if logged is not None:
            since_ns = now_ns - logged.at_ns
            if since_ns < logged.pause_ns:
                return
            if since_ns < 2 * logged.pause_ns:  # it went on all the time
                pause_ns = min(2 * logged.pause_ns, LONGEST_PERIOD_NS)
        self._logged[kind] = _Logged(now_ns, pause_ns)
        write = {"info": self._log.info, "warning": self._log.warning, "error": self._log.error}
        write[note.level](note.text, device=device)
