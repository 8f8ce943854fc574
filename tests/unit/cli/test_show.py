"""What is printed."""

import json
import math

import numpy as np
import pytest

from trolley.cli import show
from trolley.cli.show import Progress, as_json, describe, pose_text, print_table, seconds_text
from trolley.geometry import Pose2D
from trolley.messages import OccupancyGrid, Path, Scan, floats_to_bytes
from trolley.messages.arrays import ARRAY_FIELDS, arrays_of
from trolley.topics import TOPICS


def make_scan(ranges: list[float]) -> Scan:
    return Scan(
        stamp_ns=1,
        frame="laser",
        angle_min=0.0,
        angle_increment=0.1,
        time_increment=0.0,
        range_min=0.1,
        range_max=8.0,
        ranges=floats_to_bytes(np.array(ranges)),
    )


def test_every_array_of_the_wire_is_known() -> None:
    declared = {
        (topic.message, name)
        for topic in TOPICS
        for name, kind in topic.message.__annotations__.items()
        if kind is memoryview
    }
    assert declared == set(ARRAY_FIELDS)


def test_arrays_are_shortened_unless_asked_in_full() -> None:
    scan = make_scan([i / 8 for i in range(100)])
    short, full = describe(scan), describe(scan, full=True)
    assert "(100 float32) [ 0.     0.125  0.25   0.375 ... 12." in short
    assert "..." not in full
    assert full.count("12.375") == 1


def test_json_of_a_message_has_numbers_and_null_for_no_echo() -> None:
    plain = json.loads(as_json(make_scan([1.5, math.inf, 0.0])))
    assert plain["ranges"] == [1.5, None, 0.0]
    assert plain["intensities"] == []


def test_matrices_keep_their_shape() -> None:
    path = Path(stamp_ns=0, frame="map", poses=floats_to_bytes(np.arange(6.0)))
    assert arrays_of(path)["poses"].shape == (2, 3)
    grid = OccupancyGrid(
        stamp_ns=0,
        name="m",
        frame="map",
        resolution=0.05,
        width=3,
        height=2,
        origin=Pose2D.identity(),
        cells=memoryview(bytes([0, 100, 255, 1, 2, 3])),
    )
    assert json.loads(as_json(grid))["cells"] == [[0, 100, -1], [1, 2, 3]]
    empty = OccupancyGrid(
        stamp_ns=0,
        name="m",
        frame="map",
        resolution=0.05,
        width=0,
        height=0,
        origin=Pose2D.identity(),
        cells=memoryview(b""),
    )
    assert describe(empty, full=True).endswith("(0 x 0 int8) []")


@pytest.mark.parametrize(
    ("seconds", "text"),
    [(None, "?"), (3.4, "3 s"), (75.0, "1 min 15 s"), (119.7, "2 min 00 s"), (7260.0, "2 h 1 min")],
)
def test_durations_are_readable(seconds: float | None, text: str) -> None:
    assert seconds_text(seconds) == text


def test_a_pose_has_both_units() -> None:
    assert pose_text(Pose2D(1.0, -2.0, math.pi / 2)) == (
        "x 1.000 m, y -2.000 m, yaw 1.571 rad (90°)"
    )


def test_columns_line_up_whatever_a_name_holds(capsys: pytest.CaptureFixture[str]) -> None:
    print_table(("A", "B"), [("\033[31mred", "x"), ("longer", "y")])
    lines = capsys.readouterr().out.splitlines()
    assert lines[1] == "\\x1b[31mred  x"
    assert lines[2] == "longer       y"


def test_without_a_terminal_progress_is_not_printed_again_while_it_says_the_same(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(show, "QUIET_PERIOD_S", 0.0)
    progress = Progress()
    for text in ("round: driving, stop 1", "round: driving, stop 1", "round: driving, stop 2"):
        progress.show(text, "driving")
    assert capsys.readouterr().err == "round: driving, stop 1\nround: driving, stop 2\n"
