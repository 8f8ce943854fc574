"""What somebody may have meant by a name that nobody knows."""

import difflib
from collections.abc import Iterable

MOST_NAMED = 8
"""So many names are listed; of more, only those that are like the one that was given."""
LIKE = 0.6
"""How alike two names are that may be mistaken for each other, from 0 to 1 (difflib's own)."""


def did_you_mean(name: str, known: Iterable[str]) -> str:
    """A sentence that goes after "there is no …": the nearest names, else those that there are."""
    names = sorted(known)
    if not names:
        return "There are none."
    folded = {one.casefold(): one for one in names}
    close = difflib.get_close_matches(name.casefold(), folded, n=2, cutoff=LIKE)
    if close:
        return f"Did you mean {' or '.join(folded[one] for one in close)}?"
    if len(names) == 1:
        return f"There is only {names[0]}."
    shown = ", ".join(names[:MOST_NAMED])
    return f"There are {shown}{' and others' if len(names) > MOST_NAMED else ''}."
