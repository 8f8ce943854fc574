import dataclasses

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


def test_on_a_slope_it_surely_brakes_less_but_always_some() -> None:
    limits = limits_of(config(0.5))
    assert limits.slope == 0.05
    assert limits.downhill_deceleration == pytest.approx(limits.deceleration - 0.4905)
    steep = dataclasses.replace(limits, slope=0.3)
    assert 0.0 < steep.downhill_deceleration < 0.5
