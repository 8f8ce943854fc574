"""Text from outside, made fit for a terminal."""

MOST = 300


def sanitize(text: str, most: int = MOST) -> str:
    """A text on one line, without control characters, which could move a terminal's cursor."""
    line = "".join(letter if letter.isprintable() else " " for letter in text[: 2 * most])
    return line if len(line) <= most else line[: most - 1] + "…"
