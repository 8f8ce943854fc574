"""What people may call places, tours, maps and zones, and how a name is written."""

import unicodedata
from collections.abc import Collection

MAX_NAME_LENGTH = 64
_EXTRAS = "_-."


def canonical(name: str) -> str:
    """Return the one form (NFC) of a name that may be typed in several: ü, or u and its dots."""
    return unicodedata.normalize("NFC", name)


def name_problem(name: str) -> str | None:
    """Say in one sentence why `name` cannot name a place or marker; None if it can.

    Names are 1 to 64 characters after NFC: letters, combining marks and digits of any script,
    inner single spaces, `_`, `-` and `.`, with no leading dot.
    """
    text = canonical(name)
    if not 1 <= len(text) <= MAX_NAME_LENGTH:
        return f"a name has 1 to {MAX_NAME_LENGTH} characters, this one has {len(text)}"
    if text[0] == ".":
        return "a name may not begin with a dot"
    if text != " ".join(text.split(" ")).strip() or "  " in text:
        return "a name may have single spaces only, and none at its ends"
    for character in text:
        if (
            character != " "
            and character not in _EXTRAS
            and unicodedata.category(character)[0] not in "LMN"
        ):
            return (
                f"a name may not contain {character!r}: use letters, digits, spaces, '_', '-' and "
                "'.'"
            )
    return None


def free_name(name: str, taken: Collection[str]) -> str:
    """Return a name for what cannot be stored under its own: `flat-2`, `flat-3`."""
    stem, _, number = name.rpartition("-")
    if not (stem and number.isdecimal()):
        stem = name
    count = 2
    while (wanted := f"{stem[:58]}-{count}") in taken:
        count += 1
    return wanted
