"""Drives through drawn houses, as benches of localizer and mapper use them, and their slices."""

import math
from pathlib import Path

import numpy as np
import pytest
from bench.harness.houses import plan_house
from bench.harness.odd_houses import plan_odd_house
from bench.harness.results import Result, Slices
from bench.mapper.house_tours import Roads, inhabited

from trolley_base.world.spec import LidarSpec


@pytest.mark.timeout(30)
def test_a_tour_ends_though_a_place_cannot_be_reached_on_every_second_cell() -> None:
    house = inhabited(plan_house(math.sqrt(60.0) + 1.4, 11).built(), 11, LidarSpec(), 0.0, 0)
    way = Roads(house).tour(house.start)
    steps = np.hypot(*np.diff(way, axis=0).T)
    assert len(way) > 100
    assert steps.max() < 0.2, "a tour has no jumps"


@pytest.mark.parametrize("seed", [0, 1])
def test_an_odd_house_is_the_same_each_time_and_can_be_driven_through(seed: int) -> None:
    plan, again = plan_odd_house(9.0, seed), plan_odd_house(9.0, seed)
    assert np.array_equal(plan.built().cells, again.built().cells)
    house = inhabited(plan.built(), seed, LidarSpec(), 0.0, 0)
    assert house.reachable.sum() * plan.built().resolution ** 2 > 5.0
    assert plan.furniture


def test_what_a_file_of_results_holds_is_not_run_again(tmp_path: Path) -> None:
    file = tmp_path / "results.jsonl"
    runs: list[int] = []

    def work(number: int) -> Result:
        runs.append(number)
        return {"twice": 2 * number}

    for count in (2, 3):
        slices = Slices(file, math.inf)
        for number in range(count):
            slices.run({"number": number}, lambda number=number: work(number))
        assert [one["twice"] for one in slices.having("twice")] == [0, 2, 4][:count]
    assert runs == [0, 1, 2]
    late = Slices(file, 0.0)
    late.run({"number": 3}, lambda: work(3))
    assert late.left == 1
    assert runs == [0, 1, 2]
