"""The localizer on recorded drives: real lidars, real floors, furniture that has moved."""

import functools
import math
from pathlib import Path

import numpy as np
import pytest

from trolley.geometry import Pose2D

from .conftest import Score, follow, read_recording, start_nearby

FREIBURG = ("freiburg-079", "odom_signed", "reference_refined")
FREIBURG_RAW = ("freiburg-079", "odom", "reference_refined")
CREATE3 = ("create3-rplidar-mac", "odom", "reference")
MAPS = {"freiburg-079": "freiburg-079.yaml", "create3-rplidar-mac": "mac_1st_floor_final.yaml"}


@functools.lru_cache(maxsize=1)
def drive(folder: Path, names: tuple[str, str, str], seed: int) -> Score:
    recording = read_recording(folder, *names)
    return follow(recording, folder / MAPS[names[0]], seed, start_nearby(recording, seed))


def relation_errors(folder: Path, poses: list[Pose2D | None]) -> list[float]:
    """Errors [m] of the relative poses that were measured by hand, independent of any map."""
    with np.load(folder / "freiburg-079.npz") as data:
        # Their times count from the first scan.
        stamps, relations = data["stamps"] - data["stamps"][0], data["relations"]
    errors = []
    for t_a, t_b, dx, dy, _ in relations:
        a, b = (poses[int(np.argmin(np.abs(stamps - t)))] for t in (t_a, t_b))
        assert a is not None
        assert b is not None
        found = a.inverse() @ b
        errors.append(math.hypot(found.x - dx, found.y - dy))
    return errors


def check(result: Score, median_m: float, p95_m: float) -> None:
    assert result.far_share == 0.0
    assert result.median_m <= median_m
    assert result.p95_m <= p95_m
    assert "lost" not in result.states
    assert "searching" not in result.states


@pytest.mark.parametrize("seed", range(2))
def test_freiburg_is_followed_to_the_end(recordings: Path, seed: int) -> None:
    check(drive(recordings, FREIBURG, seed), 0.06, 0.13)


def test_freiburg_agrees_with_what_was_measured_by_hand(recordings: Path) -> None:
    errors = relation_errors(recordings, drive(recordings, FREIBURG, 1).poses)
    assert len(errors) == 1685
    assert np.mean(errors) <= 0.10


@pytest.mark.slow
@pytest.mark.parametrize("seed", range(2, 5))
def test_freiburg_is_followed_whatever_the_seed(recordings: Path, seed: int) -> None:
    check(drive(recordings, FREIBURG, seed), 0.06, 0.13)


def test_freiburg_is_followed_though_reversing_looks_like_driving_on(recordings: Path) -> None:
    result = drive(recordings, FREIBURG_RAW, 0)
    assert result.far_share <= 0.02
    assert not result.is_far[-1]


@pytest.mark.parametrize("seed", range(3))
def test_create3_is_followed_among_people_and_moved_furniture(recordings: Path, seed: int) -> None:
    check(drive(recordings, CREATE3, seed), 0.06, 0.13)


@pytest.mark.parametrize("names", [FREIBURG, CREATE3])
def test_without_a_start_the_place_is_found(recordings: Path, names: tuple[str, str, str]) -> None:
    recording = read_recording(recordings, *names)
    result = follow(recording, recordings / MAPS[names[0]], 0, None)
    known = [index for index, state in enumerate(result.states) if state == "localized"]
    assert recording.stamps[known[0]] < 20.0
    assert not result.is_far[known].any()
