"""Who sent the goals and trips that came from a page of this viewer."""

MAX_SENT = 200


class Senders:
    """The names of those who sent the newest goals and trips."""

    def __init__(self) -> None:
        self._names: dict[tuple[str, str], str] = {}
        """By robot and the goal's or trip's id, the newest at the end."""

    def note(self, robot: str, sent: str, name: str) -> None:
        """Note who sent a goal or trip."""
        self._names.pop((robot, sent), None)
        self._names[robot, sent] = name
        while len(self._names) > MAX_SENT:
            del self._names[next(iter(self._names))]

    def of(self, robot: str, sent: str | None) -> str:
        """Return who sent a goal or trip, "" where it was nobody at a page."""
        return self._names.get((robot, sent), "") if sent else ""
