"""What a check says: one plain sentence, how bad it is, and what to do."""

import dataclasses
import enum
from collections.abc import Callable

from trolley.sanitize import sanitize


class Level(enum.IntEnum):
    """How bad it is."""

    OK = 0
    """Nothing to do."""
    NOTE = 1
    """Good to know."""
    WARNING = 2
    """It works, but not as it should."""
    PROBLEM = 3
    """Something does not work."""


@dataclasses.dataclass(frozen=True, slots=True)
class Finding:
    """One thing that was looked at."""

    level: Level
    about: str
    """What was looked at, in a word: `clock`, `map`, `base`."""
    sentence: str
    remedy: str = ""
    """What to do; "" where nothing needs to be done."""

    def __post_init__(self) -> None:
        """Take out what would disturb a terminal: names and messages come from outside."""
        for field in ("about", "sentence", "remedy"):
            object.__setattr__(self, field, sanitize(getattr(self, field), 600))


def ok(about: str, sentence: str) -> Finding:
    """Something that is fine."""
    return Finding(Level.OK, about, sentence)


def note(about: str, sentence: str, remedy: str = "") -> Finding:
    """Something that is good to know."""
    return Finding(Level.NOTE, about, sentence, remedy)


def warning(about: str, sentence: str, remedy: str) -> Finding:
    """Something that works, but not as it should."""
    return Finding(Level.WARNING, about, sentence, remedy)


def problem(about: str, sentence: str, remedy: str) -> Finding:
    """Something that does not work."""
    return Finding(Level.PROBLEM, about, sentence, remedy)


# What reading a file that is missing, closed, cut short or of an unknown form may raise.
UNREADABLE = (OSError, ValueError, LookupError)


def looked_at(about: str, look: Callable[[], list[Finding]]) -> list[Finding]:
    """The findings of a check; where its facts cannot be read, one that says so."""
    try:
        return look()
    except PermissionError as error:
        where = f" ({error.filename})" if error.filename else ""
        return [
            note(about, f"You may not read this{where}.", "Run this again with `sudo`."),
        ]
    except UNREADABLE as error:
        return [note(about, f"This could not be checked: {type(error).__name__}: {error}.")]
