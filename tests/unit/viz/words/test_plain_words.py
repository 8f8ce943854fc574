"""What services say, in the words of the page: no commands, keys or codes are left of it."""

import ast
import re
from collections.abc import Iterator
from pathlib import Path

import pytest

import trolley_viz
from trolley import codes
from trolley.codes import Refused
from trolley.messages import BaseState, StopResult
from trolley_viz.words.plain_words import plain, said
from trolley_viz.words.sentences import base_line, refusal, result_line

SERVICES = Path(__file__).parents[4] / "services"
TALKERS = ("base", "localizer", "mapper", "planner", "tour")
ASIDE = ("calibration", "commands", "detection", "emulators", "importers")
"""What speaks in a terminal only."""


def spoken(path: Path) -> Iterator[str]:
    """The texts of a module that are no docstrings, with _ for what is filled in."""
    tree = ast.parse(path.read_text())
    aside: set[int] = set()
    for node in ast.walk(tree):
        if isinstance(node, ast.Expr):
            aside.add(id(node.value))
        elif isinstance(node, ast.JoinedStr):
            aside |= {id(part) for part in node.values}
            parts = [one.value if isinstance(one, ast.Constant) else "_" for one in node.values]
            yield "".join(map(str, parts))
    for node in ast.walk(tree):
        if isinstance(node, ast.Constant) and id(node) not in aside and isinstance(node.value, str):
            yield node.value


def test_nothing_that_services_say_is_left_in_backticks_or_speaks_of_resuming() -> None:
    said_by_services = {
        text
        for service in TALKERS
        for path in sorted((SERVICES / service).rglob("*.py"))
        if not set(ASIDE) & set(path.parts)
        for text in spoken(path)
        if " " in text
    }
    assert any("`trolley resume`" in text for text in said_by_services)
    assert any("; resume the goal" in text for text in said_by_services)
    # `trolley detect` and the like are for who can reach a terminal: they stay, in quotes.
    plainly = {text: plain(text) for text in said_by_services}
    assert [text for text, shown in plainly.items() if "`" in shown or "; resume" in shown] == []
    commands = {
        found for shown in plainly.values() for found in re.findall("“trolley [^”]*", shown)
    }
    assert commands == {"“trolley detect"}


@pytest.mark.parametrize("code", codes.SENTENCES)
def test_every_code_is_said_without_words_of_programs(code: str) -> None:
    text = said("", code)
    assert not [word for word in ("`", "resume", "_", "frame", "keep-out") if word in text]


@pytest.mark.parametrize(
    ("text", "shown"),
    [
        ("goal/send: planner did not answer in time.", "Planner did not answer in time."),
        ("map/new: `name`: a map's name has 1 to 64.", "A map's name has 1 to 64."),
        ("Stopped. `trolley resume` lets it drive.", "Stopped. “Drive on” lets it drive."),
        (
            "That name is taken; use `replace` to overwrite it.",  # release 0.2.0
            "That name is taken; choose another one.",
        ),
        ("unknown key `colour`", "unknown key “colour”"),
        ("An odd ` stays", "An odd ` stays"),
        ("", ""),
    ],
)
def test_words_of_programs_become_words_of_the_page(text: str, shown: str) -> None:
    assert plain(text) == shown


def test_a_name_that_is_taken_is_said_without_options_of_commands() -> None:
    assert "--" not in codes.SENTENCES[codes.EXISTS]
    assert said("", codes.EXISTS) == "That name is taken; choose another one."


def test_a_code_of_a_newer_program_is_shown_as_words() -> None:
    assert said("", "wheel_fell_off") == "wheel fell off"
    result = StopResult(stop=0, state="failed", seconds=1.0, code="wheel_fell_off")
    assert result_line(result).detail == "wheel fell off"
    assert refusal(Refused("wheel_fell_off", "")) == "wheel fell off"
    assert refusal(Refused("internal", "map/edit: no `mapper` here")) == "No “mapper” here"


def test_a_stop_says_once_what_lets_it_drive() -> None:
    base = BaseState(
        stamp_ns=0,
        mode="stopped",
        reason="button",
        message="Stopped. `trolley resume` lets it drive.",
    )
    line = base_line(base)
    assert line is not None
    assert line.detail == "“Drive on” lets it drive."


def test_all_that_services_say_is_said_by_one_module() -> None:
    """Where a message or code is shown, it went through `said`."""
    folder = Path(trolley_viz.__file__).parent
    users = {
        str(path.relative_to(folder))
        for path in folder.rglob("*.py")
        if "SENTENCES.get(" in path.read_text() or ".message or " in path.read_text()
    }
    assert users == {"words/plain_words.py"}
