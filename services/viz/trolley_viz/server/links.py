"""The links that let a browser on another host in."""

import socket
from dataclasses import dataclass, field

from trolley.config import VizConfig
from trolley_viz.server.access import AccessTokens

EVERYWHERE = ("0.0.0.0", "::", "")
OUT_OF_REACH = (
    "The viewer listens on its own host only, so nobody else can reach it: to change that, set "
    'host = "0.0.0.0" under [viz] in robot.toml and restart the viewer.'
)


@dataclass(frozen=True)
class Links:
    """The two links with a token; each is as good as a password."""

    operator: str = field(repr=False)
    """Lets its holder do everything."""
    viewer: str = field(repr=False)
    """Lets its holder look, and press Stop."""
    is_reachable: bool
    """Whether they lead here from another host."""


def links_of(viz: VizConfig, tokens: AccessTokens) -> Links:
    """Return the links of a viewer."""
    page = page_address(viz)
    return Links(
        operator=f"{page}/?token={tokens.operator}",
        viewer=f"{page}/?token={tokens.viewer}",
        is_reachable=viz.is_reachable,
    )


def page_address(viz: VizConfig) -> str:
    """Return the address of the page, as another host may call it."""
    if viz.origins:
        return viz.origins[0]
    host = socket.gethostname() if viz.host in EVERYWHERE else viz.host
    return f"http://{f'[{host}]' if ':' in host else host}:{viz.port}"
