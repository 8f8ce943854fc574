"""The bounded tables of the past against plain lists, and records that are written and read."""

from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from support.cases import cases

from trolley.geometry import Pose2D
from trolley_viz.features.past.record import LATELY, MAX_BEAMS, TRIP, Capacity, Failure, Record
from trolley_viz.features.past.rows import AT, Rows
from trolley_viz.features.past.trip_file import decode, encode
from trolley_viz.words.sentences import StatusLine

KIND = np.dtype([(AT, "<i8"), ("value", "<i4")])
STEPS = st.lists(st.integers(-3, 20), max_size=60)
SECOND = 1_000_000_000


class NaiveRows:
    """What `Rows` is to hold, as a list."""

    def __init__(self, capacity: int, *, thins: bool) -> None:
        self.capacity, self.thins, self.gap_ns = capacity, thins, 0
        self.rows: list[tuple[int, int]] = []

    def append(self, row: tuple[int, int]) -> None:
        if self.rows and row[0] < self.rows[-1][0] + max(self.gap_ns, 1):
            return
        if len(self.rows) == self.capacity:
            if self.thins:
                self.rows = self.rows[::2]
                span_ns = self.rows[-1][0] - self.rows[0][0]
                self.gap_ns = span_ns // max(len(self.rows) - 1, 1)
            else:
                self.rows = self.rows[1:]
        self.rows.append(row)

    def drop_before(self, at_ns: int) -> None:
        self.rows = [one for one in self.rows if one[0] >= at_ns]


@pytest.mark.parametrize("thins", [False, True])
@given(steps=STEPS, capacity=st.integers(2, 9), drops=st.sets(st.integers(0, 60)))
def test_rows_are_what_a_list_would_hold(
    steps: list[int], capacity: int, drops: set[int], *, thins: bool
) -> None:
    rows, naive = Rows(KIND, capacity, thins=thins), NaiveRows(capacity, thins=thins)
    at_ns = 100
    for number, step in enumerate(steps):
        at_ns += step
        rows.append((at_ns, number))
        naive.append((at_ns, number))
        if number in drops:
            rows.drop_before(at_ns - 12)
            naive.drop_before(at_ns - 12)
        assert rows.rows.tolist() == naive.rows
        older = [one for one in naive.rows if one[0] <= at_ns - 7]
        assert rows.index(at_ns - 7) == len(older) - 1
    copy = rows.copy()
    rows.drop_before(at_ns + 1)
    assert copy.rows.tolist() == naive.rows


poses = st.builds(
    Pose2D,
    st.floats(-300, 300, width=32),
    st.floats(-300, 300, width=32),
    st.floats(-3, 3, width=32),
)


@st.composite
def records(draw: st.DrawFn) -> Record:
    """Records of anything."""
    record = Record(TRIP)
    at_ns = draw(st.integers(0, 2**60))
    for _ in range(draw(st.integers(0, 12))):
        at_ns += draw(st.integers(1, 3 * SECOND))
        pose, name = draw(poses), draw(st.sampled_from(["home", "garden"]))
        record.add_pose(at_ns, at_ns, name, pose, draw(st.sampled_from(["lost", "unsure"])))
        record.say(at_ns, StatusLine(draw(st.text(max_size=9)), "warn"))
        record.aim(at_ns, draw(st.none() | poses))
        if draw(st.booleans()):
            away = np.array(draw(st.lists(st.tuples(st.floats(-9, 9), st.floats(-9, 9)))))
            record.add_scan(at_ns, name, pose, away.reshape(-1, 2) + np.array([pose.x, pose.y]))
        if draw(st.booleans()):
            record.fail(Failure(at_ns, draw(st.integers(0, 9)), None, "no"))
    return record


@settings(max_examples=cases(50))
@given(record=records(), offset_ns=st.integers(-(2**40), 2**60))
def test_a_record_comes_back_from_its_file(record: Record, offset_ns: int) -> None:
    content = encode("trolley", "t1", offset_ns, record)
    found, found_ns = decode(content)
    assert found_ns == offset_ns
    assert encode("trolley", "t1", offset_ns, found) == content
    for at_ns in record.poses.rows[AT].tolist():
        mine, other = record.at(at_ns), found.at(at_ns)
        assert (mine.pose, mine.map, mine.state, mine.words) == (
            other.pose,
            other.map,
            other.state,
            other.words,
        )


@settings(max_examples=cases(50))
@given(record=records(), by_ns=st.integers(-(2**50), 2**50))
def test_a_record_that_is_shifted_tells_the_same_of_other_times(record: Record, by_ns: int) -> None:
    shifted = record.copy()
    shifted.shift(by_ns)
    for at_ns in record.poses.rows[AT].tolist():
        mine, other = record.at(at_ns), shifted.at(at_ns + by_ns)
        assert (mine.pose, mine.words, mine.aim) == (other.pose, other.words, other.aim)


@settings(max_examples=cases(50))
@given(older=records(), newer=records())
def test_a_record_goes_on_after_the_viewer_was_restarted(older: Record, newer: Record) -> None:
    ends: list[Any] = [older.copy(), newer.copy()]
    older.go_on(newer)
    rows = older.poses.rows
    assert (np.diff(rows[AT]) > 0).all()
    assert len(rows) == sum(len(one.poses.rows) for one in ends)
    assert len(older.failures) == sum(len(one.failures) for one in ends)
    for at_ns in ends[1].poses.rows[AT].tolist():
        mine, other = older.at(at_ns), ends[1].at(at_ns)
        assert (mine.pose, mine.map) == (other.pose, other.map)


@given(num=st.integers(0, 500), pose=poses)
def test_a_scan_is_kept_to_a_centimetre(num: int, pose: Pose2D) -> None:
    record = Record(LATELY)
    record.add_pose(1, 1, "home", pose, "localized")
    angles = np.linspace(0.0, 6.0, num)
    points = 7.3 * np.stack([np.cos(angles), np.sin(angles)], axis=1) + (pose.x, pose.y)
    record.add_scan(1, "home", pose, points)
    scan = record.at(1).scan
    assert scan is not None
    assert len(scan) <= MAX_BEAMS
    assert len(scan) >= min(num, MAX_BEAMS // 2)
    far_m = np.hypot(*(scan - np.array([pose.x, pose.y])).T)
    assert np.abs(far_m - 7.3).max(initial=0.0) < 0.012


def test_what_is_kept_takes_less_than_five_megabytes() -> None:
    num_bytes = sum(
        rows.num_bytes for record in (Record(LATELY), Record(TRIP)) for rows in tables(record)
    )
    assert num_bytes < 5e6


def tables(record: Record) -> tuple[Rows, Rows]:
    return record.poses, record.scans


def test_nothing_joins_two_places_between_which_it_was_carried() -> None:
    record = Record(Capacity(50, 1, thins=False))
    for i in range(20):
        x = 0.1 * i + (5.0 if i >= 10 else 0.0)
        record.add_pose(i * SECOND, i, "home", Pose2D(x, 0.0, 0.0), "localized")
    track = record.track(19 * SECOND, 0, "home")
    assert np.hypot(*(track[:, 1] - track[:, 0]).T).max() < 0.3
    assert record.track(19 * SECOND, 0, "garden").shape == (0, 2, 2)
    assert record.track(4 * SECOND, 0, "home")[..., 0].max() == pytest.approx(0.4)


def test_where_it_was_is_unknown_once_it_was_not_heard_of() -> None:
    record = Record(LATELY)
    record.add_pose(0, 0, "home", Pose2D(1.0, 0.0, 0.0), "localized")
    record.say(0, StatusLine("Ready.", "good"))
    record.say(20 * SECOND, StatusLine("No contact.", "bad"))
    assert record.at(2 * SECOND).pose is not None
    assert record.at(5 * SECOND).pose is None
    assert record.at(25 * SECOND).words == StatusLine("No contact.", "bad")
    assert [one.at_ns for one in record.troubles()] == [20 * SECOND]
    record.drop_before(10 * SECOND)
    assert record.at(11 * SECOND).words == StatusLine("Ready.", "good")
    record.drop_before(60 * SECOND)
    assert record.first_ns is None
