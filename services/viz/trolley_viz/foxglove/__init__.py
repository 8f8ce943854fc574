"""The door for Foxglove; what is behind it is imported only where the configuration opens it."""

from typing import TYPE_CHECKING

from trolley.config.viz import VizConfig
from trolley.ports import is_loopback_host
from trolley.runtime.service import Service

if TYPE_CHECKING:
    from trolley_viz.foxglove.bridge import FoxgloveBridge


def open_bridge(service: Service, config: VizConfig) -> "FoxgloveBridge | None":
    """Let Foxglove connect where the configuration says so; without it the viewer goes on."""
    if config.foxglove_port is None:
        return None
    if not (config.foxglove_open or is_loopback_host(config.foxglove_host)):
        why = (
            f"Foxglove asks for no password, and {config.foxglove_host} is open to the network: "
            "set [viz] foxglove_open = true if that is meant, or leave foxglove_host out and "
            "reach the port through ssh"
        )
        _say_why(service, why)
        return None
    try:
        from trolley_viz.foxglove.bridge import FoxgloveBridge

        return FoxgloveBridge(service, config)
    except ImportError as error:
        why = f"the extra trolley-robot[foxglove] is not installed ({error})"
    except RuntimeError as error:
        why = f"{config.foxglove_host}, port {config.foxglove_port}, is not available ({error})"
    _say_why(service, why)
    return None


def _say_why(service: Service, why: str) -> None:
    service.log.error("Foxglove cannot connect", why=why)
    service.set_health("degraded", f"Foxglove cannot connect: {why}.")
