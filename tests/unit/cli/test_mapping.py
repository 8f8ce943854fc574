"""`trolley map`: what a person is asked before a map is thrown away."""

import contextlib
from types import SimpleNamespace

import pytest
from click.testing import CliRunner
from msgspec.structs import replace

from trolley import codes
from trolley.cli import mapping
from trolley.messages import MappingStatus

IDLE = MappingStatus(stamp_ns=0, state="idle", message="The map home was discarded.")
MAKING = MappingStatus(stamp_ns=0, state="mapping", name="home")


def cancel(monkeypatch: pytest.MonkeyPatch, known: MappingStatus | None, typed: str) -> str:
    """Type something at `trolley map cancel` to a robot; returns the output."""
    robot = SimpleNamespace(ask=lambda _: IDLE, latest=lambda _: known)
    monkeypatch.setattr(mapping, "one_robot", lambda: contextlib.nullcontext(robot))
    return CliRunner().invoke(mapping.cancel_map, input=typed).output


def test_a_map_that_is_being_made_is_named_before_it_is_discarded(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    assert "Discard the map home?" in cancel(monkeypatch, MAKING, "y\n")
    assert "was discarded" in cancel(monkeypatch, MAKING, "y\n")
    assert "was discarded" not in cancel(monkeypatch, MAKING, "n\n")


def test_what_a_saved_map_still_waits_with_is_said_before_it_is_discarded(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    saving = replace(MAKING, state="saving")
    assert "Discard the zones that are not saved yet?" in cancel(monkeypatch, saving, "n\n")


def test_nobody_is_asked_about_a_map_that_is_not_being_made(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    output = cancel(monkeypatch, IDLE, "y\n")
    assert "?" not in output
    assert "was discarded" not in output
    assert codes.SENTENCES[codes.NOT_MAPPING] in output


@pytest.mark.parametrize(
    "doing", ["The map is being saved.", "The map home is saved; the localizer takes over."]
)
def test_a_save_that_takes_long_says_whether_the_map_is_written(
    monkeypatch: pytest.MonkeyPatch, doing: str
) -> None:
    saving = replace(MAKING, state="saving", message=doing)
    robot = SimpleNamespace(ask=lambda *_: saving, latest=lambda _: saving)
    monkeypatch.setattr(mapping, "one_robot", lambda: contextlib.nullcontext(robot))
    monkeypatch.setattr(mapping, "SAVE_TIMEOUT_S", 0.0)
    output = CliRunner().invoke(mapping.save_map).output
    assert doing in output
    assert "still saving" not in output


def test_who_extends_a_map_is_told_what_its_mapper_says(monkeypatch: pytest.MonkeyPatch) -> None:
    extending = replace(MAKING, extends="home", message="Save it under another name.")
    robot = SimpleNamespace(ask=lambda *_: extending, latest=lambda _: extending)
    monkeypatch.setattr(mapping, "one_robot", lambda: contextlib.nullcontext(robot))
    output = CliRunner().invoke(mapping.extend_map, ["home"]).output
    assert output.endswith("run `trolley map save`. Save it under another name.\n")


@pytest.mark.parametrize(
    ("loose", "said"), [(1, ", 1 scan that hangs loose"), (2, ", 2 scans that hang loose")]
)
def test_the_status_counts_what_hangs_loose(loose: int, said: str) -> None:
    assert said in mapping.status_text(replace(MAKING, loose=loose))


@pytest.mark.parametrize(("scans", "said"), [(1, ", 1 scan"), (2, ", 2 scans")])
def test_the_status_counts_the_scans(scans: int, said: str) -> None:
    assert mapping.status_text(replace(MAKING, scans=scans)).endswith(said)


def test_a_map_of_which_nothing_is_heard_is_not_named(monkeypatch: pytest.MonkeyPatch) -> None:
    assert "Discard the map that is being made?" in cancel(monkeypatch, None, "n\n")
