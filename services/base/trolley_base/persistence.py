"""What base keeps across restarts, one file each in the state folder."""

from msgspec import Struct

from trolley.geometry import Pose2D
from trolley.messages.types import StampNs

TIME_FILE, LATCH_FILE, WORLD_FILE = "base_time.toml", "base_stop.toml", "base_world.toml"

SAFETY_NS = 120_000_000_000
"""A run begins at least this much after the last saved value, which is at most half as old [ns]."""

LATEST_NS = 7_258_118_400_000_000_000
"""The year 2200; a later saved time is a mistake. Stamps end in 2262, in signed 64 bits [ns]."""


class SavedTime(Struct, frozen=True, kw_only=True):
    """Robot time, so that it never goes back even if the host's clock does."""

    stamp_ns: StampNs

    def __post_init__(self) -> None:
        """Refuse a time from which no run could begin."""
        if self.stamp_ns > LATEST_NS:
            raise ValueError(f"stamp_ns {self.stamp_ns} lies beyond the year 2200")


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
