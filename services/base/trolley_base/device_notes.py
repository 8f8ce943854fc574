"""What the devices say for people: into the log, once and not twenty times a second."""

from collections.abc import Callable, Mapping

from trolley.messages import Link
from trolley.runtime.log import Log
from trolley_base.drivers import Note

# A note of one kind is passed on at most this often [ns].
PERIOD_NS = {"info": 60_000_000_000, "warning": 5_000_000_000, "error": 5_000_000_000}
# Kinds may come from a board's own words; what is beyond so many counts as one kind.
MOST_KINDS = 64


class DeviceNotes:
    """Logs links when they change, notes now and then, and counts.

    Args:
        log: of the service.
        count: adds to a counter of the service.
    """

    def __init__(self, log: Log, count: Callable[[str, int], None]) -> None:
        self._log = log
        self._count = count
        self._links: dict[str, Link] = {}
        self._said_ns: dict[str, int] = {}

    def hear(
        self, now_ns: int, link: Link, notes: tuple[Note, ...], counts: Mapping[str, int]
    ) -> None:
        """Take what one device said since the last time."""
        self._hear_link(link)
        for note in notes:
            self._hear_note(now_ns, link.name, note)
        for name, number in counts.items():
            self._count(name, number)

    def _hear_link(self, link: Link) -> None:
        before = self._links.get(link.name)
        self._links[link.name] = link
        if before == link:
            return
        if link.state == "down":
            self._log.warning(link.message, device=link.name)
        elif link.state == "up" and before is not None:
            self._log.info("Connected", device=link.name)

    def _hear_note(self, now_ns: int, device: str, note: Note) -> None:
        kind = f"{device}/{note.kind}"
        if kind not in self._said_ns and len(self._said_ns) >= MOST_KINDS:
            kind = "other"
        said_ns = self._said_ns.get(kind)
        if said_ns is not None and now_ns - said_ns < PERIOD_NS[note.level]:
            return
        self._said_ns[kind] = now_ns
        write = {"info": self._log.info, "warning": self._log.warning, "error": self._log.error}
        write[note.level](note.text, device=device)
