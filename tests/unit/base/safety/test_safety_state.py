import pytest

from trolley import codes
from trolley.messages import Link
from trolley_base.drivers import ChassisReading
from trolley_base.safety.safety_state import SafetyState, find_restriction
from trolley_base.safety.velocity_limiter import Block

UP = Link(name="chassis", state="up")


def condition(
    *,
    cannot_drive: str = "",
    stopped: bool = False,
    own_pause_ns: int = 0,
    chassis: Link = UP,
    alarms: tuple[str, ...] = (),
    lidar: Link = UP,
    scan_age_ns: int | None = 100_000_000,
    gone: str = "",
) -> SafetyState:
    reading = ChassisReading((), chassis, alarms=alarms, is_gone=gone == "chassis")
    return SafetyState(
        cannot_drive, stopped, own_pause_ns, reading, lidar, scan_age_ns, gone == "lidar"
    )


def test_nothing_forbids_to_drive_when_all_is_well() -> None:
    assert find_restriction(condition()) is None


@pytest.mark.parametrize(
    ("now", "mode", "reason"),
    [
        (condition(stopped=True), "stopped", codes.BUTTON),
        (condition(stopped=True, own_pause_ns=300_000_000), "stopped", codes.BUTTON),
        (condition(own_pause_ns=300_000_000), "held", codes.OVERLOADED),
        (condition(own_pause_ns=300_000_000, scan_age_ns=None), "held", codes.OVERLOADED),
        (condition(own_pause_ns=300_000_000, gone="chassis"), "held", codes.LINK_LOST),
        (condition(own_pause_ns=300_000_000, gone="lidar"), "held", codes.SCAN_LOST),
        (condition(chassis=Link(name="chassis", state="down")), "held", codes.LINK_LOST),
        (condition(chassis=Link(name="chassis", state="searching")), "held", codes.LINK_LOST),
        (condition(lidar=Link(name="lidar", state="down")), "held", codes.SCAN_LOST),
        (condition(lidar=Link(name="lidar", state="searching")), "held", codes.SCAN_LOST),
        (condition(scan_age_ns=None), "held", codes.SCAN_LOST),
        (condition(scan_age_ns=500_000_001), "held", codes.SCAN_LOST),
        (condition(alarms=(codes.BATTERY, codes.BUMPER)), "held", codes.BATTERY),
        (condition(alarms=("overheated",)), "fault", "overheated"),
        (condition(cannot_drive="A recording is played.", scan_age_ns=None), "ok", ""),
    ],
)
def test_each_trouble_stops_the_robot_and_says_why(
    now: SafetyState, mode: str, reason: str
) -> None:
    restriction = find_restriction(now)
    assert restriction is not None
    assert (restriction.block, restriction.mode, restriction.reason) == (Block.ALL, mode, reason)
    assert restriction.message.endswith(".")


@pytest.mark.parametrize("code", [codes.BUMPER, codes.CLIFF])
def test_what_is_ahead_leaves_the_way_back(code: str) -> None:
    restriction = find_restriction(condition(alarms=(code,)))
    assert restriction is not None
    assert (restriction.block, restriction.reason) == (Block.ALL_BUT_BACK, code)


def test_the_stop_matters_most() -> None:
    worst = condition(stopped=True, chassis=Link(name="chassis", state="down"), scan_age_ns=None)
    restriction = find_restriction(worst)
    assert restriction is not None
    assert restriction.mode == "stopped"


def test_stopped_is_not_said_of_a_board_that_says_nothing() -> None:
    stopped = find_restriction(condition(stopped=True))
    unplugged = Link(name="chassis", state="down", message="/dev/ttyUSB0 is not there.")
    unknown = find_restriction(condition(stopped=True, chassis=unplugged))
    assert stopped is not None
    assert stopped.message.startswith("Stopped.")
    assert unknown is not None
    assert unknown.mode == "stopped"
    assert "not known" in unknown.message
    assert unknown.message.endswith("/dev/ttyUSB0 is not there.")
    assert not unknown.message.startswith("Stopped")


def test_the_driver_may_say_it_better() -> None:
    unplugged = Link(name="chassis", state="down", message="/dev/ttyUSB0 is not there.")
    restriction = find_restriction(condition(chassis=unplugged))
    assert restriction is not None
    assert restriction.message == "/dev/ttyUSB0 is not there."
