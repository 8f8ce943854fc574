"""Settings of the mapper: `[mapper]` in robot.toml."""

from typing import Annotated

from msgspec import Meta, Struct


class MapperConfig(Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """How the mapper matches scans, closes loops and draws the map."""

    resolution_m: Annotated[float, Meta(ge=0.01, le=0.2)] = 0.05
    """Cell edge of the map [m]."""
    max_range_m: Annotated[float, Meta(gt=0.5, le=100.0)] = 30.0
    """Echoes from beyond are left out [m]."""
    keyframe_distance_m: Annotated[float, Meta(ge=0.05, le=2.0)] = 0.3
    """Drive after which a scan becomes part of the map [m]."""
    keyframe_turn_rad: Annotated[float, Meta(ge=0.05, le=1.6)] = 0.3
    """Turn after which a scan becomes part of the map [rad]."""
    local_way_m: Annotated[float, Meta(ge=1.0, le=50.0)] = 8.0
    """Scans are compared with keyframes that are tied to the newest within so long a way [m];
    keyframes farther back are found again by the search for loops."""
    local_reach_m: Annotated[float, Meta(ge=2.0, le=50.0)] = 25.0
    """And with surfaces within this distance [m]."""
    local_keyframes: Annotated[int, Meta(ge=3, le=200)] = 20
    """And with at most so many keyframes."""
    drift_share: Annotated[float, Meta(ge=0.0, le=0.5)] = 0.05
    """How far off a pose may be at most, as a share of the way driven since the place was seen."""
    lost_after_s: Annotated[float, Meta(gt=0.0, le=60.0)] = 1.5
    """Time without a good match after which the robot is lost [s]."""
