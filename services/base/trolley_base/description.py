"""What the configuration says about the robot, as the core and the wire want it."""

import numpy as np
from numpy.typing import NDArray

from trolley.config import ConfigError, RobotConfig
from trolley.files import read_file
from trolley.geometry import footprint_from_box, footprint_from_polygon, footprint_from_radius
from trolley.messages import Robot
from trolley.messages.motion import MAX_MESH_BYTES
from trolley_base.odometry.wheel_scales import counted_track_of
from trolley_base.safety.motion_limits import MotionLimits

LONGEST_WATCHDOG_S = 0.5
"""A board whose own watchdog takes longer than this drives at `UNWATCHED_SPEED` at most [s]."""
UNWATCHED_SPEED = 0.2
"""Highest speed with such a board, until its owner shortens the watchdog and says so [m/s]."""


def footprint_of(config: RobotConfig) -> NDArray[np.float64]:
    """Return the footprint (n, 2) [m] in `base_link`, counter-clockwise.

    Raises:
        ConfigError: it is not one that a robot can have.
    """
    given = config.robot.footprint
    try:
        if given.polygon_m is not None:
            return footprint_from_polygon(given.polygon_m)
        if given.radius_m is not None:
            return footprint_from_radius(given.radius_m)
        return footprint_from_box(given.length_m or 0.0, given.width_m or 0.0)
    except ValueError as error:
        raise ConfigError(f"[robot.footprint] {error}") from error


def half_track_of(config: RobotConfig, footprint: NDArray[np.float64]) -> float:
    """Return half of the distance between left and right wheels [m], at most half the width."""
    half_width_m = 0.5 * float(np.ptp(footprint[:, 1]))
    return half_width_m if (track_m := counted_track_of(config)) is None else 0.5 * track_m


def limits_of(config: RobotConfig, watchdog_s: float = 0.0) -> MotionLimits:
    """Return what no source may exceed.

    Args:
        config: the settings.
        watchdog_s: after what silence the motor board stops by itself [s].
    """
    limits = config.base.limits
    speed = limits.max_speed_mps
    return MotionLimits(
        speed=min(speed, UNWATCHED_SPEED) if watchdog_s > LONGEST_WATCHDOG_S else speed,
        wz=limits.max_wz_radps,
        acceleration=limits.acceleration_mps2,
        deceleration=limits.deceleration_mps2,
        angular_acceleration=limits.angular_acceleration_radps2,
        sideways=config.robot.drive == "mecanum",
        slope=limits.slope,
    )


def _mesh_of(config: RobotConfig) -> bytes | None:
    """Read the robot's body, None if there is no file of one."""
    if config.robot.mesh is None:
        return None
    path = config.path(config.robot.mesh)
    try:
        mesh = read_file(path)
    except OSError as error:
        raise ConfigError(f"[robot.mesh] {path}: cannot be read: {error.strerror}") from error
    if len(mesh) > MAX_MESH_BYTES:
        raise ConfigError(
            f"[robot.mesh] {path}: {len(mesh)} bytes, at most {MAX_MESH_BYTES} are allowed"
        )
    return mesh


def describe_robot(
    config: RobotConfig,
    footprint: NDArray[np.float64],
    limits: MotionLimits,
    delay_s: float | None,
    *,
    is_simulated: bool,
) -> Robot:
    """Return the message that makes the robot known, not stamped yet.

    Args:
        config: of the robot.
        footprint: (n, 2) corners [m] in `base_link`.
        limits: that are enforced.
        delay_s: usual time until the wheels follow a command, None if it was not measured.
        is_simulated: whether it drives in a simulated world.

    Raises:
        ConfigError: its mesh cannot be read or is too large for the wire.
    """
    return Robot(
        stamp_ns=0,
        name=config.robot.name,
        title=config.robot.title or config.robot.name,
        footprint=[(float(x), float(y)) for x, y in footprint],
        drive=config.robot.drive,
        max_speed=limits.speed,
        max_wz=limits.wz,
        deceleration=limits.deceleration,
        mesh=_mesh_of(config),
        simulated=is_simulated,
        delay=delay_s,
    )
