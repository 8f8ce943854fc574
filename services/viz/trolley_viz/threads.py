"""From the web server's threads to the service's, where everything else runs."""

from collections.abc import Callable
from typing import Any

import viser

Post = Callable[[Callable[[], None]], None]
"""Hands a call to the service's thread."""


def handler(
    post: Post, act: Callable[[viser.ClientHandle, Any], None]
) -> Callable[[viser.GuiEvent[Any]], Any]:
    """Make a viser callback that calls `act(client, value)` on the service's thread.

    Changes that the service itself makes come without a client; they are ignored.
    """

    # async: viser runs such callbacks in order and at once, not on a pool of threads.
    async def handle(event: viser.GuiEvent[Any]) -> None:
        client, value = event.client, event.target.value
        if client is not None:
            post(lambda: act(client, value))

    return handle
