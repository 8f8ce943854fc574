"""What was found, in words and figures for a person."""

import math
from collections.abc import Sequence

import numpy as np

from trolley_base.calibration.correction import Correction
from trolley_base.calibration.estimate import Estimate
from trolley_base.calibration.legs import Leg
from trolley_base.calibration.umbmark import Benchmark
from trolley_base.odometry.wheel_scales import WheelScales

UNSURE_SCALE = 0.01
"""An estimate less certain than this is not proposed: drive once more instead."""
UNSURE_BEND = 0.03


def usable(found: Estimate) -> Correction:
    """Return the parts of an estimate that are sure enough; the others change nothing."""
    one = found.correction
    return Correction(
        one.linear if found.linear_std <= UNSURE_SCALE else 1.0,
        one.angular if found.angular_std <= UNSURE_SCALE else 1.0,
        one.bend if found.bend_std <= UNSURE_BEND else 0.0,
    )


def describe_estimate(found: Estimate) -> list[str]:
    """Say what is wrong with the odometry as it is now, a line each."""
    one = found.correction
    lines = ["What the odometry is wrong by now:"]
    if found.linear_std <= UNSURE_SCALE:
        lines.append(f"  a metre that it reports is {one.linear:.4f} m (± {found.linear_std:.4f})")
    elif math.isfinite(found.linear_std):
        lines.append("  a metre: not known; the drive held too few straight parts")
    else:
        lines.append("  a metre: not known; where a closed path ends does not say it")
    if found.angular_std <= UNSURE_SCALE:
        lines.append(
            f"  a full turn that it reports is {360.0 * one.angular:.1f}° "
            f"(± {360.0 * found.angular_std:.1f}°)"
        )
    else:
        lines.append("  a full turn: not known; the drive held too few turns")
    if found.bend_std <= UNSURE_BEND:
        side = "left" if one.bend > 0.0 else "right"
        lines.append(
            f"  what it takes for straight bends to the {side} by "
            f"{math.degrees(abs(one.bend)):.1f}° in a metre (± {math.degrees(found.bend_std):.1f}°)"
        )
    else:
        lines.append("  bending: not known; the drive held too few straight parts")
    return lines


def describe_fit(legs: Sequence[Leg], correction: Correction) -> str:
    """Say how far the odometry of a piece of the drive ends from the truth, before and after."""
    before, after = (_misses(legs, one) for one in (Correction(), correction))
    return (
        f"A piece of the drive ends {before[0] * 100.0:.1f} cm and {before[1]:.1f}° off before, "
        f"{after[0] * 100.0:.1f} cm and {after[1]:.1f}° after (root mean square of {len(legs)})."
    )


def describe_benchmark(before: Benchmark, after: Benchmark, side_m: float) -> list[str]:
    """Say where squares end, before and after."""
    lines = [f"UMBmark, squares of {side_m:g} m: where a square ends by odometry and really"]
    for name, one in (("before", before), ("after", after)):
        centres = ", ".join(
            f"{way} ({x:+.3f}, {y:+.3f}) m"
            for way, (x, y) in (("left round", one.centre_ccw), ("right round", one.centre_cw))
        )
        lines.append(f"  {name:6s} {centres}; E_max,syst {one.largest_m:.3f} m")
    return lines


def describe_track(scales: WheelScales) -> str | None:
    """Say how far apart the wheels seem to be, None where nobody knows what the board thinks."""
    if scales.track_m is None:
        return None
    seeming_m = scales.track_m * scales.linear / scales.angular
    return (
        f"The robot turns as if its wheels were {seeming_m:.3f} m apart; "
        f"the board counts with {scales.track_m:.3f} m."
    )


def _misses(legs: Sequence[Leg], correction: Correction) -> tuple[float, float]:
    errors = np.array([leg.error_of(correction) for leg in legs])
    distance_m = math.sqrt(float(np.mean(errors[:, 0] ** 2 + errors[:, 1] ** 2)))
    measured = [math.isfinite(leg.error_rad) for leg in legs]
    headings = errors[measured, 2]
    rms_rad = math.sqrt(float(np.mean(headings**2))) if len(headings) else math.nan
    return distance_m, math.degrees(rms_rad)
