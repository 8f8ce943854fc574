"""Settings of the mapper: `[mapper]` in robot.toml."""

from typing import Annotated

from msgspec import Meta, Struct


class MapperConfig(Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """How the mapper matches scans, closes loops and draws the map."""

    resolution_m: Annotated[float, Meta(ge=0.01, le=0.2)] = 0.05
    """Cell edge of the map [m]."""
    max_range_m: Annotated[float, Meta(gt=0.5, le=100.0)] = 30.0
    """Echoes from farther away are ignored [m]."""
    keyframe_distance_m: Annotated[float, Meta(ge=0.05, le=2.0)] = 0.3
    """Distance driven after which a scan becomes part of the map [m]."""
    keyframe_turn_rad: Annotated[float, Meta(ge=0.05, le=1.6)] = 0.3
    """Rotation after which a scan becomes part of the map [rad]."""
    local_way_m: Annotated[float, Meta(ge=1.0, le=50.0)] = 8.0
    """Scans are matched with keyframes at most this far from the newest one along the edges of the
    pose graph [m]; the search for loops finds others."""
    local_reach_m: Annotated[float, Meta(ge=2.0, le=50.0)] = 25.0
    """Scans are matched with surfaces at most this far away [m]."""
    local_keyframes: Annotated[int, Meta(ge=3, le=200)] = 20
    """Highest number of keyframes that a scan is matched with."""
    keyframes_per_place: Annotated[int, Meta(ge=2, le=50)] = 4
    """Keyframes kept of one place; older ones are dropped, so memory follows the area mapped."""
    drift_share: Annotated[float, Meta(ge=0.0, le=0.5)] = 0.05
    """Greatest error of a pose, as a share of the distance driven since the place was seen."""
    lost_after_s: Annotated[float, Meta(gt=0.0, le=60.0)] = 1.5
    """Time without a good match after which the robot is lost [s]."""
    explore_radius_m: Annotated[float, Meta(ge=1.0, le=200.0)] = 30.0
    """The robot explores no farther than this from where it began, whatever it sees through glass
    [m]."""
    explore_area_m2: Annotated[float, Meta(ge=1.0, le=10_000.0)] = 500.0
    """Exploring ends once this much floor is known [m²]."""
