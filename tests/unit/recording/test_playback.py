"""The time of a recording that is played, and what is made of its messages."""

import pytest
from support.samples import make_clock, make_estimate, make_scan

from trolley import topics
from trolley.geometry import Pose2D, Twist2D
from trolley.messages import Clock, Marker, Robot, Truth, VelocityCommand
from trolley.recording.playback import TURN_NS, Pace, Replica
from trolley.recording.reader import Entry
from trolley.runtime import codec
from trolley.runtime.robot_time import FollowedTime

from .conftest import ROBOT, SECOND_NS, START_NS, sample_of

MS = 1_000_000


def entry_of(at_s: float, topic: topics.Topic, message: object, *parts: str) -> Entry:
    sample = sample_of(topic, message, *parts)
    name = sample.key.removeprefix("trolley/one/")
    at_ns = START_NS + round(at_s * SECOND_NS)
    return Entry(at_ns, name, topic, sample.payload, sample.encoding)


def clock_entry(at_s: float, epoch: int = START_NS, rate: float = 1.0) -> Entry:
    stamp_ns = START_NS + round(at_s * SECOND_NS)
    return entry_of(at_s, topics.CLOCK, make_clock(stamp_ns, epoch=epoch, rate=rate))


@pytest.mark.parametrize("speed", [0.1, 1.0, 2.0, 100.0])
def test_messages_are_due_when_their_time_comes(speed: float) -> None:
    pace = Pace(speed)
    pace.begin(START_NS, 5 * SECOND_NS)
    at_ns = START_NS + 4 * SECOND_NS
    assert pace.wait_s(at_ns, 5 * SECOND_NS) == pytest.approx(4.0 / speed)
    later_ns = 5 * SECOND_NS + round(4.0 / speed * SECOND_NS)
    assert pace.wait_s(at_ns, later_ns) == pytest.approx(0.0, abs=1e-6)
    assert pace.now(later_ns) == pytest.approx(at_ns, abs=1000)


def test_a_long_gap_is_skipped() -> None:
    pace = Pace(1.0)
    pace.begin(START_NS, 0)
    at_ns = START_NS + 120 * SECOND_NS
    assert pace.wait_s(at_ns, SECOND_NS) == 0.0
    assert pace.now(SECOND_NS) == at_ns


def test_a_machine_that_is_too_slow_lowers_the_speed_and_skips_nothing() -> None:
    pace = Pace(100.0)
    pace.begin(START_NS, 0)
    monotonic_ns = 0
    for step in range(4000):  # 10 ms of the recording need 1 ms: speed 10 is possible
        at_ns = START_NS + 10 * MS * step
        monotonic_ns += max(1 * MS, round(pace.wait_s(at_ns, monotonic_ns) * SECOND_NS))
        pace.played(at_ns, monotonic_ns)
    assert 8.0 < pace.rate < 10.0
    late_s = (pace.now(monotonic_ns) - at_ns) / pace.rate / SECOND_NS
    assert late_s < 0.5


def test_a_hiccup_does_not_lower_it() -> None:
    pace = Pace(1.0)
    pace.begin(START_NS, 0)
    monotonic_ns = 0
    for step in range(1000):
        at_ns = START_NS + 10 * MS * step
        monotonic_ns += max(MS // 10, round(pace.wait_s(at_ns, monotonic_ns) * SECOND_NS))
        if step == 500:
            monotonic_ns += 3 * SECOND_NS
        pace.played(at_ns, monotonic_ns)
    assert pace.rate == 1.0


def test_messages_go_out_as_they_were_but_the_robot_has_its_new_name() -> None:
    replica = Replica("two", 0)
    scan = entry_of(0.0, topics.SCAN, make_scan(START_NS))
    assert replica.take(scan) is scan
    robot = replica.take(entry_of(0.0, topics.ROBOT, ROBOT))
    assert robot is not None
    renamed = codec.decode(Robot, robot.payload, robot.encoding)
    assert (renamed.name, renamed.title, renamed.footprint) == ("two", ROBOT.title, ROBOT.footprint)
    assert renamed.replayed  # so that no robot waits for it


def test_a_simulation_does_not_take_it_for_a_thing_of_its_world() -> None:
    still = Twist2D.zero()
    truth = Truth(
        stamp_ns=1, world="apartment", pose=Pose2D(1, 2, 3), twist=still, collisions=0, clearance=1
    )
    played = Replica("two", 0).take(entry_of(0.0, topics.SIM_TRUTH, truth))
    assert played is not None
    changed = codec.decode(Truth, played.payload, played.encoding)
    assert (changed.world, changed.pose) == ("replay", truth.pose)


def test_nothing_that_could_drive_goes_out() -> None:
    replica = Replica("two", 0)
    command = VelocityCommand(stamp_ns=1, twist=Twist2D(1.0, 0.0, 0.0), valid_for=0.5)
    assert replica.take(entry_of(0.0, topics.COMMAND, command, "teleop")) is None
    assert replica.take(entry_of(0.0, topics.CMD_VEL, command)) is not None  # what was driven


def test_receivers_accept_every_turn_and_all_that_is_stamped_in_it() -> None:
    """Each turn begins anew, without the silence that would make receivers forget."""
    time = FollowedTime()
    for turn in range(5):
        replica = Replica("two", 1000 + turn)
        replica.take(clock_entry(0.0))
        assert replica.clock(START_NS, 1.0) is not None
        for step in range(10):
            clock = replica.clock(START_NS + step * SECOND_NS // 10, 1.0)
            assert clock is not None
            arrived_ns = (10 * turn + step) * SECOND_NS // 10 + SECOND_NS
            began = time.update(clock, arrived_ns)
            assert began == (step == 0)
            assert time.now(arrived_ns) == START_NS + step * SECOND_NS // 10
            assert START_NS - TURN_NS <= time.epoch < START_NS


def test_a_restart_of_base_is_played_as_one() -> None:
    replica = Replica("two", 7)
    replica.take(clock_entry(0.0))
    before = replica.clock(START_NS, 1.0)
    later_ns = START_NS + 130 * SECOND_NS
    replica.take(clock_entry(130.0, epoch=later_ns))
    after = replica.clock(later_ns, 1.0)
    assert before is not None
    assert after is not None
    assert after.epoch - before.epoch == 130 * SECOND_NS


def test_a_silent_clock_is_played_as_silence() -> None:
    replica = Replica("two", 0)
    assert replica.clock(START_NS, 1.0) is None
    replica.take(clock_entry(0.0))
    assert replica.clock(START_NS + 900 * MS, 10.0) == Clock(
        stamp_ns=START_NS + 900 * MS, rate=10.0, epoch=START_NS - TURN_NS
    )
    assert replica.clock(START_NS + 1100 * MS, 10.0) is None
    # At 20 simulated seconds a second ten clocks a second lie 2 s apart.
    replica.take(clock_entry(10.0, rate=20.0))
    assert replica.clock(START_NS + 12 * SECOND_NS, 1.0) is not None


def test_late_joiners_are_told_what_is_said_on_change() -> None:
    replica = Replica("two", 0)
    marker = Marker(kind="cube")
    replica.take(entry_of(0.0, topics.ROBOT, ROBOT))
    replica.take(entry_of(0.0, topics.SCAN, make_scan(START_NS)))
    for name in ("a", "b"):
        replica.take(entry_of(0.0, topics.MARKER, marker, "ns", name))
    replica.take(entry_of(0.0, topics.POSE, make_estimate(1)))
    replica.take(entry_of(0.1, topics.POSE, make_estimate(2)))
    assert [one.name for one in replica.kept()] == ["robot", "markers/ns/a", "markers/ns/b", "pose"]
    replica.take(Entry(START_NS, "markers/ns/**", topics.MARKER, b"", ""))
    assert [one.name for one in replica.kept()] == ["robot", "pose"]


def test_what_is_not_understood_changes_nothing() -> None:
    replica = Replica("two", 0)
    nonsense = b"\x81"
    assert replica.take(Entry(1, "robot", topics.ROBOT, nonsense, "")) is None
    assert replica.take(Entry(1, "clock", topics.CLOCK, nonsense, "")) is None
    assert replica.clock(1, 1.0) is None
