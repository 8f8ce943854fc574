"""The lidar: times of beams, mirrors and glass, and the errors that it is said to have."""

import math
from typing import TYPE_CHECKING

import numpy as np
import pytest

from trolley.geometry import Pose2D, Twist2D
from trolley_base.drivers.interface import LidarScan

if TYPE_CHECKING:
    from collections.abc import Callable

    from trolley_base.world import Simulation

    MakeSimulation = Callable[..., Simulation]

EXACT_WHEELS = """
[wheels]
scale_std = 0.0
turn_scale_std = 0.0
slip_per_m = 0.0
yaw_slip_per_m = 0.0
yaw_slip_per_rad = 0.0
"""
PERFECT = "[lidar]\nnoise_m = 0.0\nnoise_share = 0.0\ndrop_out = 0.0\ninvalid = 0.0\n"


def scans(
    simulation: "Simulation",
    count: int,
    command: Twist2D = Twist2D(0, 0, 0),  # noqa: B008
) -> list[LidarScan]:
    found: list[LidarScan] = []
    while len(found) < count:
        simulation.step(command)
        found += simulation.take_scans()
    return found


def beam(scan: LidarScan, bearing: float) -> float:
    return float(scan.ranges[round((bearing - scan.angle_min) / scan.angle_increment)])


def test_walls_are_where_they_are(simulate: "MakeSimulation") -> None:
    scan = scans(simulate(base_T_laser=Pose2D(0.1, 0.0, math.pi / 2)), 1)[0]
    # The laser looks to the left: its own left is the robot's back.
    assert beam(scan, 0.0) == pytest.approx(2.0)
    assert beam(scan, math.pi / 2) == pytest.approx(3.1)
    assert beam(scan, -math.pi / 2) == pytest.approx(2.9)


def test_beyond_reach_is_no_echo_and_too_near_is_invalid(simulate: "MakeSimulation") -> None:
    errors = EXACT_WHEELS + PERFECT + "range_max_m = 2.5\nrange_min_m = 0.4\n"
    simulation = simulate("[[circle]]\nx = 0.4\ny = 0\nradius_m = 0.1\n", errors)
    scan = scans(simulation, 1)[0]
    assert beam(scan, math.pi / 2) == pytest.approx(2.0)
    assert beam(scan, -math.pi) == math.inf
    assert beam(scan, 0.0) == 0.0


@pytest.mark.parametrize("clockwise", [False, True])
def test_each_beam_is_measured_at_its_own_time(simulate: "MakeSimulation", clockwise: bool) -> None:
    errors = EXACT_WHEELS + PERFECT + f"clockwise = {str(clockwise).lower()}\n"
    simulation = simulate(errors=errors)
    scan = scans(simulation, 6, Twist2D(0.0, 0.0, 2.0))[-1]
    beams = len(scan.ranges)
    assert scan.time_increment == pytest.approx((-1 if clockwise else 1) * 0.1 / beams)
    times = scan.stamp_ns * 1e-9 + np.arange(beams) * scan.time_increment
    assert min(times) == pytest.approx(0.5)
    assert max(times) < 0.6
    # It has turned at 2 rad/s since the first half second, which was for getting there.
    yaw = simulation.truth().pose.yaw - 2.0 * (0.6 - times)
    bearings = yaw + scan.angle_min + np.arange(beams) * scan.angle_increment
    expected = np.minimum(3.0 / np.abs(np.cos(bearings)), 2.0 / np.abs(np.sin(bearings)))
    np.testing.assert_allclose(scan.ranges, expected, atol=1e-4)


@pytest.mark.parametrize("clockwise", [False, True])
def test_a_narrower_view_is_the_middle_of_the_whole(
    simulate: "MakeSimulation", clockwise: bool
) -> None:
    sense = f"clockwise = {str(clockwise).lower()}\n"
    turning = Twist2D(0.0, 0.0, 1.0)
    whole = EXACT_WHEELS + PERFECT + sense + "beams = 360\n"
    part = EXACT_WHEELS + PERFECT + sense + f"beams = 270\nfield_of_view = {1.5 * math.pi}\n"
    all_round = scans(simulate(errors=whole), 3, turning)[-1]
    ahead = scans(simulate(errors=part), 3, turning)[-1]
    np.testing.assert_array_equal(ahead.ranges, all_round.ranges[45:315])
    assert ahead.angle_min == pytest.approx(all_round.angle_min + 45 * all_round.angle_increment)
    assert ahead.angle_increment == pytest.approx(all_round.angle_increment)
    lag_ns = round(45 * all_round.time_increment * 1e9)
    assert abs(ahead.stamp_ns - all_round.stamp_ns - lag_ns) <= 1


def test_no_beam_is_left_out_at_odd_rates(simulate: "MakeSimulation") -> None:
    errors = EXACT_WHEELS + PERFECT + "beams = 457\nrate_hz = 7.3\n"
    found = scans(simulate(errors=errors), 20)
    stamps = np.array([scan.stamp_ns for scan in found]) * 1e-9
    np.testing.assert_allclose(stamps, np.arange(20) / 7.3, atol=1e-8)
    for scan in found:
        np.testing.assert_array_equal(scan.ranges, found[0].ranges)


def test_noise_and_drop_outs_are_as_stated(simulate: "MakeSimulation") -> None:
    errors = "[lidar]\nnoise_m = 0.01\nnoise_share = 0.01\ndrop_out = 0.1\ninvalid = 0.05\n"
    clean = scans(simulate(), 1)[0].ranges
    ranges = np.array([scan.ranges for scan in scans(simulate(errors=errors), 100)])
    assert np.isinf(ranges).mean() == pytest.approx(0.1, abs=0.01)
    assert (ranges == 0.0).mean() == pytest.approx(0.05, abs=0.01)
    measured = np.isfinite(ranges) & (ranges > 0.0)
    errors_in_sigma = ((ranges - clean) / (0.01 + 0.01 * clean))[measured]
    assert errors_in_sigma.mean() == pytest.approx(0.0, abs=0.03)
    assert errors_in_sigma.std() == pytest.approx(1.0, abs=0.03)


def test_a_mirror_shows_the_room_behind_it(simulate: "MakeSimulation") -> None:
    mirror = "[[mirror]]\npoints = [[1.5, 1.0], [1.5, -1.0]]\nside = 'left'\n"
    simulation = simulate(mirror, start=Pose2D(-1.0, 0.0, 0.0))
    scan = scans(simulation, 1)[0]
    # Walking the points the left is +x: the robot is behind the mirror, which is opaque there.
    assert beam(scan, 0.0) == pytest.approx(2.5)
    scan = scans(simulate(mirror, start=Pose2D(2.5, 0.0, math.pi)), 1)[0]
    # To the mirror and back is the robot's own front: 2 x 1.0 - 0.15.
    assert beam(scan, 0.0) == pytest.approx(1.85)
    # Past its own body the beam ends at the wall behind it: 1.0 + 1.5 along x.
    assert beam(scan, 0.35) == pytest.approx(2.5 / math.cos(0.35), rel=0.002)


def test_two_mirrors_show_each_other(simulate: "MakeSimulation") -> None:
    mirrors = (
        "[[mirror]]\npoints = [[1.0, -1.9], [1.0, 1.9]]\n"
        "[[mirror]]\npoints = [[-1.0, -1.9], [-1.0, 1.9]]\n"
    )
    scan = scans(simulate(mirrors), 1)[0]
    bearing = math.radians(40)
    # Up to the wall at y = 2: three metres along, so a bounce at 1 m and one at 3 m, no more.
    assert beam(scan, bearing) == pytest.approx(2.0 / math.sin(bearing), rel=1e-3)
    # A flat beam meets more mirrors than it has strength for.
    assert beam(scan, math.radians(13)) == math.inf


def test_a_mirror_flush_on_the_wall_is_met_before_it(simulate: "MakeSimulation") -> None:
    mirror = "[[mirror]]\npoints = [[3.0, -1.0], [3.0, 1.0]]\n"
    scan = scans(simulate(mirror, start=Pose2D(2.0, 0.0, 0.0)), 1)[0]
    bearing = math.radians(10)
    # One metre to the mirror and six to the wall on the other side of the room.
    assert beam(scan, bearing) == pytest.approx(7.0 / math.cos(bearing), rel=1e-3)


def test_glass_returns_its_share_of_the_beams(simulate: "MakeSimulation") -> None:
    glass = "[[glass]]\npoints = [[1.0, -1.5], [1.0, 1.5]]\ntransmission = 0.8\n"
    found = np.array([scan.ranges for scan in scans(simulate(glass), 200)])
    slanted = found[:, 210:220]
    bearings = (np.arange(210, 220) - 180) * math.radians(1.0)
    at_glass = np.abs(slanted - 1.0 / np.cos(bearings)) < 1e-3
    assert at_glass.mean() == pytest.approx(0.2, abs=0.03)
    assert slanted[~at_glass].min() > 2.0
    np.testing.assert_allclose(found[:, 180], 1.0, atol=1e-4)


def test_the_lidar_sees_legs_where_they_are_solid(simulate: "MakeSimulation") -> None:
    person = "[[person]]\npath = [[1.0, 0.0]]\nlegs = true\n"
    scan = scans(simulate(person), 1)[0]
    assert beam(scan, 0.0) == pytest.approx(3.0)
    assert beam(scan, math.radians(6)) == pytest.approx(0.94, abs=0.01)
