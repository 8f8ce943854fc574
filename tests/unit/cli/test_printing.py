"""What commands print moves no terminal, and fits what the terminal can show."""

import io
import json
import subprocess
import sys
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path

import click
import pytest

from trolley.cli import exits, show
from trolley.cli.printing import say, say_block, say_over, show_error
from trolley.messages import GoalStatus

NAMES = ("\x1b]0;owned\x07lime", "\x9b2Jlime", "lime\u202e", "K\u00fcche \u66f8\u658e")


class Terminal(io.TextIOWrapper):
    """Takes what its encoding has, as strictly as PYTHONIOENCODING asks for."""

    def __init__(self, encoding: str) -> None:
        super().__init__(io.BytesIO(), encoding=encoding, errors="strict", write_through=True)

    @property
    def shown(self) -> str:
        buffer = self.buffer
        assert isinstance(buffer, io.BytesIO)
        return buffer.getvalue().decode(self.encoding)


@pytest.fixture(params=["utf-8", "latin-1", "ascii"])
def take_terminal(
    request: pytest.FixtureRequest, monkeypatch: pytest.MonkeyPatch
) -> Callable[[], Terminal]:
    def take() -> Terminal:
        """Put it in place; pytest takes its own away only when a test has begun."""
        terminal = Terminal(request.param)
        monkeypatch.setattr(sys, "stdout", terminal)
        monkeypatch.setattr(sys, "stderr", terminal)
        return terminal

    return take


@pytest.mark.parametrize("name", NAMES)
def test_a_name_from_outside_moves_no_terminal(take_terminal: Callable[[], Terminal], name: str):
    terminal = take_terminal()
    say(f"{name}: stopped", fg="red")
    say(name, err=True)
    show.print_table(("ROBOT", "NOW"), [(name, "drives"), ("a", name)])
    show_error(click.UsageError(f"there is no {name}"))
    shown = terminal.shown
    assert shown.replace("\n", "").isprintable()
    assert "lime" in shown or "K" in shown


def test_an_output_without_room_ends_the_command_with_a_sentence(
    capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    with Path("/dev/full").open("w", buffering=1) as full:
        monkeypatch.setattr(sys, "stdout", full)
        with pytest.raises(SystemExit, match=str(exits.FAILED)):
            say("all of it")
        monkeypatch.undo()
        with suppress(OSError):  # what it still holds has no room either
            full.close()
    assert capsys.readouterr().err == "The output cannot be written: No space left on device.\n"


@pytest.mark.programs
def test_a_command_runs_where_its_streams_are_closed(tmp_path: Path) -> None:
    words = [sys.executable, "-m", "trolley.cli", "init", str(tmp_path / "robot.toml")]
    done = subprocess.run(["sh", "-c", 'exec "$@" <&- >&- 2>&-', "sh", *words], check=False)
    assert done.returncode == 0
    assert (tmp_path / "robot.toml").read_text().startswith("#")


def test_a_text_from_outside_begins_no_line_of_its_own(take_terminal: Callable[[], Terminal]):
    terminal = take_terminal()
    status = GoalStatus(stamp_ns=0, id=None, state="idle", message="on\nkiwi: stopped")
    say(f"lime: {status.message}", err=True)
    say_block(show.describe(status))
    assert "kiwi: stopped" in terminal.shown
    assert not any(line.startswith("kiwi") for line in terminal.shown.splitlines())


def test_a_block_has_the_lines_it_was_given(take_terminal: Callable[[], Terminal]):
    terminal = take_terminal()
    say_block("\na\n\nb\x1b[A\n", nl=False)
    say_block("c\nd")
    assert terminal.shown == "\na\n\nb\\x1b[A\nc\nd\n"


def test_a_line_that_is_written_over_stays_one_line(take_terminal: Callable[[], Terminal]):
    terminal = take_terminal()
    say_over("driving to\nlime\x1b[A")
    assert terminal.shown == "\rdriving to\\nlime\\x1b[A"


@pytest.mark.parametrize("name", NAMES)
def test_json_is_the_same_text_for_a_program(take_terminal: Callable[[], Terminal], name: str):
    terminal = take_terminal()
    show.print_json({"name": name, name: [1]})
    shown = terminal.shown
    assert shown.replace("\n", "").isprintable()
    assert json.loads(shown) == {"name": name, name: [1]}
