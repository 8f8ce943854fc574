"""A udev rule that gives the robot's two ports names of their own and keeps ModemManager away.

Source:
    udev(7); ModemManager, "Port and device ignoring" (ID_MM_DEVICE_IGNORE, ID_MM_PORT_IGNORE).
"""

import re
from collections.abc import Sequence
from pathlib import Path

from trolley.network_ports import is_network
from trolley_base.detection.detector import devices_of
from trolley_base.detection.ports import Port, has_own_serial
from trolley_base.detection.results import PortResult

FILE = Path("/etc/udev/rules.d/99-trolley.rules")
NAMES = {"board": "trolley-chassis", "lidar": "trolley-lidar"}
PLAIN = re.compile(r"[A-Za-z0-9_.:@/+-]+")
"""Characters that need no escaping between quotes in a rule."""

HEAD = """\
# Names that stay for the serial ports of a robot: /dev/trolley-chassis and /dev/trolley-lidar.
# Written by `trolley detect --udev`. Install:
#   sudo cp {source} {file}
#   sudo udevadm control --reload && sudo udevadm trigger --subsystem-match=tty
"""
RULE = (
    'SUBSYSTEM=="tty", {match}, SYMLINK+="{name}", TAG+="systemd", GROUP="dialout", MODE="0660", '
    'ENV{{ID_MM_DEVICE_IGNORE}}="1", ENV{{ID_MM_PORT_IGNORE}}="1"'
)


def render(seen: Sequence[PortResult], source: str = "99-trolley.rules") -> str:
    """Return the rule's text.

    Args:
        seen: what was found where.
        source: the file that the person saves it in.
    """
    lines: list[str] = []
    for kind, name in NAMES.items():
        found = [one for one in devices_of(seen, kind) if not is_network(one[0].device)]
        for port, device in found:
            # Two devices of a kind cannot both have its name.
            own_name = name if len(found) == 1 else f"{name}-{found.index((port, device)) + 1}"
            match, why = _match(port)
            lines += ["", f"# {device.title}: {why}"]
            lines += [RULE.format(match=match, name=own_name)] if match else []
    return HEAD.format(source=source, file=FILE) + "\n".join(lines) + "\n"


def _match(port: Port) -> tuple[str, str]:
    """Return a rule's match for a port, and its description; no match if nothing identifies it."""
    serial, vendor = port.property("ID_SERIAL_SHORT"), port.property("ID_VENDOR_ID")
    model, path = port.property("ID_MODEL_ID"), port.property("ID_PATH")
    is_usable = all(PLAIN.fullmatch(text) for text in (serial, vendor, model))
    if has_own_serial(dict(port.properties)) and not port.twin_serial and is_usable:
        match = (
            f'ENV{{ID_VENDOR_ID}}=="{vendor}", ENV{{ID_MODEL_ID}}=="{model}", '
            f'ENV{{ID_SERIAL_SHORT}}=="{serial}"'
        )
        number = port.property("ID_USB_INTERFACE_NUM")
        if number:
            match += f', ENV{{ID_USB_INTERFACE_NUM}}=="{number}"'
        return match, "known by its serial number, in any USB socket."
    if PLAIN.fullmatch(path):
        return f'ENV{{ID_PATH}}=="{path}"', "known by its USB socket; leave it plugged in there."
    name = Path(port.device).name
    if name.startswith(("ttyAMA", "ttyS")):
        return f'KERNEL=="{name}"', "this computer's own UART."
    return "", f"udev knows nothing about {port.device} that identifies it."
