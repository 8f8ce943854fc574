"""Which ports there are, and by which name each stays the same."""

import os
import pty
from collections.abc import Iterator
from pathlib import Path

import pytest

from trolley_base.detection.ports import find_ports


class Machine:
    """A made-up /dev and /run/udev/data; its devices are pseudo-terminals."""

    def __init__(self, folder: Path) -> None:
        self.devices = folder / "dev"
        self.udev = folder / "udev"
        for path in (self.devices / "serial/by-id", self.devices / "serial/by-path", self.udev):
            path.mkdir(parents=True)
        self._open: list[int] = []

    def plug(self, name: str, by_id: str = "", by_path: str = "", serial: str = "") -> str:
        """Add a device; return its real path."""
        master, slave = pty.openpty()
        self._open += [master, slave]
        device = os.ttyname(slave)
        (self.devices / name).symlink_to(device)
        for folder, link in (("by-id", by_id), ("by-path", by_path)):
            if link:
                path = self.devices / "serial" / folder / link
                path.unlink(missing_ok=True)  # as udev does it: the last one wins
                path.symlink_to(device)
        number = os.stat(device).st_rdev
        lines = [f"E:ID_PATH={by_path}", "E:ID_VENDOR_ID=10c4", "E:ID_MODEL_ID=ea60"]
        lines += [f"E:ID_SERIAL_SHORT={serial}"] if serial else []
        entry = self.udev / f"c{os.major(number)}:{os.minor(number)}"
        entry.write_text("\n".join(lines))
        return device

    def names(self, *given: str) -> dict[str, str]:
        return {port.device: port.name for port in find_ports(given, self.devices, self.udev)}

    def link(self, name: str) -> str:
        return str(self.devices / "serial" / name)

    def close(self) -> None:
        for handle in self._open:
            os.close(handle)


@pytest.fixture
def machine(tmp_path: Path) -> Iterator[Machine]:
    machine = Machine(tmp_path)
    yield machine
    machine.close()


def test_lists_each_device_once(machine: Machine) -> None:
    device = machine.plug("ttyUSB0", "usb-lidar", "pci-1", serial="A1B2C3D4")
    assert machine.names() == {device: machine.link("by-id/usb-lidar")}


def test_names_twins_by_their_sockets(machine: Machine) -> None:
    one = machine.plug("ttyUSB0", "usb-cp2102", "pci-1", serial="0a1b2c3d")
    two = machine.plug("ttyUSB1", "usb-cp2102", "pci-2", serial="0a1b2c3d")
    assert machine.names() == {
        one: machine.link("by-path/pci-1"),
        two: machine.link("by-path/pci-2"),
    }
    ports = find_ports((), machine.devices, machine.udev)
    assert {port.twin_serial for port in ports} == {"0a1b2c3d"}
    assert all("another adapter here has the serial number 0a1b2c3d" in p.reason for p in ports)


def test_a_twin_is_one_even_if_only_one_was_asked_for(machine: Machine) -> None:
    one = machine.plug("ttyUSB0", "usb-cp2102", "pci-1", serial="0a1b2c3d")
    machine.plug("ttyUSB1", "usb-cp2102", "pci-2", serial="0a1b2c3d")
    assert machine.names(one) == {one: machine.link("by-path/pci-1")}


def test_does_not_trust_a_factory_serial(machine: Machine) -> None:
    device = machine.plug("ttyUSB0", "usb-cp2102_0001", "pci-1", serial="0001")
    assert machine.names() == {device: machine.link("by-path/pci-1")}


def test_prefers_the_by_path_name_that_older_systems_know(machine: Machine) -> None:
    device = machine.plug("ttyUSB0", "", "pci-usbv2-0:1")
    (machine.devices / "serial/by-path/pci-usb-0:1").symlink_to(device)
    assert machine.names() == {device: machine.link("by-path/pci-usb-0:1")}


def test_keeps_a_name_that_was_given(machine: Machine, tmp_path: Path) -> None:
    device = machine.plug("ttyUSB0", "usb-lidar", "pci-1", serial="A1B2C3D4")
    link = tmp_path / "lidar"
    link.symlink_to(device)
    assert machine.names(str(link)) == {device: str(link)}


def test_leaves_the_bluetooth_chip_alone(machine: Machine) -> None:
    bluetooth = machine.plug("ttyAMA0")
    (machine.devices / "serial1").symlink_to(bluetooth)
    uart = machine.plug("serial0")
    assert list(machine.names()) == [uart]


def test_names_a_port_that_is_not_there(machine: Machine) -> None:
    assert machine.names("/dev/ttyUSB77") == {"/dev/ttyUSB77": "/dev/ttyUSB77"}
