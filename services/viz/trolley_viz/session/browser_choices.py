"""What the viewer remembers for each browser: the robot, the layers that are shown, the look."""

from typing import Any, ClassVar

from msgspec import Struct, structs

from trolley_viz.features.zones.dismissed import Dismissed

FILE = "viewer.toml"
MAX_BROWSERS = 100
MAX_DISMISSED = 50


class Choices(Struct, frozen=True, kw_only=True):
    """The choices of one browser; keys that are not known any more are ignored."""

    robot: str = ""
    """The robot that it follows; "": the viewer's own."""
    layers: dict[str, bool] = {}
    """Layer key to shown or not; a layer that is missing is as it is by default."""
    dark: bool = False
    """The dark look, even where the device is set to the light one."""
    light: bool = False
    """The light look, even where the device is set to the dark one."""
    language: str = ""
    """The code of the language; "": as the device is set."""
    dismissed: list[Dismissed] = []
    """Mirrors that are no longer suspected here."""
    folders: dict[str, bool] = {}
    """Title of a folder of controls to open or not."""
    no_letters: bool = False
    """Whether keys that are single letters do nothing: who speaks to a computer types them."""


class ViewerSettings(Struct, frozen=True, kw_only=True):
    """The content of `viewer.toml`."""

    SCHEMA: ClassVar[int] = 3

    browsers: dict[str, Choices] = {}
    """By what the viewer calls each browser, those that chose last at the end."""
    names: dict[str, str] = {}
    """What people call their browsers, by what the viewer does. Not in `Choices`: each page of a
    browser saves its own."""

    @classmethod
    def bring_forward(cls, plain: dict[str, Any], schema: int) -> dict[str, Any]:
        """Return the content of an older file: those knew less, and nothing else."""
        del schema
        return plain

    def with_choices(self, browser: str, choices: Choices) -> "ViewerSettings":
        """Remember a browser's choices, and forget the browsers that chose longest ago."""
        others = {name: old for name, old in self.browsers.items() if name != browser}
        recent = dict([*others.items()][-(MAX_BROWSERS - 1) :])
        return structs.replace(self, browsers={**recent, browser: choices})
