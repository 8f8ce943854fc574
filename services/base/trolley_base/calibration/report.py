"""The results of a calibration, in sentences for people."""

import math
from collections.abc import Sequence

import numpy as np

from trolley.geometry import Pose2D
from trolley_base.calibration.estimate import Estimate
from trolley_base.calibration.umbmark import Benchmark
from trolley_base.odometry.wheel_scales import WheelScales
from trolley_base.upkeep.correction import Correction
from trolley_base.upkeep.legs import Leg

UNSURE_SCALE = 0.01
"""Standard deviation of a scale above which it is not proposed; another drive is needed."""
UNSURE_BEND = 0.015
"""Standard deviation of the bend above which it is not proposed [rad/m]."""
SLIPPED = 1.3
"""A misfit above this says that the legs do not fit each other, whatever is corrected."""
SURE = 5.0
"""The lidar is said to sit otherwise if it does by so many standard errors ..."""
LIDAR_RAD, LIDAR_M = math.radians(1.0), 0.02
"""... and by this much."""


def usable(found: Estimate) -> Correction:
    """Return the parts of an estimate that are certain enough; the others change nothing."""
    one = found.correction
    return Correction(
        one.linear if found.linear_std <= UNSURE_SCALE else 1.0,
        one.angular if found.angular_std <= UNSURE_SCALE else 1.0,
        one.bend if found.bend_std <= UNSURE_BEND else 0.0,
    )


def is_right(found: Estimate) -> bool:
    """Say whether no error is larger than two standard errors."""
    one = found.correction
    errors = one.linear - 1.0, one.angular - 1.0, one.bend
    deviations = found.linear_std, found.angular_std, found.bend_std
    limits = UNSURE_SCALE, UNSURE_SCALE, UNSURE_BEND
    return all(
        abs(error) < 2.0 * std or std > limit
        for error, std, limit in zip(errors, deviations, limits, strict=True)
    )


def describe_estimate(found: Estimate) -> list[str]:
    """Describe the errors of the odometry with its current settings, one line each."""
    one = found.correction
    lines = ["Odometry errors with the current settings:"]
    if found.linear_std <= UNSURE_SCALE:
        lines.append(f"  a reported metre is really {one.linear:.4f} m (± {found.linear_std:.4f})")
    elif math.isfinite(found.linear_std):
        lines.append(f"  distance: unknown; {_why(found, 'straight stretches')}")
    else:
        lines.append("  distance: unknown; the end of a closed path does not show it")
    if found.angular_std <= UNSURE_SCALE:
        lines.append(
            f"  a reported full turn is really {360.0 * one.angular:.1f}° "
            f"(± {360.0 * found.angular_std:.1f}°)"
        )
    else:
        lines.append(f"  turning: unknown; {_why(found, 'turns')}")
    if found.bend_std <= UNSURE_BEND:
        side = "left" if one.bend > 0.0 else "right"
        lines.append(
            f"  a reported straight line really bends to the {side} by "
            f"{math.degrees(abs(one.bend)):.1f}° per metre (± {math.degrees(found.bend_std):.1f}°)"
        )
    else:
        lines.append(f"  bending: unknown; {_why(found, 'straight stretches')}")
    return lines + _describe_lidar(found)


def _why(found: Estimate, what: str) -> str:
    if found.misfit > SLIPPED:
        return "the wheels slipped, or something moved: the pieces of the drive do not agree"
    return f"the drive had too few {what}"


def _describe_lidar(found: Estimate) -> list[str]:
    """Say how the lidar sits otherwise than robot.toml says, nothing where it does not."""
    lidar, (yaw_std, x_std, y_std) = found.lidar, found.lidar_std
    words: list[str] = []
    if abs(lidar.yaw) > max(LIDAR_RAD, SURE * yaw_std):
        side = "left" if lidar.yaw > 0.0 else "right"
        words.append(f"turned to the {side} by {math.degrees(abs(lidar.yaw)):.1f}°")
    for metres, std, way in (
        (lidar.x, x_std, ("ahead", "back")),
        (lidar.y, y_std, ("to the left", "to the right")),
    ):
        if abs(metres) > max(LIDAR_M, SURE * std):
            words.append(f"{100.0 * abs(metres):.0f} cm further {way[metres < 0.0]}")
    if not words:
        return []
    return [
        f"  the lidar sits otherwise than robot.toml says: {', '.join(words)}. Correct "
        "[base.lidar] pose; `trolley setup` measures it.",
    ]


def describe_fit(legs: Sequence[Leg], correction: Correction, lidar: Pose2D) -> str:
    """Say by how much odometry misses the end of a leg of the drive, before and after.

    Args:
        legs: of the drive.
        correction: of the odometry.
        lidar: as in `Estimate`.
    """
    before, after = (_misses(legs, one, lidar) for one in (Correction(), correction))
    return (
        f"Odometry misses the end of a leg by {before[0] * 100.0:.1f} cm and {before[1]:.1f}° "
        f"before, {after[0] * 100.0:.1f} cm and {after[1]:.1f}° after (RMS of {len(legs)} legs)."
    )


def describe_benchmark(before: Benchmark, after: Benchmark, side_m: float) -> list[str]:
    """Say by how much odometry misses the end of a square, before and after."""
    lines = [f"UMBmark, squares of {side_m:g} m: true end of a square minus its end by odometry"]
    for name, one in (("before", before), ("after", after)):
        directions = (("counter-clockwise", one.centre_ccw), ("clockwise", one.centre_cw))
        centres = ", ".join(f"{way} ({x:+.3f}, {y:+.3f}) m" for way, (x, y) in directions)
        lines.append(f"  {name:6s} {centres}; E_max,syst {one.largest_m:.3f} m")
    return lines


def describe_track(scales: WheelScales) -> str | None:
    """Say how far apart the wheels seem to be, None if the board's own figure is unknown."""
    if scales.track_m is None:
        return None
    seeming_m = scales.track_m * scales.linear / scales.angular
    return (
        f"The robot turns as if its wheels were {seeming_m:.3f} m apart; "
        f"the board assumes {scales.track_m:.3f} m."
    )


def _misses(legs: Sequence[Leg], correction: Correction, lidar: Pose2D) -> tuple[float, float]:
    errors = np.array([leg.error_of(correction, lidar) for leg in legs])
    distance_m = math.sqrt(float(np.mean(errors[:, 0] ** 2 + errors[:, 1] ** 2)))
    measured = [math.isfinite(leg.error_rad) for leg in legs]
    headings = errors[measured, 2]
    rms_rad = math.sqrt(float(np.mean(headings**2))) if len(headings) else math.nan
    return distance_m, math.degrees(rms_rad)
