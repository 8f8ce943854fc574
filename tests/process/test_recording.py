"""`trolley record` and `trolley replay` over a real router, ended gently and otherwise."""

import os
import signal
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest
from support.demo import PROGRAM
from support.processes import Process
from support.waiting import PATIENCE_S, wait_until

from trolley import topics
from trolley.connection import Connection
from trolley.geometry import Twist2D
from trolley.messages import Clock, Robot, VelocityCommand
from trolley.recording.reader import RecordingFile
from trolley.runtime.bus import Sample
from trolley.runtime.robot_time import FollowedTime
from trolley.topics import Qos

Trolley = Callable[..., Any]


@pytest.fixture
def start(tmp_path: Path, endpoint: str) -> Iterator[Callable[..., Process]]:
    """Start `trolley` with these arguments, at the test's router."""
    started: list[Process] = []

    def run(*arguments: str) -> Process:
        process = Process(
            ["-c", PROGRAM, *arguments, "--connect", endpoint], tmp_path / f"{len(started)}.log"
        )
        started.append(process)
        return process

    yield run
    for process in started:
        process.kill()


@pytest.fixture(scope="module")
def shelf(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Where the recording of the first test that needs one is kept for the others."""
    return tmp_path_factory.mktemp("recorded") / "one.mcap"


@pytest.fixture
def recorded(shelf: Path, add_robot: Callable, trolley: Trolley, endpoint: str) -> Path:
    """Four seconds of robot `one`, somebody's commands included."""
    if shelf.exists():
        return shelf
    add_robot("one")
    command = VelocityCommand(stamp_ns=1, twist=Twist2D(0.1, 0.0, 0.0), valid_for=0.2)
    with Connection([endpoint]) as connection:

        def send(_: Sample) -> None:
            connection.publish("one", topics.COMMAND, command, "teleop")

        listening = connection.listen(topics.CLOCK.key("one"), send)
        result = trolley("record", str(shelf), "--connect", endpoint, "--seconds", "4")
        listening.close()
    assert result.returncode == 0, result.stderr
    return shelf


def replayed(endpoint: str, name: str, process: Callable[[], Process]) -> dict[str, list[Sample]]:
    """All that is published under a name while a replay lasts, by the rest of the key."""
    heard: dict[str, list[Sample]] = {}
    with Connection([endpoint]) as connection, Connection([endpoint]) as other:

        def take(sample: Sample) -> None:
            heard.setdefault(sample.key.split("/", 2)[2], []).append(sample)

        closer = connection.listen(f"trolley/{name}/**", take)
        running = process()
        code = running.wait()
        assert code == 0, running.log
        # The router has read all of a session that it knows to be over; the mark comes behind.
        wait_until(lambda: name not in other.robots(), "the replay has gone")
        other.bus.put(f"trolley/{name}/end", b"", "", Qos.STATE)
        wait_until(lambda: heard.pop("end", None), "all has arrived")
        closer.close()
    return heard


def test_what_was_recorded_is_heard_again_under_another_name(
    recorded: Path, start: Callable[..., Process], endpoint: str
) -> None:
    entries = list(RecordingFile(recorded).entries())
    assert {"clock", "odom", "pose", "robot", "poses", "tf/laser", "goal"} <= {
        entry.name for entry in entries
    }
    assert [entry.name for entry in entries].count("cmd_vel/teleop") > 10
    heard = replayed(endpoint, "two", lambda: start("replay", str(recorded), "--as", "two"))
    for name in {entry.name for entry in entries} - {"clock", "robot", "cmd_vel/teleop"}:
        sent = [(entry.payload, entry.encoding) for entry in entries if entry.name == name]
        assert [(one.payload, one.encoding) for one in heard[name]] == sent, name
    assert "cmd_vel/teleop" not in heard
    assert not any(name.startswith("@do") for name in heard)


def test_a_client_sees_a_robot_like_any_other(
    recorded: Path, start: Callable[..., Process], endpoint: str
) -> None:
    with Connection([endpoint]) as connection:
        process = start("replay", str(recorded), "--as", "two", "--loop", "--speed", "2")
        robot = wait_until(lambda: connection.latest("two", topics.ROBOT), "it is there")
        assert isinstance(robot, Robot)
        assert (robot.name, robot.title) == ("two", "Scripted")
        assert "two" in connection.robots()
        wait_until(lambda: connection.latest("two", topics.POSES), "its places are told")
        wait_until(lambda: connection.get("two", topics.TF, "laser"), "its lidar's place is told")
        follow_time(connection, "two", 2.0)
        process.terminate()
        assert process.wait() == 0
        wait_until(lambda: "two" not in connection.robots(), "it has gone")


def follow_time(connection: Connection, name: str, rate: float) -> None:
    """Robot time runs at its rate, over the turn where the recording begins anew."""
    followed = FollowedTime()
    begun, stamps_in_time = 0, 0
    with connection.subscribe(name, topics.CLOCK) as clocks:
        while begun < 2 or stamps_in_time <= 20:
            heard = clocks.next(PATIENCE_S)
            assert heard is not None
            clock: Clock = heard.message
            assert clock.rate == rate
            arrived_ns = round(heard.arrived_s * 1e9)
            begun += followed.update(clock, arrived_ns)
            now_ns = followed.now(arrived_ns)
            assert now_ns is not None
            stamps_in_time += abs(now_ns - clock.stamp_ns) < 500_000_000


def test_the_name_of_a_robot_that_is_there_is_refused(
    recorded: Path,
    start: Callable[..., Process],
    add_robot: Callable,
    trolley: Trolley,
    endpoint: str,
) -> None:
    add_robot("other")
    at = ("--connect", endpoint)
    for name, problem in (("other", "a robot called other"), ("No Name", "not a valid robot name")):
        done = trolley("replay", str(recorded), "--as", name, *at)
        assert done.returncode == 2
        assert problem in done.stderr
    first = start("replay", str(recorded), "--loop")
    wait_until(lambda: "Playing" in first.log, "the first one plays")
    with Connection([endpoint]) as connection:
        wait_until(lambda: "one-replay" in connection.robots(), "the first one is there")
    done = trolley("replay", str(recorded), *at)
    assert done.returncode == 2
    assert "one-replay" in done.stderr
    done = trolley("status", "--robot", "one-replay", *at)
    assert done.returncode == 0, done.stdout
    assert "A recording is played" in done.stdout


def test_a_robot_that_comes_up_later_has_its_name_for_itself(
    recorded: Path, start: Callable[..., Process], add_robot: Callable, endpoint: str
) -> None:
    process = start("replay", str(recorded), "--loop", "--as", "two")
    with Connection([endpoint]) as connection:
        wait_until(lambda: "two" in connection.robots(), "the replay is there")
    add_robot("two")
    assert process.wait() == 1
    assert "has come up" in process.log


def test_a_start_and_a_choice_of_topics(
    recorded: Path, start: Callable[..., Process], trolley: Trolley, endpoint: str
) -> None:
    arguments = ("--as", "two", "--start", "2", "--speed", "10", "--topics", "odom,poses")
    heard = replayed(endpoint, "two", lambda: start("replay", str(recorded), *arguments))
    entries = [e for e in RecordingFile(recorded).entries() if e.name == "odom"]
    played = [sample.payload for sample in heard["odom"]]
    assert 0 < len(played) < len(entries)
    assert played == [entry.payload for entry in entries][-len(played) :]
    assert len(heard["poses"]) == 1  # said long before, told at the start
    assert "pose" not in heard
    done = trolley("replay", str(recorded), "--start", "99", "--connect", endpoint)
    assert done.returncode == 1
    assert "past the end" in done.stderr


@pytest.mark.parametrize("number", [signal.SIGKILL, signal.SIGTERM])
def test_however_it_ends_what_was_heard_is_there(
    add_robot: Callable,
    start: Callable[..., Process],
    endpoint: str,
    tmp_path: Path,
    number: signal.Signals,
) -> None:
    """After a crash all is there that had been flushed, which it does each second."""
    add_robot("one")
    file = tmp_path / "one.mcap"
    process = start("record", str(file))
    wait_until(lambda: file.exists() and file.stat().st_size > 20_000, "it records")
    first = num_saved(file)
    wait_until(lambda: num_saved(file) > first, "more is flushed")
    flushed = num_saved(file)
    with Connection([endpoint]) as connection:
        odometry: list[Sample] = []
        connection.listen(topics.ODOM.key("one"), odometry.append)
        wait_until(lambda: len(odometry) >= 10, "more is heard")
    process.send(number)
    code = process.wait()
    assert code == (-number if number == signal.SIGKILL else 0), process.log
    recording = RecordingFile(file)
    entries = list(recording.entries())
    assert len(entries) >= flushed
    if number != signal.SIGKILL:
        assert odometry[0].payload in [e.payload for e in entries if e.name == "odom"]
    assert (recording.span_ns is None) == (number == signal.SIGKILL)
    assert {"robot", "poses", "tf/laser"} <= {entry.name for entry in entries}


def num_saved(file: Path) -> int:
    """How many messages would be there if the power failed now."""
    return len(list(RecordingFile(file).entries()))


def test_what_cannot_be_done_is_said_in_words(
    recorded: Path, add_robot: Callable, trolley: Trolley, endpoint: str, tmp_path: Path
) -> None:
    add_robot("one")
    at = ("--connect", endpoint)
    before = recorded.read_bytes()
    for arguments, code, problem in (
        (("record", str(recorded)), 2, "already exists"),
        (("record", str(tmp_path / "no" / "x.mcap")), 2, "cannot be written"),
        (("record", "x.mcap", "--topics", "scam"), 2, "there is no topic 'scam'"),
        (("record", "x.mcap", "--robot", "nobody", "--seconds", "1"), 1, "Nothing was received"),
        (("replay", str(tmp_path / "x.txt")), 2, "does not exist"),
        (("replay", str(recorded), "--speed", "0"), 2, "--speed"),
        (("replay", str(recorded), "--robot", "two"), 2, "--as"),
    ):
        done = trolley(*arguments, *at)
        assert done.returncode == code, done.stderr
        assert problem in done.stderr
    assert recorded.read_bytes() == before
    assert not (tmp_path / "x.mcap").exists()


@pytest.mark.skipif(os.geteuid() != 0, reason="a small file system can be made by root only")
def test_a_full_disk_ends_it_with_words(
    add_robot: Callable, start: Callable[..., Process], tmp_path: Path
) -> None:
    add_robot("one")
    folder = tmp_path / "small"
    folder.mkdir()
    if os.system(f"mount -t tmpfs -o size=1m tmpfs {folder} 2>/dev/null") != 0:
        pytest.skip("file systems cannot be mounted here")
    try:
        (folder / "map").write_bytes(bytes(980_000))
        file = folder / "one.mcap"
        process = start("record", str(file))
        assert process.wait() == 1
        assert "The disk is full" in process.log
        recording = RecordingFile(file)
        assert len(list(recording.entries())) > 20
        assert recording.damage.sentences() == []
        # What the robot saves still fits on it.
        (folder / "places").write_bytes(bytes(8192))
        disk = os.statvfs(folder)
        (folder / "log").write_bytes(bytes(disk.f_frsize * (disk.f_bavail - 1)))
        process = start("record", str(folder / "next.mcap"))
        assert process.wait() != 0
        assert "cannot be written" in process.log
        assert not (folder / "next.mcap").exists()
    finally:
        os.system(f"umount {folder}")
