"""It drives only where the lidar has seen: through the whole service, by hand and by a program."""

import dataclasses
import math
from collections.abc import Callable

import numpy as np
import pytest
from numpy.typing import NDArray

from trolley import codes, topics
from trolley.messages import Health
from trolley_base.drivers import LidarReading, LidarScan

from .conftest import EXACT, REAL, MakeRig, Rig

CREEP = 0.1
SLOW = pytest.mark.slow
HALF_ROUND = f"{EXACT}field_of_view = {math.pi}\nbeams = 180\n"
HALF_ROUND_REAL = f"{REAL}[lidar]\nfield_of_view = {math.pi}\nbeams = 180\n"
Spoil = Callable[[LidarScan], NDArray[np.bool_]]


def spoil(
    rig: Rig,
    monkeypatch: pytest.MonkeyPatch,
    which: Spoil,
    by: float | Callable[[LidarScan], NDArray[np.float32]] = 0.0,
    *,
    is_silence: bool = False,
) -> None:
    """Let beams measure something else from now on; 0 is invalid, or silence where that counts."""
    lidar = rig.base.hardware.lidar
    read = lidar.read

    def spoilt() -> LidarReading:
        reading = read()
        scans = [
            dataclasses.replace(
                scan,
                ranges=np.where(which(scan), by(scan) if callable(by) else by, scan.ranges).astype(
                    np.float32
                ),
                silent=which(scan) if is_silence else scan.silent,
            )
            for scan in reading.scans
        ]
        return dataclasses.replace(reading, scans=tuple(scans))

    monkeypatch.setattr(lidar, "read", spoilt)


def ahead(scan: LidarScan) -> NDArray[np.bool_]:
    """Sixty degrees about straight ahead."""
    angles = scan.angle_min + np.arange(len(scan.ranges)) * scan.angle_increment
    return np.abs(angles) < math.radians(30.0)


def all_round(scan: LidarScan) -> NDArray[np.bool_]:
    return np.ones(len(scan.ranges), np.bool_)


def most(seed: int) -> Spoil:
    """Nineteen beams of twenty, others each time."""
    rng = np.random.default_rng(seed)
    return lambda scan: rng.random(len(scan.ranges)) < 0.95


def fastest(rig: Rig, since: int = 0) -> float:
    return max(abs(truth.twist.vx) for truth in rig.truths[since:])


BLINDED: dict[str, Spoil] = {"sixty degrees ahead": ahead, "95 % of all": most(3)}


@pytest.mark.parametrize("which", BLINDED.values(), ids=BLINDED.keys())
def test_by_hand_it_creeps_where_the_lidar_sees_nothing(
    make_rig: MakeRig, monkeypatch: pytest.MonkeyPatch, which: Spoil
) -> None:
    rig = make_rig()
    spoil(rig, monkeypatch, which)
    rig.run(1.0)
    rig.drive(6.0, 0.5)
    assert fastest(rig) == pytest.approx(CREEP, abs=0.005)
    assert (rig.state.mode, rig.state.reason) == ("ok", codes.BLIND)
    assert "ahead" in rig.state.message
    assert "creep" in rig.state.message


@pytest.mark.parametrize(("source", "limit"), [("teleop", CREEP), ("planner", 0.0)])
def test_a_lidar_that_reports_open_floor_all_around_is_not_believed(
    make_rig: MakeRig, monkeypatch: pytest.MonkeyPatch, source: str, limit: float
) -> None:
    rig = make_rig()
    healths: list[Health] = rig.lockstep.record(topics.HEALTH, "base")
    rig.run(1.0)
    spoil(rig, monkeypatch, all_round, math.inf)
    rig.drive(1.5, 0.0)  # what was seen before still counts for a moment
    since = len(rig.truths)
    rig.drive(3.0, 0.5, source=source)
    assert fastest(rig, since) <= limit + 0.005
    assert rig.state.reason == codes.BLIND
    assert healths[-1].state == "degraded"
    assert "open floor all around" in healths[-1].message
    assert healths[-1].figures["lidar/seen"] == 0.0


def test_in_a_hall_where_few_beams_reach_a_wall_it_drives_as_told(
    make_rig: MakeRig, monkeypatch: pytest.MonkeyPatch
) -> None:
    rig = make_rig()
    healths: list[Health] = rig.lockstep.record(topics.HEALTH, "base")

    def far(scan: LidarScan) -> NDArray[np.bool_]:
        angles = scan.angle_min + np.arange(len(scan.ranges)) * scan.angle_increment
        return np.abs(angles - math.radians(90.0)) > math.radians(4.0)

    spoil(rig, monkeypatch, far, math.inf)
    rig.run(1.0)
    since = len(rig.truths)
    rig.drive(2.0, 0.5, source="planner")
    assert fastest(rig, since) == pytest.approx(0.5, abs=0.01)
    assert healths[-1].state == "ok"


@pytest.mark.parametrize("which", BLINDED.values(), ids=BLINDED.keys())
@pytest.mark.parametrize("source", ["planner", pytest.param("calibrate", marks=SLOW)])
def test_a_program_is_held_where_the_lidar_sees_nothing(
    make_rig: MakeRig, monkeypatch: pytest.MonkeyPatch, which: Spoil, source: str
) -> None:
    rig = make_rig()
    spoil(rig, monkeypatch, which)
    rig.run(1.0)
    rig.drive(4.0, 0.5, source=source)
    assert fastest(rig) < 0.01
    assert (rig.state.mode, rig.state.reason) == ("held", codes.BLIND)
    assert "ahead" in rig.state.message


def test_a_program_creeps_where_a_lidar_of_short_reach_gets_nothing_back(
    make_rig: MakeRig, monkeypatch: pytest.MonkeyPatch
) -> None:
    rig = make_rig()
    spoil(rig, monkeypatch, ahead, is_silence=True)
    rig.run(1.0)
    rig.drive(4.0, 0.5, source="planner")
    assert 0.8 * CREEP < fastest(rig) <= 1.05 * CREEP


@pytest.mark.parametrize(
    ("source", "limit"), [pytest.param("teleop", CREEP, marks=SLOW), ("planner", 0.0)]
)
def test_a_lidar_that_goes_blind_under_way_takes_the_speed_away_before_the_wall(
    make_rig: MakeRig, monkeypatch: pytest.MonkeyPatch, source: str, limit: float
) -> None:
    rig = make_rig()
    rig.drive(2.0, 0.5, source=source)
    assert rig.truth.twist.vx == pytest.approx(0.5)
    spoil(rig, monkeypatch, ahead)
    rig.drive(0.9, 0.5, source=source)  # what was seen lately is not forgotten at once
    rig.drive(0.6, 0.5, source=source)
    since = len(rig.truths)
    rig.drive(12.0, 0.5, source=source)
    assert fastest(rig, since) <= limit + 0.005
    assert rig.state.reason in (codes.BLIND, codes.STOP_FIELD)


@pytest.mark.parametrize(
    ("source", "limit"), [pytest.param("teleop", CREEP, marks=SLOW), ("planner", 0.0)]
)
def test_backwards_with_half_a_view_it_drives_only_over_its_own_trail(
    make_rig: MakeRig, source: str, limit: float
) -> None:
    rig = make_rig(errors=HALF_ROUND)
    rig.drive(3.0, -0.5, source=source)
    assert fastest(rig) <= limit + 0.005
    assert rig.state.reason == codes.BLIND
    assert "behind" in rig.state.message
    rig.drive(3.0, 0.5, source=source)
    assert fastest(rig) > 0.45, "ahead it sees"
    since, there = len(rig.truths), rig.truth.pose.x
    rig.drive(1.5, -0.5, source=source)
    assert fastest(rig, since) > 0.4, "where it came from it has been"
    assert rig.truth.pose.x < there - 0.1
    rig.drive(2.5, -0.5, source=source)
    assert abs(rig.truth.twist.vx) == pytest.approx(CREEP, abs=0.005), "somebody may stand there"
    rig.drive(15.0, -0.5, source=source)
    assert abs(rig.truth.twist.vx) <= limit + 0.005
    assert rig.state.reason == codes.BLIND


@pytest.mark.parametrize("source", ["teleop", pytest.param("planner", marks=SLOW)])
def test_with_half_a_view_it_can_turn_round_and_then_drive_there(
    make_rig: MakeRig, source: str
) -> None:
    rig = make_rig(errors=HALF_ROUND_REAL)
    for _ in range(100):
        if abs(rig.truth.pose.yaw) > 3.0:
            break
        rig.drive(0.1, 0.0, 1.0, source=source)
    assert abs(rig.truth.pose.yaw) > 3.0, "a turn in place is how it comes to see"
    rig.drive(3.0, 0.5, source=source)
    assert fastest(rig) > 0.45


@pytest.mark.parametrize("source", ["teleop", "planner"])
def test_a_lidar_whose_every_beam_is_at_its_nearest_range_sees_nothing(
    make_rig: MakeRig, monkeypatch: pytest.MonkeyPatch, source: str
) -> None:
    rig = make_rig()
    rig.drive(1.0, 0.3, source=source)
    spoil(rig, monkeypatch, all_round, by=0.1)
    rig.drive(0.8, 0.5, source=source)
    since = len(rig.truths)
    rig.drive(4.0, 0.5, source=source)
    assert fastest(rig, since) <= CREEP + 0.005
    assert rig.state.reason == codes.SCAN_LOST
    assert "cover" in rig.state.message
    monkeypatch.undo()
    rig.drive(2.0, -0.3, source=source)
    assert rig.state.mode == "ok"
    assert rig.truth.twist.vx == pytest.approx(-0.3, abs=0.01)


@pytest.mark.parametrize("source", ["teleop", "planner"])
def test_a_lidar_that_repeats_one_scan_while_the_robot_drives_is_as_good_as_silent(
    make_rig: MakeRig, monkeypatch: pytest.MonkeyPatch, source: str
) -> None:
    rig = make_rig()
    rig.drive(1.0, 0.5, source=source)
    with monkeypatch.context() as hanging:
        kept: list[NDArray[np.float32]] = []

        def repeat(scan: LidarScan) -> NDArray[np.float32]:
            kept.append(scan.ranges)
            return kept[(len(kept) - 1) % 2]  # as one revolution may be cut

        spoil(rig, hanging, all_round, by=repeat)
        hung_at_m = rig.truth.pose.x
        rig.drive(8.0, 0.5, source=source)
        assert (rig.state.mode, rig.state.reason) == ("held", codes.SCAN_LOST)
        assert "repeats" in rig.state.message
        assert rig.truth.twist.is_zero
        assert rig.truth.collisions == 0
        assert rig.truth.pose.x < hung_at_m + 0.3, "5 cm, the next scan, and what braking takes"
    rig.drive(1.0, 0.2, source=source)
    assert rig.state.mode == "ok"
    assert rig.truth.twist.vx > 0.1


def test_sixty_degrees_at_the_nearest_range_do_not_pin_the_robot_but_are_blind(
    make_rig: MakeRig, monkeypatch: pytest.MonkeyPatch
) -> None:
    rig = make_rig(base={"lidar": {"pose": {"x": 0.12, "y": 0.0, "yaw": 0.0}}})
    spoil(rig, monkeypatch, ahead, by=0.1)
    rig.run(1.0)
    rig.drive(3.0, 0.5)
    assert fastest(rig) == pytest.approx(CREEP, abs=0.005)
    assert rig.state.reason == codes.BLIND


@pytest.mark.parametrize("near", [0.05, 0.1, 0.12])
def test_a_cloth_over_the_lidar_is_no_view(
    make_rig: MakeRig, monkeypatch: pytest.MonkeyPatch, near: float
) -> None:
    rig = make_rig()
    spoil(rig, monkeypatch, ahead, by=near)
    rig.run(1.0)
    rig.drive(3.0, 0.5)
    assert fastest(rig) == pytest.approx(CREEP, abs=0.005)
    assert rig.state.reason == codes.BLIND


DROP_OUTS = "[lidar]\ndrop_out = 0.03\ninvalid = 0.03\n"


@pytest.mark.parametrize(
    "view",
    [*(pytest.param(turns * math.pi, marks=SLOW) for turns in (2.0, 1.5)), math.pi],
)
def test_a_lidar_with_ordinary_drop_outs_raises_no_alarm(make_rig: MakeRig, view: float) -> None:
    beams = round(180 * view / (2.0 * math.pi))
    rig = make_rig(errors=f"{DROP_OUTS}field_of_view = {view}\nbeams = {beams}\nrate_hz = 6.0\n")
    rng = np.random.default_rng(7)
    for _ in range(6):
        rig.drive(0.1 * int(rng.integers(5, 30)), float(rng.uniform(0.1, 0.5)), 0.0)
        rig.drive(0.1 * int(rng.integers(5, 20)), 0.0, float(rng.uniform(-1.5, 1.5)))
    begun_ns = rig.states[0].stamp_ns + 10**10  # what lies behind it must have been seen once
    near_ns = [truth.stamp_ns for truth in rig.truths if truth.clearance < 0.1]
    assert [
        state
        for state in rig.states
        if state.reason == codes.BLIND
        and state.stamp_ns > begun_ns
        and not any(abs(state.stamp_ns - stamp_ns) < 10**9 for stamp_ns in near_ns)
    ] == []
    assert sum(abs(truth.twist.vx) for truth in rig.truths) * 0.05 > 1.0


def test_looking_into_the_sun_is_no_blindness(
    make_rig: MakeRig, monkeypatch: pytest.MonkeyPatch
) -> None:
    rig, rng = make_rig(errors=REAL), np.random.default_rng(5)
    spoil(rig, monkeypatch, lambda scan: ahead(scan) & (rng.random(len(scan.ranges)) < 0.8))
    rig.run(1.0)
    rig.drive(4.0, 0.3, source="planner")
    assert codes.BLIND not in {state.reason for state in rig.states}
    assert rig.truth.pose.x > 0.9


def test_health_names_the_side_whose_view_was_closed(
    make_rig: MakeRig, monkeypatch: pytest.MonkeyPatch
) -> None:
    rig = make_rig(errors=REAL)
    healths: list[Health] = rig.lockstep.record(topics.HEALTH, "base")
    rig.drive(2.0, 0.2)
    assert healths[-1].state == "ok"
    assert healths[-1].figures["lidar/seen"] > 0.95
    with monkeypatch.context() as covered:
        spoil(rig, covered, ahead)
        rig.run(6.0)
        assert healths[-1].state == "degraded"
        assert "front" in healths[-1].message
        assert healths[-1].figures["lidar/seen/front"] < 0.1
        assert healths[-1].figures["lidar/seen/rear"] > 0.9
    rig.run(3.0)
    assert healths[-1].state == "ok"


def test_a_side_that_the_lidar_never_saw_is_no_trouble(make_rig: MakeRig) -> None:
    rig = make_rig(errors=HALF_ROUND)
    healths: list[Health] = rig.lockstep.record(topics.HEALTH, "base")
    rig.drive(6.0, 0.1)
    assert {health.state for health in healths} == {"ok"}
    assert healths[-1].figures["lidar/seen/rear"] == 0.0
