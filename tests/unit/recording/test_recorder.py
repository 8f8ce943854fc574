"""What of a robot's streams goes into a file, and with what time."""

from pathlib import Path

import pytest
from support.samples import (
    make_clock,
    make_estimate,
    make_place,
    make_places,
    make_scan,
    make_transform,
)

from trolley import topics
from trolley.geometry import Twist2D
from trolley.messages import Marker, VelocityCommand
from trolley.recording.layout import bad_pattern
from trolley.recording.reader import Entry, RecordingFile
from trolley.recording.recorder import MAX_KEYS, Recorder
from trolley.recording.writer import RecordingWriter
from trolley.runtime.bus import Sample

from .conftest import ROBOT, SECOND_NS, START_NS, sample_of


class Taking:
    """A recorder that writes a file, and what is in it."""

    def __init__(self, folder: Path, *patterns: str) -> None:
        self.path = folder / "one.mcap"
        self._writer = RecordingWriter(self.path, "one", {})
        self.recorder = Recorder(self._writer, "one", patterns)

    def take(self, at_s: float, sample: Sample, *, is_latest: bool = False) -> None:
        self.recorder.take(sample, round(at_s * SECOND_NS), START_NS, is_latest=is_latest)

    def entries(self) -> list[Entry]:
        with self._writer:
            self._writer.finish()
        return list(RecordingFile(self.path).entries())


def clock_at(seconds: float, rate: float = 1.0, epoch: int = START_NS) -> Sample:
    stamp_ns = START_NS + round(seconds * SECOND_NS)
    return sample_of(topics.CLOCK, make_clock(stamp_ns, epoch=epoch, rate=rate))


def times(entries: list[Entry]) -> list[float]:
    return [round((entry.at_ns - START_NS) / SECOND_NS, 3) for entry in entries]


def test_arrivals_are_told_in_robot_time(tmp_path: Path) -> None:
    taking = Taking(tmp_path)
    taking.take(100.0, clock_at(0.0, rate=2.0))
    taking.take(100.5, sample_of(topics.SCAN, make_scan(START_NS)))
    # A clock that fell silent is carried on, and time never goes back.
    taking.take(103.0, sample_of(topics.SCAN, make_scan(START_NS)))
    taking.take(104.0, clock_at(7.0, rate=2.0))
    taking.take(104.5, sample_of(topics.SCAN, make_scan(START_NS)))
    assert times(taking.entries()) == [0.0, 1.0, 6.0, 8.0, 9.0]


def test_a_restart_of_base_leaps_ahead(tmp_path: Path) -> None:
    taking = Taking(tmp_path)
    taking.take(0.0, clock_at(0.0))
    taking.take(5.0, clock_at(130.0, epoch=START_NS + 130 * SECOND_NS))
    taking.take(5.5, sample_of(topics.SCAN, make_scan(START_NS)))
    assert times(taking.entries()) == [0.0, 130.0, 130.5]


def test_without_a_clock_the_hosts_time_counts(tmp_path: Path) -> None:
    taking = Taking(tmp_path)
    taking.take(1.0, sample_of(topics.SCAN, make_scan(5)))
    assert times(taking.entries()) == [0.0]


def test_latest_values_come_first_and_only_once(tmp_path: Path) -> None:
    taking = Taking(tmp_path)
    taking.take(0.0, sample_of(topics.ROBOT, ROBOT))
    taking.take(0.1, sample_of(topics.ROBOT, ROBOT), is_latest=True)  # older than what came
    taking.take(0.1, sample_of(topics.TF, make_transform(1, "laser"), "laser"), is_latest=True)
    taking.take(0.1, sample_of(topics.SCAN, make_scan(5)), is_latest=True)  # the next will come
    # base answers `get tf/base_link`, but it is no stream.
    base_link = sample_of(topics.TF, make_transform(1, "base_link"), "base_link")
    taking.take(0.1, base_link, is_latest=True)
    assert [entry.name for entry in taking.entries()] == ["robot", "tf/laser"]


def test_what_was_missed_while_the_router_was_away_is_news(tmp_path: Path) -> None:
    taking = Taking(tmp_path)
    taking.take(0.0, sample_of(topics.POSES, make_places(0, "a")))
    taking.take(0.0, sample_of(topics.POSE, make_estimate(7)))
    for _ in range(2):  # asked again after each reconnection
        taking.take(9.0, sample_of(topics.POSES, make_places(0, "a", "b")), is_latest=True)
        taking.take(9.0, sample_of(topics.POSE, make_estimate(6)), is_latest=True)
    assert [entry.name for entry in taking.entries()] == ["poses", "pose", "poses"]


def test_wishes_requests_and_strangers_are_left_out(tmp_path: Path) -> None:
    taking = Taking(tmp_path)
    taking.take(0.0, sample_of(topics.SAVED_POSE, make_place("a"), "a"))
    taking.take(0.0, Sample("trolley/one/@do/goal/send", b"{}", ""))
    taking.take(0.0, Sample("trolley/one/weather", b"{}", ""))
    taking.take(0.0, Sample("trolley/one/scan", b"", "application/msgpack"))
    taking.take(0.0, Sample("trolley/one/scan", bytes(2 << 20), "application/msgpack"))
    command = VelocityCommand(stamp_ns=1, twist=Twist2D.zero(), valid_for=0.1)
    taking.take(0.0, sample_of(topics.COMMAND, command, "teleop"))
    assert [entry.name for entry in taking.entries()] == ["cmd_vel/teleop"]
    assert taking.recorder.counts == {"empty": 1, "too large": 1}


def test_what_is_not_understood_is_kept_as_it_came(tmp_path: Path) -> None:
    taking = Taking(tmp_path)
    taking.take(0.0, Sample("trolley/one/pose", b"{nonsense", "application/json"))
    taking.take(0.0, Sample("trolley/one/clock", b"\x80", "application/msgpack"))
    entries = taking.entries()
    assert [entry.payload for entry in entries] == [b"{nonsense", b"\x80"]
    assert taking.recorder.counts == {"not understood": 2}


def test_deleted_markers_are_told(tmp_path: Path) -> None:
    taking = Taking(tmp_path)
    marker = Marker(kind="cube")
    for name in ("a", "b"):
        taking.take(0.0, sample_of(topics.MARKER, marker, "things", name))
    taking.take(1.0, Sample("trolley/one/markers/things/a", b"", "", is_delete=True))
    taking.take(2.0, Sample("trolley/one/markers/things/**", b"", "", is_delete=True))
    told = [(entry.name, entry.is_delete) for entry in taking.entries()]
    assert told == [
        ("markers/things/a", False),
        ("markers/things/b", False),
        ("markers/things/a", True),
        ("markers/things/**", True),
    ]


def test_a_stranger_cannot_fill_the_list_of_keys(tmp_path: Path) -> None:
    taking = Taking(tmp_path)
    for number in range(MAX_KEYS + 5):
        name = f"frame{number}"
        taking.take(0.0, sample_of(topics.TF, make_transform(1, name), name))
    taking.take(0.0, clock_at(0.0))
    assert taking.recorder.counts == {"too many keys": 6}


def test_only_what_is_wanted(tmp_path: Path) -> None:
    taking = Taking(tmp_path, "scan", "tf/*")
    for sample in (
        clock_at(0.0),
        sample_of(topics.ROBOT, ROBOT),
        sample_of(topics.SCAN, make_scan(5)),
        sample_of(topics.POSE, make_estimate(5)),
        sample_of(topics.TF, make_transform(1, "laser"), "laser"),
    ):
        taking.take(0.0, sample)
    assert [entry.name for entry in taking.entries()] == ["clock", "robot", "scan", "tf/laser"]


@pytest.mark.parametrize(
    ("patterns", "bad"),
    [
        ([], None),
        (["scan", "tf/*", "costmap/**", "markers/**", "health/base"], None),
        (["scam"], "scam"),
        (["scan", ""], ""),
        (["@do/goal/send"], "@do/goal/send"),
        (["poses/kitchen"], "poses/kitchen"),
    ],
)
def test_misspelt_names_are_found(patterns: list[str], bad: str | None) -> None:
    assert bad_pattern(patterns) == bad
