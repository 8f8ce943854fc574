"""The localizer on recorded drives: real lidars, real floors, furniture that has moved."""

from pathlib import Path

import numpy as np
import pytest
from bench.harness.recorded import (
    CREATE3,
    FREIBURG,
    FREIBURG_RAW,
    MAPS,
    Score,
    follow,
    read_recording,
    relation_errors,
    start_nearby,
)


def drive(folder: Path, names: tuple[str, str, str], seed: int) -> Score:
    recording = read_recording(folder, *names)
    return follow(recording, folder / MAPS[names[0]], seed, start_nearby(recording, seed))


def check(result: Score, median_m: float, p95_m: float) -> None:
    assert result.far_share == 0.0
    assert result.median_m <= median_m
    assert result.p95_m <= p95_m
    assert "lost" not in result.states
    assert "searching" not in result.states


def test_freiburg_is_followed_to_the_end_as_measured_by_hand(recordings: Path) -> None:
    result = drive(recordings, FREIBURG, 1)
    check(result, 0.06, 0.13)
    errors = relation_errors(recordings, result.poses)
    assert len(errors) == 1685
    assert np.mean(errors) <= 0.10


@pytest.mark.slow
@pytest.mark.parametrize("seed", [0, 2, 3, 4])
def test_freiburg_is_followed_whatever_the_seed(recordings: Path, seed: int) -> None:
    check(drive(recordings, FREIBURG, seed), 0.06, 0.13)


@pytest.mark.slow
def test_freiburg_is_followed_though_reversing_looks_like_driving_on(recordings: Path) -> None:
    result = drive(recordings, FREIBURG_RAW, 0)
    assert result.far_share <= 0.02
    assert not result.is_far[-1]


@pytest.mark.parametrize("seed", range(3))
def test_create3_is_followed_among_people_and_moved_furniture(recordings: Path, seed: int) -> None:
    check(drive(recordings, CREATE3, seed), 0.06, 0.13)


@pytest.mark.parametrize("names", [pytest.param(FREIBURG, marks=pytest.mark.slow), CREATE3])
def test_without_a_start_the_place_is_found(recordings: Path, names: tuple[str, str, str]) -> None:
    recording = read_recording(recordings, *names)
    result = follow(recording, recordings / MAPS[names[0]], 0, None)
    known = [index for index, state in enumerate(result.states) if state == "localized"]
    assert recording.stamps[known[0]] < 20.0
    assert not result.is_far[known].any()
