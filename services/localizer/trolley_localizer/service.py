"""The localizer as a service: scans and odometry in, pose, map and zones out."""

import zlib
from functools import partial

import msgspec
import numpy as np

from trolley import requests, topics
from trolley.config import RobotConfig
from trolley.geometry import Pose2D
from trolley.messages import MappingStatus, Odometry, PoseEstimate, Scan, Suspects, Transform
from trolley.messages.request_params import Nothing, SetPose
from trolley.runtime.live_config import LiveConfig
from trolley.runtime.service import Service, Watch, answers, on
from trolley.scanning import MAX_WAIT_S, Reject, ScanAssembler, ScanInput
from trolley.slices import do_aside
from trolley_localizer.change_proposals import ChangeProposals
from trolley_localizer.core import Localizer
from trolley_localizer.map_server import LoadedMap, MapServer, refuse_pose
from trolley_localizer.mapper_lease import MapperLease
from trolley_localizer.pose_publisher import PosePublisher, set_pose_message
from trolley_localizer.start_pose import LastPoseStore, StartPose
from trolley_localizer.zone_store import ZoneStore

LATER_S = 1e-3
"""Time after it is due at which a scan without odometry is used all the same [s]."""


class LocalizerService(Service):
    """Where the robot is on its map: owns the map, its zones and the pose."""

    name = "localizer"

    def __init__(self, config: RobotConfig) -> None:
        self._assembler = ScanAssembler()
        self._lease = MapperLease(self, self)
        self._maps = MapServer(self, config, self._lease, self)
        self._zones = ZoneStore(self, self._maps, self._lease)
        self._changes = ChangeProposals(self, self._maps, self._lease)
        self._publisher = PosePublisher(self)
        self._last_pose = LastPoseStore(self)
        self._start_pose = StartPose(self, config.start, self._is_localized)
        live = LiveConfig(self, config, self._maps.set_config)
        self.parts = (self._lease, self._maps, self._zones, self._changes, self._start_pose, live)

    # Life.

    def start(self) -> None:
        """Read what is known of the last run and load the map."""
        seed = zlib.crc32(self.new_id().encode())
        self._odometry: Watch[Odometry] = self.watch(
            topics.ODOM, seconds=2.0, then=self._odometry_came
        )
        self._odometry.wakes = False
        self._overdue = self.deadline(self._locate_if_due)
        self._laser: Watch[Transform] = self.watch(topics.TF, "laser")
        self._start_pose.open(self._last_pose.read())
        self.get(topics.MAPPING, then=partial(self._begin, seed))

    def _begin(self, seed: int, found: dict[tuple[str, ...], MappingStatus]) -> None:
        """Load the map; its topics stay leased while the mapper is at work."""
        self._lease.begin_if_mapping(found.get(()))
        self._maps.open(seed)

    def stop(self) -> None:
        """Save where the robot is and what it saw."""
        self._last_pose.save(self._publisher.latest, self._publisher.map_T_odom)
        self._changes.save()

    def epoch_began(self) -> None:
        """Forget the odometry of base's previous run; the robot itself has not moved."""
        self._assembler.clear()
        self._publisher.forget_odometry()
        if self._maps.current is not None:
            self._maps.current.localizer.restart_odometry()

    # Scans.

    @on(topics.SCAN)
    def take_scan(self, scan: Scan) -> None:
        """Locate by a scan as soon as the odometry of its last beam is there."""
        if not self._lease.is_held:
            self._assembler.add(scan, self.monotonic_ns)
            self._locate_if_due()
            if self._assembler.is_waiting:
                self._overdue.set(MAX_WAIT_S / self.time_of(self.robot).rate + LATER_S)

    def _odometry_came(self, _: Odometry) -> None:
        if self._assembler.is_waiting:
            self._locate_if_due()

    def _locate_if_due(self) -> None:
        """Locate by the scan that waits, if its odometry is there or overdue."""
        history, laser = self._odometry.history, self._laser.latest
        rate = self.time_of(self.robot).rate
        for scan in self._assembler.take(history, laser, self.monotonic_ns, rate):
            self._locate(scan)
        self._odometry.wakes = self._assembler.is_waiting
        if not self._assembler.is_waiting:
            self._overdue.clear()

    def _locate(self, scan: ScanInput | Reject) -> None:
        """Step the localizer and publish what it says."""
        loaded = self._maps.current
        if loaded is None:
            self.count("scan/no_map")
            if self._maps.is_gone:
                self._publisher.say_no_map()
            return
        if isinstance(scan, Reject):
            self.count(f"scan/{scan.name.lower()}")
            return
        self._start_pose.resume(loaded, scan.odom_T_base)
        estimate = loaded.localizer.step(scan)
        if isinstance(estimate, Reject):
            self.count(f"scan/{estimate.name.lower()}")
            return
        self._publisher.publish(loaded, estimate)
        self._last_pose.save_if_due(self._publisher.latest, estimate.map_T_odom)
        self._publisher.publish_suspects(loaded.localizer)
        self._search_if_wanted(loaded.localizer)

    def _search_if_wanted(self, localizer: Localizer) -> None:
        """Run the search that the localizer asks for, aside, as long as it is wanted."""
        job = localizer.take_job()
        if job is None:
            return

        def is_wanted() -> bool:
            loaded = self._maps.current
            return loaded is not None and loaded.localizer is localizer and localizer.wants(job)

        do_aside(self.work, job.slices(), partial(localizer.finish, job), is_wanted)

    # Poses.

    @answers(requests.POSE_SET)
    def set_pose(self, params: SetPose) -> PoseEstimate:
        """Take a pose as a hypothesis, to be believed once the scans agree."""
        loaded, pose = self._maps.ready(), params.pose
        refuse_pose(loaded.localizer, pose)
        covariance = params.covariance
        self._start_pose.cancel()
        loaded.localizer.set_pose(
            pose, None if covariance is None else np.array(covariance).reshape(3, 3)
        )
        self.log.info("Pose set", x=pose.x, y=pose.y, yaw=pose.yaw)
        self._publisher.latest = set_pose_message(
            self.stamp_ns, loaded.name, pose, loaded.localizer.covariance
        )
        return self._publisher.latest

    @answers(requests.POSE_FIND)
    def find_pose(self, _: Nothing) -> PoseEstimate:
        """Search the whole map; the outcome is in `pose`."""
        self._maps.ready().localizer.search()
        self._start_pose.cancel()
        self._publisher.latest = msgspec.structs.replace(
            self._publisher.latest,
            state="searching",
            match=0.0,
            candidates=[],
            wants_turn=False,
            message="searching the whole map",
        )
        return self._publisher.latest

    def known_pose(self) -> PoseEstimate:
        """Return the newest estimate."""
        return self._publisher.latest

    def pose_to_keep(self) -> Pose2D | None:
        """Keep a pose that was known."""
        latest = self._publisher.latest
        return latest.pose if latest.state in ("localized", "unsure") else None

    def odometry_pose(self) -> Pose2D | None:
        """Return the newest odom_T_base."""
        return None if self._odometry.latest is None else self._odometry.latest.pose

    def _is_localized(self) -> bool:
        return self._publisher.latest.state == "localized"

    # The map changes, or its owner.

    def use_map(self, loaded: LoadedMap) -> None:
        """Locate on another map from now on; nothing is known of the pose on it."""
        self._zones.open(loaded)
        self._changes.open(loaded)
        self._start_pose.cancel()
        self._publisher.begin_on_map(loaded.name)
        self._publish_map()
        self._maps.say_health()
        self.log.info("Map loaded", map=loaded.name, zones=len(self._zones.zones))

    def begin_on_map(self, loaded: LoadedMap) -> None:
        """Choose a start pose on the first map."""
        self._start_pose.begin(loaded)

    def _publish_map(self) -> None:
        """Publish the map and what belongs to it."""
        if self._lease.is_held or self._maps.current is None:
            return
        self._maps.publish()
        self._zones.publish()
        self.publish(topics.SUSPECTS, Suspects(stamp_ns=self.stamp_ns, lines=[]))

    def lease_began(self) -> None:
        """Leave map and pose to the mapper; save what is known."""
        self._maps.say_health()
        self._assembler.clear()
        self._last_pose.save(self._publisher.latest, self._publisher.map_T_odom)
        self._changes.save()

    def lease_ended(self) -> None:
        """Go on from where the odometry says that the robot has gone."""
        self._publisher.forget_told()
        self._changes.repeat()
        self._maps.is_gone = self._maps.current is None
        self._publish_map()
        self._maps.say_health()
