"""Checks of the routers that the configuration names: is anybody there?"""

import dataclasses
import socket

from trolley.connection import Connection, RobotUnreachable, RouterBusy
from trolley.doctor.finding import Finding, note, ok, problem, warning
from trolley.ports import ROS_ROUTER
from trolley.security.host_keys import ALLOWED, AUTHORITY, HostKeys

PATIENCE_S = 1.5
WITH_PORT = ("tcp", "tls", "ws")


@dataclasses.dataclass(frozen=True)
class Endpoint:
    """A router's address and what came of knocking there."""

    text: str
    trouble: str = ""
    """Why nobody answers; "" if somebody does."""


def address_of(endpoint: str) -> tuple[str, int] | None:
    """Host and port of an endpoint that is reached over TCP, None for another kind."""
    protocol, _, rest = endpoint.partition("/")
    host, _, port = rest.partition("?")[0].partition("#")[0].rpartition(":")
    if protocol not in WITH_PORT or not port.isdigit():
        return None
    return host.removeprefix("[").removesuffix("]"), int(port)


def knock(endpoint: str) -> Endpoint | None:
    """Connect and hang up; None for an endpoint of a kind that cannot be knocked at."""
    address = address_of(endpoint)
    if address is None:
        return None
    try:
        with socket.create_connection(address, PATIENCE_S):
            return Endpoint(endpoint)
    except socket.gaierror:
        return Endpoint(endpoint, f"the name {address[0]} is not known")
    except TimeoutError:
        return Endpoint(endpoint, "nothing comes back")
    except OSError as error:
        return Endpoint(endpoint, (error.strerror or str(error)).lower())


def check_uplink(endpoint: str, keys: HostKeys | None) -> list[Finding]:
    """Whether this host can link to the home router. The robot drives without it, too.

    Args:
        endpoint: of the home router.
        keys: this host's; None where a check of its own says that they cannot be used.
    """
    knocked = knock(endpoint)
    where = f"The home router at {endpoint}"
    if knocked is not None and knocked.trouble:
        return [
            warning(
                "router",
                f"{where} does not answer: {knocked.trouble}.",
                "Make sure that it is switched on and its address is right ([zenoh] uplink); the "
                "robot itself works without it.",
            )
        ]
    if keys is None:
        return []
    try:
        with Connection([endpoint], keys=keys) as connection:
            robots = connection.robots()
    except RouterBusy:
        return [
            warning(
                "router",
                f"{where} answers, but does not say in time who is there.",
                "It, the link to it or this computer is too busy: try again later.",
            )
        ]
    except RobotUnreachable:
        return [
            problem(
                "router",
                f"{where} answers, but this host cannot link to it.",
                f"Its {AUTHORITY} and that in {keys.folder} must be the same, its {ALLOWED} must "
                "hold this host's certificate, and its own must name that address: copy the files "
                "that `trolley keys` made for both again. If they are right, look at its clock: by "
                "that, too, the certificates must not have expired.",
            )
        ]
    if not robots:
        # To a host that may do nothing it shows nothing: the two look alike.
        return [
            note(
                "router",
                f"{where} shows no robot to this host.",
                f"If one is linked to it, this host's certificate is missing in its {ALLOWED}: "
                "copy that again, and restart it (docs/network.md).",
            )
        ]
    return [ok("router", f"{where} answers.")]


@dataclasses.dataclass(frozen=True)
class Door:
    """What is known about the router of this host."""

    endpoints: tuple[str, ...]
    trouble: str
    """Why there is no connection; "" if there is one."""
    owner: str = ""
    """Who listens at its port, where that can be seen."""
    silent: tuple[Endpoint, ...] = ()
    """Addresses that do not answer, where there are several."""
    is_wanted: bool = True
    """Whether it was asked for, or something here is set up to need it."""


def _check_router(where: str, owner: str) -> Finding:
    if not owner.startswith(ROS_ROUTER):
        return ok("router", f"The router at {where} answers.")
    return warning(
        "router",
        f"The router at {where} is that of ROS 2, {owner}: by itself it lets in every host of your "
        "network, and whoever comes in may drive the robot.",
        "End it and start `trolley router`, which nodes of ROS 2 use as well; docs/ros2.md says "
        "how both run.",
    )


def check_door(door: Door) -> list[Finding]:
    """Whether services and tools can meet."""
    where = ", ".join(door.endpoints)
    if not door.trouble:
        silent = [one.text for one in door.silent]
        answering = ", ".join(one for one in door.endpoints if one not in silent) or where
        return [
            _check_router(answering, door.owner),
            *(
                warning(
                    "router",
                    f"No router answers at {one.text}: {one.trouble}.",
                    "Another one does; take this address out of [zenoh] connect if it is old.",
                )
                for one in door.silent
            ),
        ]
    if door.owner.startswith(ROS_ROUTER):
        return [
            problem(
                "router",
                f"The router of ROS 2, {door.owner}, occupies the port of Trolley's and does not "
                f"answer at {where}.",
                "End it: nodes of ROS 2 use Trolley's router as well (docs/ros2.md).",
            )
        ]
    if door.owner:
        return [
            problem(
                "router",
                f"No router answers at {where}; the port is used by {door.owner}.",
                "End that program, or set another port in [zenoh] connect.",
            )
        ]
    remedy = (
        "Start the robot: `sudo systemctl start trolley-robot.target`, or `trolley up`; "
        "--connect names a router elsewhere."
    )
    if door.is_wanted:
        return [problem("router", f"No router answers at {where}, so nothing can run.", remedy)]
    return [
        note(
            "router",
            f"No robot runs on this computer (no router at {where}).",
            "`trolley demo` shows one; --connect names a router elsewhere.",
        )
    ]
