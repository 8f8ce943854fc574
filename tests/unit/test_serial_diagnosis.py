"""What is said about a serial port that cannot be used."""

import errno
import fcntl
import os
import pty
import subprocess
import sys
import termios
from collections.abc import Iterator
from pathlib import Path

import pytest

from trolley import serial_diagnosis as diagnosis
from trolley.serial_diagnosis import explain, holders, modem_manager_warning, udev_properties


def error_of(code: int) -> OSError:
    return OSError(code, os.strerror(code))


@pytest.fixture
def port() -> Iterator[str]:
    """A pseudo-terminal that nobody but the test itself holds on the master's side."""
    master, slave = pty.openpty()
    name = os.ttyname(slave)
    os.close(slave)
    yield name
    os.close(master)


def start_holder(port: str) -> subprocess.Popen[bytes]:
    """A process that has the port open; returns when it has."""
    process = subprocess.Popen(
        [
            sys.executable,
            "-c",
            "import sys; f = open(sys.argv[1]); print(flush=True); input()",
            port,
        ],
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
    )
    assert process.stdout is not None
    process.stdout.readline()
    return process


def test_says_that_a_port_is_missing() -> None:
    text = explain("/dev/ttyUSB77", error_of(errno.ENOENT))
    assert text.startswith("/dev/ttyUSB77 is not there: is the device unplugged?")


def test_lists_the_ports_that_are_there(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    for name in ("ttyUSB0", "ttyUSB1"):
        (tmp_path / name).touch()
    by_id = tmp_path / "serial" / "by-id"
    by_id.mkdir(parents=True)
    (by_id / "usb-a-lidar").symlink_to(tmp_path / "ttyUSB1")
    monkeypatch.setattr(diagnosis, "DEVICES", tmp_path)
    text = explain("/dev/ttyUSB77", error_of(errno.ENOENT))
    assert text.endswith(f"There are {by_id}/usb-a-lidar, {tmp_path}/ttyUSB0.")


@pytest.mark.programs
def test_names_the_process_that_holds_a_port(port: str) -> None:
    with start_holder(port) as process:
        try:
            text = explain(port, error_of(errno.EBUSY))
            found = holders(port)
        finally:
            process.communicate(b"\n")
    assert f"(pid {process.pid})" in text
    assert [holder.pid for holder in found.seen] == [process.pid]
    assert holders(port).seen == ()


def test_follows_links_to_the_port(port: str, tmp_path: Path) -> None:
    link = tmp_path / "lidar"
    link.symlink_to(port)
    with open(port, "rb", buffering=0):
        assert [holder.pid for holder in holders(str(link)).seen] == [os.getpid()]
        assert "this program itself" in explain(str(link), error_of(errno.EBUSY))


def test_says_what_cannot_be_seen() -> None:
    unseen = diagnosis.Holders((), is_complete=False)
    assert "sudo fuser -v /dev/ttyUSB0" in unseen.in_words("/dev/ttyUSB0")
    assert "container" in diagnosis.Holders((), is_complete=True).in_words("/dev/ttyUSB0")


def test_a_process_of_another_user_makes_the_search_incomplete(
    port: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def refuse(process: Path, device: str) -> bool:
        raise PermissionError(errno.EACCES, os.strerror(errno.EACCES), str(process))

    (tmp_path / "1" / "fd").mkdir(parents=True)
    assert holders(port, tmp_path).is_complete
    monkeypatch.setattr(diagnosis, "_has_open", refuse)
    assert not holders(port, tmp_path).is_complete


def test_names_the_group_that_may_use_a_port(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    device = tmp_path / "ttyUSB0"
    device.touch()
    device.chmod(0o660)
    if os.geteuid() == 0:
        os.chown(device, 0, 20)  # dialout on Debian
    monkeypatch.setattr(os, "getgroups", list)
    text = explain(str(device), error_of(errno.EACCES))
    assert "usermod -aG" in text
    assert "log out and in again" in text


@pytest.mark.parametrize(
    ("code", "advice"),
    [
        (errno.EACCES, "trolley`, then `sudo systemctl restart trolley-base`"),
        (errno.EPERM, "sandbox of trolley-base: `sudo systemctl edit trolley-base`"),
    ],
)
def test_a_service_is_let_in_as_a_service(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, code: int, advice: str
) -> None:
    device = tmp_path / "ttyTHS1"
    device.touch()
    device.chmod(0o660)
    if os.geteuid() == 0:
        os.chown(device, 0, 20)
    (tmp_path / "self").mkdir()
    (tmp_path / "self" / "cgroup").write_text("0::/system.slice/trolley-base.service\n")
    monkeypatch.setattr(diagnosis, "PROC", tmp_path)
    monkeypatch.setattr(os, "getgroups", list)
    text = explain(str(device), error_of(code))
    assert advice in text
    assert "$USER" not in text


def test_does_not_send_into_a_group_that_may_not_either(tmp_path: Path) -> None:
    device = tmp_path / "ttyUSB0"
    device.touch()
    device.chmod(0o600)
    text = explain(str(device), error_of(errno.EACCES))
    assert "usermod" not in text
    assert "-rw-------" in text


def test_says_that_a_file_is_no_port(tmp_path: Path) -> None:
    path = tmp_path / "file"
    path.touch()
    with path.open() as file, pytest.raises(OSError, match="ioctl") as raised:
        fcntl.ioctl(file, termios.TIOCEXCL)
    assert "is not a serial port" in explain(str(path), raised.value)


def test_tells_a_pulled_plug_from_a_loose_cable(tmp_path: Path) -> None:
    assert "unplugged" in explain(str(tmp_path / "gone"), error_of(errno.EIO))
    assert "cable" in explain(str(tmp_path), error_of(errno.EIO))


def test_keeps_the_systems_words_for_the_rest() -> None:
    assert "File name too long" in explain("/dev/x", error_of(errno.ENAMETOOLONG))


class Udev:
    """A made-up /proc and /run/udev/data for one port."""

    def __init__(self, port: str, folder: Path) -> None:
        number = os.stat(port).st_rdev
        self.data = folder / "data"
        self.data.mkdir()
        self.entry = self.data / f"c{os.major(number)}:{os.minor(number)}"
        self.proc = folder / "proc"
        (self.proc / "42").mkdir(parents=True)
        (self.proc / "42" / "comm").write_text("ModemManager\n")


def test_warns_of_modem_manager(port: str, tmp_path: Path) -> None:
    udev = Udev(port, tmp_path)
    udev.entry.write_text(
        "S:serial/by-id/x\nE:ID_BUS=usb\nE:ID_PATH=pci-0000:00:14.0-usb-0:2:1.0\n"
    )
    assert udev_properties(port, udev.data)["ID_PATH"] == "pci-0000:00:14.0-usb-0:2:1.0"
    warning = modem_manager_warning(port, udev.proc, udev.data)
    assert warning is not None
    assert "trolley detect --udev" in warning


def test_does_not_warn_where_a_rule_keeps_it_away(port: str, tmp_path: Path) -> None:
    udev = Udev(port, tmp_path)
    udev.entry.write_text("E:ID_BUS=usb\nE:ID_MM_DEVICE_IGNORE=1\n")
    assert modem_manager_warning(port, udev.proc, udev.data) is None


def test_does_not_warn_where_it_does_not_run(port: str, tmp_path: Path) -> None:
    udev = Udev(port, tmp_path)
    udev.entry.write_text("E:ID_BUS=usb\n")
    (udev.proc / "42" / "comm").write_text("python3\n")
    assert modem_manager_warning(port, udev.proc, udev.data) is None


def test_does_not_warn_about_ports_that_are_not_usb(port: str, tmp_path: Path) -> None:
    udev = Udev(port, tmp_path)
    assert modem_manager_warning(port, udev.proc, udev.data) is None
    assert udev_properties("/dev/ttyUSB77") == {}
