"""The real `trolley` command against a scripted robot over real Zenoh."""

import json
import math
import os
import signal
import socket
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path

import pytest
from support.waiting import PATIENCE_S, wait_until

from trolley import topics
from trolley.messages import GoalStatus
from trolley.runtime import codec
from trolley.runtime.zenoh_bus import open_bus
from trolley.topics import Qos

DRIVES_ON = (GoalStatus(stamp_ns=0, id=None, state="driving"),) * 300


def test_pose_without_the_tour_service_is_the_localizers(
    add_robot: Callable, endpoint: str, trolley: Callable
) -> None:
    add_robot("one")
    done = trolley("pose", "--json", "--connect", endpoint)
    assert done.returncode == 0, done.stderr
    assert json.loads(done.stdout)["pose"] == {"x": 1.0, "y": 2.0, "yaw": 0.5}
    assert "localized" in trolley("--connect", endpoint, "pose").stdout


def test_several_robots_are_listed_with_exit_code_2(
    add_robot: Callable, endpoint: str, trolley: Callable
) -> None:
    add_robot("one")
    add_robot("two")
    done = trolley("pose", "--connect", endpoint)
    assert done.returncode == 2
    assert done.stderr.split()[-2:] == ["one", "two"]
    assert trolley("pose", "--connect", endpoint, "--robot", "two").returncode == 0
    everybody = trolley("stop", "--all", "--connect", endpoint)
    assert everybody.returncode == 0
    assert everybody.stdout.split() == ["one:", "stopped", "two:", "stopped"]


def test_a_goal_that_stays_paused_after_a_resume_is_told(
    add_robot: Callable, endpoint: str, trolley: Callable
) -> None:
    scripted = add_robot("one")
    assert trolley("resume", "--connect", endpoint).stdout == "Resumed; it can drive again.\n"
    scripted.current = GoalStatus(stamp_ns=0, id="a", state="paused", reason="stopped")
    told = "Its goal is still paused: `trolley ask goal/resume` continues it, `trolley cancel` ends"
    assert told in trolley("resume", "--connect", endpoint).stdout
    assert "Stopped" not in trolley("status", "--connect", endpoint).stdout


def test_where_it_was_found_is_said_with_what_is_the_matter(
    add_robot: Callable, endpoint: str, trolley: Callable
) -> None:
    add_robot("one")
    done = trolley("pose", "find", "--connect", endpoint)
    assert done.stdout.startswith("localized at "), done.stderr
    assert done.stdout.endswith(": checking\n")


def test_nobody_there_is_exit_code_3(endpoint: str, trolley: Callable) -> None:
    for arguments in (["status"], ["go", "kitchen"], ["stop"], ["--robot", "one", "stop"]):
        done = trolley(*arguments, "--connect", endpoint)
        assert (done.returncode, done.stdout) == (3, ""), arguments
        assert done.stderr.count("\n") == 1
    assert "NOT STOPPED" in trolley("--robot", "one", "stop", "--connect", endpoint).stderr
    assert trolley("pose", "--connect", "tcp/127.0.0.1:1").returncode == 3


OF_A_MISTYPED_NAME = [
    "zones --robot ones",
    "status --robot ones",
    "top --once --robot ones",
    "topic hz scan --seconds 0.2 --robot ones",
    "topic echo scan --timeout 0.2 --robot ones",
]


def test_a_list_of_what_nobody_keeps_says_who_is_missing(
    add_robot: Callable, endpoint: str, trolley: Callable
) -> None:
    add_robot("one")
    for arguments, sentence in (
        (["map", "status", "--robot", "one"], "The service mapper is not running. (not_ready)"),
        *((words.split(), "no robot called ones is at") for words in OF_A_MISTYPED_NAME),
    ):
        done = trolley(*arguments, "--connect", endpoint)
        assert (done.returncode, done.stdout) == (3, ""), done.stderr
        assert done.stderr.startswith(sentence), arguments


def test_go_follows_until_it_arrives(add_robot: Callable, endpoint: str, trolley: Callable) -> None:
    scripted = add_robot("one", DRIVES_ON)
    command = [sys.executable, "-m", "trolley.cli", "go", "-1.5", "-2", "90", "--deg"]
    going = subprocess.Popen(
        [*command, "--connect", endpoint], stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True
    )
    assert going.stderr is not None
    while "driving" not in (line := going.stderr.readline()):
        assert line, "it ended before it had said that the robot drives"
    scripted.arrive()
    said, errors = going.communicate(timeout=PATIENCE_S)
    assert going.returncode == 0, errors
    assert said.startswith("arrived")
    pose = scripted.sent[0].pose
    assert (pose.x, pose.y, round(pose.yaw, 4)) == (-1.5, -2.0, 1.5708)


def test_go_that_fails_is_exit_code_1_with_the_reason(
    add_robot: Callable, endpoint: str, trolley: Callable
) -> None:
    add_robot("one", (GoalStatus(stamp_ns=0, id=None, state="failed", reason="no_path"),))
    done = trolley("go", "kitchen", "--connect", endpoint)
    assert done.returncode == 1
    assert "no_path" in done.stdout
    refused = trolley("go", "nowhere", "--json", "--connect", endpoint)
    assert refused.returncode == 1
    assert json.loads(refused.stderr)["code"] == "unknown_name"


def test_ctrl_c_cancels_the_goal(add_robot: Callable, endpoint: str) -> None:
    scripted = add_robot("one", DRIVES_ON)
    command = [sys.executable, "-m", "trolley.cli", "go", "kitchen", "--connect", endpoint]
    going = subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)
    assert going.stderr is not None
    assert going.stderr.readline()  # it has heard of its goal, and follows it
    going.send_signal(signal.SIGINT)
    _, errors = going.communicate(timeout=PATIENCE_S)
    assert going.returncode == 130, errors
    assert scripted.canceled == [scripted.sent[0].id]


def test_go_without_waiting_returns_at_once(
    add_robot: Callable, endpoint: str, trolley: Callable
) -> None:
    scripted = add_robot("one", DRIVES_ON)
    done = trolley("go", "kitchen", "--no-wait", "--json", "--connect", endpoint)
    assert done.returncode == 0
    assert json.loads(done.stdout)["id"] == scripted.sent[0].id
    assert trolley("cancel", "--connect", endpoint).returncode == 0
    assert scripted.canceled == [None]


def test_the_configuration_file_names_robot_and_router(
    add_robot: Callable, endpoint: str, trolley: Callable, tmp_path: Path
) -> None:
    add_robot("one")
    add_robot("two")
    path = tmp_path / "robot.toml"
    path.write_text(
        f'[robot]\nname = "two"\nfootprint = {{ radius_m = 0.2 }}\n'
        f'[zenoh]\nconnect = ["{endpoint}"]\n'
    )
    done = trolley("status", "--json", "--config", str(path))
    assert json.loads(done.stdout)["name"] == "two"
    path.write_text('[robot]\nname = "two"\nspeed = 3\n')
    done = trolley("status", "--config", str(path))
    assert done.returncode == 2
    assert "speed" in done.stderr


def test_status_names_what_is_missing(
    add_robot: Callable, endpoint: str, trolley: Callable
) -> None:
    add_robot("one")
    done = trolley("status", "--connect", endpoint)
    assert done.returncode == 1
    assert "planner is not running" in done.stdout
    assert "localized" in done.stdout


def test_tf_gives_distance_bearing_and_age(
    add_robot: Callable, endpoint: str, trolley: Callable
) -> None:
    add_robot("one")
    done = trolley("tf", "/map", "laser", "--json", "--connect", endpoint)
    assert done.returncode == 0, done.stderr
    found = json.loads(done.stdout)
    assert found["translation"][2] == pytest.approx(0.2)
    expected_m = math.hypot(1.0 + 0.1 * math.cos(0.5), 2.0 + 0.1 * math.sin(0.5))
    assert found["distance"] == pytest.approx(expected_m)
    assert found["age"] >= 0.0
    missing = trolley("tf", "map", "gripper", "--connect", endpoint)
    assert missing.returncode == 1
    assert "tf/gripper" in missing.stderr


def test_topics_are_listed_echoed_and_measured(
    add_robot: Callable, endpoint: str, trolley: Callable
) -> None:
    add_robot("one")
    rows: dict[str, dict] = {}

    def is_heard() -> bool:
        listed = trolley("topic", "list", "--seconds", "0.5", "--json", "--connect", endpoint)
        rows.update({row["topic"]: row for row in json.loads(listed.stdout)})
        return {"odom", "tf/laser"} <= rows.keys() and rows["odom"]["hz"] > 0.0

    wait_until(is_heard, "odom is heard while it listens")
    assert rows["tf/laser"]["hz"] == 0.0
    echoed = trolley("topic", "echo", "odom", "-n", "2", "--json", "--connect", endpoint)
    assert [json.loads(line)["pose"]["x"] for line in echoed.stdout.splitlines()] == [1.0, 1.0]
    hz = ("topic", "hz", "odom", "--seconds", "1", "--json", "--connect", endpoint)
    wait_until(lambda: json.loads(trolley(*hz).stdout)["hz"], "two messages come in a second")
    silent = trolley("topic", "echo", "scan", "--timeout", "0.3", "--connect", endpoint)
    assert silent.returncode == 1
    assert trolley("topic", "echo", "nonsense", "--connect", endpoint).returncode == 2


def test_broken_messages_do_not_break_an_echo(
    add_robot: Callable, endpoint: str, trolley: Callable
) -> None:
    add_robot("one")
    with open_bus([endpoint], PATIENCE_S) as bus:
        for payload in (b"\xc1", b"{", b"\x80", b""):
            bus.put(topics.ODOM.key("one"), payload, codec.MIME["msgpack"], Qos.SENSOR)
    echoed = trolley("topic", "echo", "odom", "-n", "2", "--connect", endpoint)
    assert echoed.returncode == 0


def test_running_needs_a_configuration(trolley: Callable, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delenv("TROLLEY_CONFIG", raising=False)
    for arguments in (["up"], ["run", "base"]):
        done = trolley(*arguments)
        assert done.returncode == 2
        assert "trolley init" in done.stderr


def test_a_broker_that_is_none_is_refused(trolley: Callable) -> None:
    done = trolley("up", "--mqtt", "mqtt://home")
    assert done.returncode == 2
    assert "'mqtt://home' is not a broker" in done.stderr


def test_a_port_of_the_viewer_that_is_taken_is_said_with_who_has_it(
    trolley: Callable, tmp_path: Path
) -> None:
    with socket.create_server(("127.0.0.1", 0)) as taken:
        port = taken.getsockname()[1]
        path = tmp_path / "robot.toml"
        size = "{ length_m = 0.3, width_m = 0.3 }"
        path.write_text(f'[robot]\nname = "a"\nfootprint = {size}\n[viz]\nport = {port}\n')
        done = trolley("up", "--no-router", "--config", str(path))
    assert done.returncode == 2
    assert f"port {port} is taken by " in done.stderr
    assert f"(pid {os.getpid()}); change `[viz] port`" in done.stderr


def test_a_service_to_leave_out_that_is_none_is_refused(trolley: Callable) -> None:
    done = trolley("up", "--without", "bass")
    assert done.returncode == 2
    assert "'bass' is not installed; installed are: base, localizer" in done.stderr


def test_the_router_runs_until_it_is_told_to_stop(port: int, trolley: Callable) -> None:
    endpoint = f"tcp/127.0.0.1:{port}"
    command = [sys.executable, "-m", "trolley.cli", "router", "--listen", endpoint]
    router = subprocess.Popen(command, stderr=subprocess.PIPE, text=True, env={**os.environ})
    try:
        with open_bus([endpoint], PATIENCE_S):
            pass
        again = trolley("router", "--listen", endpoint)
        assert again.returncode == 2
        assert f"port {port} is taken" in again.stderr
        assert str(router.pid) in again.stderr
    finally:
        router.terminate()
        assert router.wait(PATIENCE_S) == 0
        assert router.stderr is not None
        router.stderr.close()
