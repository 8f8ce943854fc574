"""How old a message from the broker may be at most.

A broker delivers in order. The bridge sends a mark each second and hears it come back: whatever
arrives after a mark left the broker after that mark was sent. So a command that waited in a
connection that had stalled, or in this process, is known to be too old to be carried out.
"""

MAX_AGE_S = 3.0
"""A command that may be older than this is dropped."""
MAX_UNANSWERED = 5
"""A broker that lets more marks than these go by, one each second, passes nothing on."""
MAX_UNDER_WAY = 64
"""Marks that are remembered until they come back."""


class Freshness:
    """Marks under way, and the newest one that came back."""

    def __init__(self) -> None:
        self._run = ""
        self._number = 0
        self._sent_ns: dict[bytes, int] = {}
        self._proof_ns: int | None = None

    def start(self, run: str) -> None:
        """Name the run, which tells its marks from those of others."""
        self._run = run

    def renew(self) -> None:
        """Start over on a new connection."""
        self._sent_ns.clear()
        self._proof_ns = None

    def mark(self, now_ns: int) -> bytes:
        """The next mark to send."""
        self._number += 1
        mark = f"{self._run}-{self._number}".encode()
        self._sent_ns[mark] = now_ns
        while len(self._sent_ns) > MAX_UNDER_WAY:
            del self._sent_ns[next(iter(self._sent_ns))]
        return mark

    def update(self, mark: bytes) -> bool:
        """Take a mark that came back; False where it is not one of ours."""
        if mark not in self._sent_ns:
            return False
        self._proof_ns = self._sent_ns[mark]
        # Those before it were lost: they cannot come back any more.
        self._sent_ns = {one: ns for one, ns in self._sent_ns.items() if ns > self._proof_ns}
        return True

    def age_s(self, now_ns: int) -> float | None:
        """How old what arrives now may be at most [s]; None where nothing is known."""
        return None if self._proof_ns is None else (now_ns - self._proof_ns) * 1e-9

    def is_fresh(self, now_ns: int) -> bool:
        """Whether what arrives now is surely new enough to be carried out."""
        age_s = self.age_s(now_ns)
        return age_s is not None and age_s <= MAX_AGE_S

    def is_passed_on(self, sent_ns: int) -> bool:
        """Whether what was sent then has long been passed on: a later mark has come back."""
        return self._proof_ns is not None and self._proof_ns > sent_ns

    def is_cut_off(self) -> bool:
        """Whether nothing that is sent has come back for a while.

        Counted, not timed: a process that stood still has sent nothing meanwhile.
        """
        return len(self._sent_ns) > MAX_UNANSWERED
