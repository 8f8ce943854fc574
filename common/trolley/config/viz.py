"""`[viz]`: the web viewer."""

from typing import Annotated

from msgspec import Meta, Struct


class VizConfig(Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """Where the viewer listens."""

    host: str = "127.0.0.1"
    """The address to bind; anything but loopback lets the whole network steer the robot."""
    port: Annotated[int, Meta(ge=1, le=65_535)] = 8080
    """The port; a busy one is an error, not a silent move to the next."""
