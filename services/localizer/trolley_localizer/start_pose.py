"""Where the robot may stand when it is switched on: the last pose, or the configured one."""

from collections.abc import Iterator

from msgspec import Struct

from trolley.config.robot import StartSection
from trolley.geometry import Pose2D
from trolley.messages import SavedPoses

# A start pose that names a saved pose waits this long for the stream `poses` [s].
WAIT_FOR_NAME_S = 5.0


class LastPose(Struct, frozen=True, kw_only=True):
    """The file `last_pose.toml`: where the robot was on which map."""

    map: str
    pose: Pose2D


class StartPose:
    """The hypotheses for the start, in the order of the configuration."""

    def __init__(self, section: StartSection, last: LastPose | None) -> None:
        self._section = section
        self._last = last

    @property
    def wanted_name(self) -> str | None:
        """The saved pose that the configuration names, or None."""
        pose = self._section.pose
        return pose if isinstance(pose, str) else None

    @property
    def waits_for_name(self) -> bool:
        """Whether a saved pose, once known, goes before everything else."""
        return self.wanted_name is not None and (self._section.always or self._last is None)

    def hypotheses(self, map_name: str) -> Iterator[tuple[str, Pose2D]]:
        """Give what is known now, best first, as what it is and map_T_base."""
        configured = self._configured()
        if self._section.always and configured is not None:
            yield "the configured start pose", configured
        if self._last is not None and self._last.map == map_name:
            yield "the last pose", self._last.pose
        if not self._section.always and configured is not None:
            yield "the configured start pose", configured

    def _configured(self) -> Pose2D | None:
        pose = self._section.pose
        return None if pose is None or isinstance(pose, str) else pose.as_pose()


def find_saved(poses: SavedPoses | None, name: str, map_name: str) -> Pose2D | None:
    """Return a saved pose of a map by its name, or None."""
    if poses is None:
        return None
    for saved in poses.poses:
        if saved.name == name and saved.map == map_name:
            return saved.pose
    return None
