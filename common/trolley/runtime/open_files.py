"""How many files and sockets a process may have open."""

import resource
from contextlib import suppress

MANY = 16_384
"""A connection needs one; Linux gives 1,024 unless asked, and allows many more."""


def allow_many_files() -> int:
    """Ask for many, or as many as are allowed, and return how many it may be."""
    soft, hard = resource.getrlimit(resource.RLIMIT_NOFILE)
    wanted = MANY if hard == resource.RLIM_INFINITY else min(MANY, hard)
    if soft != resource.RLIM_INFINITY and soft < wanted:
        with suppress(OSError, ValueError):  # a sandbox may forbid it, and fewer do as well
            resource.setrlimit(resource.RLIMIT_NOFILE, (wanted, hard))
            soft = wanted
    return MANY if soft == resource.RLIM_INFINITY else soft
