"""The mapper on recorded drives: a map from scans and wheels alone."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from bench.harness.recorded import CREATE3, FREIBURG, FREIBURG_RAW, Recording, read_recording
from bench.mapper.recorded_drives import follow, relation_errors, without_scans
from bench.mapper.simulated_houses import fitted
from bench.mapper.sparse_drives import through_building

SECONDS = 150.0


def beginning(recording: Recording) -> Recording:
    count = int(np.searchsorted(recording.stamps, SECONDS))
    return replace(recording, stamps=recording.stamps[:count])


@pytest.mark.parametrize("names", [FREIBURG, pytest.param(FREIBURG_RAW, marks=pytest.mark.slow)])
def test_relations_measured_by_hand_hold(recordings: Path, names: tuple[str, str, str]) -> None:
    result = follow(beginning(read_recording(recordings, *names)))
    metres, radians = relation_errors(recordings, result.drive.poses)
    assert len(metres) > 50
    assert metres.mean() <= 0.045
    assert radians.mean() <= 0.02
    assert result.drive.mapping_share > 0.98


def test_a_lidar_cut_for_five_seconds_bends_nothing(recordings: Path) -> None:
    recording = beginning(read_recording(recordings, *FREIBURG))
    cut = without_scans(
        replace(
            recording,
            odom=recording.odom[: len(recording.stamps)],
            reference=recording.reference[: len(recording.stamps)],
            ranges=recording.ranges[: len(recording.stamps)],
        ),
        60.0,
        5.0,
    )
    result = follow(cut)
    _, error_m = fitted(result.drive.poses, [cut.reference_at(k) for k in range(len(cut.stamps))])
    assert error_m < 0.3


def test_create3_is_mapped_among_people(recordings: Path) -> None:
    recording = read_recording(recordings, *CREATE3)
    result = follow(recording)
    truths = [recording.reference_at(k) for k in range(len(recording.stamps))]
    assert fitted(result.drive.poses, truths)[1] < 0.05


def test_a_floor_of_offices_with_a_scan_a_metre_is_mapped_without_a_place_shown_twice() -> None:
    # Corridors look alike every few metres; the first closures that offer themselves are wrong.
    result = through_building("offices-500", 1)
    revisits = result.revisits
    assert revisits.num_closed == revisits.num_loops == 3
    assert not revisits.is_wrong.any()
    assert result.errors_m.mean() < 0.1


def test_a_turn_that_the_wheels_miss_on_the_way_to_new_corridors_bends_nothing() -> None:
    # What lies behind it looks like corridors that are known, 17 m away.
    result = through_building("missed-turns", 11)
    revisits = result.revisits
    assert revisits.num_closed == revisits.num_loops == 6
    assert not revisits.is_wrong.any()
