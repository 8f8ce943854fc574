"""What `trolley topic` says."""

import contextlib
from types import SimpleNamespace

import pytest
from click.testing import CliRunner

from trolley.cli import topic


@pytest.mark.parametrize(
    ("endpoint", "is_told"), [("tls/home.local:7448", True), ("tcp/127.0.0.1:7447", False)]
)
def test_who_comes_from_afar_is_told_that_nobody_confirms_what_is_published(
    monkeypatch: pytest.MonkeyPatch, endpoint: str, is_told: bool
) -> None:
    robot = SimpleNamespace(
        name="one",
        now_ns=lambda: 5,
        publish=lambda *_: None,
        connection=SimpleNamespace(endpoints=[endpoint]),
    )
    monkeypatch.setattr(topic, "one_robot", lambda: contextlib.nullcontext(robot))
    message = '{"twist": {"vx": 0, "vy": 0, "wz": 0}, "valid_for": 0.3}'
    done = CliRunner().invoke(topic.topic_command, ["pub", "cmd_vel/teleop", message])
    assert done.output.startswith("sent 1 message on cmd_vel/teleop")
    assert ("Nobody confirms what is published" in done.output) == is_told
