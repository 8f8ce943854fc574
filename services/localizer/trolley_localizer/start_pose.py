"""Where the robot may stand when it is switched on: the last pose, or the configured one."""

from collections.abc import Callable, Iterator
from typing import Any, ClassVar

from msgspec import Struct

from trolley import topics
from trolley.config.robot import StartSection
from trolley.geometry import Pose2D, angle_difference
from trolley.messages import PoseEstimate, SavedPoses
from trolley.names import canonical
from trolley.runtime.service import Service, Watch, every
from trolley_localizer.map_server import LoadedMap

LAST_POSE_FILE = "last_pose.toml"
WAIT_FOR_NAME_S = 5.0
"""Longest time that a start pose with the name of a saved pose waits for the topic `poses` [s]."""
SAVE_PERIOD_NS = 2_000_000_000
"""Least time between two saves of the last pose [ns]."""
SAVE_AFTER_M = 0.01
"""Distance after which the last pose is saved again [m]."""
SAVE_AFTER_RAD = 0.02
"""Turn after which the last pose is saved again [rad]."""


class LastPose(Struct, frozen=True, kw_only=True):
    """The file `last_pose.toml`: where the robot was on which map."""

    SCHEMA: ClassVar[int] = 2

    map: str
    pose: Pose2D
    epoch_ns: int | None = None
    """Run of `base` in which it was saved [ns]."""
    map_T_odom: Pose2D | None = None
    """Origin of that run's odometry on the map."""

    @classmethod
    def bring_forward(cls, plain: dict[str, Any], schema: int) -> dict[str, Any]:
        """Return the content of a file of schema 1: it knew nothing of the odometry."""
        del schema
        return plain


class LastPoseStore:
    """Saves where the robot is, so that it knows after a restart."""

    def __init__(self, service: Service) -> None:
        self._service = service
        self._saved_ns = 0
        self.saved: LastPose | None = None
        """As it is on disk."""

    def read(self) -> LastPose | None:
        """Read the pose of the last run."""
        self.saved = self._service.state.read(LAST_POSE_FILE, LastPose)
        return self.saved

    def save_if_due(self, latest: PoseEstimate, map_T_odom: Pose2D | None) -> None:
        """Save where the robot is, if that was not done a moment ago."""
        if self._service.monotonic_ns - self._saved_ns >= SAVE_PERIOD_NS:
            self.save(latest, map_T_odom)

    def save(self, latest: PoseEstimate, map_T_odom: Pose2D | None) -> None:
        """Save where the robot is, if that is known and has changed."""
        saved = self.saved
        if latest.pose is None or latest.map is None or latest.state != "localized":
            return
        if (
            saved is not None
            and (saved.map, saved.epoch_ns) == (latest.map, self._service.epoch_ns)
            and saved.pose.distance_to(latest.pose) < SAVE_AFTER_M
            and abs(angle_difference(latest.pose.yaw, saved.pose.yaw)) < SAVE_AFTER_RAD
        ):
            return
        self.saved = LastPose(
            map=latest.map,
            pose=latest.pose,
            epoch_ns=self._service.epoch_ns,
            map_T_odom=map_T_odom,
        )
        self._saved_ns = self._service.monotonic_ns
        self._service.save(LAST_POSE_FILE, self.saved, self._written)

    def _written(self, error: OSError | None) -> None:
        """Try again the next time where it could not be written."""
        self._service.say_not_saved(LAST_POSE_FILE, error)
        if error is not None:
            self.saved = None


class StartPose:
    """Begins on the first map at the best hypothesis there is.

    The order is the configuration's. A saved pose may only be named there: it is waited for.
    """

    def __init__(
        self, service: Service, section: StartSection, is_localized: Callable[[], bool]
    ) -> None:
        self._service = service
        self._section = section
        self._is_localized = is_localized
        self._last: LastPose | None = None
        self._poses: Watch[SavedPoses] | None = None
        self._waiting: tuple[LoadedMap, int] | None = None
        """The map on which the saved pose is waited for, and until when (local clock) [ns]."""
        self._before: LastPose | None = None
        """Where the robot was, if the next scan is the first and nothing better is known."""

    def open(self, last: LastPose | None) -> None:
        """Take note of the last pose, and listen for the saved pose that is named."""
        self._last = last
        if self._wanted_name is not None:
            self._poses = self._service.watch(topics.POSES, then=self._poses_came)

    def begin(self, loaded: LoadedMap) -> None:
        """Set the pose on the first map; without a hypothesis the localizer searches."""
        log = self._service.log
        self._before = self._last
        for what, pose in self._hypotheses(loaded.name):
            problem = loaded.localizer.pose_problem(pose)
            if problem is None:
                log.info("Starting at a hypothesis", what=what, x=pose.x, y=pose.y)
                loaded.localizer.set_pose(pose)
                break
            log.warning("A start pose cannot be used", what=what, why=problem)
        # A saved pose that is named goes before everything else, but a known last pose.
        is_known = self._last is not None and self._last.map == loaded.name
        if self._poses is not None and (self._section.always or not is_known):
            until_ns = self._service.monotonic_ns + int(WAIT_FOR_NAME_S * 1e9)
            self._waiting = loaded, until_ns
            self._poses_came(self._poses.latest)

    def resume(self, loaded: LoadedMap, odom_T_base: Pose2D) -> None:
        """Go on from where the robot was with the first scan, if `base` has run on since."""
        before, self._before = self._before, None
        if (
            before is None
            or before.map_T_odom is None
            or (before.map, before.epoch_ns) != (loaded.name, self._service.epoch_ns)
        ):
            return
        pose = before.map_T_odom @ odom_T_base
        if loaded.localizer.pose_problem(pose) is None:
            self._waiting = None
            self._service.log.info("Going on by the odometry", x=pose.x, y=pose.y)
            loaded.localizer.resume(pose)

    def cancel(self) -> None:
        """Wait no longer for a saved pose: something better is known."""
        self._waiting = self._before = None

    @every(0.5, clock="local")
    def give_up(self) -> None:
        """Say that the saved pose is not known, after having waited for it."""
        if self._waiting is None:
            return
        loaded, until_ns = self._waiting
        if self._service.monotonic_ns > until_ns:
            self._waiting = None
            self._service.log.warning(
                "The start pose is not among the saved places of this map; searching instead",
                name=self._wanted_name,
                map=loaded.name,
            )

    def _poses_came(self, poses: SavedPoses | None) -> None:
        """Start at the saved pose that the configuration names, unless more is known by now."""
        if self._waiting is None or self._wanted_name is None:
            return
        (loaded, _), wanted = self._waiting, self._wanted_name
        pose = find_saved(poses, wanted, loaded.name)
        if pose is None:
            return
        self._waiting = None
        problem = loaded.localizer.pose_problem(pose)
        if problem is not None:
            self._service.log.warning("The start pose cannot be used", name=wanted, why=problem)
        elif not self._is_localized():
            self._service.log.info("Starting at a saved place", name=wanted)
            loaded.localizer.set_pose(pose)

    @property
    def _wanted_name(self) -> str | None:
        """The saved pose that the configuration names, or None."""
        pose = self._section.pose
        return pose if isinstance(pose, str) else None

    def _hypotheses(self, map_name: str) -> Iterator[tuple[str, Pose2D]]:
        """Give what is known now, best first, as what it is and map_T_base."""
        pose = self._section.pose
        configured = None if pose is None or isinstance(pose, str) else pose.as_pose()
        if self._section.always and configured is not None:
            yield "the configured start pose", configured
        if self._last is not None and self._last.map == map_name:
            yield "the last pose", self._last.pose
        if not self._section.always and configured is not None:
            yield "the configured start pose", configured


def find_saved(poses: SavedPoses | None, name: str, map_name: str) -> Pose2D | None:
    """Return a saved pose of a map by its name, or None."""
    if poses is None:
        return None
    name = canonical(name)
    for saved in poses.poses:
        if saved.name == name and saved.map == map_name:
            return saved.pose
    return None
