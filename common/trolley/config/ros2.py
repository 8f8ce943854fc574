"""`[ros2]`: what ROS 2 nodes see of the robot and may do, through `trolley ros2`."""

import re
from typing import Annotated, Literal

from msgspec import Meta, Struct

from trolley.config.robot import why_no_endpoint

Namespace = Annotated[str, Meta(max_length=200)]
_NAMESPACE = re.compile(r"/|(/[A-Za-z_][A-Za-z0-9_]*)+")


class Ros2Config(Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """The bridge to ROS 2 nodes that use rmw_zenoh."""

    role: Literal["viewer", "operator"] = "operator"
    """With `operator`, nodes drive the robot, too; with `viewer`, they only look."""
    distro: Literal["jazzy", "humble"] = "jazzy"
    """The nodes' release of ROS 2: `humble`, or `jazzy` for every newer one."""
    domain: Annotated[int, Meta(ge=0, le=232)] = 0
    """The ROS_DOMAIN_ID of the nodes."""
    namespace: Namespace = ""
    """Where the robot's topics are, such as `/kiwi`, or `/`; the robot's name if empty."""
    router: str = ""
    """Endpoint of the nodes' router, such as `tcp/127.0.0.1:7447`; Trolley's own if empty."""

    def __post_init__(self) -> None:
        """Refuse what is neither a namespace nor an endpoint."""
        if self.namespace and (why_not := why_no_namespace(self.namespace)):
            raise ValueError(why_not)
        if self.router and (why_not := why_no_endpoint(self.router)):
            raise ValueError(why_not)


def why_no_namespace(text: str) -> str:
    """Why this is no namespace, "" where it is one."""
    if _NAMESPACE.fullmatch(text):
        return ""
    return f"{text!r} is not a namespace: write /kiwi or /home/kiwi, or / for none"
