"""What a drive has shown, as settings of a `robot.toml` and as sentences."""

import math
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from trolley.config import RobotConfig
from trolley.config.hardware import Axis
from trolley.messages import SetupSight
from trolley_base.odometry.wheel_scales import counted_track_of
from trolley_base.setup.drive import SetupDrive
from trolley_base.setup.geometry import Estimate, Geometry, cut, fit
from trolley_base.setup.gyro import Gyro, find_gyro
from trolley_base.setup.record import SetupRefused
from trolley_base.setup.response import Response, WheelWorth, measure
from trolley_base.setup.sight import Sector, picture

Floats = NDArray[np.float64]
Settings = dict[tuple[str, ...], Any]
LIDAR, ODOMETRY = ("base", "lidar"), ("base", "odometry")
CHASSIS, LIMITS, IMU = ("base", "chassis"), ("base", "limits"), ("base", "imu")


@dataclass(frozen=True, slots=True)
class FindingsParams:
    """What is written down; set by hand."""

    braking_share: float = 0.8
    """Share of the measured braking that is relied on: batteries empty, floors are wet."""
    known_std: float = 0.02
    """Scales whose standard deviation is larger are not known."""
    sure_std: float = 0.0025
    """Wheels whose standard deviation is larger are not sure within 0.5 %, and that is said."""
    known_m: float = 0.02
    """The lidar's place is not known where its standard deviation is larger [m]."""
    known_rad: float = 0.02
    """The same of its direction [rad]."""


PARAMS = FindingsParams()


@dataclass(frozen=True, slots=True)
class Findings:
    """What was measured.

    Attributes:
        geometry: lidar and wheels.
        response: the motors.
        gyro: the gyro, a sentence that says why it is not used, or None where there is none.
        slowest_mps: slowest commanded speed that moved the robot; None: none of those tried did.
        own: where the lidar sees the robot itself, in frame `laser` as it will be.
    """

    geometry: Geometry
    response: Response
    gyro: Gyro | str | None
    slowest_mps: float | None
    own: list[Sector]


def evaluate(drive: SetupDrive, half_track_m: float) -> Findings:
    """Find what a finished drive has shown.

    Args:
        drive: the drive.
        half_track_m: half of the track that the board calculates with [m].

    Raises:
        SetupRefused: it has shown too little, or was disturbed.
    """
    course = cut(drive.record, half_track_m)
    geometry = fit(course)
    _refuse_unknown(geometry)
    left, right = geometry.left.value, geometry.right.value
    worth = WheelWorth(left, right, half_track_m, geometry.linear.std, geometry.slip_m)
    response = measure(drive.record, worth)
    own = drive.own
    if geometry.is_mirrored:
        own = [(-last, -first) for first, last in reversed(own)]
    gyro = find_gyro(drive.record, course.stretches)
    return Findings(geometry, response, gyro, drive.slowest_mps, own)


def picture_of(
    drive: SetupDrive, geometry: Geometry, footprint: Floats, room_m: float
) -> SetupSight:
    """Return what the lidar has seen at the end, as it was found to be mounted.

    Args:
        drive: a finished drive.
        geometry: what it has shown.
        footprint: (n, 2) corners [m] in `base_link`.
        room_m: how far it had to be free all round [m].
    """
    points = drive.echoes * ((1.0, -1.0) if geometry.is_mirrored else (1.0, 1.0))
    return picture(points, geometry.base_T_laser, footprint, room_m, is_measured=True)


def _refuse_unknown(geometry: Geometry) -> None:
    place = max(geometry.x.std, geometry.y.std)
    scale = max(geometry.left.std, geometry.right.std, geometry.track.std)
    if place > PARAMS.known_m or geometry.yaw.std > PARAMS.known_rad or scale > PARAMS.known_std:
        raise SetupRefused(
            "The wheels slip so much that nothing can be measured well: the lidar's place is known "
            f"within {place:.3f} m and {math.degrees(geometry.yaw.std):.1f}°, the wheels within "
            f"{100.0 * scale:.1f} %. Measure on a floor that grips."
        )


def settings_of(findings: Findings, config: RobotConfig) -> Settings:
    """Return what is to stand in the `robot.toml`."""
    geometry, response, base = findings.geometry, findings.response, config.base
    pose = geometry.base_T_laser
    settings: Settings = {
        (*LIDAR, "pose"): {
            "x": round(pose.x, 4),
            "y": round(pose.y, 4),
            "yaw": round(pose.yaw, 4),
        },
        (*ODOMETRY, "linear_scale"): round(geometry.linear.value, 4),
        (*ODOMETRY, "angular_scale"): round(geometry.angular.value, 4),
        (*CHASSIS, "delay_s"): round(response.longest_delay_s, 3),
        (*CHASSIS, "usual_delay_s"): round(max(0.0, response.delay.value), 3),
    }
    masks = base.lidar.masks_deg
    if geometry.is_mirrored:
        settings[*LIDAR, "upside_down"] = not base.lidar.upside_down
        masks = [(-last, -first) for first, last in masks]
    masks = [*masks, *(_in_degrees(sector) for sector in findings.own)]
    if masks != base.lidar.masks_deg:
        settings[*LIDAR, "masks_deg"] = masks
    if counted_track_of(config) is not None:
        settings[*ODOMETRY, "wheel_ratio"] = round(geometry.wheel_ratio.value, 4)
    if isinstance(findings.gyro, Gyro):
        own = base.imu
        before = base.chassis.imu_axes if own is None else own.axes
        axes: tuple[Axis, Axis, Axis] = findings.gyro.axes(before)
        if axes != before:
            key = (*CHASSIS, "imu_axes") if own is None else (*IMU, "axes")
            settings[key] = list(axes)
    braking = round(PARAMS.braking_share * response.braking.value, 2)
    if braking < base.limits.deceleration_mps2:
        settings[*LIMITS, "deceleration_mps2"] = braking
    acceleration = round(response.acceleration.value, 2)
    if acceleration < base.limits.acceleration_mps2:
        settings[*LIMITS, "acceleration_mps2"] = acceleration
    return settings


def describe(findings: Findings, track_m: float | None) -> list[str]:
    """Return what was measured, line by line, each with one standard deviation.

    Args:
        findings: what was measured.
        track_m: the track that the board calculates with, where it is known [m].
    """
    geometry, response = findings.geometry, findings.response
    lines = [
        f"lidar: x {_m(geometry.x)}, y {_m(geometry.y)}, yaw {_deg(geometry.yaw)}"
        + (", turning the other way than set" if geometry.is_mirrored else ""),
        f"left wheel: a metre counted is really {_scale(geometry.left)} m",
        f"right wheel: a metre counted is really {_scale(geometry.right)} m",
        f"turns: a radian counted is really {_scale(geometry.angular)} rad",
    ]
    least_sure = max(geometry.left.std, geometry.right.std)
    if least_sure > PARAMS.sure_std:
        lines.append(
            f"the wheels slip by some {100.0 * geometry.slip_m:.1f} cm in a metre, so their sizes "
            f"are sure within {200.0 * least_sure:.1f} % only; a longer drive (--long), more room "
            "or a floor that grips makes them surer"
        )
    if track_m is not None:
        track = Estimate(track_m * geometry.track.value, track_m * geometry.track.std)
        lines.append(f"track: {_m(track)}, where the board assumes {track_m:.3f} m")
    if geometry.play.value > 2.0 * geometry.play.std:
        lines.append(f"play of the wheels when they turn back: {1e3 * geometry.play.value:.1f} mm")
    lines += [f"the lidar sees the robot itself from {_sector(own)}" for own in findings.own]
    lines += [
        f"delay: {response.delay.value:.3f} ± {response.delay.std:.3f} s, "
        f"at most {response.longest_delay_s:.3f} s",
        f"acceleration: {_rate(response.acceleration)}; braking: {_rate(response.braking)}",
        f"stopping from {response.speed:.2f} m/s takes {_m(response.stopping)}",
        "slowest speed that moves the robot: "
        + ("unknown" if findings.slowest_mps is None else f"{findings.slowest_mps:g} m/s"),
    ]
    match findings.gyro:
        case Gyro(up, scale):
            lines.append(f"gyro: {up} points up, a radian reported is really {_scale(scale)} rad")
        case str(why_not):
            lines.append(f"gyro: {why_not}")
        case None:
            pass
    return lines


def _in_degrees(sector: Sector) -> tuple[float, float]:
    first = math.remainder(sector[0], 2.0 * math.pi)
    last = first + (sector[1] - sector[0]) % (2.0 * math.pi)
    return round(math.degrees(first), 1), round(math.degrees(last), 1)


def _m(one: Estimate) -> str:
    return f"{one.value:.3f} ± {one.std:.3f} m"


def _deg(one: Estimate) -> str:
    return f"{math.degrees(one.value):.1f} ± {math.degrees(one.std):.1f}°"


def _scale(one: Estimate) -> str:
    return f"{one.value:.4f} ± {one.std:.4f}"


def _rate(one: Estimate) -> str:
    return f"{one.value:.2f} ± {one.std:.2f} m/s²"


def _sector(sector: Sector) -> str:
    first, last = _in_degrees(sector)
    return f"{first:g}° to {last:g}°"
