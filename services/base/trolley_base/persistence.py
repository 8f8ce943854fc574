"""What base keeps across restarts, one file each in the state folder."""

from msgspec import Struct

from trolley.geometry import Pose2D
from trolley.messages.types import StampNs

TIME_FILE, LATCH_FILE, WORLD_FILE = "base_time.toml", "base_stop.toml", "base_world.toml"

SAFETY_NS = 120_000_000_000
"""A run begins at least this much after the last saved value, which is at most half as old [ns]."""


class SavedTime(Struct, frozen=True, kw_only=True):
    """Robot time, so that it never goes back even if the host's clock does."""

    stamp_ns: StampNs


class SavedLatch(Struct, frozen=True, kw_only=True):
    """Whether somebody stopped the robot and nobody has resumed it."""

    stopped: bool


class SavedWorld(Struct, frozen=True, kw_only=True):
    """Where a simulated robot truly stood, and from where it was configured to start."""

    world: str
    pose: Pose2D
    start: Pose2D | None = None


def first_stamp_ns(unix_ns: int, saved: SavedTime | None) -> int:
    """Return the robot time at which a run begins."""
    return max(unix_ns, 0 if saved is None else saved.stamp_ns + SAFETY_NS)
