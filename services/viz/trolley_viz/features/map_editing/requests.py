"""Requests to edit a map, repeated while the mapper is still working on the first."""

from collections.abc import Callable

from msgspec.structs import replace

from trolley import codes, requests
from trolley.codes import Refused
from trolley.messages import EditMap, MapEdited
from trolley.runtime.service import Service

PATIENCE_NS = 120_000_000_000
"""Local time: a large map on a small computer takes its time."""


def request_map_edit(
    service: Service,
    params: EditMap,
    done: Callable[[MapEdited | Refused], None],
    robot: str | None,
) -> None:
    """Request a change of a map; `done` gets the outcome."""
    params = replace(params, id=service.new_id())
    until_ns = service.monotonic_ns + PATIENCE_NS

    def answered(reply: MapEdited | Refused) -> None:
        if isinstance(reply, Refused):
            is_late = reply.code == codes.TIMEOUT
        else:
            is_late = reply.state == "working"
        if not is_late:
            done(reply)
        elif service.monotonic_ns > until_ns:
            done(Refused(codes.TIMEOUT, "The map is still being changed."))
        else:
            ask()

    def ask() -> None:
        service.request(requests.MAP_EDIT, params, answered, robot=robot)

    ask()
