"""The bridge from beginning to end."""

from collections.abc import Sequence

from trolley.config import ConfigError, Ros2Config
from trolley.connection import RobotUnreachable, Target
from trolley.interrupts import Interrupts
from trolley.runtime.foreign_bus import open_foreign_bus
from trolley.runtime.guest import guest
from trolley.runtime.log import Log, set_up_logging
from trolley.runtime.zenoh_bus import NotConnected
from trolley_ros2.names import namespace_of
from trolley_ros2.service import Ros2Service

CONNECT_S = 5.0


def bridge(robot: str, target: Target, settings: Ros2Config) -> None:
    """Let ROS 2 nodes see and drive the robot until a signal ends it.

    Raises:
        ConfigError: No ROS 2 node can come to the router.
        RobotUnreachable: A router does not answer.
    """
    endpoints = _endpoints_of_nodes(target, settings)
    namespace = settings.namespace or namespace_of(robot)
    set_up_logging()
    with Interrupts().handled() as interrupts:
        try:
            with open_foreign_bus(endpoints, CONNECT_S) as ros:
                service = Ros2Service(ros, settings, namespace)
                with guest(service, robot, target.endpoints, target.keys):
                    Log(service.name).info(
                        "ROS 2 nodes see the robot",
                        robot=robot,
                        namespace=namespace,
                        domain=settings.domain,
                        distro=settings.distro,
                        role=settings.role,
                        router=", ".join(endpoints),
                    )
                    interrupts.wait()
        except KeyboardInterrupt:
            return
        except NotConnected as error:
            raise RobotUnreachable(_why(error, settings)) from error


def _endpoints_of_nodes(target: Target, settings: Ros2Config) -> Sequence[str]:
    if settings.router:
        return [settings.router]
    for one in target.endpoints:
        if one.startswith("tls/"):
            raise ConfigError(
                f"{one} lets in nobody without a certificate, and ROS 2 nodes have none: run a "
                "router for them here and name it, as in --router tcp/127.0.0.1:7447 "
                "(docs/ros2.md)"
            )
    return target.endpoints


def _why(error: NotConnected, settings: Ros2Config) -> str:
    if settings.router and settings.router in str(error):
        return (
            f"no router for ROS 2 nodes answers at {settings.router}; start one with "
            "`ros2 run rmw_zenoh_cpp rmw_zenohd`, or leave --router out for Trolley's own"
        )
    return str(error)
