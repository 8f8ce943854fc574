"""`[tour]`: stored places and trips."""

from typing import Annotated

from msgspec import Meta, Struct


class TourConfig(Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """What can be set about trips."""

    stop_timeout_s: Annotated[float, Meta(gt=0.0, le=86_400.0)] = 300.0
    """How long a drive to one stop may take where the stop itself does not say."""
    history_days: Annotated[int, Meta(ge=1, le=3650)] = 365
    """How long past trips are kept."""
