"""Trolley: navigation for small indoor robots, without ROS.

`from trolley import Robot` talks to a robot (`AsyncRobot` for asyncio); services are built on
`trolley.runtime`.
"""

TYPE_CHECKING = False  # `typing` takes longer than all else that a program begins with
if TYPE_CHECKING:
    from trolley.async_client import AsyncRobot
    from trolley.client import Robot
    from trolley.codes import Refused
    from trolley.connection import RobotUnreachable, SeveralRobots

__all__ = ["AsyncRobot", "Refused", "Robot", "RobotUnreachable", "SeveralRobots"]

_PLACES = {
    "AsyncRobot": "trolley.async_client",
    "Refused": "trolley.codes",
    "Robot": "trolley.client",
    "RobotUnreachable": "trolley.connection",
    "SeveralRobots": "trolley.connection",
}


def __getattr__(name: str) -> object:
    """Import the client when it is first asked for: services need none of it."""
    if name not in _PLACES:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    import importlib

    return getattr(importlib.import_module(_PLACES[name]), name)
