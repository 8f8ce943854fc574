"""A robot in its world, moved in fixed steps: the same seed and commands give the same bytes."""

from collections import deque
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from trolley.geometry import Pose2D, Twist2D, wrap_angle
from trolley.gridmap import GridMap
from trolley_base.drivers.interface import LidarScan, MotionSample
from trolley_base.world.body import move_into
from trolley_base.world.contacts import Contact, ContactLog
from trolley_base.world.floor import Floor
from trolley_base.world.gaps import place_outline_into
from trolley_base.world.scanner import Scanner, Shots, cast_shots_into
from trolley_base.world.solids import OtherRobot, Solids
from trolley_base.world.spec import DriveLimits, LidarSpec, WorldError, WorldSpec
from trolley_base.world.wheels import STANDING, Drive, WheelMotion

STEP_NS = 10_000_000
STEP_S = STEP_NS / 1e9
MAX_CLEARANCE = 10.0
"""Clearances beyond this are reported as this [m]."""


@dataclass(frozen=True, slots=True, eq=False)
class RobotBody:
    """The robot as the world meets it.

    Attributes:
        footprint: (n, 2) corners [m] in `base_link`, without crossing itself.
        base_T_laser: where the lidar sits.
        limits: what the motors can do; None: as the world says.
        lidar: the scanner; None: as the world says.
    """

    footprint: NDArray[np.float64]
    base_T_laser: Pose2D
    limits: DriveLimits | None = None
    lidar: LidarSpec | None = None


@dataclass(frozen=True, slots=True)
class TrueState:
    """The true state.

    Attributes:
        stamp_ns: time since the simulation began.
        pose: map_T_base.
        twist: of `base_link` [m/s, rad/s].
        collisions: contacts that the robot drove into, each counted once until it has ended.
        bumps: all other contacts.
        clearance: distance from the footprint to the nearest solid thing [m], at most 10.
    """

    stamp_ns: int
    pose: Pose2D
    twist: Twist2D
    collisions: int
    bumps: int
    clearance: float


class Simulation:
    """One robot in one world.

    Args:
        spec: the world file.
        grid: its map.
        robot: footprint, sensor and motors.
        seed: fixes all noise, the odometry's scales and where people walk at first.
        start: map_T_base; None: as the world says.

    Raises:
        WorldError: the robot would stand in something solid.
    """

    def __init__(
        self,
        spec: WorldSpec,
        grid: GridMap,
        robot: RobotBody,
        seed: int,
        start: Pose2D | None = None,
    ) -> None:
        streams = [np.random.default_rng(s) for s in np.random.SeedSequence(seed).spawn(7)]
        self._robot = robot
        self._solids = Solids(spec, grid, streams[3])
        self._contacts = ContactLog(self._solids.names)
        corners = np.ascontiguousarray(robot.footprint, dtype=np.float64)
        self._footprint = (corners, circle_around(corners))
        self._outline = np.empty_like(corners)
        limits = robot.limits or spec.limits
        self._drive = Drive(spec.wheels, spec.motors, limits, streams[0], streams[1], streams[4])
        self._floor = Floor(spec.rug, spec.sun, streams[5])
        self._scanner = Scanner(robot.lidar or spec.lidar, streams[2], streams[6])
        self._now_ns = 0
        self._before = self._pose = start or spec.start.as_pose()
        self._twist = Twist2D.zero()
        self._motion = Pose2D.identity()
        self._scans: list[LidarScan] = []
        self._resize()
        place_outline_into(self._outline, corners, self._pose.x, self._pose.y, self._pose.yaw)
        self._solids.keep_people_off(self._outline, streams[3])
        self._clearance = self._move(STANDING, 0.0)[1]
        self._refuse_overlap()

    def _refuse_overlap(self) -> None:
        people = self._solids.people
        for body, gap in enumerate(self._gaps):
            if gap < 0.0 and body not in people:
                raise WorldError(
                    f"at x = {self._pose.x:.3f}, y = {self._pose.y:.3f} the robot would stand in "
                    f"{self._contacts.names[body]}; choose another start pose"
                )

    def set_others(self, others: list[OtherRobot]) -> None:
        """Say where the other robots are; they stay there until the next call."""
        self._solids.set_others(others)
        self._contacts.rename(self._solids.names)
        self._resize()

    def _resize(self) -> None:
        count = len(self._contacts.names)
        self._gaps, self._touches = np.empty(count), np.empty((count, 4))
        self._towards = np.empty(count)

    def lift_robot(self, pose: Pose2D) -> None:
        """Put the robot somewhere else; its wheels do not notice."""
        self._before = self._pose = pose

    def move_lidar(self, base_T_laser: Pose2D) -> None:
        """Put the lidar elsewhere on the robot; nobody is told."""
        self._robot = replace(self._robot, base_T_laser=base_T_laser)

    def wear_wheels(self, left: float, right: float) -> None:
        """Make the wheels smaller: what is left of each; their encoders do not notice."""
        self._drive.wear(left, right)

    def widen_track(self, share: float) -> None:
        """Move the wheels apart, to so much of what it was; nobody is told."""
        self._drive.widen_track(share)

    def remove_people(self) -> None:
        """Take everybody out of the world."""
        self._solids.remove_people()

    @property
    def contacts(self) -> deque[Contact]:
        """The newest contacts."""
        return self._contacts.newest

    @property
    def now_ns(self) -> int:
        """Time since the simulation began [ns]."""
        return self._now_ns

    def step(self, command: Twist2D) -> None:
        """Advance the world by `STEP_NS`.

        Args:
            command: the velocity that the robot is told to drive.
        """
        touched = self._solids.move_people(STEP_S, self._outline)
        motion = self._drive.step(command, STEP_S, self._floor.grip(self._pose))
        self._before = self._pose
        part, self._clearance = self._move(motion, STEP_S)
        self._twist = motion.own.scaled(part)
        self._motion = self._motion @ motion.reported
        self._now_ns += STEP_NS
        self._contacts.update(self._now_ns, self._gaps, self._towards, touched)
        mount = self._robot.base_T_laser
        laser = (self._before @ mount, self._pose @ mount)
        scene = self._solids.scene(self._outline)
        sun = self._floor.sun(self._pose)
        self._scans += self._scanner.step(self._now_ns - STEP_NS, self._now_ns, laser, scene, sun)

    def _move(self, motion: WheelMotion, dt: float) -> tuple[float, float]:
        """Move the body; return the fraction of the step that was free, and the clearance."""
        pose = self._pose.as_array()
        part, clearance = move_into(
            pose,
            (self._gaps, self._touches, self._outline),
            self._towards,
            ((motion.slipping.vx, motion.slipping.wz), (motion.own.vx, motion.own.wz), dt),
            self._footprint,
            (self._solids.walls, self._solids.things),
            MAX_CLEARANCE,
        )
        x, y, yaw = pose.tolist()
        self._pose = Pose2D(x, y, wrap_angle(yaw))
        return part, clearance

    def truth(self) -> TrueState:
        """Return the true state now."""
        return TrueState(
            self._now_ns,
            self._pose,
            self._twist,
            self._contacts.collisions,
            self._contacts.bumps,
            min(MAX_CLEARANCE, max(0.0, self._clearance)),
        )

    def take_motion(self) -> MotionSample:
        """Return what the wheels reported since the last call, stamped now."""
        motion, self._motion = self._motion, Pose2D.identity()
        return MotionSample(self._now_ns, motion, self._drive.twist)

    def measure(self, base_T_laser: Pose2D, shots: Shots) -> NDArray[np.float64]:
        """Return the exact ranges (n,) [m] of beams that another sensor fired in the last step.

        Each is cast from where the robot was at its moment; +inf where nothing is within reach.
        """
        poses = np.array([(p @ base_T_laser).as_array() for p in (self._before, self._pose)])
        ranges = np.empty(len(shots.bearings))
        cast_shots_into(ranges, shots, poses, self._solids.scene(self._outline))
        return ranges

    def take_scans(self) -> tuple[LidarScan, ...]:
        """Return the revolutions completed since the last call."""
        scans, self._scans = tuple(self._scans), []
        return scans


def circle_around(corners: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return centre x, y and radius (3,) of a circle around corners (n, 2) [m]."""
    centre = 0.5 * (corners.min(axis=0) + corners.max(axis=0))
    radius = float(np.hypot(*(corners - centre).T).max())
    return np.array([centre[0], centre[1], radius])
