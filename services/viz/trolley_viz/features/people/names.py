"""The names that people give to their browsers: one line, and no two alike."""

import unicodedata
from collections.abc import Callable, Iterable, Mapping

from trolley.names import canonical
from trolley.sanitize import sanitize
from trolley_viz.server.devices import A_BROWSER, DEVICE_NAMES
from trolley_viz.server.visitors import Visitor

MAX_NAME = 40
MAX_NAMES = 100
MAX_LOOKED_AT = 4 * MAX_NAME
"""Number of characters of a text that are examined: a longer one is too long anyway."""
BLANKS = dict.fromkeys(map(ord, "\u115f\u1160\u2800\u3164\uffa0"), " ")
"""Letters by Unicode's book that nobody can see."""
SEEN = "LNPS"
"""Letters, numbers, punctuation and symbols: one of them has to be in a name."""

NO_COOKIE = "This browser keeps no cookies, so its name cannot be remembered."
TOO_LONG = f"A name has at most {MAX_NAME} characters."
NOT_YOURS = "That is what browsers without a name are called. Choose another name."
A_ROBOT = "This is the name of a robot. Choose another name."
TAKEN = "Another browser has this name. Choose another name."


class Names:
    """The names of all browsers.

    Args:
        given: by browser, as they were saved.
        save: saves them.
        robots: what the robots are called.
    """

    def __init__(
        self,
        given: Mapping[str, str],
        save: Callable[[dict[str, str]], None],
        robots: Callable[[], Iterable[str]],
    ) -> None:
        read = {browser: clean(name)[:MAX_NAME] for browser, name in given.items()}
        self._given = {browser: name for browser, name in read.items() if name}
        self._save = save
        self._robots = robots

    def given(self, visitor: Visitor) -> str:
        """Return the name that a browser was given, "" for none."""
        return self._given.get(visitor.browser, "") if visitor.browser else ""

    def of(self, visitor: Visitor) -> str:
        """Return what to call a browser: by its name, else by what it is."""
        if not visitor.browser:
            return A_BROWSER
        return self.given(visitor) or visitor.device or A_BROWSER

    def give(self, visitor: Visitor, text: str) -> str:
        """Give a browser a name, or take it away where there is none in `text`.

        Returns:
            Why that cannot be, "" if it is done.
        """
        name = clean(text)
        why = self._objection(visitor, name)
        if why:
            return why
        others = self._others(visitor)
        recent = dict([*others.items()][-(MAX_NAMES - 1) :])
        self._given = {**recent, visitor.browser: name} if name else others
        self._save(dict(self._given))
        return ""

    def _objection(self, visitor: Visitor, name: str) -> str:
        if not visitor.browser:
            return NO_COOKIE
        if len(name) > MAX_NAME:
            return TOO_LONG
        wanted = _as_read(name)
        if wanted in map(_as_read, DEVICE_NAMES):
            return NOT_YOURS
        if name and wanted in map(_as_read, self._robots()):
            return A_ROBOT
        return TAKEN if wanted in map(_as_read, self._others(visitor).values()) else ""

    def _others(self, visitor: Visitor) -> dict[str, str]:
        return {browser: old for browser, old in self._given.items() if browser != visitor.browser}


def clean(text: str) -> str:
    """Return a text as one line that can be read, "" where nothing of it can be seen."""
    line = sanitize(text[:MAX_LOOKED_AT], MAX_LOOKED_AT).translate(BLANKS)
    line = " ".join(canonical(line).split())
    is_seen = any(unicodedata.category(letter)[0] in SEEN for letter in line)
    return line if is_seen else ""


def _as_read(name: str) -> str:
    """Reduce a name to what tells it from others: names that look alike become equal."""
    return " ".join(unicodedata.normalize("NFKC", clean(name)).casefold().split())
