"""Supervision of the motors against random robots of an independent plant."""

import pytest
from bench.base.obedience import BREAKS, run


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
