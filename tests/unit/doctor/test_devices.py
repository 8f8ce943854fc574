"""What doctor says of serial ports, rights and systemd units."""

import os
import pty
import subprocess
import sys
from collections.abc import Iterator, Sequence
from dataclasses import replace
from pathlib import Path

import pytest

from trolley.config import RobotConfig, load_config
from trolley.doctor import Level
from trolley.doctor.computer_facts import Host
from trolley.doctor.devices import Port, check_ports, read_ports
from trolley.doctor.rights import Access, check_access, check_secrets, named_secrets, read_access
from trolley.doctor.units import Unit, check_units, parse_units, read_units
from trolley.doctor.users import READ, WRITE, User, closed_at, this_user
from trolley.serial_diagnosis import Holder

STRANGER = User("trolley", 64_321, 64_321, frozenset({64_321}))
LIDAR = Port("base.lidar.port", "/dev/trolley-lidar", "/dev/ttyUSB1")
BOARD = Port("base.chassis.port", "/dev/trolley-chassis", "/dev/ttyUSB0")


def write_settings(path: Path, lidar: str, board: str) -> RobotConfig:
    path.write_text(
        f"""\
[robot]
name = "one"
footprint = {{ radius_m = 0.2 }}
[base]
driver = "hardware"
[base.lidar]
model = "ld19"
port = "{lidar}"
[base.chassis]
board = "linorobot"
port = "{board}"
"""
    )
    return load_config(path)


@pytest.fixture
def port() -> Iterator[str]:
    """A pseudo-terminal, which is a serial port as far as its file goes."""
    master, slave = pty.openpty()
    yield os.ttyname(slave)
    os.close(slave)
    os.close(master)


def test_good_ports_are_fine() -> None:
    assert [one.level for one in check_ports([LIDAR, BOARD])] == [Level.OK] * 2
    assert check_ports([]) == []


@pytest.mark.parametrize(
    ("port", "level", "words"),
    [
        (replace(LIDAR, path="", device=""), Level.PROBLEM, "[base.lidar.port] is not set"),
        (replace(LIDAR, device=""), Level.PROBLEM, "is not there"),
        (replace(LIDAR, is_serial=False), Level.PROBLEM, "not a serial port"),
        (replace(LIDAR, forbidden="x may not", remedy="usermod"), Level.PROBLEM, "x may not"),
        (replace(LIDAR, held_by=(Holder(812, "screen"),)), Level.PROBLEM, "screen (pid 812)"),
        (replace(LIDAR, modem_manager="it runs"), Level.WARNING, "ModemManager"),
        (replace(LIDAR, is_seen_whole=False), Level.NOTE, "which program has it open"),
        (replace(LIDAR, path="/dev/ttyUSB1"), Level.WARNING, "a different device"),
    ],
)
def test_a_bad_port_is_named_with_what_to_do(port: Port, level: Level, words: str) -> None:
    (found,) = check_ports([port])
    assert found.level is level
    assert words in found.sentence
    assert found.remedy


def test_two_keys_for_one_device_are_seen_through_their_links() -> None:
    found = check_ports([LIDAR, replace(BOARD, device=LIDAR.device)])
    assert "name the same device" in found[-1].sentence


def test_ports_are_looked_at_without_being_opened(port: str, tmp_path: Path) -> None:
    link = tmp_path / "lidar"
    link.symlink_to(port)
    settings = write_settings(tmp_path / "robot.toml", str(link), str(tmp_path / "nothing"))
    seen = {one.key: one for one in read_ports(settings, this_user())}
    lidar = seen["base.lidar.port"]
    assert (lidar.device, lidar.is_serial, lidar.forbidden) == (port, True, "")
    assert seen["base.chassis.port"].device == ""
    os.chmod(port, 0o600)
    (lidar, _) = read_ports(settings, STRANGER)
    assert "trolley may not use it" in lidar.forbidden
    os.chmod(port, 0o660)
    (lidar, _) = read_ports(settings, STRANGER)
    assert lidar.remedy
    (lidar, _) = read_ports(settings, replace(STRANGER, groups=frozenset({os.stat(port).st_gid})))
    assert lidar.forbidden == ""


@pytest.mark.programs
def test_an_address_in_the_network_is_no_missing_port(tmp_path: Path) -> None:
    config = write_settings(tmp_path / "robot.toml", "tcp://192.168.0.10:10940", "/dev/null")
    (lidar, _) = read_ports(config, this_user())
    (found,) = check_ports([lidar])
    assert found.level == Level.OK
    assert "tcp://192.168.0.10:10940 ([base.lidar.port]) is in the network" in found.sentence


def test_a_program_that_holds_a_port_is_named_but_for_base(port: str, tmp_path: Path) -> None:
    hold = "import sys; f = open(sys.argv[1]); print(flush=True); input()"
    settings = write_settings(tmp_path / "robot.toml", port, str(tmp_path / "nothing"))
    for words, is_stranger in (([], True), (["trolley", "run", "base"], False)):
        process = subprocess.Popen(
            [sys.executable, "-c", hold, port, *words],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
        )
        with process:
            assert process.stdout is not None
            process.stdout.readline()
            (lidar, _) = read_ports(settings, this_user())
            assert (process.pid in [one.pid for one in lidar.held_by]) is is_stranger
            process.kill()


def test_a_simulated_robot_needs_no_ports(tmp_path: Path) -> None:
    path = tmp_path / "robot.toml"
    path.write_text('[robot]\nname = "one"\nfootprint = { radius_m = 0.2 }\n')
    assert read_ports(load_config(path), this_user()) == []


# Rights.
def test_what_keeps_a_user_out_is_found(tmp_path: Path) -> None:
    for folder in (tmp_path, *tmp_path.parents[:-2]):
        folder.chmod(0o755)
    file = tmp_path / "robot.toml"
    file.touch(mode=0o644)
    assert closed_at(STRANGER, file, READ) is None
    assert closed_at(STRANGER, file, READ | WRITE) == file
    tmp_path.chmod(0o700)
    assert closed_at(STRANGER, file, READ) == tmp_path
    with pytest.raises(FileNotFoundError):
        closed_at(STRANGER, tmp_path / "nothing", READ)


def test_a_state_folder_of_somebody_else_is_a_problem(tmp_path: Path) -> None:
    for folder in (tmp_path, *tmp_path.parents[:-2]):
        folder.chmod(0o755)
    (tmp_path / "poses.toml").touch(mode=0o644)
    own = read_access(this_user(), None, tmp_path)
    assert [one.level for one in check_access(own)] == [Level.OK]
    closed = read_access(STRANGER, None, tmp_path)
    assert [one.level for one in check_access(closed)] == [Level.PROBLEM]
    tmp_path.chmod(0o777)
    foreign = read_access(STRANGER, None, tmp_path)
    assert foreign.foreign == (str(tmp_path / "poses.toml"),)
    assert [one.level for one in check_access(foreign)] == [Level.PROBLEM]
    assert "chown" in check_access(foreign)[0].remedy


def test_a_closed_configuration_is_a_problem() -> None:
    found = check_access(Access("trolley", "robots", "/etc/x: root:root -rw-r-----"))
    assert [one.level for one in found] == [Level.PROBLEM]
    # It may hold a secret: `chmod a+r` showed that to everybody.
    assert "chgrp robots" in found[0].remedy


def test_a_private_key_of_somebody_else_is_a_problem(tmp_path: Path) -> None:
    for folder in (tmp_path, *tmp_path.parents[:-2]):
        folder.chmod(0o755)
    key = tmp_path / "key.pem"
    assert read_access(STRANGER, None, tmp_path, key).key_closed == ""
    key.touch(mode=0o600)
    assert read_access(this_user(), None, tmp_path, key).key_closed == ""
    closed = read_access(STRANGER, None, tmp_path, key)
    assert str(key) in closed.key_closed
    assert any("private key" in one.sentence for one in check_access(closed))


def test_secrets_are_for_the_services_only(tmp_path: Path) -> None:
    user = this_user()
    key, other = tmp_path / "key.pem", tmp_path / "other.pem"
    assert check_secrets([key, other], user) == []
    for path in (key, other):
        path.touch(mode=0o600)
    assert [one.level for one in check_secrets([key, other], user)] == [Level.OK]
    key.chmod(0o640)
    assert [one.level for one in check_secrets([key, other], user)] == [Level.OK]
    (found,) = check_secrets([key, other], STRANGER)
    assert (found.level, "key.pem" in found.sentence) == (Level.WARNING, True)
    key.chmod(0o604)
    assert [one.level for one in check_secrets([key, other], user)] == [Level.WARNING]


def test_secrets_are_also_what_the_settings_name(tmp_path: Path) -> None:
    """Doctor did not look at a broker's password, nor at a webhook's address."""
    path = tmp_path / "robot.toml"
    text = '[robot]\nname = "one"\nfootprint = { radius_m = 0.2 }\n'
    path.write_text(f'{text}[mqtt]\nbroker = "b"\npassword_file = "password"\n')
    assert named_secrets(load_config(path)) == [tmp_path / "password"]
    path.write_text(f'{text}[webhook]\nurls = ["https://a/b"]\ntoken_file = "/token"\n')
    assert named_secrets(load_config(path)) == [Path("/token"), path]


# Units.
SHOWN = """\
Id=trolley-base.service
LoadState=loaded
ActiveState=active
UnitFileState=enabled
NRestarts=7
Result=success
ExecMainStatus=0
User=trolley
SupplementaryGroups=dialout
Environment=NUMBA_CACHE_DIR=/var/cache/trolley

Id=trolley-tour.service
LoadState=loaded
ActiveState=failed
UnitFileState=enabled
NRestarts=[not set]
Result=exit-code
ExecMainStatus=2

Id=trolley-old.service
LoadState=not-found
ActiveState=inactive
"""


def test_units_are_read_as_systemctl_shows_them() -> None:
    base, tour = parse_units(SHOWN)
    assert (base.service, base.user, base.groups, base.restarts) == (
        "base",
        "trolley",
        ("dialout",),
        7,
    )
    assert base.environment == {"NUMBA_CACHE_DIR": "/var/cache/trolley"}
    assert (tour.active, tour.exit_status, tour.restarts) == ("failed", "2", 0)
    assert parse_units("garbage\n\n=\n") == []


def test_systemd_is_asked_only_where_it_runs(tmp_path: Path) -> None:
    asked: list[str] = []

    def run(words: Sequence[str]) -> str:
        asked.extend(words)
        return SHOWN

    host = Host(tmp_path, run)
    assert read_units(host) is None
    (tmp_path / "run/systemd/system").mkdir(parents=True)
    assert read_units(host) == []
    assert asked == []
    folder = tmp_path / "etc/systemd/system"
    folder.mkdir(parents=True)
    for name in ("trolley-base.service", "trolley-tour.service", "trolley-retry@.service"):
        (folder / name).touch()
    assert len(read_units(host) or []) == 2
    assert asked[-2:] == ["trolley-base.service", "trolley-tour.service"]
    assert read_units(Host(tmp_path, lambda _: None)) == []


@pytest.mark.parametrize(
    ("unit", "level", "words"),
    [
        (Unit("trolley-base.service", "active"), Level.OK, "runs"),
        (Unit("trolley-viz.service", "inactive", "disabled"), Level.OK, "not in use"),
        (Unit("trolley-base.service", "active", restarts=2), Level.NOTE, "2 times"),
        (Unit("trolley-base.service", "active", restarts=9), Level.WARNING, "9 times"),
        (Unit("trolley-base.service", "activating"), Level.WARNING, "not ready"),
        (
            Unit("trolley-base.service", "activating", sub="auto-restart"),
            Level.PROBLEM,
            "stops every time",
        ),
        (Unit("trolley-base.service", "inactive", "enabled"), Level.PROBLEM, "should be running"),
        (Unit("trolley-base.service", "failed", result="watchdog"), Level.PROBLEM, "watchdog"),
        (Unit("trolley-base.service", "failed", exit_status="2"), Level.PROBLEM, "robot.toml"),
    ],
)
def test_units(unit: Unit, level: Level, words: str) -> None:
    (found,) = check_units([unit])
    assert found.level is level
    assert words in found.sentence


def test_no_units_are_fine() -> None:
    assert [one.level for one in check_units(None) + check_units([])] == [Level.OK] * 2
