"""What a robot proposes to correct in its `robot.toml`."""

from msgspec import Struct

from trolley.geometry.pose import Finite
from trolley.messages.types import StampNs


class Proposal(Struct, frozen=True, kw_only=True):
    """Something that no longer is as `robot.toml` says; `message` says it to people.

    `settings` are what the file should say, by their full names; without any there is something to
    repair. `right_until` is the robot time until which it was right, null if that is not known.
    """

    id: str
    message: str
    settings: dict[str, Finite] = {}
    right_until: StampNs | None = None


class Proposals(Struct, frozen=True, kw_only=True):
    """What `base` has found while the robot drove. Owned by `base`, on change."""

    stamp_ns: StampNs
    proposals: list[Proposal]
