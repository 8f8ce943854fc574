"""The soak in lock-step is the same drive for the same seed, and counts what came."""

from pathlib import Path

import pytest
from bench.soak.lockstep import Soak, new_results

from trolley.messages import StopResult


def drive(folder: Path, seed: int) -> Soak:
    folder.mkdir()
    soak = Soak(folder, seed)
    soak._next_restart_s = 20.0
    soak.run(32.0)
    soak.close()
    return soak


@pytest.mark.slow
def test_same_seed_is_the_same_drive_restarts_and_all(tmp_path: Path) -> None:
    one, same = (drive(tmp_path / name, 3) for name in ("one", "same"))
    assert one.digest == same.digest
    assert one.restarts == same.restarts
    assert sum(one.restarts.values()) == 1
    assert one.driven_m > 1.0
    assert one.problems == []


def test_new_results_are_told_from_those_before() -> None:
    first, second, third = (StopResult(stop=k, state="reached") for k in range(3))
    assert new_results([], [first]) == [first]
    assert new_results([first], [first]) == []
    assert new_results([first, second], [first, second, third]) == [third]
    assert new_results([first, second], [second, third]) == [third]
    assert new_results([first], [second, third]) == [second, third]
