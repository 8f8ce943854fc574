"""How many cases a property is tried on."""

import os

NEW = bool(os.environ.get("TROLLEY_NEW_CASES"))
"""Whether cases are drawn that nobody has seen, rather than the same ones each time."""
SAME_SHARE = 3
"""A case that was tried before tells only of the last change: one of so many does for that."""


def cases(number: int) -> int:
    """How many of a property's cases are tried: all of `number` where they are new ones.

    Where they are the same each time it is a part of them: as many of those as `make slow` draws
    anew would take `make test` minutes that teach nothing.
    """
    return number if NEW else max(number // SAME_SHARE, 4)
