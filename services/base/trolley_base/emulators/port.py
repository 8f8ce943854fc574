"""A device behind its port: what the host writes reaches it, what it sends is paced and spoilt."""

import math
from collections import deque
from collections.abc import Callable

import numpy as np

from trolley_base.emulators.arduino_bridge import ArduinoBridge
from trolley_base.emulators.calling_port import CallingPort
from trolley_base.emulators.create2 import Create2
from trolley_base.emulators.device import Board, Device
from trolley_base.emulators.faults import Damage, Fault, trouble_of
from trolley_base.emulators.lidar import BadView, SpinningLidar
from trolley_base.emulators.line import Line, misheard
from trolley_base.emulators.linorobot import Linorobot
from trolley_base.emulators.linorobot2 import Linorobot2
from trolley_base.emulators.pseudo_terminal import PseudoTerminal
from trolley_base.emulators.socket_port import SocketPort
from trolley_base.world import Simulation

MOST_WRITES = 20_000
RESET_NS = 1_000_000_000
"""A board whose supply breaks down restarts about so often [ns]."""
USB_BAUD = 4_000_000
"""As fast as a small board on USB of its own."""
BAUD_TOLERANCE = 0.03
"""Two ends of a line understand each other up to this difference, as a share."""


class DevicePort:
    """One device with its terminal.

    Args:
        name: of the port.
        device: what is behind it.
        terminal: where the host finds it.
        rng: source of what faults add.
        tell: called with a line for a person.
    """

    def __init__(
        self,
        name: str,
        device: Device,
        terminal: PseudoTerminal | SocketPort | CallingPort,
        rng: np.random.Generator,
        tell: Callable[[str], None],
    ) -> None:
        self.name = name
        self.device = device
        self.terminal = terminal
        self.writes: deque[tuple[int, bytes]] = deque(maxlen=MOST_WRITES)
        """What the host wrote: monotonic time [ns], bytes."""
        pace = USB_BAUD if device.is_usb else device.baud
        self._line = Line(pace, device.buffer_bytes)
        self._damage = Damage(pace, rng)
        self._faults: dict[str, Fault] = {}
        self._tell = tell
        self._reset_ns = 0
        self._reported_baud: int | None = None

    @property
    def dropped(self) -> int:
        """Bytes that the device could not send, its line being full."""
        return self._line.dropped

    def set_faults(self, faults: dict[str, Fault], now_ns: int) -> None:
        """Say what is wrong from now on."""
        before, self._faults = self._faults, faults
        device = self.device
        device.is_stuck = "stuck" in faults
        if ("unplug" in faults) != ("unplug" in before):
            device.restart(now_ns)
            self._line.clear()
            if "unplug" in faults:
                self.terminal.unplug()
            else:
                self.terminal.plug()
        if isinstance(device, Linorobot | Linorobot2):
            self._change_firmware(device, before, now_ns)
        if isinstance(device, Board):
            trouble = trouble_of(faults)
            if trouble != device.motors.trouble:
                device.motors.trouble = trouble
            device.leaps = "jump" in faults
        self.terminal.refuse(is_refused="refuse" in faults)
        if isinstance(device, SpinningLidar):
            amounts = {kind: fault.amount for kind, fault in faults.items()}
            device.bad_view = BadView(
                blind=math.radians(amounts.get("blind", 0.0)),
                failing=amounts.get("fail", 0.0),
                is_covered="cover" in faults,
            )
        if isinstance(device, ArduinoBridge):
            device.wired = dict(fault.pin for fault in faults.values() if fault.kind == "pin")
        if isinstance(device, Create2):
            device.felt = frozenset(one.pin[0] for one in faults.values() if one.kind == "feels")

    def _change_firmware(
        self, device: Linorobot | Linorobot2, before: dict[str, Fault], now_ns: int
    ) -> None:
        faults = self._faults
        device.says_nan = "nan" in faults
        device.inertial.gyro_factor = faults["gyro"].amount if "gyro" in faults else 1.0
        if device.has_wrong_md5 != ("md5" in faults):
            device.has_wrong_md5 = not device.has_wrong_md5
            device.restart(now_ns)  # it has been flashed
        if isinstance(device, Linorobot2) and "session" in faults and "session" not in before:
            device.join_another_agent()

    def look(self, now_ns: int) -> None:
        """Notice a host that opens the port or lets go of it."""
        was_open = self.terminal.is_open
        if self.terminal.look():
            self._line.clear()
            self._reported_baud = None
            self._tell(f"{self.name}: the host opened the port")
            self.device.opened(now_ns)
        elif was_open and not self.terminal.is_open:
            self._tell(f"{self.name}: the host closed the port")

    def listen(self, now_ns: int) -> None:
        """Take what the host has written."""
        data = self.terminal.read()
        if data:
            self.writes.append((now_ns, data))
            host_baud = self._host_baud()
            if host_baud is not None:
                data = misheard(data, host_baud, self.device.baud)
            self.device.receive(data, now_ns)
            self._collect(now_ns, now_ns)

    def step(self, simulation: Simulation, from_ns: int, to_ns: int) -> None:
        """Let the device live through a step of the world."""
        if "reset" in self._faults and to_ns - self._reset_ns >= RESET_NS:
            self._reset_ns = to_ns
            self._tell(f"{self.name}: it restarts")
            self.device.restart(to_ns)
        if self.terminal.is_plugged:
            self.device.step(simulation, from_ns, to_ns)
            self._collect(from_ns, to_ns)

    def talk(self, now_ns: int) -> None:
        """Hand over to the host what has passed the line."""
        data = self._line.take(now_ns)
        if self.terminal.is_open:
            host_baud = self._host_baud() if data else None
            if host_baud is not None:
                data = misheard(data, self.device.baud, host_baud)
            self.terminal.write(data)

    def _collect(self, from_ns: int, to_ns: int) -> None:
        frames = self.device.take_frames()
        for remark in self.device.take_remarks():
            self._tell(f"{self.name}: {remark}")
        if not self.terminal.is_open:
            return
        for frame in self._damage.apply(frames, self._faults, from_ns, to_ns):
            self._line.push(frame.due_ns, frame.data)

    def _host_baud(self) -> int | None:
        """The host's speed where it is another than the device's, else None."""
        baud = self.terminal.host_baud()
        if self.device.is_usb or abs(baud / self.device.baud - 1.0) < BAUD_TOLERANCE:
            return None
        if baud != self._reported_baud:
            self._reported_baud = baud
            self._tell(f"{self.name}: the host works at {baud} baud, not {self.device.baud}")
        return baud
