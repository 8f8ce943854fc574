"""`trolley doctor`, `top` and `status` as a user runs them, with and without a robot."""

import json
import threading
import time
from collections.abc import Callable, Generator
from pathlib import Path
from typing import Any

import pytest
from support.terminals import Terminal
from support.terminals import trolley as command
from support.waiting import PATIENCE_S, wait_until

from trolley import topics
from trolley.messages import TourStatus
from trolley.runtime import codec
from trolley.runtime.bus import Query
from trolley.runtime.process import Run
from trolley.runtime.zenoh_bus import open_bus

SETTINGS = '[robot]\nname = "one"\nfootprint = {{ radius_m = 0.2 }}\n[zenoh]\nconnect = ["{}"]\n'


def findings(text: str, level: str) -> list[str]:
    """The sentences of a level in what `--json` printed."""
    return [one["sentence"] for one in json.loads(text)["findings"] if one["level"] == level]


def test_doctor_needs_nothing_that_runs(port: int, trolley: Callable, tmp_path: Path) -> None:
    path = tmp_path / "robot.toml"
    path.write_text(SETTINGS.format(f"tcp/127.0.0.1:{port}") + '[base]\ndriver = "hardware"\n')
    done = trolley("doctor", "--config", str(path), "--json")
    problems = findings(done.stdout, "problem")
    assert "No map is set, so the robot cannot drive anywhere." in problems
    assert "[base.lidar.port] is not set." in problems
    # Making the service itself, in a process of its own, finds what the checks do not know.
    assert [one for one in problems if one.startswith("base cannot use robot.toml")]
    assert not [one for one in problems if one.startswith("tour cannot use")]
    assert any("No robot runs on this computer" in one for one in findings(done.stdout, "note"))
    assert any("functions are compiled" in one for one in findings(done.stdout, "ok"))
    assert done.returncode == 1
    # It was asked for, so now it is a problem that it is not there.
    asked = trolley("doctor", "--config", str(path), "--robot", "one", "--verbose")
    assert "No router answers at" in " ".join(asked.stdout.split())
    assert "\nfine     system:" in asked.stdout


def test_a_robot_that_is_not_there_is_one_problem(
    add_robot: Callable, endpoint: str, trolley: Callable
) -> None:
    add_robot("kiwi")
    done = trolley("doctor", "--robot", "nobody", "--connect", endpoint, "--json", "--seconds", "1")
    about = [one for one in json.loads(done.stdout)["findings"] if one["robot"] == "nobody"]
    assert [(one["sentence"], one["remedy"]) for one in about] == [
        (f"There is no robot called nobody at {endpoint}. There is only kiwi.", "Check --robot.")
    ]


def test_doctor_names_every_fault_of_the_settings(
    port: int, trolley: Callable, tmp_path: Path
) -> None:
    path = tmp_path / "robot.toml"
    wrong = "[planner]\nfast = 1\nseed = -1\n[basse]\n"
    path.write_text(SETTINGS.format(f"tcp/127.0.0.1:{port}") + wrong)
    done = trolley("doctor", "--config", str(path))
    assert done.returncode == 1
    assert "\\n" not in done.stdout  # a remedy of several lines once showed its line ends
    assert max(map(len, done.stdout.splitlines())) <= 100
    text = " ".join(done.stdout.split())
    assert "[planner] unknown key `fast`" in text
    assert "[planner.seed]" in text
    assert "Did you mean base? >" in text
    assert "\x1b" not in done.stdout
    assert "\nfine     " not in done.stdout


def test_a_pc_with_uplink_only_has_no_problem_but_its_keys(
    add_robot: Callable, endpoint: str, trolley: Callable, tmp_path: Path
) -> None:
    """What the page on networks tells to write on a PC was refused as "missing key `robot`"."""
    add_robot("one")
    path = tmp_path / "robot.toml"
    path.write_text(f'[zenoh]\nconnect = ["{endpoint}"]\n')
    done = trolley("doctor", "--config", str(path), "--json", "--seconds", "1")
    about_settings = [
        one for one in json.loads(done.stdout)["findings"] if one["about"] == "settings"
    ]
    assert [one["level"] for one in about_settings] == ["note", "ok"]
    assert trolley("pose", "--config", str(path)).returncode == 0
    refused = trolley("run", "base", "--config", str(path))
    assert refused.returncode == 2
    assert "has no [robot]" in refused.stderr
    path.write_text("[robbot]\n")
    refused = trolley("run", "base", "--config", str(path))
    assert "unknown key `robbot`. Did you mean robot?" in refused.stderr


def test_doctor_finds_what_is_wrong_with_a_robot(
    add_robot: Callable, endpoint: str, trolley: Callable
) -> None:
    add_robot("one")
    add_robot("two")
    found: list[dict[str, Any]] = []

    def problems() -> list[str]:
        return [one["sentence"] for one in found if one["level"] == "problem"]

    def is_base_heard() -> bool:
        """Whether base had its share of the processor while the doctor listened."""
        done = trolley("doctor", "--connect", endpoint, "--robot", "one", "--json")
        assert done.returncode == 1
        found[:] = json.loads(done.stdout)["findings"]
        return "base is not running, or hangs." not in problems()

    wait_until(is_base_heard, "doctor hears base")
    assert "planner is not running, or hangs." in problems()
    assert "scan is not published, although base is running." in problems()
    assert {one["robot"] for one in found} == {None, "one"}
    assert all(one["remedy"] for one in found if one["level"] in ("problem", "warning"))
    everybody = trolley("doctor", "--connect", endpoint, "--json", "--seconds", "1")
    assert {one["robot"] for one in json.loads(everybody.stdout)["findings"]} == {
        None,
        "one",
        "two",
    }


def test_doctor_misses_the_bridge_of_its_own_robot(
    add_robot: Callable, endpoint: str, trolley: Callable, tmp_path: Path
) -> None:
    add_robot("one")
    add_robot("two")
    path = tmp_path / "robot.toml"
    path.write_text(SETTINGS.format(endpoint) + '[mqtt]\nbroker = "broker.local"\n')
    for robot, is_missed in (("one", True), ("two", False)):
        words = ("--config", str(path), "--robot", robot, "--seconds", "1", "--json")
        problems = findings(trolley("doctor", *words).stdout, "problem")
        assert ("mqtt is not running, or hangs." in problems) == is_missed


def test_doctor_sees_two_services_of_one_name(
    add_robot: Callable, endpoint: str, trolley: Callable
) -> None:
    add_robot("one")
    with open_bus([endpoint], PATIENCE_S) as bus:
        bus.declare_token(topics.ALIVE.key("one", "base", "elsewhere-7-1700000000000"))
        done = trolley("doctor", "--connect", endpoint, "--json", "--seconds", "1")
    assert any("base runs 2 times" in one for one in findings(done.stdout, "problem"))


def test_what_strangers_say_harms_nobody(
    add_robot: Callable, endpoint: str, trolley: Callable
) -> None:
    add_robot("one")
    evil = "\x1b[2Jevil"
    with open_bus([endpoint], PATIENCE_S) as bus:
        bus.declare_token(topics.ALIVE.key("*", "*", "1"))
        bus.declare_token(topics.ALIVE.key("one", evil, "no run"))

        def shout() -> None:
            while not stop.wait(0.05):
                for topic in topics.TOPICS:
                    key = topic.key("one", *[evil] * topic.num_parts)
                    for payload in (b"", b"\xc1", b"{" * 5000, b"x" * 20_000):
                        bus.put(key, payload, "application/msgpack", topic.qos)

        stop = threading.Event()
        shouting = threading.Thread(target=shout)
        shouting.start()
        try:
            for words in (["doctor", "--seconds", "1"], ["top", "--once"], ["status", "--all"]):
                done = trolley(*words, "--connect", endpoint)
                assert done.returncode in (0, 1), done.stderr
                assert "\x1b" not in done.stdout
                assert "Traceback" not in done.stderr
                assert "*: " not in done.stdout  # a token's key with a wildcard is no robot
                assert "\n* " not in done.stdout
        finally:
            stop.set()
            shouting.join()


def test_status_of_all_robots(add_robot: Callable, endpoint: str, trolley: Callable) -> None:
    add_robot("one")
    add_robot("two")
    done = trolley("status", "--all", "--connect", endpoint)
    assert done.returncode == 1  # most of their services are missing
    lines = done.stdout.splitlines()
    assert lines[1:3] == ["one    Ready.", "two    Ready."]
    plain = json.loads(trolley("status", "--all", "--json", "--connect", endpoint).stdout)
    assert [one["name"] for one in plain] == ["one", "two"]


def test_top_measures_once_without_a_terminal(
    add_robot: Callable, endpoint: str, trolley: Callable
) -> None:
    add_robot("one")

    def is_ready() -> bool:
        done = trolley("top", "--connect", endpoint)
        assert done.returncode == 0, done.stderr
        assert "\x1b" not in done.stdout
        return "one: Ready." in done.stdout

    wait_until(is_ready, "its pose is fresh as the measurement ends")
    assert trolley("top", "--connect", endpoint, "--robot", "three").returncode == 3


def test_top_knows_of_a_paused_trip_that_nobody_repeats(
    add_robot: Callable, endpoint: str, trolley: Callable
) -> None:
    add_robot("one")
    trip = TourStatus(stamp_ns=1, name="round", trip="a", state="paused", stop=1)
    key = topics.TOUR.key("one")

    def tell(query: Query) -> None:
        query.reply(key, codec.encode(trip, "msgpack"), codec.MIME["msgpack"])
        query.finish()

    with open_bus([endpoint], PATIENCE_S) as bus:
        bus.serve(key, tell)
        for words in ((), ("--robot", "one")):
            plain = json.loads(trolley("top", "--json", "--connect", endpoint, *words).stdout)
            assert plain["robots"] == {"one": "On tour round, stop 2, paused."}
        echo = trolley("topic", "echo", "tour", "--once", "--timeout", "5", "--connect", endpoint)
        assert "paused" in echo.stdout


def test_top_tells_programs_what_it_measures(
    add_robot: Callable, endpoint: str, trolley: Callable
) -> None:
    add_robot("one")

    def measured() -> set[str]:
        plain = json.loads(trolley("top", "--once", "--json", "--connect", endpoint).stdout)
        assert plain["services"][0]["service"] == "base"
        return {one["topic"] for one in plain["topics"] if one["hz"] > 0.0}

    wait_until(lambda: "odom" in measured(), "base has its share of the processor meanwhile")


@pytest.fixture
def top(add_robot: Callable, endpoint: str, tmp_path: Path) -> Generator[Terminal]:
    """`trolley top` on a terminal of 60 columns, with a robot to watch."""
    add_robot("one")
    terminal = Terminal(
        command("top", "--connect", endpoint), {"TROLLEY_STATE": str(tmp_path)}, columns=60
    )
    yield terminal
    terminal.end()


def test_top_is_live_until_q(top: Terminal) -> None:
    top.wait_for("odom")
    before = len(top.output)
    wait_until(lambda: top.output[before:].count("\x1b[H") >= 2, "two more pictures")
    top.type("q")
    assert top.wait() == 0
    assert top.is_as_found
    assert top.output.endswith("\x1b[?1049l\x1b[?25h")


def test_top_counts_the_runs_of_a_service(top: Terminal, endpoint: str) -> None:
    top.wait_for("odom")
    with open_bus([endpoint], PATIENCE_S) as bus:
        for pid in (1, 2, 3):
            run = str(Run(time.time_ns() // 10**6, "pi", pid))
            token = bus.declare_token(topics.ALIVE.key("one", "tour", run))
            wait_until(lambda: _row(top, "tour")[:1] not in ([], ["gone"]), f"run {pid} is seen")
            token.close()
            wait_until(lambda: _row(top, "tour")[:1] == ["gone"], "tour is gone")
        # Three runs have been seen: it was started again twice, and is gone now.
        assert _row(top, "tour")[:2] == ["gone", "2"]
    top.type("\x03")
    assert top.wait() == 130
    assert top.is_as_found


def _row(top: Terminal, service: str) -> list[str]:
    """The cells of a service in the newest picture, those that hold nothing left out."""
    picture = top.output.rpartition("\x1b[H")[2]
    for line in picture.splitlines():
        plain = line.partition(f"{service} ")[2].partition("\x1b")[0]
        if line.lstrip("\x1b[0123456789m").startswith(service):
            return [word for word in plain.split() if word != "-"]
    return []
