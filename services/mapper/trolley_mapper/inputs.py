"""What the mapper hears of the robot while it maps; nothing is listened to while it is idle."""

from collections.abc import Callable
from dataclasses import replace

from trolley import topics
from trolley.geometry import Pose2D
from trolley.messages import Odometry, Scan
from trolley.runtime.service import Service
from trolley.scanning import Reject, ScanAssembler, ScanInput

SILENT_S = 1.0
"""Time without a message after which a sensor is silent [s]."""


class RobotInputs:
    """Scans with the odometry that belongs to them.

    A new run of base begins its odometry at zero, but the robot has not moved: what comes here is
    continued from where it was.

    Args:
        service: that hears.
        heard: called when something came; `take` may have a scan then.
    """

    def __init__(self, service: Service, heard: Callable[[], None]) -> None:
        self._service = service
        self._heard = heard
        self._assembler = ScanAssembler()
        self.run_T_odom = Pose2D.identity()
        """From the odometry of the present run of base to the continued one."""
        self._newest: Pose2D | None = None
        self._is_new_run = False
        self.scan = service.watch(topics.SCAN, then=self._hear_scan)
        self.odometry = service.watch(topics.ODOM, seconds=2.0, then=self._hear_odometry)
        self.laser = service.watch(topics.TF, "laser")
        self._watches = [self.scan, self.odometry, self.laser]

    def close(self) -> None:
        """Hear nothing any more."""
        for watch in self._watches:
            self._service.close_watch(watch)

    def begin_epoch(self) -> None:
        """Take note that base started over."""
        self._assembler.clear()
        self._is_new_run = True

    def missing(self) -> list[str]:
        """Return the names of what a map cannot be made without and has not come."""
        needed = (
            ("clock", self._service.now_ns),
            ("scan", self.scan.latest),
            ("odom", self.odometry.latest),
            ("tf/laser", self.laser.latest),
        )
        return [name for name, known in needed if known is None]

    def silent(self) -> str | None:
        """Say what has fallen silent, in a sentence."""
        now_ns, service = self._service.monotonic_ns, self._service
        if service.now_ns is None:
            return "The robot's base is silent; the map does not grow."
        # A simulation that cannot keep up sends as little more rarely.
        patience_ns = SILENT_S * 1e9 / min(service.time_of(service.robot).rate, 1.0)
        for what, watch in (("lidar", self.scan), ("odometry", self.odometry)):
            arrived_ns = watch.arrived_ns
            if arrived_ns is None or now_ns - arrived_ns > patience_ns:
                return f"The {what} is silent; the map does not grow."
        return None

    def _hear_scan(self, scan: Scan) -> None:
        self._assembler.add(scan, self._service.monotonic_ns)
        self._heard()

    def _hear_odometry(self, _: Odometry) -> None:
        self._heard()

    def take(self) -> list[ScanInput]:
        """Return the scans that are complete by now, oldest first."""
        service = self._service
        rate = service.time_of(service.robot).rate
        found = self._assembler.take(
            self.odometry.history, self.laser.latest, service.monotonic_ns, rate
        )
        for reject in found:
            if isinstance(reject, Reject):
                service.count(f"scan/{reject.name.lower()}")
        return [self._continue(scan) for scan in found if isinstance(scan, ScanInput)]

    def continued(self, odom_T_base: Pose2D) -> Pose2D:
        """Return odometry of the present run of base as the continuation of those before."""
        return self.run_T_odom @ odom_T_base

    def newest(self) -> Pose2D | None:
        """Return the newest odom_T_base, continued; None until a new run of base has a scan."""
        latest = self.odometry.latest
        return None if latest is None or self._is_new_run else self.continued(latest.pose)

    def _continue(self, scan: ScanInput) -> ScanInput:
        """Put a scan's odometry on as the continuation of the runs of base before."""
        if self._is_new_run and self._newest is not None:
            self.run_T_odom = self._newest @ scan.odom_T_base.inverse()
        self._is_new_run = False
        self._newest = self.continued(scan.odom_T_base_end)
        return replace(
            scan, odom_T_base=self.continued(scan.odom_T_base), odom_T_base_end=self._newest
        )
