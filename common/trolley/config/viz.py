"""`[viz]`: the web viewer."""

from typing import Annotated

from msgspec import Meta, Struct

from trolley.ports import is_loopback_host

Origin = Annotated[str, Meta(pattern=r"^https?://[^/\s]+$", max_length=200)]


class VizConfig(Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """Where the viewer listens, and who may use it."""

    host: str = "127.0.0.1"
    """The address to bind; beyond loopback (`"0.0.0.0"`) everyone needs a link with a token."""
    port: Annotated[int, Meta(ge=1, le=65_535)] = 8080
    """The port; if it is busy, the viewer reports an error and does not take another one."""
    origins: list[Origin] = []
    """Addresses of the page behind a proxy, as `"https://robot.example"`."""
    always_ask: bool = False
    """Whether browsers on this host need a link with a token, too."""
    foxglove_port: Annotated[int, Meta(ge=1, le=65_535)] | None = None
    """The port for Foxglove, which can watch but not command; 8765 is usual."""
    foxglove_host: str = "127.0.0.1"
    """The address for Foxglove; anything but loopback also needs `foxglove_open`."""
    foxglove_open: bool = False
    """Whether anybody who reaches `foxglove_host` may watch: Foxglove has no password."""

    @property
    def is_reachable(self) -> bool:
        """Whether the links of the page lead here from another host."""
        return bool(self.origins) or not is_loopback_host(self.host)
