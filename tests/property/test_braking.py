"""Robots with real brakes among things that stand; the plant shares nothing with the stop field."""

import pytest
from bench.harness.brakes import drive_case

DRIVEN_INTO = (75, 93)
"""Seeds whose robots drove into something with an earlier stop field."""
DRIVEN_INTO_TOO = (1, 14, 22, 26, 31, 42, 45, 47, 61, 63, 69, 73, 76, 82, 84)
"""More such seeds, for which there is no time each day."""


@pytest.mark.parametrize(
    "seed",
    [*DRIVEN_INTO, *(pytest.param(seed, marks=pytest.mark.slow) for seed in DRIVEN_INTO_TOO)],
)
def test_no_robot_drives_into_what_one_has_driven_into(seed: int) -> None:
    outcome = drive_case(seed)
    assert outcome.closing is None
    assert outcome.driven_m > 0.3, "it was not just held"


@pytest.mark.parametrize("seed", [1012, 1034])
def test_one_whose_base_decides_too_seldom_drives_into_nothing(seed: int) -> None:
    assert drive_case(seed, decides_ns=300_000_000).closing is None


@pytest.mark.slow
def test_no_robot_drives_into_anything() -> None:
    outcomes = [drive_case(seed, seconds=5.0) for seed in range(100, 400)]
    assert [one for one in outcomes if one.closing is not None] == []
    assert sum(one.driven_m for one in outcomes) > 200.0
