"""What doctor says of routers, certificates, and a trial of the services."""

import os
import shutil
import socket
import subprocess
import sys
from dataclasses import replace
from datetime import UTC, datetime, timedelta
from pathlib import Path

import pytest
from support.waiting import wait_until

from trolley.config import load_config
from trolley.connection import RouterBusy
from trolley.doctor import Level
from trolley.doctor.certificates import Validity, check_certificates, check_keys
from trolley.doctor.endpoints import (
    Door,
    Endpoint,
    address_of,
    check_door,
    check_uplink,
    knock,
)
from trolley.doctor.finding import Finding, looked_at, note
from trolley.doctor.trial import Running, Trial, check_trial, try_services
from trolley.doctor.users import User
from trolley.security.certificates import make_authority, make_certificate
from trolley.security.host_keys import HostKeys
from trolley.security.keyring import Keyring
from trolley.supervision import PARENT_VARIABLE

NOW = datetime(2026, 5, 1, tzinfo=UTC)


@pytest.mark.parametrize(
    ("endpoint", "address"),
    [
        ("tcp/127.0.0.1:7447", ("127.0.0.1", 7447)),
        ("tls/[::1]:7448?x=1#y", ("::1", 7448)),
        ("udp/10.0.0.1:7447", None),
        ("unixsock-stream//tmp/x", None),
    ],
)
def test_addresses(endpoint: str, address: tuple[str, int] | None) -> None:
    assert address_of(endpoint) == address


def test_knocking_tells_who_answers() -> None:
    with socket.create_server(("127.0.0.1", 0)) as server:
        port = server.getsockname()[1]
        assert knock(f"tcp/127.0.0.1:{port}") == Endpoint(f"tcp/127.0.0.1:{port}")
    gone = knock(f"tcp/127.0.0.1:{port}")
    assert gone is not None
    assert gone.trouble == "connection refused"
    assert [one.level for one in check_uplink(f"tls/127.0.0.1:{port}", None)] == [Level.WARNING]
    assert knock("unixsock-stream//tmp/x") is None
    unknown = knock("tcp/no-such-host.invalid:7447")
    assert unknown is not None
    assert unknown.trouble


def test_a_home_router_that_is_busy_has_no_wrong_keys(monkeypatch: pytest.MonkeyPatch) -> None:
    """Whoever looked while it was busy was told to copy all certificates again."""

    class Busy:
        def __init__(self, *_: object, **__: object) -> None: ...

        def __enter__(self) -> "Busy":
            return self

        def __exit__(self, *_: object) -> None: ...

        def robots(self) -> list[str]:
            raise RouterBusy("it does not say in time who is there")

    monkeypatch.setattr("trolley.doctor.endpoints.Connection", Busy)
    with socket.create_server(("127.0.0.1", 0)) as server:
        endpoint = f"tls/127.0.0.1:{server.getsockname()[1]}"
        (found,) = check_uplink(endpoint, HostKeys(Path("keys")))
    assert (found.level, "too busy" in found.remedy) == (Level.WARNING, True)


def test_doors() -> None:
    where = ("tcp/127.0.0.1:7447",)
    assert [one.level for one in check_door(Door(where, ""))] == [Level.OK]
    assert [one.level for one in check_door(Door(where, "nobody"))] == [Level.PROBLEM]
    assert [one.level for one in check_door(Door(where, "nobody", is_wanted=False))] == [Level.NOTE]
    two = Door(("tcp/a:1", "tcp/b:1"), "", silent=(Endpoint("tcp/b:1", trouble="no"),))
    answers, silent = check_door(two)
    assert answers.sentence == "The router at tcp/a:1 answers."
    assert (silent.level, "tcp/b:1" in silent.sentence) == (Level.WARNING, True)
    (taken,) = check_door(Door(where, "nobody", owner="nginx (pid 7)"))
    assert "nginx (pid 7)" in taken.sentence


def test_a_router_of_ros_is_told_by_its_name() -> None:
    where = ("tcp/127.0.0.1:7447",)
    (open_to_all,) = check_door(Door(where, "", "rmw_zenohd (pid 7)"))
    assert (open_to_all.level, "every host" in open_to_all.sentence) == (Level.WARNING, True)
    (in_the_way,) = check_door(Door(where, "nobody", "rmw_zenohd (pid 7)"))
    assert (in_the_way.level, "Trolley's router as well" in in_the_way.remedy) == (
        Level.PROBLEM,
        True,
    )
    ours = Door(where, "", "trolley router (pid 7)")
    assert [one.level for one in check_door(ours)] == [Level.OK]


def validity(days: float, since: datetime = NOW - timedelta(days=9)) -> Validity:
    return Validity("robot", "one", "/etc/cert.pem", since, NOW + timedelta(days=days))


def test_certificates_run_out() -> None:
    levels = [check_certificates([validity(days)], NOW)[0].level for days in (400.0, 10.0, -1.0)]
    assert levels == [Level.OK, Level.WARNING, Level.PROBLEM]
    (authority,) = check_certificates([replace(validity(10.0), role="ca")], NOW)
    assert "new authority" in authority.remedy
    (late,) = check_certificates([validity(-1.0)], NOW)
    assert f"here it is {NOW:%Y-%m-%d}" in late.sentence
    assert "set the clock" in late.remedy
    (early,) = check_certificates([validity(400.0, NOW + timedelta(days=1))], NOW)
    assert (early.level, "clock" in early.remedy) == (Level.PROBLEM, True)


@pytest.mark.parametrize(
    ("role", "name", "command"),
    [
        ("operator", "anna", "trolley keys operator anna --replace"),
        ("router", "home", "trolley keys router --name home --replace"),
    ],
)
def test_who_renews_a_certificate_is_told_how(role: str, name: str, command: str) -> None:
    """What was told for a router made one whose only address was its name."""
    (found,) = check_certificates([replace(validity(10.0), role=role, name=name)], NOW)
    assert f"`{command}`" in found.remedy


def test_certificates_are_read_from_the_folder_of_the_settings(tmp_path: Path) -> None:
    path = tmp_path / "robot.toml"
    path.write_text(
        '[robot]\nname = "one"\nfootprint = { radius_m = 0.2 }\n'
        '[zenoh]\nuplink = ["tls/home:7448"]\n'
    )
    settings = load_config(path)
    (missing,) = check_keys(settings, NOW)
    assert (missing.level, "there is no folder" in missing.sentence) == (Level.PROBLEM, True)
    folder = tmp_path / "keys"
    folder.mkdir()
    (empty,) = check_keys(settings, NOW)
    assert (empty.level, "ca.pem" in empty.sentence) == (Level.PROBLEM, True)
    authority = make_authority(NOW)
    pair = make_certificate(authority, "robot", "one", (), NOW + timedelta(days=10))
    (folder / "ca.pem").write_bytes(authority.certificate)
    (folder / "cert.pem").write_bytes(pair.certificate)
    (folder / "key.pem").write_bytes(pair.key)
    levels = {one.sentence.split()[2]: one.level for one in check_keys(settings, NOW)}
    assert levels == {"ca": Level.OK, "robot": Level.WARNING}
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("os.access", lambda *_: False)
        assert "sudo" in check_keys(settings, NOW)[0].remedy
    (folder / "cert.pem").write_bytes(b"-----BEGIN CERTIFICATE-----\ngarbage")
    assert [one.level for one in check_keys(settings, NOW)] == [Level.PROBLEM]


def test_keys_that_cannot_work_are_told(tmp_path: Path) -> None:
    """Doctor looked at the dates only, and said that all is fine."""
    path = tmp_path / "robot.toml"
    path.write_text('[robot]\nname = "kiwi"\nfootprint = { radius_m = 0.2 }\n')
    ring = Keyring(tmp_path)
    ring.create(NOW)
    until = NOW + timedelta(days=400)
    other = ring.issue("robot", "kiwi2", until, replace=False)
    other.folder.rename(tmp_path / "keys")
    settings = load_config(path)

    def told() -> list[str]:
        return [one.sentence for one in check_keys(settings, NOW) if one.level is Level.PROBLEM]

    (foreign,) = told()
    assert "is of robot kiwi2, but [robot] name is kiwi" in foreign
    shutil.rmtree(tmp_path / "keys")
    ring.issue("robot", "kiwi", until, replace=False).folder.rename(tmp_path / "keys")
    assert told() == []
    key = tmp_path / "keys" / "key.pem"
    kept = key.read_bytes()
    key.write_bytes(make_authority(NOW).key)
    (mixed,) = told()
    assert "do not belong together" in mixed
    key.unlink()
    (missing,) = told()
    assert "key.pem: No such file" in missing
    key.write_bytes(kept)
    authority = tmp_path / "keys" / "ca.pem"
    kept = authority.read_bytes()
    authority.write_bytes(make_authority(NOW).certificate)
    (other_family,) = told()
    assert "do not belong together" in other_family
    authority.write_bytes(kept)
    (tmp_path / "keys" / "cert.pem").write_bytes(b"")
    (empty,) = told()
    assert "one of them is broken" in empty


def test_trials() -> None:
    assert [one.level for one in check_trial(Trial({}, ("base",), 9))] == [Level.OK] * 2
    assert [one.level for one in check_trial(Trial({}, (), trouble="died"))] == [Level.NOTE]
    refused, uncompiled = check_trial(Trial({"base": "no world"}, ("base",), 9, missing=2))
    assert (refused.level, uncompiled.level) == (Level.PROBLEM, Level.WARNING)
    assert "2 of 9" in uncompiled.sentence


def test_no_service_is_tried_that_the_settings_leave_out(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Every robot.toml without a broker had the problem that `mqtt` cannot use it."""
    monkeypatch.setenv("TROLLEY_STATE", str(tmp_path))
    path = tmp_path / "robot.toml"
    text = '[robot]\nname = "one"\nfootprint = { radius_m = 0.2 }\n'
    path.write_text(text)
    tried = try_services(path)
    assert "mqtt" not in tried
    assert set(tried.values()) == {""}
    path.write_text(f'{text}[mqtt]\nbroker = "broker.local"\npassword_file = "nowhere"\n')
    assert "nowhere" in try_services(path)["mqtt"]


def test_a_trial_ends_with_whoever_asked_for_it() -> None:
    running = Running(None, {})
    assert running._process is not None
    environ = Path(f"/proc/{running._process.pid}/environ")
    # Empty while the kernel is still setting the program up.
    wait_until(environ.read_bytes, "it has an environment")
    environment = environ.read_bytes().split(b"\0")
    running.end()
    assert f"{PARENT_VARIABLE}={os.getpid()}".encode() in environment
    # One whose parent is another by now, since it ended meanwhile, does not go on.
    words = [sys.executable, "-m", "trolley.doctor.trial"]
    orphan = {**os.environ, PARENT_VARIABLE: "1"}
    assert subprocess.check_output(words, env=orphan, text=True) == ""


def test_a_trial_that_ends_badly_is_said_so(tmp_path: Path) -> None:
    trial = Running(None, {"PYTHONPATH": str(tmp_path), "PYTHONHOME": str(tmp_path)}).outcome()
    assert trial.trouble
    assert [one.level for one in check_trial(trial)] == [Level.NOTE]


@pytest.mark.skipif(os.geteuid() != 0, reason="only root can be somebody else")
def test_a_trial_that_cannot_begin_is_said_so(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("sys.executable", "/nowhere/python")
    trial = Running(None, {}, User("nobody", 65_534, 65_534, frozenset())).outcome()
    assert "it cannot be started as nobody" in trial.trouble


def test_a_fact_that_cannot_be_read_is_said_so() -> None:
    def closed() -> list[Finding]:
        raise PermissionError(13, "Permission denied", "/etc/trolley/keys")

    def broken() -> list[Finding]:
        return [note("x", str(int("abc")))]

    (found,) = looked_at("certificates", closed)
    assert (found.level, "/etc/trolley/keys" in found.sentence) == (Level.NOTE, True)
    (found,) = looked_at("memory", broken)
    assert "could not be checked" in found.sentence


def test_findings_cannot_steer_a_terminal() -> None:
    found = note("base", "\x1b]0;evil\x07 says\nso\u202e", "rm\r")
    assert (found.sentence, found.remedy) == (" ]0;evil  says so ", "rm ")
