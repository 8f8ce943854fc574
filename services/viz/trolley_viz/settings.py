"""What a viewer remembers: which layers are shown, and the look."""

from msgspec import Struct

FILE = "viewer.toml"


class ViewerSettings(Struct, frozen=True, kw_only=True):
    """The content of `viewer.toml`; keys that are not known any more are ignored."""

    layers: dict[str, bool] = {}
    """Layer key to shown or not; a layer that is missing is as it is by default."""
    dark: bool = False
    """Dark background."""
