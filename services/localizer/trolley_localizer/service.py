"""The localizer as a service: scans and odometry in, pose, map and zones out."""

import zlib
from functools import partial

import msgspec
import numpy as np

from trolley import requests, topics
from trolley.config import RobotConfig
from trolley.geometry import Pose2D
from trolley.messages import (
    BeamClasses,
    MappingStatus,
    Odometry,
    PoseEstimate,
    SavedPoses,
    Scan,
    SuspectLine,
    Suspects,
)
from trolley.messages.request_params import Nothing, SetPose
from trolley.runtime.service import answers, every, on
from trolley.scanning.front_end import Reject, ScanAssembler, ScanInput
from trolley_localizer.change_owner import ChangeOwner
from trolley_localizer.core import Localizer
from trolley_localizer.estimate import Estimate
from trolley_localizer.map_owner import refuse_pose
from trolley_localizer.matching.global_search import SearchJob
from trolley_localizer.start_pose import WAIT_FOR_NAME_S, LastPose, StartPose, find_saved
from trolley_localizer.to_messages import (
    odom_transform,
    particle_message,
    pose_message,
    suspect_lines,
    unknown_pose,
)

LAST_POSE_FILE = "last_pose.toml"
# Shortest times between two messages, a little less than the contract's periods [ns].
BEAMS_PERIOD_NS = 95_000_000
PARTICLES_PERIOD_NS = 195_000_000
SAVE_PERIOD_NS = 2_000_000_000
# The last pose is saved again after this way [m] or turn [rad].
SAVE_AFTER_M = 0.01
SAVE_AFTER_RAD = 0.02


class LocalizerService(ChangeOwner):
    """Where the robot is on its map: owns the map, its zones and the pose."""

    name = "localizer"

    def __init__(self, config: RobotConfig) -> None:
        super().__init__(config)
        self._latest = unknown_pose(0, None, "no map is loaded yet")
        self._assembler = ScanAssembler()
        self._saved: LastPose | None = None
        self._saved_ns = 0
        self._beams_ns = -BEAMS_PERIOD_NS
        self._particles_ns = -PARTICLES_PERIOD_NS
        self._name_until_ns: int | None = None
        self._suspects: list[SuspectLine] = []

    # Life.

    def start(self) -> None:
        """Read what is known of the last run and load the map."""
        self._seed = zlib.crc32(self.new_id().encode())
        self._odometry = self.watch(topics.ODOM, seconds=2.0, then=self._odometry_came)
        self._laser = self.watch(topics.TF, "laser")
        self._saved = self.state.read(LAST_POSE_FILE, LastPose)
        self._start_pose = StartPose(self._config.start, self._saved)
        if self._start_pose.wanted_name is not None:
            self._poses = self.watch(topics.POSES, then=self._poses_came)
        self.get(topics.MAPPING, then=self._begin)

    def _begin(self, found: dict[tuple[str, ...], MappingStatus]) -> None:
        """Load the map, and keep quiet about it where the mapper is at work."""
        self.yield_if_mapping(found.get(()))
        self.open_maps()

    def stop(self) -> None:
        """Save where the robot is and what it saw."""
        self._save_pose()
        self.save_changes()

    def epoch_began(self) -> None:
        """Forget the odometry of base's run before; the robot itself has not moved."""
        self._assembler.clear()
        if self._localizer is not None:
            self._localizer.restart_odometry()

    # Scans.

    @on(topics.SCAN)
    def take_scan(self, scan: Scan) -> None:
        """Locate by a scan as soon as the odometry of its last beam is there."""
        if self.is_yielding:
            return
        self._assembler.add(scan, self.monotonic_ns)
        self._locate_if_due()

    def _odometry_came(self, _: Odometry) -> None:
        self._locate_if_due()

    @every(0.05)
    def _locate_if_due(self) -> None:
        """Locate by the scan that waits, if its odometry is there or does not come."""
        rate = self.time_of(self.robot).rate
        history, laser = self._odometry.history, self._laser.latest
        for scan in self._assembler.take(history, laser, self.monotonic_ns, rate):
            self._locate(scan)

    def _locate(self, scan: ScanInput | Reject) -> None:
        """Step the localizer and publish what it says."""
        localizer = self._localizer
        if localizer is None:
            self.count("scan/no_map")
            return
        result = scan if isinstance(scan, Reject) else localizer.step(scan)
        if isinstance(result, Reject):
            self.count(f"scan/{result.name.lower()}")
            return
        self._publish(localizer, result)
        self._publish_suspects(localizer)
        self._search_if_wanted(localizer)

    def _publish_suspects(self, localizer: Localizer) -> None:
        """Publish which mirrors are suspected, if that has changed."""
        lines = suspect_lines(localizer)
        if lines == self._suspects:
            return
        if len(lines) != len(self._suspects):
            self.log.info("Mirrors suspected", count=len(lines))
        self._suspects = lines
        self.publish(topics.SUSPECTS, Suspects(stamp_ns=self.stamp_ns, lines=lines))

    def _publish(self, localizer: Localizer, estimate: Estimate) -> None:
        """Publish an estimate and what goes with it."""
        stamp_ns = estimate.stamp_ns
        if estimate.map_T_odom is not None and estimate.state in ("localized", "unsure"):
            self.publish(topics.TF, odom_transform(stamp_ns, estimate.map_T_odom), "odom")
        if estimate.state != self._latest.state:
            self.log.info("Pose", state=estimate.state, why=estimate.message or "the scan fits")
        self._latest = pose_message(estimate, self._map_name or "")
        self.publish(topics.POSE, self._latest)
        if stamp_ns - self._beams_ns >= BEAMS_PERIOD_NS:
            self._beams_ns = stamp_ns
            classes = memoryview(estimate.beam_classes.tobytes())
            self.publish(topics.BEAMS, BeamClasses(stamp_ns=stamp_ns, classes=classes))
        if stamp_ns - self._particles_ns >= PARTICLES_PERIOD_NS:
            self._particles_ns = stamp_ns
            self.publish(topics.PARTICLES, particle_message(stamp_ns, localizer))
        if self.monotonic_ns - self._saved_ns >= SAVE_PERIOD_NS:
            self._save_pose()

    def _search_if_wanted(self, localizer: Localizer) -> None:
        """Run the search that the localizer asks for, aside."""
        job = localizer.take_job()
        if job is not None:
            self.work(job.run, partial(self._searched, localizer))

    def _searched(self, localizer: Localizer, job: SearchJob) -> None:
        """Give a search back to the localizer that asked for it."""
        localizer.finish(job)

    def _save_pose(self) -> None:
        """Save where the robot is, if that is known and has changed."""
        latest, saved = self._latest, self._saved
        if latest.pose is None or latest.map is None or latest.state != "localized":
            return
        if (
            saved is not None
            and saved.map == latest.map
            and saved.pose.distance_to(latest.pose) < SAVE_AFTER_M
            and abs((saved.pose.inverse() @ latest.pose).yaw) < SAVE_AFTER_RAD
        ):
            return
        self._saved = LastPose(map=latest.map, pose=latest.pose)
        self._saved_ns = self.monotonic_ns
        self.save(LAST_POSE_FILE, self._saved)

    # Poses.

    @answers(requests.POSE_SET)
    def set_pose(self, params: SetPose) -> PoseEstimate:
        """Take a pose as a hypothesis, to be believed once the scans agree."""
        localizer = self.ready()
        refuse_pose(localizer, params.pose)
        covariance = params.covariance
        self._name_until_ns = None
        localizer.set_pose(
            params.pose, None if covariance is None else np.array(covariance).reshape(3, 3)
        )
        self.log.info("Pose set", x=params.pose.x, y=params.pose.y, yaw=params.pose.yaw)
        self._latest = PoseEstimate(
            stamp_ns=self.stamp_ns,
            map=self._map_name,
            pose=params.pose.wrapped(),
            covariance=[float(value) for value in localizer.covariance.ravel()],
            state="unsure",
            match=0.0,
            spread=0.0,
            message="checking the pose against the scan",
        )
        return self._latest

    @answers(requests.POSE_FIND)
    def find_pose(self, _: Nothing) -> PoseEstimate:
        """Search the whole map; the outcome is in `pose`."""
        self.ready().search()
        self._name_until_ns = None
        self._latest = msgspec.structs.replace(
            self._latest,
            state="searching",
            match=0.0,
            candidates=[],
            wants_turn=False,
            message="searching the whole map",
        )
        return self._latest

    # The start.

    def on_map(self, localizer: Localizer, name: str) -> None:
        """Know nothing of the pose on a new map."""
        super().on_map(localizer, name)
        self._suspects = []
        self._name_until_ns = None
        self._latest = unknown_pose(self.stamp_ns, name, "searching the whole map")

    def gave_way(self) -> None:
        """Let no scan wait."""
        super().gave_way()
        self._assembler.clear()
        self._save_pose()
        self.save_changes()

    def took_back(self) -> None:
        """Go on from where the odometry says that the robot has gone."""
        self._suspects = []
        super().took_back()

    def known_pose(self) -> PoseEstimate:
        """Return the newest estimate."""
        return self._latest

    def odometry_pose(self) -> Pose2D | None:
        """Return the newest odom_T_base."""
        return None if self._odometry.latest is None else self._odometry.latest.pose

    def pose_to_keep(self) -> Pose2D | None:
        """Keep a pose that was known."""
        return self._latest.pose if self._latest.state in ("localized", "unsure") else None

    def on_first_map(self, localizer: Localizer, name: str) -> None:
        """Begin at the best hypothesis there is; without one the localizer searches."""
        for what, pose in self._start_pose.hypotheses(name):
            problem = localizer.pose_problem(pose)
            if problem is None:
                self.log.info("Starting at a hypothesis", what=what, x=pose.x, y=pose.y)
                localizer.set_pose(pose)
                break
            self.log.warning("A start pose cannot be used", what=what, why=problem)
        if self._start_pose.waits_for_name:
            self._name_until_ns = self.monotonic_ns + int(WAIT_FOR_NAME_S * 1e9)
            self._poses_came(self._poses.latest)

    def _poses_came(self, poses: SavedPoses | None) -> None:
        """Take the saved pose that the configuration names, unless it is known better by now."""
        wanted, localizer = self._start_pose.wanted_name, self._localizer
        if self._name_until_ns is None or wanted is None or localizer is None:
            return
        pose = find_saved(poses, wanted, self._map_name or "")
        if pose is None:
            return
        self._name_until_ns = None
        problem = localizer.pose_problem(pose)
        if problem is not None:
            self.log.warning("The start pose cannot be used", name=wanted, why=problem)
        elif self._latest.state != "localized":
            self.log.info("Starting at a saved pose", name=wanted)
            localizer.set_pose(pose)

    @every(0.5, clock="local")
    def give_up_name(self) -> None:
        """Say that the saved pose of the start is not known, after having waited for it."""
        if self._name_until_ns is not None and self.monotonic_ns > self._name_until_ns:
            self._name_until_ns = None
            self.log.warning(
                "The start pose is not among the saved poses of this map; searching instead",
                name=self._start_pose.wanted_name,
                map=self._map_name,
            )
