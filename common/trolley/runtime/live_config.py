"""The part of a service that takes settings while it runs."""

from collections.abc import Callable

from trolley import topics
from trolley.config import RobotConfig
from trolley.config.changeable_settings import with_changes
from trolley.messages import ConfigChanges
from trolley.runtime.service import Service, on


class LiveConfig:
    """Keeps up with what was set since the service read its `robot.toml`.

    Args:
        service: that it is a part of.
        config: what its file said.
        use: gets the whole, with what counts at once, whenever that has changed.
    """

    def __init__(
        self, service: Service, config: RobotConfig, use: Callable[[RobotConfig], None]
    ) -> None:
        self._service = service
        self._read = self._now = config
        self._use = use

    @on(topics.CONFIG)
    def update(self, message: ConfigChanges) -> None:
        """Use what was set; what this Trolley does not know is counted and left out."""
        config, left_out = with_changes(self._read, message.changes)
        if left_out:
            self._service.count("config/not_understood", len(left_out))
        if config != self._now:
            self._now = config
            self._use(config)
