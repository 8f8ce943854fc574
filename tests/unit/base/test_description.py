import msgspec
import pytest

from trolley.config import RobotConfig
from trolley_base.description import limits_of


def config(max_speed_mps: float) -> RobotConfig:
    plain = {
        "robot": {"name": "one", "footprint": {"radius_m": 0.2}},
        "base": {"limits": {"max_speed_mps": max_speed_mps}},
    }
    return msgspec.convert(plain, RobotConfig)


@pytest.mark.parametrize(
    ("watchdog_s", "wanted", "allowed"),
    [(0.4, 0.5, 0.5), (0.5, 0.5, 0.5), (0.51, 0.5, 0.2), (2.0, 0.5, 0.2), (2.0, 0.1, 0.1)],
)
def test_a_board_that_goes_on_by_itself_drives_slowly(
    watchdog_s: float, wanted: float, allowed: float
) -> None:
    assert limits_of(config(wanted), watchdog_s).speed == allowed
