"""What the devices say for people: into the log, once and not twenty times a second."""

from collections.abc import Callable, Mapping

from trolley.messages import Link
from trolley.runtime.log import Log
from trolley_base.drivers import Note


class DeviceNotes:
    """Logs links when they change, notes at most every 5 s of a kind, and counts.

    Args:
        log: of the service.
        count: adds to a counter of the service.
    """

    def __init__(self, log: Log, count: Callable[[str, int], None]) -> None:
        self._log = log
        self._count = count
        self._links: dict[str, Link] = {}

    def hear(self, link: Link, notes: tuple[Note, ...], counts: Mapping[str, int]) -> None:
        """Take what one device said since the last time."""
        self._hear_link(link)
        for note in notes:
            self._log.limited(note.kind, note.text, device=link.name)
        for name, number in counts.items():
            self._count(name, number)

    def _hear_link(self, link: Link) -> None:
        before = self._links.get(link.name)
        self._links[link.name] = link
        if before == link:
            return
        if link.state != "up":
            if link.message:
                self._log.warning(link.message, device=link.name)
        elif before is not None:
            self._log.info("Connected", device=link.name)
