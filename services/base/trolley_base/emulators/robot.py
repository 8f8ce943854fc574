"""A robot whose boards and lidars are programs behind pseudo terminals, in a simulated world.

    with EmulatedRobot(["linorobot", "ld19"], RobotInWorld(load_world(path), seed=7)) as robot:
        serial.Serial(str(robot.ports["ld19"]), 230400)
        robot.fault("ld19:silence+2")
        robot.truth().pose

One thread steps the world by the monotonic clock, each step at its beginning, so that what happens
within it reaches the line at its own moment. Delays are caught up on; no step is left out.
"""

import select
import threading
import time
from collections.abc import Callable, Mapping, Sequence
from contextlib import ExitStack
from dataclasses import dataclass, field
from pathlib import Path
from tempfile import TemporaryDirectory
from types import MappingProxyType, TracebackType
from typing import Literal, Self

import numpy as np
from numpy.typing import NDArray

from trolley.geometry import Pose2D, Twist2D, footprint_from_box
from trolley.network_ports import MOST_PORT
from trolley_base.emulators.calling_port import CallingPort
from trolley_base.emulators.catalogue import make_devices
from trolley_base.emulators.device import Board, DeviceError, ReceivedCommand
from trolley_base.emulators.faults import FaultPlan, parse_fault
from trolley_base.emulators.lidar import Mount
from trolley_base.emulators.port import DevicePort
from trolley_base.emulators.pseudo_terminal import PseudoTerminal
from trolley_base.emulators.socket_port import SocketPort
from trolley_base.emulators.surroundings import Surroundings, WheelFacts
from trolley_base.world import (
    STEP_NS,
    LidarSpec,
    RobotBody,
    Shots,
    Simulation,
    TrueState,
    WorldError,
)
from trolley_base.world.world_file import World

TICK_MS = 2
"""The longest wait: bytes are sent in portions of this many ms."""
MOST_STEPS = 10
"""Steps made up for at once; then the ports have their turn."""
HOPELESS_NS = 1_000_000_000
COMPLAIN_NS = 10_000_000_000
_IDLE_LIDAR = LidarSpec(beams=8, rate_hz=1.0)
"""The emulated lidars measure by themselves; the simulation's own does as little as possible."""


@dataclass(frozen=True, slots=True, eq=False)
class RobotInWorld:
    """The robot behind the devices, and where it is.

    Attributes:
        world: what it drives in.
        seed: fixes all noise and where people walk at first.
        start: map_T_base; None: as the world says.
        footprint: (n, 2) corners [m] in `base_link`, counter-clockwise.
        mount: how the lidars sit on it.
        wheels: of a board that counts ticks.
    """

    world: World
    seed: int = 0
    start: Pose2D | None = None
    footprint: NDArray[np.float64] = field(default_factory=lambda: footprint_from_box(0.30, 0.24))
    mount: Mount = field(default_factory=lambda: Mount(Pose2D.identity()))
    wheels: WheelFacts = field(default_factory=WheelFacts)


class EmulatedRobot:
    """Devices on ports, from `__enter__` to `__exit__`.

    Args:
        devices: such as "ld19" or "linorobot:quiet"; at most one motor board.
        body: the robot and its world.
        folder: where the ports' links are made; None: a temporary folder.
        tell: called with each line for a person, on the emulator's thread.
        network: the devices that are reached over the network, such as {"hokuyo_urg": "tcp:10940"};
            port 0 is any that is free. A board that calls its host sends to that port, over UDP.

    Raises:
        DeviceError: there is no such device or option.
        WorldError: the robot would stand in something solid, or off the map.
        PortError: a port's name is taken.
    """

    def __init__(
        self,
        devices: Sequence[str],
        body: RobotInWorld,
        folder: Path | None = None,
        tell: Callable[[str], None] = lambda line: None,
        network: Mapping[str, str] = MappingProxyType({}),
    ) -> None:
        spec = body.world.spec
        robot = RobotBody(body.footprint, body.mount.base_T_laser, lidar=_IDLE_LIDAR)
        self.body = body
        self.devices = make_devices(
            devices, Surroundings(body.mount, spec.lidar, body.wheels), body.seed
        )
        self._simulation = Simulation(spec, body.world.grid, robot, body.seed, body.start)
        self._network = {name: _parse_network(text) for name, text in network.items()}
        if unknown := set(network) - set(self.devices):
            raise DeviceError(f"there is no {' or '.join(sorted(unknown))} to be in the network")
        for name, (kind, number) in self._network.items():
            if self.devices[name].calls_host and (kind == "tcp" or number == 0):
                raise DeviceError(f"{name} sends to a port of its host: write {name}=udp:8888")
        start = self._simulation.truth().pose
        if not body.world.grid.contains(start.as_array()[None, :2])[0]:
            raise WorldError(
                f"the start at x = {start.x:g}, y = {start.y:g} lies outside of the map "
                f"{body.world.map_file}; choose another"
            )
        _compile(Simulation(spec, body.world.grid, robot, body.seed, body.start))
        self._folder = folder
        self._tell = tell
        self._plan = FaultPlan()
        self._lock = threading.RLock()
        self._undo = ExitStack()
        self._ports: dict[str, DevicePort] = {}
        self._poll = select.poll()
        self._polled: set[int] = set()
        self._end = threading.Event()
        self._thread = threading.Thread(target=self._run, name="emulator", daemon=True)
        self._began_ns = self._complained_ns = 0
        self._state = self._simulation.truth()

    def __enter__(self) -> Self:
        with ExitStack() as undo:
            folder = self._folder
            if folder is None:
                folder = Path(undo.enter_context(TemporaryDirectory(prefix="trolley-ports-")))
            folder.mkdir(parents=True, exist_ok=True)
            seeds = np.random.SeedSequence(self.body.seed).spawn(len(self.devices))
            for (name, device), seed in zip(self.devices.items(), seeds, strict=True):
                rng = np.random.default_rng(seed)
                terminal = self._terminal(name, folder)
                port = DevicePort(name, device, terminal, rng, self._remark)
                undo.callback(port.terminal.unplug)
                self._ports[name] = port
            self._began_ns = time.monotonic_ns()
            for device in self.devices.values():
                device.restart(self._began_ns)
                device.take_frames()  # it was switched on before anybody could open its port
            self._thread.start()
            self._undo = undo.pop_all()
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        self._end.set()
        self._thread.join()
        self._undo.close()

    def _terminal(self, name: str, folder: Path) -> PseudoTerminal | SocketPort | CallingPort:
        device = self.devices[name]
        if name not in self._network:
            return PseudoTerminal(folder / name, device.baud)
        kind, number = self._network[name]
        if device.calls_host:
            return CallingPort(number, device.baud)
        return SocketPort(kind, number, device.baud)

    @property
    def ports(self) -> Mapping[str, Path]:
        """The names under which the host finds the devices on serial ports, by device."""
        return {
            name: port.terminal.link
            for name, port in self._ports.items()
            if isinstance(port.terminal, PseudoTerminal)
        }

    @property
    def addresses(self) -> Mapping[str, str]:
        """What the host writes for those in the network, such as `tcp://127.0.0.1:10940`."""
        return {
            name: port.terminal.address
            for name, port in self._ports.items()
            if not isinstance(port.terminal, PseudoTerminal)
        }

    @property
    def terminals(self) -> Mapping[str, str]:
        """The terminals' own names, such as /dev/pts/5; "" while unplugged."""
        with self._lock:
            return {name: port.terminal.device for name, port in self._ports.items()}

    def check(self) -> None:
        """Raise RuntimeError if the emulator's thread has died of an error."""
        if self._began_ns and not (self._thread.is_alive() or self._end.is_set()):
            raise RuntimeError("the emulator has died; what of stands above")

    def fault(self, text: str) -> None:
        """Trigger a fault, written as in `faults`.

        Raises:
            FaultError: it cannot be parsed.
        """
        fault = parse_fault(text, self.devices)
        with self._lock:
            self._plan.add(fault, self._elapsed_s)

    def truth(self) -> TrueState:
        """Return the true state; `stamp_ns` is local monotonic time."""
        self.check()
        with self._lock:
            return self._state

    def carry(self, pose: Pose2D) -> None:
        """Put the robot somewhere else; its wheels do not notice."""
        with self._lock:
            self._simulation.lift_robot(pose)

    def commands(self) -> tuple[ReceivedCommand, ...]:
        """Return the newest commands that the board has understood, oldest first."""
        with self._lock:
            boards = [one for one in self.devices.values() if isinstance(one, Board)]
            return tuple(boards[0].commands) if boards else ()

    def writes(self, name: str) -> tuple[tuple[int, bytes], ...]:
        """Return what the host wrote to a port: local monotonic time [ns], bytes."""
        with self._lock:
            return tuple(self._ports[name].writes)

    def dropped(self, name: str) -> int:
        """Return how many bytes a device could not send, its line being full."""
        with self._lock:
            return self._ports[name].dropped

    @property
    def _elapsed_s(self) -> float:
        return (time.monotonic_ns() - self._began_ns) * 1e-9 if self._began_ns else 0.0

    def _remark(self, text: str) -> None:
        self._tell(f"{self._elapsed_s:8.2f} s  {text}")

    def _run(self) -> None:
        while not self._end.is_set():
            self._poll.poll(TICK_MS)
            with self._lock:
                self._pass()

    def _pass(self) -> None:
        now_ns = time.monotonic_ns()
        self._change_faults(now_ns)
        for port in self._ports.values():
            port.look(now_ns)
            port.listen(now_ns)
        self._catch_up(now_ns)
        for port in self._ports.values():
            port.talk(now_ns)
        self._wait_for_hosts()

    def _change_faults(self, now_ns: int) -> None:
        changes = self._plan.advance((now_ns - self._began_ns) * 1e-9)
        for fault, begins in changes:
            what = f"begins ({fault.text})" if begins else "ends"
            self._remark(f"{fault.device}: {fault.kind} {what}")
        for name in {fault.device for fault, _ in changes}:
            self._ports[name].set_faults(self._plan.of(name), now_ns)

    def _catch_up(self, now_ns: int) -> None:
        """Step the world until its time is that of the clock; the present step is the last one."""
        simulation = self._simulation
        for _ in range(MOST_STEPS):
            from_ns = self._began_ns + simulation.now_ns
            if from_ns > now_ns:
                break
            simulation.step(self._wheels())
            for port in self._ports.values():
                port.step(simulation, from_ns, from_ns + STEP_NS)
            state = simulation.truth()
            self._state = TrueState(
                from_ns + STEP_NS,
                state.pose,
                state.twist,
                state.collisions,
                state.bumps,
                state.clearance,
            )
        late_ns = now_ns - self._began_ns - simulation.now_ns
        if late_ns > HOPELESS_NS and now_ns - self._complained_ns > COMPLAIN_NS:
            self._complained_ns = now_ns
            self._remark(f"the world is {late_ns * 1e-9:.1f} s late: this computer is too busy")

    def _wheels(self) -> Twist2D:
        for port in self._ports.values():
            if isinstance(port.device, Board) and port.terminal.is_plugged:
                return port.device.motors.driven(port.device.wheels(), STEP_NS * 1e-9)
        return Twist2D.zero()

    def _wait_for_hosts(self) -> None:
        """Let the next wait end when a host writes; a port that nobody has open ends it at once."""
        numbers = {port.terminal.fileno for port in self._ports.values()}
        wanted = {number for number in numbers if number is not None}
        for number in self._polled - wanted:
            self._poll.unregister(number)
        for number in wanted - self._polled:
            self._poll.register(number, select.POLLIN)
        self._polled = wanted


def _compile(rehearsal: Simulation) -> None:
    """Call every kernel once, before anybody waits for bytes."""
    rehearsal.step(Twist2D.zero())
    one = np.zeros(1)
    rehearsal.measure(Pose2D.identity(), Shots(one, one, one, 1.0))


def _parse_network(text: str) -> tuple[Literal["tcp", "udp"], int]:
    match text.partition(":"):
        case ("tcp" | "udp" as kind, ":", number) if (
            number.isdecimal() and int(number) <= MOST_PORT
        ):
            return kind, int(number)
        case _:
            raise DeviceError(f"{text} is no place in the network: write tcp:PORT or udp:PORT")
