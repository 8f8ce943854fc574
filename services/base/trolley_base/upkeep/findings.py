"""What to propose of what `upkeep` has found, in words and as settings."""

import math
from collections.abc import Collection, Sequence
from dataclasses import dataclass, replace

from trolley.geometry import Pose2D
from trolley.messages import Proposal
from trolley_base.odometry.wheel_scales import WheelScales
from trolley_base.upkeep.correction import Correction, combined
from trolley_base.upkeep.evidence import ANGULAR, BEND, LINEAR, PARAMS, YAW, Errors, X, Y


@dataclass(frozen=True, slots=True)
class FindingParams:
    """What is worth a proposal; set by hand."""

    sure: float = 5.0
    """Number of standard deviations by which a figure must be off."""
    lidar_rad: float = math.radians(1.0)
    """The lidar's direction must be off by this [rad]."""
    lidar_m: float = 0.02
    """Its place must be off by this [m]."""
    wheel: float = 0.02
    """The wheels' sizes must differ by this share more or less than they should."""
    both: float = 0.05
    """Both wheels must be off by this share: rugs hold them back by some per cent as well."""
    track: float = 0.03
    """The same of the track."""
    stays: float = 0.7
    """What is proposed stays so while this share of what was needed is left."""


FINDING = FindingParams()


@dataclass(frozen=True, slots=True)
class InForce:
    """What robot.toml says, as base uses it.

    Attributes:
        base_T_laser: pose of the lidar.
        scales: of the wheels.
        half_track_m: half the distance between the wheels [m].
    """

    base_T_laser: Pose2D
    scales: WheelScales
    half_track_m: float


def find_proposals(
    errors: Errors, in_force: InForce, proposed: Collection[str] = ()
) -> list[Proposal]:
    """Return what should be corrected, or looked at.

    Args:
        errors: as they are known now.
        in_force: what they are errors of.
        proposed: the ids of what is proposed already.
    """
    if errors.misfit > PARAMS.loose * (FINDING.stays if "odometry" in proposed else 1.0):
        return [
            Proposal(
                id="odometry",
                message="Wheels and lidar no longer fit each other: their differences change from "
                "metre to metre. Look at the wheels, the encoders' cables, and whether the lidar "
                "sits firmly.",
            )
        ]

    def is_off(name: str, figure: tuple[float, float], least: float) -> bool:
        value, std = figure
        share = FINDING.stays if name in proposed else 1.0
        return abs(value) > share * max(least, FINDING.sure * std)

    found: list[Proposal] = []
    yaw, x, y = (errors.combined((index, 1.0)) for index in (YAW, X, Y))
    if (
        is_off("lidar", yaw, FINDING.lidar_rad)
        or is_off("lidar", x, FINDING.lidar_m)
        or is_off("lidar", y, FINDING.lidar_m)
    ):
        found.append(_of_lidar(yaw, x, y, in_force))
    half_m = in_force.half_track_m
    left = errors.combined((LINEAR, 1.0), (BEND, -half_m))
    right = errors.combined((LINEAR, 1.0), (BEND, half_m))
    track = errors.combined((LINEAR, 1.0), (ANGULAR, -1.0))
    uneven = errors.combined((BEND, 2.0 * half_m))
    wheels = ("left wheel", left), ("right wheel", right)
    off: list[tuple[str, tuple[float, float]]] = []
    if is_off("wheels", errors.combined((LINEAR, 1.0)), FINDING.both):
        off += wheels
    elif is_off("wheels", uneven, FINDING.wheel):
        off.append(max(wheels, key=lambda one: abs(one[1][0])))
    if is_off("wheels", track, FINDING.track):
        off.append(("track", track))
    if off:
        found.append(_of_wheels(off, errors.correction, in_force))
    return found


def _of_lidar(
    yaw: tuple[float, float], x: tuple[float, float], y: tuple[float, float], in_force: InForce
) -> Proposal:
    # A place that is not known better than it is written down stays as it is.
    dx, dy = (
        value if abs(value) > FINDING.stays * max(FINDING.lidar_m, FINDING.sure * std) else 0.0
        for value, std in (x, y)
    )
    dyaw = yaw[0] if abs(yaw[0]) > FINDING.sure * yaw[1] else 0.0
    before = in_force.base_T_laser
    pose = Pose2D(before.x + dx, before.y + dy, before.yaw + dyaw).wrapped()
    words = [f"turned by {math.degrees(dyaw):.1f}°"] if dyaw else []
    if dx or dy:
        words.append(f"moved by {100.0 * math.hypot(dx, dy):.0f} cm")
    return Proposal(
        id="lidar",
        message=f"The lidar is {' and '.join(words)} against what robot.toml says. Push it back, "
        "or take its pose over.",
        settings={
            "base.lidar.pose.x": round(pose.x, 4),
            "base.lidar.pose.y": round(pose.y, 4),
            "base.lidar.pose.yaw": round(pose.yaw, 4),
        },
    )


def _of_wheels(
    off: Sequence[tuple[str, tuple[float, float]]], correction: Correction, in_force: InForce
) -> Proposal:
    words = [
        f"The {what} is {100.0 * abs(value):.1f} % {_more(what, value)} than robot.toml says."
        for what, (value, _) in off
    ]
    message = f"{' '.join(words)} Take it over?"
    scales = in_force.scales
    if scales.track_m is None:
        message += " Its wheel_ratio can only be proposed where [base.odometry] track_m is set."
        correction = replace(correction, bend=0.0)
    to_be = combined(correction, scales)
    settings = {
        "base.odometry.linear_scale": round(to_be.linear, 4),
        "base.odometry.angular_scale": round(to_be.angular, 4),
    }
    if scales.track_m is not None:
        settings["base.odometry.wheel_ratio"] = round(to_be.wheel_ratio, 4)
    return Proposal(id="wheels", message=message, settings=settings)


def _more(what: str, value: float) -> str:
    if what == "track":
        return "wider" if value > 0.0 else "narrower"
    return "larger" if value > 0.0 else "smaller"
