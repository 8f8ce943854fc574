"""Lists serial ports, each with a name that does not change.

`/dev/ttyUSB0` is whichever adapter was found first. udev keeps links that last: by-id names the
adapter's serial number, by-path the socket that it is plugged into.
"""

import os
from collections import Counter
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

from serial.tools import list_ports

from trolley.network_ports import is_network
from trolley.serial_diagnosis import UDEV_DATA, udev_properties

DEVICES = Path("/dev")
CANDIDATES = ("serial/by-id/*", "serial/by-path/*", "ttyUSB*", "ttyACM*", "ttyAMA*", "serial0")
BLUETOOTH = "serial1"
"""On a Raspberry Pi this UART belongs to the Bluetooth chip."""
SHORTEST_SERIAL = 6
"""A chip's factory setting, such as 0001 of a CP2102, is shorter than a real serial number."""


@dataclass(frozen=True, slots=True)
class Port:
    """A serial port, or a device of the network by its address.

    Attributes:
        device: the device file itself, no link.
        name: what a configuration should call it.
        reason: why that name, one sentence; "" if there is nothing to say.
        description: what the adapter calls itself; "" if unknown.
        twin_serial: a serial number that it shares with another adapter here; "" if none.
        properties: what udev knows about it.
    """

    device: str
    name: str
    reason: str = ""
    description: str = ""
    twin_serial: str = ""
    properties: tuple[tuple[str, str], ...] = ()

    def property(self, name: str) -> str:
        """Return what udev knows, such as ID_PATH; "" if nothing."""
        return dict(self.properties).get(name, "")


def find_ports(
    given: Sequence[str] = (), devices: Path = DEVICES, udev_data: Path = UDEV_DATA
) -> list[Port]:
    """List ports, each once, however many names it has.

    Args:
        given: names of ports and addresses; the ports that could hold a device if there are none.
        devices: folder of the device files.
        udev_data: where udev stores what it knows about devices.
    """
    addresses = [Port(name, name) for name in dict.fromkeys(filter(is_network, given))]
    given = [name for name in given if not is_network(name)]
    if addresses and not given:
        return addresses
    links = _links(devices)
    every = {os.path.realpath(path) for path in _candidates(devices)}
    wanted = list(dict.fromkeys(map(os.path.realpath, given))) if given else sorted(every)
    known = {device: udev_properties(device, udev_data) for device in {*every, *wanted}}
    serials = Counter(_identity(properties) for properties in known.values())
    spoken = {os.path.realpath(port.device): port.description for port in list_ports.comports()}
    called = {os.path.realpath(name): os.path.abspath(name) for name in given}
    ports: list[Port] = []
    for device in wanted:
        properties = known[device]
        is_twin = serials[_identity(properties)] > 1 and bool(properties.get("ID_SERIAL_SHORT"))
        named = called.get(device, device)
        name, reason = (
            _lasting_name(device, links.get(device, []), properties, is_twin=is_twin)
            if named == device
            else (named, "")
        )
        description = spoken.get(device, "")
        ports.append(
            Port(
                device=device,
                name=name,
                reason=reason,
                description="" if description == "n/a" else description,
                twin_serial=properties.get("ID_SERIAL_SHORT", "") if is_twin else "",
                properties=tuple(sorted(properties.items())),
            )
        )
    return [*ports, *addresses]


def has_own_serial(properties: dict[str, str]) -> bool:
    """Tell a real serial number from none and from a chip's factory setting."""
    return len(properties.get("ID_SERIAL_SHORT", "")) >= SHORTEST_SERIAL


def _candidates(devices: Path) -> Iterator[Path]:
    bluetooth = os.path.realpath(devices / BLUETOOTH)
    for place in CANDIDATES:
        yield from (path for path in devices.glob(place) if os.path.realpath(path) != bluetooth)


def _links(devices: Path) -> dict[str, list[Path]]:
    """The lasting names of each device, the best first."""
    links: dict[str, list[Path]] = {}
    for place in ("serial/by-id/*", "serial/by-path/*"):
        # Newer systems have two by-path names for a socket; the older form works everywhere.
        for path in sorted(devices.glob(place), key=lambda path: ("-usbv" in path.name, path.name)):
            links.setdefault(os.path.realpath(path), []).append(path)
    return links


def _identity(properties: dict[str, str]) -> tuple[str, ...]:
    """What makes up a by-id name: two devices that agree in it fight for the link."""
    names = ("ID_VENDOR_ID", "ID_MODEL_ID", "ID_SERIAL_SHORT", "ID_USB_INTERFACE_NUM")
    return tuple(properties.get(name, "") for name in names)


def _lasting_name(
    device: str, links: list[Path], properties: dict[str, str], *, is_twin: bool
) -> tuple[str, str]:
    """Choose a port's name, and say why in a sentence."""
    by_id = [str(path) for path in links if path.parent.name == "by-id"]
    by_path = [str(path) for path in links if path.parent.name == "by-path"]
    if by_id and has_own_serial(properties) and not is_twin:
        return by_id[0], "Named by its serial number: it stays the same in any USB socket."
    if by_path:
        serial = properties.get("ID_SERIAL_SHORT")
        if is_twin:
            why = f"another adapter here has the serial number {serial} too"
        elif serial:
            why = f"its serial number {serial} is one that many adapters have"
        else:
            why = "it has no serial number"
        return by_path[0], f"Named by its USB socket, since {why}: leave it plugged in there."
    if by_id:
        return by_id[0], "Named by what it is: a second adapter of this kind would look the same."
    if Path(device).name.startswith(("ttyUSB", "ttyACM")):
        return device, "No permanent name is known (no udev here): this one may change."
    return device, ""
