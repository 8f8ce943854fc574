"""The udev rule that `trolley detect` writes, and the example that ships with Trolley."""

import re
import shutil
import subprocess
from pathlib import Path

import pytest

from trolley_base.detection import udev_rules
from trolley_base.detection.ports import Port
from trolley_base.detection.results import FoundDevice, PortResult

EXAMPLE = Path(__file__).parents[4] / "deploy" / "udev" / "99-trolley.rules"
# udev(7): key, perhaps with an attribute, operator, value in quotes.
PART = re.compile(r'[A-Z]+(\{[\w/]+\})?(==|!=|=|\+=|:=)"[^"]*"')
TEENSY = {
    "ID_SERIAL_SHORT": "12345670",
    "ID_VENDOR_ID": "16c0",
    "ID_MODEL_ID": "0483",
    "ID_USB_INTERFACE_NUM": "00",
    "ID_PATH": "pci-0000:00:14.0-usb-0:1:1.0",
}
CP2102 = {"ID_SERIAL_SHORT": "0001", "ID_PATH": "pci-0000:00:14.0-usb-0:2:1.0"}
BOARD = FoundDevice("board", "linorobot", "linorobot", 57600)
LIDAR = FoundDevice("lidar", "ld19", "LD19", 230400)


def seen(found: FoundDevice, device: str, twin: str = "", **properties: str) -> PortResult:
    port = Port(device, device, twin_serial=twin, properties=tuple(properties.items()))
    return PortResult(port, found)


def rules(text: str) -> list[str]:
    return [line for line in text.splitlines() if line and not line.startswith("#")]


def test_knows_a_board_by_its_serial_number_and_a_lidar_by_its_socket() -> None:
    text = udev_rules.render(
        [seen(BOARD, "/dev/ttyACM0", **TEENSY), seen(LIDAR, "/dev/ttyUSB0", **CP2102)]
    )
    chassis, lidar = rules(text)
    assert 'ENV{ID_SERIAL_SHORT}=="12345670"' in chassis
    assert 'SYMLINK+="trolley-chassis"' in chassis
    assert f'ENV{{ID_PATH}}=="{CP2102["ID_PATH"]}"' in lidar
    assert "0001" not in lidar
    for rule in (chassis, lidar):
        assert 'GROUP="dialout"' in rule
        assert 'ENV{ID_MM_DEVICE_IGNORE}="1"' in rule


def test_knows_a_twin_by_its_socket() -> None:
    (rule,) = rules(udev_rules.render([seen(BOARD, "/dev/ttyACM0", "12345670", **TEENSY)]))
    assert "ID_PATH" in rule
    assert "ID_SERIAL_SHORT" not in rule


def test_knows_a_computers_own_uart() -> None:
    (rule,) = rules(udev_rules.render([seen(LIDAR, "/dev/ttyAMA0")]))
    assert 'KERNEL=="ttyAMA0"' in rule


def test_writes_no_rule_for_what_cannot_be_known_again() -> None:
    text = udev_rules.render(
        [seen(LIDAR, "/dev/pts/7"), seen(BOARD, "/dev/x", ID_PATH='a", RUN+="b')]
    )
    assert rules(text) == []
    assert "udev knows nothing about /dev/pts/7" in text


def test_gives_two_lidars_two_names() -> None:
    two = [
        seen(LIDAR, "/dev/ttyUSB0", ID_PATH="pci-1"),
        seen(LIDAR, "/dev/ttyUSB1", ID_PATH="pci-2"),
    ]
    one, other = rules(udev_rules.render(two))
    assert 'SYMLINK+="trolley-lidar-1"' in one
    assert 'SYMLINK+="trolley-lidar-2"' in other


def texts() -> list[str]:
    both = [seen(BOARD, "/dev/ttyACM0", **TEENSY), seen(LIDAR, "/dev/ttyUSB0", **CP2102)]
    return [udev_rules.render(both), EXAMPLE.read_text(encoding="utf-8")]


@pytest.mark.parametrize("text", texts(), ids=["written", "example"])
def test_the_grammar_is_udevs(text: str) -> None:
    for rule in rules(text):
        for part in rule.split(", "):
            assert PART.fullmatch(part), part


@pytest.mark.programs
@pytest.mark.skipif(shutil.which("udevadm") is None, reason="udevadm is not installed")
@pytest.mark.parametrize("text", texts(), ids=["written", "example"])
def test_udev_itself_accepts_it(text: str, tmp_path: Path) -> None:
    asked = subprocess.run(["udevadm", "verify", "--help"], capture_output=True, check=False)
    if asked.returncode != 0:
        pytest.skip("this udevadm is older than 254 and cannot verify rules")
    path = tmp_path / "99-trolley.rules"
    path.write_text(text)
    done = subprocess.run(
        ["udevadm", "verify", str(path)], capture_output=True, text=True, check=False
    )
    assert done.returncode == 0, done.stdout + done.stderr
