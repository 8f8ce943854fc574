"""Faults are read strictly, hold for their time, and do to the bytes what they say."""

import numpy as np
import pytest

from trolley_base.emulators.device import Frame
from trolley_base.emulators.faults import Damage, FaultError, FaultPlan, parse_fault, trouble_of
from trolley_base.world.faulty_wheels import WELL

DEVICES = ("linorobot", "ld19", "arduino_bridge", "create2")
MS = 1_000_000


@pytest.mark.parametrize(
    ("text", "meant"),
    [
        ("ld19:silence@10+5", ("ld19", "silence", 0.0, ("", 0), 10.0, 5.0)),
        ("ld19:silence", ("ld19", "silence", 0.0, ("", 0), None, None)),
        ("linorobot:md5@0.5", ("linorobot", "md5", 0.0, ("", 0), 0.5, None)),
        (" ld19:noise=1000+2.5 ", ("ld19", "noise", 1000.0, ("", 0), None, 2.5)),
        ("ld19:blind", ("ld19", "blind", 60.0, ("", 0), None, None)),
        ("ld19:fail=0.5+3", ("ld19", "fail", 0.5, ("", 0), None, 3.0)),
        ("ld19:cut", ("ld19", "cut", 0.3, ("", 0), None, None)),
        ("create2:feels=cliff+1", ("create2", "feels", 0.0, ("cliff", 1), None, 1.0)),
        ("arduino_bridge:pin=d4:0@1+2", ("arduino_bridge", "pin", 0.0, ("d4", 0), 1.0, 2.0)),
    ],
)
def test_faults_are_read(text: str, meant: tuple):
    fault = parse_fault(text, DEVICES)
    assert meant == (
        fault.device,
        fault.kind,
        fault.amount,
        fault.pin,
        fault.start_s,
        fault.duration_s,
    )


@pytest.mark.parametrize(
    ("text", "says"),
    [
        ("", "is not a fault"),
        ("ld19", "is not a fault"),
        ("ld19:silence@", "is not a fault"),
        ("ld19:silence@-1", "is not a fault"),
        ("ld19:silence+5@1", "is not a fault"),
        ("xv11:silence", "no xv11 here, only linorobot, ld19"),
        ("ld19:explode", "no fault explode, only silence"),
        ("ld19:blind=400", "from 0 to 360"),
        ("linorobot:cover", "only lidars"),
        ("ld19:md5", "only linorobot"),
        ("ld19:pin=d4:0", "only arduino_bridge"),
        ("ld19:deaf", "only motor boards"),
        ("arduino_bridge:gyro", "only linorobot"),
        ("linorobot:motor", "motor=left"),
        ("linorobot:encoder=front", "encoder=left"),
        ("linorobot:drives=9", "from -2 to 2"),
        ("arduino_bridge:pin", "pin=d4:0"),
        ("create2:feels=hunger", "feels=bump"),
        ("linorobot:feels=bump", "only create2"),
        ("ld19:silence=3", "takes no value"),
        ("ld19:cut=2", "from 0 to 1"),
        ("ld19:noise=much", "from 0 to"),
    ],
)
def test_what_is_no_fault_is_refused(text: str, says: str):
    with pytest.raises(FaultError, match=says):
        parse_fault(text, DEVICES)


def test_what_is_broken_of_the_wheels_is_told():
    texts = ("linorobot:motor=left", "linorobot:encoder=both", "linorobot:factor=-2")
    faults = {fault.kind: fault for fault in (parse_fault(text, DEVICES) for text in texts)}
    trouble = trouble_of(faults)
    assert trouble.dead_motors == {"left"}
    assert trouble.stuck_encoders == {"left", "right"}
    assert trouble.factor == -2.0
    assert trouble_of({}) is WELL


def changes(plan: FaultPlan, now_s: float) -> list[tuple[str, bool]]:
    """What begins (True) and ends (False) at a time, by kind."""
    return [(fault.kind, begins) for fault, begins in plan.advance(now_s)]


def test_faults_hold_for_their_time():
    plan = FaultPlan()
    plan.add(parse_fault("ld19:silence@10+5", DEVICES), 0.0)
    plan.add(parse_fault("ld19:noise", DEVICES), 2.0)
    assert changes(plan, 1.0) == []
    assert changes(plan, 2.0) == [("noise", True)]
    plan.advance(10.1)
    assert set(plan.of("ld19")) == {"silence", "noise"}
    assert plan.of("linorobot") == {}
    assert changes(plan, 15.2) == [("silence", False)]
    plan.add(parse_fault("ld19:ok", DEVICES), 16.0)
    assert changes(plan, 16.0) == [("noise", False)]
    assert plan.of("ld19") == {}


def test_a_busy_computer_takes_faults_that_come_together_in_their_order():
    plan = FaultPlan()
    for text in ("ld19:silence", "ld19:ok", "ld19:unplug"):
        plan.add(parse_fault(text, DEVICES), 1.0)
    assert changes(plan, 1.1) == [("silence", True), ("silence", False), ("unplug", True)]
    assert set(plan.of("ld19")) == {"unplug"}


def test_several_pins_may_be_pulled_at_once():
    plan = FaultPlan()
    for text in ("arduino_bridge:pin=d4:0", "arduino_bridge:pin=a0:600"):
        plan.add(parse_fault(text, DEVICES), 0.0)
    plan.advance(0.0)
    assert {fault.pin for fault in plan.of("arduino_bridge").values()} == {("d4", 0), ("a0", 600)}


def spoil(*texts: str, seconds: int = 1) -> list[list[Frame]]:
    """What becomes of a frame of 20 bytes every 10 ms on a line of 5760 bytes per second."""
    damage = Damage(57600, np.random.default_rng(1))
    faults = {fault.kind: fault for fault in (parse_fault(text, DEVICES) for text in texts)}
    return [
        damage.apply([Frame(t * 10 * MS, b"A" * 20)], faults, t * 10 * MS, (t + 1) * 10 * MS)
        for t in range(100 * seconds)
    ]


def data_of(spans: list[list[Frame]]) -> bytes:
    return b"".join(frame.data for span in spans for frame in span)


def test_without_faults_nothing_changes():
    assert data_of(spoil()) == b"A" * 2000


def test_silence_sends_nothing():
    assert data_of(spoil("ld19:silence", "ld19:noise")) == b""


def test_noise_lies_between_the_frames():
    spans = spoil("ld19:noise=300")
    whole = [frame for span in spans for frame in span if frame.data == b"A" * 20]
    assert len(whole) == 100
    assert len(data_of(spans)) == pytest.approx(2000 + 300, abs=3)


def test_cut_frames_are_shorter():
    lengths = [len(frame.data) for span in spoil("ld19:cut=0.5", seconds=4) for frame in span]
    assert lengths.count(20) == pytest.approx(200, abs=40)
    assert max(lengths) == 20
    assert len(set(lengths)) > 15


def test_a_flood_is_more_than_the_line_carries():
    spans = spoil("ld19:flood")
    assert len(data_of(spans)) > 2000 + 1.4 * 5760
    assert set(data_of(spans)) == {ord("A")}
