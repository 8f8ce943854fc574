"""Which robot is meant, where it is looked for, and signals that close what waits for it."""

import os
import sys
import threading
from collections.abc import Callable
from pathlib import Path
from types import FrameType
from typing import Any

import pytest
from support.waiting import PATIENCE_S

from trolley import Robot, RobotUnreachable, connection, requests, topics
from trolley.codes import Refused
from trolley.config import ConfigError
from trolley.connection import DEFAULT_ENDPOINT, Connection, Subscription, Target, find_target
from trolley.messages import Clock
from trolley.messages.request_params import SendGoal
from trolley.runtime import codec
from trolley.runtime.bus import Reply, Sample


@pytest.fixture(autouse=True)
def no_configuration(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delenv("TROLLEY_CONFIG", raising=False)
    monkeypatch.setattr("trolley.config.load.DEFAULT_PATH", Path("/nonexistent/robot.toml"))


@pytest.fixture
def config(tmp_path: Path) -> Path:
    path = tmp_path / "robot.toml"
    path.write_text(
        '[robot]\nname = "filed"\nfootprint = { radius_m = 0.2 }\n'
        '[zenoh]\nconnect = ["tcp/127.0.0.1:7001"]\n'
    )
    return path


def test_without_anything_it_is_the_single_robot_at_the_default_router() -> None:
    assert find_target() == Target(None, (DEFAULT_ENDPOINT,))


def test_the_file_gives_what_was_not_given(config: Path) -> None:
    assert find_target(config=config) == Target("filed", ("tcp/127.0.0.1:7001",))
    assert find_target("other", config=config) == Target("other", ("tcp/127.0.0.1:7001",))
    assert find_target(connect=["tcp/b:1"], config=config) == Target("filed", ("tcp/b:1",))


def test_a_router_named_by_hand_may_be_another_robot_s(
    config: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("TROLLEY_CONFIG", str(config))
    assert find_target() == Target("filed", ("tcp/127.0.0.1:7001",))
    assert find_target(connect=["tcp/b:1"]) == Target(None, ("tcp/b:1",), preferred="filed")


def test_a_file_that_is_not_there_is_an_error_unless_it_is_not_needed(tmp_path: Path) -> None:
    with pytest.raises(ConfigError, match="nowhere"):
        find_target(config=tmp_path / "nowhere.toml")
    missing = tmp_path / "nowhere.toml"
    assert find_target("a", ["tcp/b:1"], missing) == Target("a", ("tcp/b:1",))


def test_keys_are_looked_for_where_an_endpoint_needs_them(config: Path) -> None:
    with pytest.raises(ConfigError, match=str(config.parent / "keys")):
        find_target(connect=["tls/home.local:7448"], config=config)
    # Those in /etc/trolley/keys were taken where the robot was named, too.
    with pytest.raises(ConfigError, match=str(config.parent / "keys")):
        find_target("kiwi", ["tls/home.local:7448"], config)


def test_a_name_in_another_encoding_is_refused_before_anybody_is_asked() -> None:
    latin1 = os.fsdecode(b"K\xfcche")  # as an argument of a command arrives
    with pytest.raises(Refused, match=r"goal/send: 'K\\udcfcche' is not UTF-8 text"):
        Connection([DEFAULT_ENDPOINT]).ask("one", requests.GOAL_SEND, SendGoal(name=latin1))


def test_a_message_to_many_keys_at_once_is_none() -> None:
    subscription = Subscription(topics.CLOCK)
    payload = codec.encode(Clock(stamp_ns=1, rate=1.0, epoch=0), "msgpack")
    for key in ("trolley/*/clock", "trolley/kiwi/clock"):
        subscription.add_latest(Reply(key, payload, codec.MIME["msgpack"]))
    first = subscription.next(0.0)
    assert first is not None
    assert first.robot == "kiwi"
    assert subscription.next(0.0) is None


def interrupted(call: Callable[[], object], line: int, handler: Callable[[], object]) -> bool:
    """Run a call that a signal's handler interrupts before a line; whether it has so many."""
    num_lines = 0

    def trace(_frame: FrameType, event: str, _: Any) -> Any:
        nonlocal num_lines
        num_lines += event == "line"
        if event == "line" and num_lines == line:
            sys.settrace(None)
            handler()
        return trace

    def run() -> None:
        sys.settrace(trace)
        try:
            call()
        except RobotUnreachable:
            pass
        finally:
            sys.settrace(None)

    running = threading.Thread(target=run, daemon=True)
    running.start()
    running.join(PATIENCE_S)
    assert not running.is_alive(), f"it hangs where it is interrupted before line {line}"
    return num_lines >= line


def waits_for_a_message() -> tuple[Callable[[], object], Callable[[], object]]:
    subscription = Subscription(topics.CLOCK)
    return subscription.next, subscription.close


def waits_for_a_service() -> tuple[Callable[[], object], Callable[[], object]]:
    robot = Robot.over(Connection([]), "one")
    return lambda: robot._pause(0.01), robot.close


@pytest.mark.parametrize("begin", [waits_for_a_message, waits_for_a_service])
def test_a_signal_may_close_it_before_any_line_of_what_waits(
    monkeypatch: pytest.MonkeyPatch, begin: Callable
) -> None:
    """Where it had just looked, or held the lock, it waited for ever."""
    monkeypatch.setattr(connection, "SLICE_S", 0.01)
    for line in range(1, 60):
        call, close = begin()
        if not interrupted(call, line, close):
            break
        close()  # what ended before


def test_a_signal_may_close_it_while_a_message_waits_for_what_it_interrupts() -> None:
    """The session then waited 5 s for the thread that took the message in."""
    subscription = Subscription(topics.CLOCK)
    payload = codec.encode(Clock(stamp_ns=1, rate=1.0, epoch=0), "msgpack")
    sample = Sample(topics.CLOCK.key("kiwi"), payload, codec.MIME["msgpack"])
    with subscription._condition:  # as `next`
        taking = threading.Thread(target=subscription._take, args=(sample,), daemon=True)
        taking.start()
        subscription.close()
        taking.join(PATIENCE_S)
        assert not taking.is_alive()
