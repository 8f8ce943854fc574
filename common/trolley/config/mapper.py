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
