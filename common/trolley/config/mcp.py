"""`[mcp]`: what chat assistants may do, which talk to `trolley mcp`."""

from typing import Annotated, Literal

from msgspec import Meta, Struct


class McpConfig(Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """What an assistant may do; it cannot change any of this itself."""

    role: Literal["viewer", "operator"] = "operator"
    """A `viewer` looks and stops; an `operator` drives, saves places and makes maps, too."""
    max_speed_mps: Annotated[float, Meta(gt=0.0, le=5.0)] = 0.3
    """The highest speed of every drive, tour and exploration that an assistant starts [m/s]."""
    may_resume: bool = False
    """Whether an assistant may let a stopped robot drive again."""
