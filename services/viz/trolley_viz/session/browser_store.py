"""What the viewer remembers of browsers from one start to the next: `viewer.toml`."""

from msgspec import structs

from trolley.runtime.service import Service
from trolley_viz.session.browser_choices import FILE, Choices, ViewerSettings


class BrowserStore:
    """The choices of each browser, and what people call theirs."""

    def __init__(self, service: Service) -> None:
        self._service = service
        self._settings = service.state.read(FILE, ViewerSettings) or ViewerSettings()

    @property
    def names(self) -> dict[str, str]:
        """What people call their browsers, by what the viewer does."""
        return self._settings.names

    def choices_of(self, browser: str) -> Choices:
        """Return what was chosen in a browser."""
        return self._settings.browsers.get(browser, Choices())

    def remember(self, browser: str, **changes: object) -> None:
        """Save what has changed of a browser's choices; one without a name is not remembered.

        Only that: another page of the browser may have changed other choices.
        """
        if browser:
            choices = structs.replace(self.choices_of(browser), **changes)
            self._save(self._settings.with_choices(browser, choices))

    def save_names(self, names: dict[str, str]) -> None:
        """Save what people call their browsers."""
        self._save(structs.replace(self._settings, names=names))

    def _save(self, settings: ViewerSettings) -> None:
        self._settings = settings
        self._service.save(FILE, settings)
