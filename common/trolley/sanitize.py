"""Text from outside, made fit for a terminal or a log.

A robot's name, a sentence or a file's name may hold what moves a cursor, changes the title of a
window, or turns the order of letters: control characters (C0, C1) and marks of direction. None of
them is printable, and nothing that is not printable leaves here as it came.
"""

MOST = 300
MOST_REPEATED = 1000
"""Letters that are left of what a stranger sent where a refusal or the log repeats it."""
_KEPT = "\n\t"


def sanitize(text: str, most: int = MOST) -> str:
    """A text on one line, cut to a length, with spaces in place of what is not printable."""
    line = "".join(letter if letter.isprintable() else " " for letter in text[: 2 * most])
    return line if len(line) <= most else line[: most - 1] + "…"


def shorten(text: str, most: int = MOST_REPEATED) -> str:
    """A text of which at most so many letters are left: its beginning and its end."""
    half = most // 2
    return text if len(text) <= most else f"{text[:half]}…{text[-half + 1 :]}"


def escape(text: str, kept: str = "") -> str:
    r"""A text with what is not printable written as in Python: `\x1b`; `kept` stays as it is."""
    if text.isprintable():
        return text
    return "".join(
        letter
        if letter.isprintable() or letter in kept
        else letter.encode("unicode_escape").decode()
        for letter in text
    )


def fit(text: str, encoding: str | None) -> str:
    """Lines of text as a terminal can take them: nothing unprintable, "?" for what it lacks."""
    encoding = encoding or "utf-8"
    return escape(text, _KEPT).encode(encoding, "replace").decode(encoding, "replace")
