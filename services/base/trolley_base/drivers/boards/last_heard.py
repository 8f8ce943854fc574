"""When a motor board was last heard, and with what: what its status is made of."""

from trolley_base.drivers.boards.report import REOPEN_AFTER_NS, SILENCE_NS


class LastHeard:
    """Remembers what a board has sent since its port was opened.

    Args:
        now_ns: when that was.
    """

    def __init__(self, now_ns: int) -> None:
        self.heard_ns = now_ns
        """When it was last heard, or its port was opened."""
        self.report_ns: int | None = None
        """When it last reported how it moves, None if it has not."""
        self.nonsense_ns: int | None = None
        """When it last reported a motion that cannot be, None if it has not."""
        self.has_bytes = False
        """Whether anything has come."""
        self.has_frames = False
        """Whether something of its protocol has come."""

    def hear(self, now_ns: int) -> None:
        """Note that bytes have come."""
        self.heard_ns, self.has_bytes = now_ns, True

    def take_frame(self) -> None:
        """Note that something of its protocol has come."""
        self.has_frames = True

    def take_report(self, now_ns: int) -> None:
        """Note that it reported how it moves."""
        self.report_ns = now_ns

    def take_nonsense(self, now_ns: int) -> None:
        """Note that it reported a motion that cannot be."""
        self.nonsense_ns = now_ns

    def forgive_silence(self, now_ns: int) -> None:
        """Count silence from now on: base itself did not listen."""
        self.heard_ns = now_ns

    def forget_reports(self) -> None:
        """Start over with its reports, as in a new session."""
        self.report_ns = None

    def is_silent(self, now_ns: int) -> bool:
        """Say whether it has been silent for so long that its port is opened anew."""
        return now_ns - self.heard_ns >= REOPEN_AFTER_NS

    def is_reporting(self, now_ns: int) -> bool:
        """Say whether it reports how it moves."""
        return self.report_ns is not None and now_ns - self.report_ns <= SILENCE_NS

    def is_talking_nonsense(self, now_ns: int) -> bool:
        """Say whether it reported a motion that cannot be a moment ago."""
        return self.nonsense_ns is not None and now_ns - self.nonsense_ns <= SILENCE_NS

    @property
    def has_reported(self) -> bool:
        """Whether it has reported how it moves."""
        return self.report_ns is not None

    @property
    def speaks_otherwise(self) -> bool:
        """Whether what comes is not its protocol."""
        return self.has_bytes and not self.has_frames
