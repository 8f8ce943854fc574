"""Supervision of the motors against random robots of an independent plant."""

import numpy as np
import pytest
from bench.base.obedience import BREAKS, draw, longest_s, run


@pytest.mark.parametrize("seed", range(8))
def test_a_robot_in_order_is_not_accused(seed: int) -> None:
    assert run(seed, 40.0) is None


@pytest.mark.slow
@pytest.mark.parametrize("seed", range(8, 60))
def test_no_robot_in_order_is_accused(seed: int) -> None:
    assert run(seed, 60.0) is None


@pytest.mark.parametrize("name", BREAKS)
def test_whatever_breaks_is_found(name: str) -> None:
    for seed in range(4):
        found = run(seed, 13.0, BREAKS[name])
        assert found is not None
        assert 0.0 < found.after_s < 1.2


IGNORED = [name for name in BREAKS if name.startswith("ignores a stop at")]


@pytest.mark.parametrize("is_measured", [False, True])
@pytest.mark.parametrize("name", IGNORED)
def test_an_ignored_stop_is_found_as_soon_as_the_page_says(name: str, is_measured: bool) -> None:
    for seed in range(10):
        found = run(seed, 11.0, BREAKS[name], is_measured=is_measured)
        assert found is not None
        robot = draw(np.random.default_rng(seed))
        assert found.after_s <= longest_s(robot, is_measured=is_measured), robot


@pytest.mark.parametrize("name", ["ignores a stop at 0.5 m/s", "ignores a stop at 0.3 m/s"])
def test_a_board_that_reports_often_and_ignores_a_stop_is_found_in_half_a_second(name: str) -> None:
    robots = {seed: draw(np.random.default_rng(seed)) for seed in range(120)}
    often = [s for s, one in robots.items() if one.period_s <= 0.05 and one.tick_m <= 0.001]
    assert len(often) > 30
    for seed in often:
        found = run(seed, 10.0, BREAKS[name])
        assert found is not None
        assert found.after_s <= 0.5, robots[seed]


@pytest.mark.parametrize("seed", range(8))
def test_a_robot_whose_delay_was_measured_is_not_accused(seed: int) -> None:
    assert run(seed, 30.0, is_measured=True) is None
