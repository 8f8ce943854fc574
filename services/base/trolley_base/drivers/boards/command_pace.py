"""When a motor board is sent its next command."""

COMMAND_EVERY_NS = 35_000_000
"""Every other call of `outgoing` at 50 Hz, with room for its unevenness: 25 commands a second."""


class CommandPace:
    """Stops and starts go at once, everything else at a pace: zeros too, so that watchdogs rest.

    Attributes:
        is_standing: whether the newest command was to stand.
    """

    def __init__(self) -> None:
        self.reset()

    def reset(self) -> None:
        """The port has been opened: nothing was commanded, so the robot is taken to stand."""
        self.is_standing = True
        self._sent_ns: int | None = None

    def is_due(self, now_ns: int, *, stands: bool) -> bool:
        """Say whether a command is due now, which is to stand or to drive."""
        has_waited = self._sent_ns is None or now_ns - self._sent_ns >= COMMAND_EVERY_NS
        return has_waited or stands != self.is_standing

    def note(self, now_ns: int, *, stands: bool) -> None:
        """It is sent."""
        self.is_standing, self._sent_ns = stands, now_ns
