"""Where a router may listen: for its own host's programs, and for other hosts behind the door.

Whatever limits and denies at a router, the door, the roles and what may leave over a thin link,
holds for these endpoints only. So a router listens at no other.
"""

import os

from trolley.ports import port_of

SOCKET = "unixsock-stream/"


def is_of_this_host(endpoint: str) -> bool:
    """Whether a router at this endpoint serves this host's own programs alone."""
    return endpoint.startswith(SOCKET) or (
        endpoint.startswith(("tcp/", "tls/")) and port_of(endpoint) is not None
    )


def is_forbidden(endpoint: str) -> bool:
    """Whether this process's user has no right to use the Unix socket that it names."""
    if not endpoint.startswith(SOCKET):
        return False
    path = endpoint.removeprefix(SOCKET)
    try:
        os.stat(path)
    except OSError as error:
        return isinstance(error, PermissionError)
    return not os.access(path, os.W_OK)


def is_far(endpoint: str) -> bool:
    """Whether a router listens there for other hosts, behind a door."""
    return endpoint.startswith("tls/")


def why_not_here(endpoint: str, *, has_rules: bool) -> str:
    """Return why a router must not listen there, "" where it may.

    Args:
        endpoint: in Zenoh's words.
        has_rules: whether the router knows who may come in, and what each may do.
    """
    if is_far(endpoint):
        return "" if has_rules else "other hosts are let in with `trolley keys router` only"
    if is_of_this_host(endpoint):
        return ""
    return (
        "a router listens at tcp/127.0.0.1:port or unixsock-stream/path for this host, and at "
        "tls/host:port for others, where it can tell who comes and how many"
    )
