"""The robot as the calibration's drive wants it: its messages in, 20 commands a second out."""

import time
from contextlib import ExitStack

import numpy as np

from trolley import codes, topics
from trolley.cli.show import Progress
from trolley.client import Robot
from trolley.codes import Refused
from trolley.geometry import Twist2D, circumscribed_radius
from trolley.laser_scan import LaserScan
from trolley.messages import VelocityCommand
from trolley_base.calibration import CalibrationDrive, Comparison, Place, find_obstacle
from trolley_base.calibration.drive import SOURCE

CONTROL_PERIOD_S = 0.05
VALID_S = 0.3
STANDING_S = 0.3
"""At the end, zero is commanded for this long, and then nothing."""
WAIT_S = 5.0


def refuse_unready(robot: Robot, *, needs_pose: bool) -> None:
    """Refuse to drive a robot that is stopped, busy, or lost.

    Raises:
        Refused: with the code and what to do.
    """
    base = robot.latest(topics.BASE)
    if base is None:
        raise Refused(codes.NOT_READY, "There is no base.", service="base")
    if base.mode != "ok":
        raise Refused(base.reason or base.mode, base.message or f"Base is {base.mode}.")
    if base.source is not None:
        raise Refused(codes.TAKEN_OVER, f"{base.source} is driving the robot; stop that first.")
    if not needs_pose:
        return
    estimate = robot.pose()
    if estimate.state != "localized":
        raise Refused(
            codes.NOT_LOCALIZED,
            f"The localizer is {estimate.state}; set the pose, or measure yourself with --by-hand.",
        )


def refuse_narrow(robot: Robot, places: list[Place]) -> None:
    """Refuse a course that something stands in, as far as the lidar sees it from here.

    Raises:
        Refused: `blocked`, with where; `not_ready` without a scan.
    """
    about, laser = robot.latest(topics.ROBOT), robot.latest(topics.TF, "laser")
    scan = robot.latest(topics.SCAN)
    if about is None or laser is None or scan is None:
        raise Refused(codes.NOT_READY, "There is no scan to show whether there is room.")
    points = laser.pose.transform_points(LaserScan.of(scan).points())
    obstacle = find_obstacle(points, places, circumscribed_radius(np.array(about.footprint)))
    if obstacle is not None:
        x, y = obstacle
        raise Refused(
            codes.BLOCKED,
            f"Something is in the way, {x:.2f} m ahead and {y:.2f} m to the left of the robot. "
            "Give it more room or a shorter --side.",
        )


def drive_course(robot: Robot, drive: CalibrationDrive, title: str) -> None:
    """Drive the course to its end; whatever happens, the robot is stopped.

    Raises:
        Refused: `aborted`, with the reason.
    """
    progress = Progress()
    with ExitStack() as stack:
        stack.callback(progress.clear)
        live = stack.enter_context(_Live(robot))
        stack.callback(live.stand)
        while not drive.has_ended:
            live.tell(drive)
            now_ns = live.now_ns
            if now_ns is None:
                drive.give_up("base fell silent")
                break
            live.send(drive.step(now_ns), now_ns)
            progress.show(f"{title}: {drive.progress}", "driving")
            time.sleep(CONTROL_PERIOD_S)
    if drive.problem is not None:
        raise Refused(codes.ABORTED, f"The calibration was given up: {drive.problem}.")


def listen(robot: Robot, comparison: Comparison, seconds: float) -> None:
    """Compare for `seconds`; Ctrl-C ends it early."""
    progress = Progress()
    end_s = time.monotonic() + seconds
    with robot.subscribe(topics.ODOM) as odometry, robot.subscribe(topics.POSE) as poses:
        try:
            while (left_s := end_s - time.monotonic()) > 0.0:
                while (pose := poses.next(0.0)) is not None:
                    comparison.update_pose(pose.message)
                while (motion := odometry.next(0.0)) is not None:
                    comparison.update_odometry(motion.message)
                progress.show(f"{left_s:.0f} s left, {len(comparison.legs)} legs compared")
                time.sleep(CONTROL_PERIOD_S)
        except KeyboardInterrupt:
            pass  # what was heard so far is evaluated
        finally:
            progress.clear()


class _Live:
    """Subscriptions of one robot; a context manager."""

    def __init__(self, robot: Robot) -> None:
        self._robot = robot
        self._stack = ExitStack()
        self._stamp_ns = 0  # of the last command

    def __enter__(self) -> "_Live":
        enter, robot = self._stack.enter_context, self._robot
        self._odometry = enter(robot.subscribe(topics.ODOM))
        self._pose = enter(robot.subscribe(topics.POSE))
        self._base = enter(robot.subscribe(topics.BASE))
        end_s = time.monotonic() + WAIT_S
        while self.now_ns is None and time.monotonic() < end_s:
            time.sleep(CONTROL_PERIOD_S)
        return self

    def __exit__(self, *_: object) -> None:
        self._stack.close()

    @property
    def now_ns(self) -> int | None:
        """Robot time, None while base is silent."""
        return self._robot.now_ns()

    def tell(self, drive: CalibrationDrive) -> None:
        """Hand over what has arrived."""
        while (motion := self._odometry.next(0.0)) is not None:
            drive.update_odometry(motion.message)
        while (pose := self._pose.next(0.0)) is not None:
            drive.update_pose(pose.message)
        while (state := self._base.next(0.0)) is not None:
            drive.update_base(state.message)

    def send(self, twist: Twist2D, now_ns: int) -> None:
        """Command a velocity."""
        self._stamp_ns = max(now_ns, self._stamp_ns + 1)  # base drops what is not newer
        command = VelocityCommand(stamp_ns=self._stamp_ns, twist=twist, valid_for=VALID_S)
        robot = self._robot
        robot.connection.publish(robot.name, topics.COMMAND, command, SOURCE)

    def stand(self) -> None:
        """Command zero for a moment, and then fall silent."""
        for _ in range(round(STANDING_S / CONTROL_PERIOD_S)):
            now_ns = self.now_ns
            if now_ns is None:
                return
            self.send(Twist2D.zero(), now_ns)
            time.sleep(CONTROL_PERIOD_S)
