"""The door for Foxglove; what is behind it is imported only where the configuration opens it."""

from typing import TYPE_CHECKING

from trolley.config.viz import VizConfig
from trolley.runtime.service import Service

if TYPE_CHECKING:
    from trolley_viz.foxglove.bridge import FoxgloveBridge


def open_bridge(service: Service, config: VizConfig) -> "FoxgloveBridge | None":
    """Let Foxglove connect where the configuration says so; without it the viewer goes on."""
    if config.foxglove_port is None:
        return None
    try:
        from trolley_viz.foxglove.bridge import FoxgloveBridge

        return FoxgloveBridge(service, config)
    except ImportError as error:
        why = f"the extra trolley[foxglove] is not installed ({error})"
    except RuntimeError as error:
        why = f"{config.foxglove_host}, port {config.foxglove_port}, cannot be had ({error})"
    service.log.error("Foxglove cannot connect", why=why)
    service.set_health("degraded", f"Foxglove cannot connect: {why}.")
    return None
