"""What the person at a browser has chosen, and what the device is set to where nothing was."""

import datetime
import zoneinfo
from collections.abc import Callable, Mapping

from msgspec import structs

from trolley.messages import SuspectLine
from trolley_viz.features.zones.dismissed import Dismissed
from trolley_viz.languages.catalogue import ENGLISH, known_language
from trolley_viz.languages.translator import translator_of
from trolley_viz.session.browser_choices import MAX_DISMISSED, Choices
from trolley_viz.session.scene import shown_layers

FRAME = "frame:"
"""Begins the keys under which the choices hold the frames whose axes are shown."""


class Preferences:
    """One browser's choices (layers, look, language, folders), saved at each change.

    Args:
        choices: what was chosen there before.
        save: called with what has changed.
    """

    def __init__(self, choices: Choices, save: Callable[..., None]) -> None:
        self.choices = choices
        self.layers: Mapping[str, bool] = shown_layers(choices.layers)
        """Which layers are shown, by key."""
        self.device_is_dark = False
        """Whether the device is set to the dark look."""
        self.time_zone: datetime.tzinfo | None = None
        """The device's; None, that of the computer that runs the viewer, where it is not known."""
        self._device_language = ""
        self._save = save

    @property
    def is_dark(self) -> bool:
        """Whether the page has the dark look."""
        chosen = self.choices
        return chosen.dark or (self.device_is_dark and not chosen.light)

    @property
    def language(self) -> str:
        """The code of the language in which the page is."""
        return known_language(self.choices.language) or self._device_language or ENGLISH

    def in_language(self, english: str) -> str:
        """A text in the language of the page."""
        words = translator_of(self.language)
        return english if words is None else words.text(english)

    @property
    def has_letters(self) -> bool:
        """Whether keys that are single letters do something."""
        return not self.choices.no_letters

    @property
    def frames(self) -> list[str]:
        """The frames whose axes are shown."""
        chosen = self.choices.layers.items()
        return [key.removeprefix(FRAME) for key, is_on in chosen if is_on and key.startswith(FRAME)]

    def choose_robot(self, robot: str) -> None:
        """Follow a robot from now on."""
        self._change(robot=robot)

    def choose_look(self, *, dark: bool, light: bool) -> None:
        """Change the look; neither: as the device is set."""
        self._change(dark=dark, light=light)

    def choose_language(self, code: str) -> None:
        """Change the language; "": as the device is set."""
        self._change(language=code)

    def note_device_language(self, tag: str) -> None:
        """Note the language of the device, if it is one of ours."""
        self._device_language = known_language(tag)

    def note_time_zone(self, name: str) -> None:
        """Note the time zone of the device, if this computer knows it."""
        try:
            self.time_zone = zoneinfo.ZoneInfo(name)
        except (zoneinfo.ZoneInfoNotFoundError, ValueError, OSError):
            self.time_zone = None

    def switch_letters(self, *, is_on: bool) -> None:
        """Let keys that are single letters do something or not."""
        self._change(no_letters=not is_on)

    def switch_layer(self, key: str, *, is_on: bool) -> None:
        """Show or hide a layer."""
        self._change(layers={**self.choices.layers, key: is_on})

    def switch_frame(self, frame: str, *, is_on: bool) -> None:
        """Show or hide the axes of a frame."""
        others = {key: on for key, on in self.choices.layers.items() if key != FRAME + frame}
        self._change(layers={**others, FRAME + frame: True} if is_on else others)

    def is_open(self, title: str, default: bool) -> bool:
        """Whether the folder of controls with a title was left open."""
        return self.choices.folders.get(title, default)

    def fold(self, title: str, *, is_open: bool) -> None:
        """Note that a folder of controls was opened or closed."""
        self._change(folders={**self.choices.folders, title: is_open})

    def dismiss(self, map_name: str, suspect: SuspectLine) -> None:
        """Stop suspecting a mirror on a map."""
        one = Dismissed(map=map_name, points=suspect.points)
        self._change(dismissed=[*self.choices.dismissed, one][-MAX_DISMISSED:])

    def _change(self, **changes: object) -> None:
        self.choices = structs.replace(self.choices, **changes)
        self.layers = shown_layers(self.choices.layers)
        self._save(**changes)
