import pytest

from trolley.messages import Link
from trolley.runtime.log import Log
from trolley_base.device_log import MOST_KINDS, DeviceLog
from trolley_base.drivers import Note

UP = Link(name="chassis", state="up")
SECOND_NS = 1_000_000_000


@pytest.fixture
def counted() -> dict[str, int]:
    return {}


@pytest.fixture
def notes(counted: dict[str, int], caplog: pytest.LogCaptureFixture) -> DeviceLog:
    caplog.set_level("INFO", logger="trolley.base")
    return DeviceLog(Log("base"), counted.__setitem__)


def test_a_complaint_is_logged_once_in_five_seconds(
    notes: DeviceLog, caplog: pytest.LogCaptureFixture
) -> None:
    complaint = Note("warning", "imu", "IMU failed to initialize.")
    for tick in range(200):
        notes.add(tick * SECOND_NS // 20, UP, (complaint,), {})
    assert [record.message for record in caplog.records] == [complaint.text] * 2


def test_a_complaint_that_goes_on_is_logged_less_and_less_often(
    notes: DeviceLog, caplog: pytest.LogCaptureFixture
) -> None:
    complaint = Note("warning", "imu", "IMU failed to initialize.")
    for tick in range(20 * 600):
        notes.add(tick * SECOND_NS // 20, UP, (complaint,), {})
    assert len(caplog.records) == 7  # after 0, 5, 15, 35, 75, 155 and 315 s
    for second in (1500, 1505):  # it had gone, and is back
        notes.add(second * SECOND_NS, UP, (complaint,), {})
    assert len(caplog.records) == 9


def test_a_lidar_at_a_wrong_speed_is_not_connected_again_and_again(
    notes: DeviceLog, caplog: pytest.LogCaptureFixture
) -> None:
    for turn in range(100):
        message = f"The XV11 turns at {160 + turn % 7} rpm."
        notes.add(turn * SECOND_NS // 5, Link(name="lidar", state="up", message=message), (), {})
    assert not caplog.records


def test_a_link_that_is_tried_in_vain_is_logged_now_and_then(
    notes: DeviceLog, caplog: pytest.LogCaptureFixture
) -> None:
    for second in range(0, 60, 5):
        for link in (
            Link(name="lidar", state="searching", message="It is asked."),
            Link(name="lidar", state="down", message=f"Silent for {second} s."),
        ):
            notes.add(second * SECOND_NS, link, (), {})
    assert len(caplog.records) == 8  # each after 0, 5, 15 and 35 s, or 5 s later
    notes.add(60 * SECOND_NS, Link(name="lidar", state="up"), (), {})
    notes.add(61 * SECOND_NS, Link(name="lidar", state="down", message="Silent for 1 s."), (), {})
    assert [record.message for record in caplog.records[8:]] == ["Connected", "Silent for 1 s."]


def test_a_device_that_is_looked_for_in_vain_is_told_once(
    notes: DeviceLog, caplog: pytest.LogCaptureFixture
) -> None:
    lost = Link(name="chassis", state="searching", message="What arrives is not rosserial.")
    for tick in range(50 * 30):
        notes.add(tick * SECOND_NS // 50, lost, (), {})
        assert len(caplog.records) == (tick >= 50 * 5)


def test_a_board_that_says_ever_new_things_fills_no_disk(
    notes: DeviceLog, caplog: pytest.LogCaptureFixture
) -> None:
    for number in range(500):
        notes.add(number, UP, (Note("error", f"word {number}", f"word {number}"),), {})
    assert len(caplog.records) == MOST_KINDS + 1


def test_a_link_is_logged_when_it_changes(
    notes: DeviceLog, caplog: pytest.LogCaptureFixture
) -> None:
    down = Link(name="chassis", state="down", message="The port is gone.")
    for link in (UP, UP, down, down, UP):
        notes.add(0, link, (), {})
    assert [record.message for record in caplog.records] == ["The port is gone.", "Connected"]


def test_what_is_counted_goes_to_health(notes: DeviceLog, counted: dict[str, int]) -> None:
    notes.add(0, UP, (), {"chassis/bad_checksum": 3})
    assert counted == {"chassis/bad_checksum": 3}
