"""`[tour]`: stored places and trips."""

from typing import Annotated

from msgspec import Meta, Struct


class TourConfig(Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """Trips through several stops, and how long they are remembered."""

    stop_timeout_s: Annotated[float, Meta(gt=0.0, le=86_400.0)] = 300.0
    """How long a drive to a stop may take if the stop has no `timeout`."""
    retry_wait_s: Annotated[float, Meta(ge=0.1, le=600.0)] = 2.0
    """Time before a failed stop is tried again, doubled at each failure up to a minute."""
    history_days: Annotated[int, Meta(ge=1, le=3650)] = 365
    """How long past trips are kept."""
    photos_mb: Annotated[int, Meta(ge=0, le=10_000)] = 100
    """Space for photos of past trips [MB]; the oldest are deleted for new ones; 0 to take none."""
    low_battery: Annotated[float, Meta(ge=0.0, le=0.9)] = 0.2
    """Charge below which a robot on its way drives to the place `home`; 0 for never."""
