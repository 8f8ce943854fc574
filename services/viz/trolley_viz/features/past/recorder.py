"""Records one robot: reads twice a second where it is, and now and then what it sees.

Poses and scans are read rather than subscribed to: they come ten times a second and more, and each
arrival would wake the viewer, also where nobody looks.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import msgspec
import numpy as np
from numpy.typing import NDArray

from trolley import topics
from trolley.geometry import Pose2D, wrap_angle
from trolley.geometry.frames import BASE, MAP
from trolley.messages import (
    GoalStatus,
    Health,
    PoseEstimate,
    Scan,
    StopResult,
    TourStatus,
    Transform,
    floats_from_bytes,
)
from trolley.runtime.service import Service
from trolley.teleop import SOURCE as BY_HAND
from trolley.topics import Topic
from trolley.under_way import GOAL_UNDER_WAY, TRIP_UNDER_WAY
from trolley.zones import room_of
from trolley_viz.features.past.record import LATELY, TRIP, Failure, Record
from trolley_viz.robots.lost_drive import LastDrive
from trolley_viz.robots.past_trips import has_failed
from trolley_viz.robots.placement import poses_between, seen_from
from trolley_viz.robots.silence import SILENT_NS, SilentServices
from trolley_viz.robots.situation import RobotState, situation
from trolley_viz.robots.streams import Streams
from trolley_viz.words.plain_words import said
from trolley_viz.words.sentences import STALE_S, result_line

KEPT_NS = 600_000_000_000
"""What is kept besides trips: ten minutes."""
SCAN_PERIOD_NS = 1_000_000_000
"""Between two scans while the robot moves."""
STANDING_PERIOD_NS = 10_000_000_000
"""Between two scans while it stands."""
MOVED_M, TURNED_RAD = 0.05, math.radians(3.0)
"""It has moved, if farther than this."""
SCAN_WAITS_NS = 2_000_000_000
"""A scan waits this long for the poses around it."""
POSES_AROUND = 6
"""Where a scan was taken is looked for between this many of the newest poses."""
HEALTH_PERIOD_NS = 5_000_000_000
"""How often the services are asked whether they live."""
AFTER_TRIP_NS = 5_000_000_000
"""A trip's record goes on after its end, so that the end can be seen."""
BEGINNING_S = 5.0
"""A trip that is younger when it is first heard of is recorded from its beginning [s]."""

SILENT_START_NS = 2_000_000_000
"""Until what is watched has come, nothing is said: it would be that the robot is being asked."""
STANDING_READ_NS = 2_000_000_000
"""Between two reads of the pose while the robot stands and has no goal."""
STANDS_AFTER_NS = 5_000_000_000
"""A robot that has not moved for so long stands."""
READ_BEFORE_S = 2.5
"""A pose was read up to two seconds ago, and that took a while [s]: it is not stale yet."""
FARTHEST_M = 1e6
"""No map reaches so far; a pose beyond is somebody's mistake."""

WATCHED: tuple[Topic[Any], ...] = (
    topics.BASE,
    topics.GOAL,
    topics.TOUR,
    topics.POSES,
    topics.ZONES,
    topics.MAPPING,
)
"""What the sentence depends on: all of it comes seldom, but for a goal that is driven to."""


@dataclass
class TripRecord:
    """The record of a trip that is under way, or has just ended."""

    trip: str
    record: Record
    ended_ns: int | None = None


class Recorder:
    """Records one robot.

    Args:
        service: whose wire and clocks it uses.
    """

    def __init__(self, service: Service, robot: str) -> None:
        self.record = Record(LATELY)
        """The last ten minutes."""
        self.trip: TripRecord | None = None
        """The trip under way, or the one that ended last."""
        self._service = service
        self._robot = robot
        self._streams = Streams(
            lambda topic, seconds: service.watch(topic, seconds=seconds, robot=robot),
            service.close_watch,
        )
        self._laser = service.watch(topics.TF, "laser", robot=robot)
        self._streams.follow(WATCHED)
        self._said_from_ns = service.since_boot_ns + SILENT_START_NS
        self._epoch: int = 0
        """The run of the robot's base."""
        self._estimate: PoseEstimate | None = None
        self._last_drive = LastDrive()
        self._silence = SilentServices(HEALTH_PERIOD_NS + SILENT_NS)
        self._health: dict[str, Health] = {}
        """What each service answered last."""
        self._health_due_ns = 0
        self._last_result: StopResult | None = None
        self._scanned_ns = 0
        self._scanned_at: tuple[str, Pose2D] | None = None
        """Where the last scan was taken."""
        self._read_ns = 0
        """When the pose was last read."""
        self._moved_ns = service.since_boot_ns
        """When the robot was last seen to move."""
        self._scan: Scan | None = None
        """One that waits for the poses around it."""

    @property
    def is_trip_over(self) -> bool:
        """Whether the last trip has ended, and its record with it."""
        ended_ns = None if self.trip is None else self.trip.ended_ns
        return ended_ns is not None and self._service.since_boot_ns - ended_ns > AFTER_TRIP_NS

    def close(self) -> None:
        """Hear nothing more."""
        self._streams.drop_all()
        self._service.close_watch(self._laser)

    def sample(self) -> None:
        """Note what is said of the robot now, and ask where it is."""
        service, now_ns = self._service, self._service.since_boot_ns
        self.record.drop_before(now_ns - KEPT_NS)
        self._begin_anew(now_ns)
        self._follow_trip(now_ns)
        robot_ns = self._robot_ns()
        if now_ns >= self._said_from_ns:
            words, aim = situation(self._known(robot_ns)), self._aim()
            for record in self._records():
                record.say(now_ns, words)
                record.aim(now_ns, aim)
        if robot_ns is None:
            self._estimate = self._scan = None
            return
        self._place_scan(now_ns, robot_ns)
        if self._is_pose_due(now_ns):
            self._read_ns = now_ns
            service.get(topics.POSE, then=self._take_pose, robot=self._robot)
        if now_ns >= self._health_due_ns:
            self._health_due_ns = now_ns + HEALTH_PERIOD_NS
            service.get(topics.HEALTH, then=self._take_health, robot=self._robot)

    def _begin_anew(self, now_ns: int) -> None:
        """Forget what was heard before the robot's base began a new run."""
        epoch = self._service.time_of(self._robot).epoch
        if epoch != self._epoch:
            self._epoch, self._said_from_ns = epoch, now_ns + SILENT_START_NS
            self._estimate = self._scan = None
            self._streams.drop_all()
            self._streams.follow(WATCHED)

    # What the sentence depends on.
    def _known(self, robot_ns: int | None) -> RobotState:
        streams, estimate = self._streams, self._estimate
        saved, trip = streams.latest(topics.POSES), streams.latest(topics.TOUR)
        goal, age_s = streams.latest(topics.GOAL), None
        if robot_ns is not None and estimate is not None:
            age_s = max((robot_ns - estimate.stamp_ns) * 1e-9 - READ_BEFORE_S, 0.0)
        return RobotState(
            is_away=robot_ns is None,
            base=streams.latest(topics.BASE),
            has_map=estimate is None or estimate.map is not None,
            estimate=estimate,
            estimate_age_s=age_s,
            goal=_without_figures(goal),
            lost_goal=self._last_drive.update(goal),
            trip=trip,
            tour=None if trip is None else trip.tour,
            places=[] if saved is None else saved.poses,
            room=room_of(estimate, streams.latest(topics.ZONES)),
            silent=self._silence.update(self._health, self._service.monotonic_ns),
            mapping=streams.latest(topics.MAPPING),
        )

    def _aim(self) -> Pose2D | None:
        goal = self._streams.latest(topics.GOAL)
        is_shown = goal is not None and goal.frame == MAP and goal.state in GOAL_UNDER_WAY
        return goal.pose if is_shown and goal is not None else None

    def _take_health(self, found: dict[tuple[str, ...], Health]) -> None:
        self._health.update((name, health) for (name,), health in found.items())

    # Where it is and what it sees.
    def _take_pose(self, found: dict[tuple[str, ...], PoseEstimate]) -> None:
        estimate, robot_ns = found.get(()), self._robot_ns()
        if estimate is None or robot_ns is None:
            return
        before, self._estimate = self._estimate, estimate
        if before is None or _has_moved(before.pose, estimate.pose):
            self._moved_ns = self._service.since_boot_ns
        age_ns = max(robot_ns - estimate.stamp_ns, 0)
        if estimate.pose is None or estimate.map is None or age_ns > STALE_S * 1e9:
            return
        if max(abs(estimate.pose.x), abs(estimate.pose.y)) > FARTHEST_M:
            return
        at_ns = self._service.since_boot_ns - age_ns
        for record in self._records():
            record.add_pose(at_ns, estimate.stamp_ns, estimate.map, estimate.pose, estimate.state)
        if self._is_scan_due(estimate.map, estimate.pose):
            self._scanned_ns = self._service.since_boot_ns
            self._scanned_at = estimate.map, estimate.pose
            self._service.get(topics.SCAN, then=self._take_scan, robot=self._robot)

    def _is_scan_due(self, map_name: str, pose: Pose2D) -> bool:
        waited_ns, last = self._service.since_boot_ns - self._scanned_ns, self._scanned_at
        if last is None or last[0] != map_name or waited_ns >= STANDING_PERIOD_NS:
            return True
        return _has_moved(last[1], pose) and waited_ns >= SCAN_PERIOD_NS

    def _is_pose_due(self, now_ns: int) -> bool:
        """Whether to read the pose: each time, but seldom while the robot stands."""
        goal, base = self._streams.latest(topics.GOAL), self._streams.latest(topics.BASE)
        drives = (goal is not None and goal.state in GOAL_UNDER_WAY) or (
            base is not None and base.source == BY_HAND
        )
        stands = not drives and now_ns - self._moved_ns > STANDS_AFTER_NS
        # A scan that waits needs a pose on either side.
        return not stands or self._scan is not None or now_ns - self._read_ns >= STANDING_READ_NS

    def _take_scan(self, found: dict[tuple[str, ...], Scan]) -> None:
        self._scan = found.get(())

    def _place_scan(self, now_ns: int, robot_ns: int) -> None:
        """Put the scan that waits where the robot was at the time of each of its beams."""
        scan, rows = self._scan, self.record.poses.rows[-POSES_AROUND:]
        if scan is None or not len(rows):
            return
        rows = _of_one_run(rows[rows["map"] == rows["map"][-1]])
        if int(rows["robot_ns"][-1]) < scan.stamp_ns:
            if robot_ns - scan.stamp_ns > SCAN_WAITS_NS:
                self._scan = None
            return
        self._scan, base_T_laser = None, _mounting(self._laser.latest, scan.frame)
        if int(rows["robot_ns"][0]) > scan.stamp_ns or base_T_laser is None:
            return
        origin, points = placed_echoes(scan, rows, base_T_laser)
        at_ns = now_ns - max(robot_ns - scan.stamp_ns, 0)
        map_name = self.record.maps[int(rows["map"][-1])]
        for record in self._records():
            record.add_scan(at_ns, map_name, origin, points)

    # Trips.
    def _follow_trip(self, now_ns: int) -> None:
        """Begin and end the record of a trip, and note what became of its stops."""
        status = self._streams.latest(topics.TOUR)
        if status is None or status.trip is None:
            return
        is_going = status.state in TRIP_UNDER_WAY
        if is_going and (self.trip is None or self.trip.trip != status.trip):
            self.trip = TripRecord(status.trip, Record(TRIP))
            is_new = status.seconds <= BEGINNING_S
            self._last_result = None if is_new or not status.results else status.results[-1]
        trip = self.trip
        if trip is None or trip.trip != status.trip:
            return
        if not is_going and trip.ended_ns is None:
            trip.ended_ns = now_ns
        elif is_going:
            trip.ended_ns = None
        self._note_failures(status, now_ns)

    def _note_failures(self, status: TourStatus, now_ns: int) -> None:
        for result in _results_after(status.results, self._last_result):
            self._last_result = result
            if has_failed(result):
                text = said(result.message) or result_line(result).headline
                for record in self._records():
                    record.fail(Failure(now_ns, result.stop, result.started_at, text))

    def _records(self) -> Sequence[Record]:
        """Those that go on: the last ten minutes, and the trip until shortly after its end."""
        trip = self.trip
        is_over = trip is None or self.is_trip_over
        return [self.record] if trip is None or is_over else [self.record, trip.record]

    def _robot_ns(self) -> int | None:
        return self._service.time_of(self._robot).now(self._service.monotonic_ns)


def placed_echoes(
    scan: Scan, rows: NDArray[Any], base_T_laser: Pose2D
) -> tuple[Pose2D, NDArray[np.float64]]:
    """Place the echoes of a scan on the map, each where the robot was at its beam's time.

    Args:
        scan: the scan.
        rows: poses around its time, of one map.
        base_T_laser: where the laser is mounted.

    Returns:
        Where the robot was, and (n, 2) x, y [m].
    """
    ranges = floats_from_bytes(scan.ranges)
    good = np.isfinite(ranges) & (ranges >= scan.range_min) & (ranges <= scan.range_max)
    beams = np.flatnonzero(good & (ranges > 0.0))
    angles = scan.angle_min + scan.angle_increment * beams
    points_laser = ranges[beams, None] * np.stack([np.cos(angles), np.sin(angles)], axis=1)
    points_base = base_T_laser.transform_points(points_laser)
    known_s = (rows["robot_ns"] - scan.stamp_ns) * 1e-9
    known = np.stack([rows[name].astype(np.float64) for name in ("x", "y", "yaw")], axis=1)
    poses = poses_between(np.concatenate([[0.0], scan.time_increment * beams]), known_s, known)
    x, y, yaw = poses[0].tolist()
    return Pose2D(x, y, wrap_angle(yaw)), seen_from(poses[1:], points_base)


def _has_moved(was: Pose2D | None, is_now: Pose2D | None) -> bool:
    if was is None or is_now is None:
        return was is not is_now
    turned = abs(wrap_angle(is_now.yaw - was.yaw))
    return is_now.distance_to(was) > MOVED_M or turned > TURNED_RAD


def _of_one_run(rows: NDArray[Any]) -> NDArray[Any]:
    """Those since the robot's clock last started over."""
    (restarts,) = np.nonzero(np.diff(rows["robot_ns"]) <= 0)
    return rows[int(restarts[-1]) + 1 :] if len(restarts) else rows


def _mounting(link: Transform | None, frame: str) -> Pose2D | None:
    """Where a laser is mounted, None where that is not told as of the robot itself."""
    return link.pose if link is not None and (link.parent, link.child) == (BASE, frame) else None


def _without_figures(goal: GoalStatus | None) -> GoalStatus | None:
    """A goal without what changes all the time: each change would be another sentence."""
    if goal is None:
        return None
    return msgspec.structs.replace(goal, distance_remaining=None, eta=None)


def _results_after(results: Sequence[StopResult], last: StopResult | None) -> list[StopResult]:
    """The results that came after one; all where it is not among them."""
    new: list[StopResult] = []
    for result in reversed(results):
        if result == last:
            break
        new.insert(0, result)
    return new
