import numpy as np
import pytest

from trolley import codes
from trolley.geometry import Twist2D, footprint_from_box
from trolley.messages import VelocityCommand
from trolley_base.safety.motion_limits import MotionLimits
from trolley_base.safety.observed_space import ALL_SEEN, Unseen
from trolley_base.safety.sight_distance import SightDistance
from trolley_base.safety.stop_field import StopField
from trolley_base.safety.velocity_limiter import Block, Decision, Restriction, VelocityLimiter

MS = 1_000_000
STEP = 20 * MS
LIMITS = MotionLimits(
    speed=0.5, wz=1.5, acceleration=0.8, deceleration=1.0, angular_acceleration=4.0
)
FOOTPRINT = footprint_from_box(0.4, 0.2)
FREE = np.empty((0, 2))
POST = np.array([[0.23, 0.0]])
WALL = np.stack([np.full(201, 0.25), np.linspace(-1.0, 1.0, 201)], axis=1)


class Drive:
    """A limiter whose source sends a command at each step."""

    def __init__(self) -> None:
        field = StopField(FOOTPRINT, LIMITS, 0.05)
        self.limiter = VelocityLimiter(
            {"teleop": 20, "planner": 10}, LIMITS, field, SightDistance(FOOTPRINT, LIMITS, 0.06)
        )
        self.now_ns = 0

    def send(self, twist: Twist2D, source: str = "teleop", valid_for: float = 0.2) -> None:
        command = VelocityCommand(stamp_ns=self.now_ns, twist=twist, valid_for=valid_for)
        assert self.limiter.offer(source, command, self.now_ns, self.now_ns) is None

    def step(
        self,
        twist: Twist2D | None = None,
        steps: int = 1,
        echoes: np.ndarray = FREE,
        restriction: Restriction | None = None,
        source: str = "teleop",
        unseen: Unseen = ALL_SEEN,
    ) -> Decision:
        decision = Decision(Twist2D.zero(), None, 0, "ok")
        for _ in range(steps):
            self.now_ns += STEP
            if twist is not None:
                self.send(twist, source)
            decision = self.limiter.decide(self.now_ns, echoes, restriction, unseen)
        return decision


@pytest.fixture
def drive() -> Drive:
    return Drive()


def test_it_sets_off_along_a_ramp_and_within_the_limits(drive: Drive) -> None:
    drive.step()
    assert drive.step(Twist2D(9.0, 0.0, 0.0)).twist.vx == pytest.approx(0.8 * 0.02)
    decision = drive.step(Twist2D(9.0, 0.0, 0.0), steps=50)
    assert decision == Decision(Twist2D(0.5, 0.0, 0.0), "teleop", 0, "ok")


def test_a_silent_source_stops_the_robot_at_once_and_is_named(drive: Drive) -> None:
    drive.step(Twist2D(0.5, 0.0, 0.0), steps=50)
    decision = drive.step(steps=10)
    assert decision.twist.is_zero
    assert (decision.mode, decision.reason) == ("held", codes.COMMAND_LOST)
    assert decision.source is None
    assert drive.step(steps=300).mode == "ok", "it is said for a while, not for ever"


def test_a_source_that_ends_with_zero_is_not_missed(drive: Drive) -> None:
    drive.step(Twist2D(0.5, 0.0, 0.0), steps=50)
    drive.step(Twist2D.zero(), steps=50)
    assert drive.step(steps=20).mode == "ok"


def test_before_a_wall_it_is_held_by_the_stop_field(drive: Drive) -> None:
    decision = drive.step(Twist2D(0.3, 0.0, 0.0), steps=30, echoes=WALL)
    assert decision.twist.is_zero
    assert (decision.mode, decision.reason) == ("held", codes.STOP_FIELD)
    assert decision.source == "teleop"
    assert drive.step(Twist2D(-0.3, 0.0, 0.0), steps=30, echoes=WALL).twist.vx == -0.3
    assert drive.step(Twist2D(-0.3, 0.0, 0.0), echoes=WALL).mode == "ok"


def test_a_blocked_arc_becomes_the_turn_that_leads_clear(drive: Drive) -> None:
    decision = drive.step(Twist2D(0.3, 0.0, 1.0), steps=30, echoes=POST)
    assert abs(decision.twist.vx) < 1e-9
    assert decision.twist.wz == pytest.approx(1.0)
    assert decision.mode == "ok"


def test_the_turn_that_leads_clear_keeps_the_limits(drive: Drive) -> None:
    before = drive.step(Twist2D(0.3, 0.0, 1.0), echoes=POST).twist
    for _ in range(30):
        after = drive.step(Twist2D(0.3, 0.0, 1.0), echoes=POST).twist
        assert after.wz - before.wz <= 4.0 * 0.02 + 1e-9
        before = after


def test_while_setting_off_nobody_speaks_of_the_stop_field(drive: Drive) -> None:
    for _ in range(30):
        decision = drive.step(Twist2D(0.02, 0.0, 0.06))
        assert decision.mode == "ok"


def test_a_side_that_comes_softly_is_no_halt(drive: Drive) -> None:
    never, turning = np.array([False]), Twist2D(0.0, 0.0, 1.3)
    bucket = Unseen(np.array([[0.16, 0.15]]), never, np.array([True]))
    decision = drive.step(turning, steps=50, source="planner", unseen=bucket)
    assert 0.0 < decision.twist.wz < 0.1
    assert (decision.mode, decision.reason) == ("ok", "")
    ahead = Unseen(np.array([[0.23, 0.0]]), never, never)
    decision = drive.step(Twist2D(0.3, 0.0, 0.0), steps=50, source="planner", unseen=ahead)
    assert decision.twist.vx < 0.005
    assert (decision.mode, decision.reason) == ("held", codes.BLIND)


def test_what_forbids_to_drive_wins_over_any_command(drive: Drive) -> None:
    drive.step(Twist2D(0.5, 0.0, 0.0), steps=50)
    stopped = Restriction(Block.ALL, "stopped", codes.BUTTON, "Stopped.")
    decision = drive.step(Twist2D(0.5, 0.0, 0.0), restriction=stopped)
    assert decision == Decision(Twist2D.zero(), None, 0, "stopped", codes.BUTTON, "Stopped.")
    after = drive.step(Twist2D(0.5, 0.0, 0.0))
    assert after.twist.vx <= 0.8 * 0.02 + 1e-9, "it sets off anew"


def test_from_a_bumper_only_straight_back(drive: Drive) -> None:
    bumper = Restriction(Block.ALL_BUT_BACK, "held", codes.BUMPER, "Touched.")
    assert drive.step(Twist2D(0.3, 0.0, 0.5), steps=50, restriction=bumper).twist.is_zero
    back = drive.step(Twist2D(-0.3, 0.0, 0.5), steps=50, restriction=bumper)
    assert back.twist == Twist2D(-0.3, 0.0, 0.0)
    assert (back.mode, back.source) == ("held", "teleop")


def test_what_is_touched_is_not_driven_into_along_a_ramp(drive: Drive) -> None:
    bumper = Restriction(Block.ALL_BUT_BACK, "held", codes.BUMPER, "Touched.")
    ahead = Twist2D(0.5, 0.0, 0.5)
    assert drive.step(ahead, steps=50).twist == ahead
    assert drive.step(ahead, restriction=bumper).twist.is_zero
    back = drive.step(Twist2D(-0.3, 0.0, 0.0), restriction=bumper).twist
    assert back.vx == pytest.approx(-0.8 * 0.02)


def test_after_forgetting_it_stands_until_a_new_command(drive: Drive) -> None:
    drive.step(Twist2D(0.5, 0.0, 0.0), steps=50)
    drive.limiter.forget()
    decision = drive.step()
    assert decision.twist.is_zero
    assert decision.mode == "ok"


def test_a_loss_that_was_forgotten_is_not_told_of(drive: Drive) -> None:
    drive.step(Twist2D(0.5, 0.0, 0.0), steps=50)
    assert drive.step(steps=10).reason == codes.COMMAND_LOST
    drive.limiter.forget()
    assert drive.step().mode == "ok"


def test_a_pause_of_the_process_is_no_leap_in_speed(drive: Drive) -> None:
    drive.step(steps=2)
    drive.now_ns += 3_000 * MS
    assert drive.step(Twist2D(0.5, 0.0, 0.0)).twist.vx <= 0.8 * 0.1 + 1e-9
