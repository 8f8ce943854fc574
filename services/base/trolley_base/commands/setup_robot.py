"""The robot as the setup wants it: its devices opened, and driven while a hand is on Stop."""

import contextlib
import queue
import time
from collections.abc import Callable, Generator, Sequence
from typing import Protocol

from trolley.config import RobotConfig
from trolley.geometry import Twist2D
from trolley.messages import Imu
from trolley_base.drivers import Hardware, LidarScan, MotionSample
from trolley_base.drivers.interface import ChassisReading, LidarReading
from trolley_base.drivers.real_device import RealDevice
from trolley_base.odometry.warmup import warm_up
from trolley_base.setup.person import Hand, StoppedByHand
from trolley_base.setup.record import SetupRefused

PERIOD_S = 0.025
UP_WITHIN_S = 20.0
"""Boards boot, and lidars have to gather speed."""
STEADY_S = 1.0
"""Both devices must have answered for so long."""
PATIENCE_S = 1.5
"""A device that has failed for so long ends drive or look; until then zero is commanded."""
STANDING_S = 0.4
"""At the end, zero is commanded for this long."""


class Machine(Protocol):
    """What drives: a wheel trial, or the drive that measures."""

    problem: str | None

    @property
    def has_ended(self) -> bool:
        """Whether it is over."""
        ...

    def give_up(self, problem: str) -> None:
        """End it, with the reason."""
        ...


Step = Callable[[int, Sequence[MotionSample], Sequence[LidarScan], Sequence[Imu]], Twist2D]


class OpenRobot:
    """Board and lidar of the configuration, opened for this process alone.

    While a person is asked nobody listens to them, so they are closed then.
    """

    def __init__(self, config: RobotConfig) -> None:
        warm_up()  # while it compiles nobody would listen to the board
        self._device = RealDevice(config)
        if self._device.cannot_drive:
            raise SetupRefused(self._device.cannot_drive)
        self.watchdog_s = self._device.watchdog_s
        self._calls: queue.SimpleQueue[Callable[[], None]] = queue.SimpleQueue()

    @contextlib.contextmanager
    def opened(self) -> Generator["OpenRobot"]:
        """Open the ports, and wait until both devices answer; whatever happens, it stands then.

        Raises:
            SetupRefused: one of them does not answer, with what its link says.
        """
        begun_ns = time.monotonic_ns()
        opened = self._device.open(begun_ns, None, lambda ns: ns, self._calls.put)
        self._hardware: Hardware = opened.hardware
        try:
            self._wait_until_up()
            yield self
        finally:
            self._hardware.close()

    def run(self, machine: Machine, step: Step, doing: Callable[[], str], hand: Hand) -> None:
        """Let a machine drive until it has ended, or a hand stops it.

        Raises:
            SetupRefused: it was given up, with the reason.
            StoppedByHand: the hand has stopped it.
        """
        try:
            well_ns = time.monotonic_ns()
            while not machine.has_ended:
                chassis, lidar = self._read()
                now_ns = time.monotonic_ns()
                trouble = _trouble_of(chassis, lidar)
                if not trouble:
                    well_ns = now_ns
                elif chassis.alarms or now_ns - well_ns > PATIENCE_S * 1e9:
                    machine.give_up(trouble)
                twist = step(now_ns, chassis.motions, lidar.scans, chassis.imu)
                if hand.is_stopped:
                    self._hardware.chassis.drive(Twist2D.zero())
                    raise StoppedByHand
                self._hardware.chassis.drive(Twist2D.zero() if trouble else twist)
                hand.show(doing())
                time.sleep(PERIOD_S)
        finally:
            self.stand()
        if machine.problem is not None:
            raise SetupRefused(machine.problem)

    def look(self, count: int) -> list[LidarScan]:
        """Return the next scans, standing.

        Raises:
            SetupRefused: a device has failed for longer than a moment, or the lidar is silent.
        """
        scans: list[LidarScan] = []
        well_s = time.monotonic()
        end_s = well_s + UP_WITHIN_S
        while len(scans) < count:
            chassis, lidar = self._read()
            now_s = time.monotonic()
            trouble = _trouble_of(chassis, lidar)
            if not trouble:
                well_s = now_s
            elif chassis.alarms or now_s - well_s > PATIENCE_S:
                raise SetupRefused(trouble)
            if now_s > end_s:
                raise SetupRefused("The lidar sends no scans.")
            self._hardware.chassis.drive(Twist2D.zero())
            scans.extend(lidar.scans)
            time.sleep(PERIOD_S)
        return scans

    def stand(self) -> None:
        """Command zero for a moment."""
        end_s = time.monotonic() + STANDING_S
        while time.monotonic() < end_s:
            self._read()
            self._hardware.chassis.drive(Twist2D.zero())
            time.sleep(PERIOD_S)

    def _wait_until_up(self) -> None:
        begun_s = down_s = time.monotonic()
        while True:
            chassis, lidar = self._read()
            self._hardware.chassis.drive(Twist2D.zero())
            down = [one.link for one in (chassis, lidar) if one.link.state != "up"]
            now_s = time.monotonic()
            if down:
                down_s = now_s
            elif now_s - down_s > STEADY_S:
                return
            if down and now_s > begun_s + UP_WITHIN_S:
                what = "motor board" if down[0].name == chassis.link.name else "lidar"
                why = down[0].message or "it does not answer."
                raise SetupRefused(f"The {what} is not ready: {why}")
            time.sleep(PERIOD_S)

    def _read(self) -> tuple[ChassisReading, LidarReading]:
        with contextlib.suppress(queue.Empty):
            while True:
                self._calls.get_nowait()()
        self._hardware.advance(time.monotonic_ns())
        return self._hardware.chassis.read(), self._hardware.lidar.read()


def _trouble_of(chassis: ChassisReading, lidar: LidarReading) -> str:
    """Say why nothing may be driven, "" if it may."""
    if chassis.alarms:
        return f"The motor board reports: {', '.join(chassis.alarms)}."
    for what, link in (("motor board", chassis.link), ("lidar", lidar.link)):
        if link.state != "up":
            return f"The {what} has failed: {link.message or link.state}"
    return ""
