"""`trolley keys`: what it makes, and what it tells a person to do."""

import json
from datetime import UTC, datetime
from pathlib import Path

import pytest
from click.testing import CliRunner, Result

from trolley.cli import cli, keys


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    return tmp_path / "keys"


def run(folder: Path, *words: str) -> Result:
    return CliRunner().invoke(cli, ["keys", "--folder", str(folder), *words])


def hosts(folder: Path) -> list[str]:
    """Where others reach the last one of the list."""
    return json.loads(run(folder, "list", "--json").output)[-1]["hosts"]


def test_a_house_from_nothing(folder: Path) -> None:
    assert run(folder, "init").exit_code == 0
    assert run(folder, "router", "home.local", "192.168.1.5").exit_code == 0
    made = run(folder, "robot", "kiwi")
    assert made.exit_code == 0
    assert str(folder / "robot-kiwi") in made.output
    assert '[zenoh]\n  uplink = ["tls/home.local:7448"]' in made.output
    assert str(folder / "router-home" / "allowed.pem") in made.output
    run(folder, "operator", "anna")
    run(folder, "viewer", "tablet")
    lines = run(folder, "list").output.splitlines()
    assert [line.split()[:2] for line in lines] == [
        ["ca", "trolley"],
        ["operator", "anna"],
        ["robot", "kiwi"],
        ["router", "home"],
        ["viewer", "tablet"],
    ]
    plain = json.loads(run(folder, "list", "--json").output)
    assert [[one["role"], one["name"]] for one in plain] == [line.split()[:2] for line in lines]
    assert plain[3]["hosts"] == ["home.local", "192.168.1.5"]
    assert plain[2]["until"][:10] in lines[2]


def test_nothing_is_overwritten_by_accident(folder: Path) -> None:
    run(folder, "init")
    again = run(folder, "init")
    assert again.exit_code == 2
    assert "already" in again.output
    run(folder, "robot", "kiwi")
    before = (folder / "robot-kiwi" / "key.pem").read_bytes()
    refused = run(folder, "robot", "kiwi")
    assert refused.exit_code == 2
    assert "--replace" in refused.output
    assert (folder / "robot-kiwi" / "key.pem").read_bytes() == before
    assert run(folder, "robot", "kiwi", "--replace").exit_code == 0
    assert (folder / "robot-kiwi" / "key.pem").read_bytes() != before


def test_a_router_that_is_replaced_is_reached_as_before(folder: Path) -> None:
    """The new certificate was for this computer's name: no host of the house could link."""
    run(folder, "init")
    run(folder, "router", "home.local", "192.168.1.5", "--name", "attic")
    assert run(folder, "router", "--name", "attic", "--replace").exit_code == 0
    assert hosts(folder) == ["home.local", "192.168.1.5"]
    run(folder, "router", "attic.local", "--name", "attic", "--replace")
    assert hosts(folder) == ["attic.local"]


def test_the_order_does_not_matter_but_is_told(folder: Path) -> None:
    missing = run(folder, "robot", "kiwi")
    assert missing.exit_code == 2
    assert "trolley keys init" in missing.output
    run(folder, "init")
    assert "trolley keys router" in run(folder, "robot", "kiwi").output
    run(folder, "router", "home.local")
    assert b"BEGIN CERTIFICATE" in (folder / "router-home" / "allowed.pem").read_bytes()


def test_says_what_must_be_renewed(folder: Path) -> None:
    run(folder, "init")
    run(folder, "viewer", "tablet", "--days", "30")
    output = run(folder, "list").output
    assert "renew it: 30 days left" in output
    assert "renew" not in run(folder, "list", str(folder)).output


def test_a_lost_host_is_removed(folder: Path) -> None:
    run(folder, "init")
    run(folder, "router", "home.local")
    run(folder, "operator", "anna")
    removed = run(folder, "remove", "operator", "anna")
    assert "allowed.pem" in removed.output
    assert "anna" not in run(folder, "list").output
    assert run(folder, "remove", "operator", "anna").exit_code == 2


@pytest.mark.parametrize("words", [("robot", "Kiwi"), ("robot", "../x"), ("router", "a b")])
def test_bad_names_are_refused(folder: Path, words: tuple[str, ...]) -> None:
    run(folder, "init")
    before = sorted(folder.iterdir())
    assert run(folder, *words).exit_code == 2
    assert sorted(folder.iterdir()) == before


def test_a_computer_that_does_not_know_the_year_makes_no_keys(
    folder: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """They would have expired before its clock was set."""
    began = datetime(2000, 1, 1, tzinfo=UTC)
    with monkeypatch.context() as context:
        context.setattr(keys, "_now", lambda: began)
        refused = run(folder, "init")
    assert refused.exit_code == 2
    assert "clock of this computer says that it is 2000-01-01" in refused.output
    assert not folder.exists()
    run(folder, "init")
    monkeypatch.setattr(keys, "_now", lambda: began)
    assert run(folder, "router").exit_code == 2
    assert not (folder / "router-home").exists()


def test_an_authority_that_expired_signs_nothing(
    folder: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    run(folder, "init")
    monkeypatch.setattr(keys, "_now", lambda: datetime(2060, 1, 1, tzinfo=UTC))
    refused = run(folder, "robot", "kiwi")
    assert refused.exit_code == 2
    assert "here it is 2060-01-01" in refused.output
    assert not (folder / "robot-kiwi").exists()
