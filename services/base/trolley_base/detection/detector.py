"""Probes all ports at the same time, and says what is wrong if nothing is found."""

import threading
from collections.abc import Callable, Sequence
from concurrent.futures import Future, ThreadPoolExecutor, as_completed
from dataclasses import replace

from trolley.network_ports import explain_network, is_network
from trolley.serial_diagnosis import explain, holders, modem_manager_warning
from trolley_base.detection.network import NetworkProbePort
from trolley_base.detection.ports import Port
from trolley_base.detection.probe import Interrupted, Probe, ProbePort
from trolley_base.detection.results import FoundDevice, PortResult

MOST_AT_ONCE = 16
"""Ports that are probed at the same time."""


def detect_devices(
    ports: Sequence[Port], report: Callable[[PortResult, int], None]
) -> list[PortResult]:
    """Find out what is plugged in where.

    Args:
        ports: where to look.
        report: is given what was found at a port, and how many ports are still being probed.

    Returns:
        What was seen, in the order of the ports.

    Raises:
        KeyboardInterrupt: the person did not want to wait; the devices are left as they were.
    """
    if not ports:
        return []
    interrupt = threading.Event()
    seen: dict[str, PortResult] = {}
    with ThreadPoolExecutor(min(len(ports), MOST_AT_ONCE)) as pool:
        probes: list[Future[PortResult]] = [
            pool.submit(detect_device, port, interrupt) for port in ports
        ]
        try:
            for done in as_completed(probes):
                result = done.result()
                seen[result.port.device] = result
                report(result, len(ports) - len(seen))
        except KeyboardInterrupt:
            interrupt.set()
            raise
    return [seen[port.device] for port in ports]


def detect_device(port: Port, interrupt: threading.Event) -> PortResult:
    """Find out what is plugged in at one port; takes up to about 11 s.

    Args:
        port: where to look.
        interrupt: set when the probe is to end early.
    """
    if is_network(port.name):
        return _detect_in_network(port, interrupt)
    warning = modem_manager_warning(port.name)
    problems = () if warning is None else (warning,)
    if port.twin_serial:
        problems += (
            f"Another adapter here has the same serial number {port.twin_serial}: only the USB "
            f"socket tells them apart.",
        )
    # A login shell or another driver that has not locked the port would eat the answers.
    taken = holders(port.device)
    if taken.seen:
        busy = f"It is in use {taken.in_words(port.name)}; end that program first."
        return PortResult(port, None, (*problems, busy))
    try:
        opened = ProbePort(port.device, Probe.OPENING)
    except OSError as error:
        return PortResult(port, None, (*problems, explain(port.name, error)))
    probe = Probe(opened, interrupt)
    try:
        found = probe.identify()
    except OSError as error:
        return PortResult(port, None, (*problems, explain(port.name, error)))
    except Interrupted:
        return PortResult(port, None, problems)
    finally:
        opened.close()
    if found is None:
        return PortResult(port, None, (*problems, _why_nothing(probe.received)))
    return PortResult(port, replace(found, problems=()), (*problems, *found.problems))


def _detect_in_network(port: Port, interrupt: threading.Event) -> PortResult:
    """Find out who is at an address, or calls."""
    try:
        opened = NetworkProbePort(port.name)
    except OSError as error:
        return PortResult(port, None, (explain_network(port.name, error),))
    except ValueError as error:
        return PortResult(port, None, (f"{error}.",))
    probe = Probe(opened, interrupt)
    try:
        found = probe.identify_in_network(only_listens=opened.only_listens)
    except OSError as error:
        return PortResult(port, None, (explain_network(port.name, error),))
    except Interrupted:
        return PortResult(port, None)
    finally:
        opened.close()
    if found is None:
        return PortResult(port, None, (_why_nobody(sum(probe.received.values())),))
    return PortResult(port, replace(found, problems=()), found.problems)


def _why_nobody(received: int) -> str:
    """Say what may be wrong if nobody known is in the network where it should be."""
    if received:
        return f"{received} bytes came, but not those of a device that Trolley knows there."
    return (
        "Nobody answers or calls: has the device power, is it in this computer's network, and has "
        "it been given this computer's address, where it calls?"
    )


def _why_nothing(received: dict[int, int]) -> str:
    """Say what may be wrong if no known device answered."""
    most = max(received.values(), default=0)
    if most == 0:
        return (
            "Nothing answers: does the device have power, is the cable a data cable (not "
            "charge-only), and is it a board or lidar that Trolley knows?"
        )
    amounts = " and ".join(f"{count} at {baud} baud" for baud, count in received.items())
    return (
        f"Bytes arrive ({amounts}), but not those of a device that Trolley knows: another model, "
        f"or another baud rate?"
    )


def devices_of(seen: Sequence[PortResult], kind: str) -> list[tuple[Port, FoundDevice]]:
    """Return the devices of a kind that Trolley can use, with their ports."""
    return [
        (one.port, one.found)
        for one in seen
        if one.found is not None and one.found.kind == kind and one.found.model is not None
    ]
