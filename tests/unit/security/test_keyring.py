"""The folder with a family's keys: what is made, what is let in, and nothing lost by accident."""

import stat
from datetime import UTC, datetime, timedelta
from pathlib import Path

import pytest

from trolley.security.access import security_of
from trolley.security.certificates import Certificate, parse_certificates, read_certificates
from trolley.security.host_keys import (
    HostKeys,
    KeysError,
    find_keys,
    keys_for,
)
from trolley.security.keyring import Keyring

NOW = datetime(2026, 11, 21, tzinfo=UTC)
UNTIL = NOW + timedelta(days=1000)


@pytest.fixture
def keyring(tmp_path: Path) -> Keyring:
    ring = Keyring(tmp_path / "ring")
    ring.create(NOW)
    return ring


def allowed(keys: HostKeys) -> list[Certificate]:
    return parse_certificates(keys.allowed.read_bytes(), keys.allowed)


def test_the_authority_is_made_once(keyring: Keyring) -> None:
    before = (keyring.folder / "ca.key").read_bytes()
    with pytest.raises(KeysError, match="already"):
        keyring.create(NOW)
    assert (keyring.folder / "ca.key").read_bytes() == before


def test_needs_an_authority_first(tmp_path: Path) -> None:
    with pytest.raises(KeysError, match="trolley keys init"):
        Keyring(tmp_path).issue("robot", "kiwi", UNTIL, replace=False)
    assert list(tmp_path.iterdir()) == []


def test_private_keys_are_for_their_owner_only(keyring: Keyring) -> None:
    keys = keyring.issue("robot", "kiwi", UNTIL, replace=False)
    for secret in (keys.key, keyring.folder / "ca.key"):
        assert stat.S_IMODE(secret.stat().st_mode) == 0o600
    assert stat.S_IMODE(keys.folder.stat().st_mode) == 0o700


def test_keys_stay_unless_they_are_to_be_replaced(keyring: Keyring) -> None:
    keys = keyring.issue("robot", "kiwi", UNTIL, replace=False)
    before = keys.certificate.read_bytes()
    with pytest.raises(KeysError, match="--replace"):
        keyring.issue("robot", "kiwi", UNTIL, replace=False)
    assert keys.certificate.read_bytes() == before
    keyring.issue("robot", "kiwi", UNTIL, replace=True)
    assert keys.certificate.read_bytes() != before
    assert [path.name for path in keyring.folder.iterdir() if path.name.startswith(".")] == []


def test_routers_let_in_what_there_is_now(keyring: Keyring) -> None:
    keyring.issue("robot", "kiwi", UNTIL, replace=False)
    home = keyring.issue("router", "home", UNTIL, ["home.local"], replace=False)
    attic = keyring.issue("router", "attic", UNTIL, ["attic.local"], replace=False)
    first = {one.role: one.common_name for one in allowed(home)}
    assert [(one.role, one.name) for one in allowed(home)] == [
        ("robot", "kiwi"),
        ("router", "attic"),
        ("router", "home"),
    ]
    keyring.issue("robot", "kiwi", UNTIL, replace=True)
    second = {one.role: one.common_name for one in allowed(home)}
    assert second["robot"] != first["robot"], "the replaced one is not let in any more"
    keyring.remove("robot", "kiwi")
    assert {one.role for one in allowed(attic)} == {"router"}
    with pytest.raises(KeysError, match="no keys of robot kiwi"):
        keyring.remove("robot", "kiwi")


def test_an_interrupted_run_can_be_repeated(keyring: Keyring) -> None:
    (keyring.folder / ".robot-kiwi.new").mkdir()
    (keyring.folder / ".robot-kiwi.new" / "key.pem").write_bytes(b"half")
    keys = keyring.issue("robot", "kiwi", UNTIL, replace=False)
    assert [one.role for one in read_certificates(keys.folder)] == ["ca", "robot"]
    assert [one.name for one in keyring.certificates()] == ["kiwi"]


def test_a_folder_that_cannot_be_written_is_told(tmp_path: Path) -> None:
    (tmp_path / "file").write_text("in the way")
    with pytest.raises(KeysError, match="file"):
        Keyring(tmp_path / "file" / "ring").create(NOW)


def test_only_a_router_lets_others_in(keyring: Keyring) -> None:
    robot = keyring.issue("robot", "kiwi", UNTIL, replace=False)
    home = keyring.issue("router", "home", UNTIL, ["home.local"], replace=False)
    assert security_of(robot).access_control is None
    rules = security_of(home).access_control
    assert rules is not None
    assert rules["default_permission"] == "deny"


def test_a_broken_list_opens_no_door(keyring: Keyring) -> None:
    home = keyring.issue("router", "home", UNTIL, ["home.local"], replace=False)
    home.allowed.write_bytes(b"rubbish")
    with pytest.raises(KeysError, match=r"allowed\.pem"):
        security_of(home)


def test_no_keys_are_needed_on_loopback(tmp_path: Path) -> None:
    assert find_keys(tmp_path / "none") is None
    assert keys_for(["tcp/127.0.0.1:7447"], tmp_path / "none") is None
    with pytest.raises(KeysError, match="trolley keys"):
        keys_for(["tls/home.local:7448"], tmp_path / "none")


def test_half_of_the_keys_are_told(keyring: Keyring) -> None:
    keys = keyring.issue("robot", "kiwi", UNTIL, replace=False)
    keys.key.unlink()
    with pytest.raises(KeysError, match=r"key\.pem"):
        find_keys(keys.folder)
