"""The settings of the robot that one browser follows: what they are, and changing them."""

from collections.abc import Callable, Mapping
from typing import Any

from trolley import requests
from trolley.codes import Refused
from trolley.messages import ConfigChanges, Setting, Settings
from trolley.messages.request_params import SetConfig, WhichConfig
from trolley.runtime.service import Service
from trolley_viz.features.driving.robot_actions import RobotActions
from trolley_viz.words.sentences import refusal

AGAIN_NS = 3_000_000_000
"""A robot that does not tell its settings is asked again after this time [ns]."""

Name = tuple[str, str]
"""Section and key."""


class RobotSettings:
    """What base has told of its settings; all on the service's thread.

    Args:
        service: asks.
        actions: ask what changes something.
        robot: the name of the robot that is followed.
    """

    def __init__(self, service: Service, actions: RobotActions, robot: Callable[[], str]) -> None:
        self._service = service
        self._actions = actions
        self._robot = robot
        self._asked: tuple[str, ConfigChanges | None] | None = None
        """Of which robot they were asked, and after which change."""
        self._again_ns: int | None = None
        self.known: Mapping[Name, Setting] = {}
        """All settings, none while they are not known."""
        self.trouble = ""
        """Why they are not known."""
        self.num_told = 0
        """How often they were told."""

    def update(self, changes: ConfigChanges | None) -> None:
        """Ask for them where they are new; `changes` is what base said last."""
        robot, now_ns = self._robot(), self._service.monotonic_ns
        if self._asked is not None and self._asked[0] != robot:
            self.known = {}
        is_due = self._again_ns is not None and now_ns >= self._again_ns
        if (robot, changes) == self._asked and not is_due:
            return
        self._asked, self._again_ns = (robot, changes), None

        def told(reply: Settings | Refused) -> None:
            if self._robot() != robot:
                return
            if isinstance(reply, Refused):
                self.trouble = refusal(reply)
                self._again_ns = now_ns + AGAIN_NS
                return
            self._take(reply.settings, is_all=True)

        self._service.request(requests.CONFIG_GET, WhichConfig(), told, robot=robot)

    def change(self, section: str, values: Mapping[str, Any]) -> None:
        """Set some of one section, and tell the person what became of it."""
        # Where it is refused, the page shows again what is.
        self._again_ns = self._service.monotonic_ns + AGAIN_NS

        def done(reply: Settings) -> None:
            self._take(reply.settings, is_all=False)
            is_saved = all(one.saved for one in reply.settings)
            self._actions.tell("Changed", outcome(reply), "good" if is_saved else "warn")

        asked = SetConfig(section=section, values=dict(values))
        self._actions.ask(requests.CONFIG_SET, asked, "Not changed", done)

    def _take(self, settings: list[Setting], *, is_all: bool) -> None:
        told = {(one.section, one.key): one for one in settings}
        self.known = told if is_all else {**self.known, **told}
        self.trouble = ""
        self.num_told += 1


def outcome(reply: Settings) -> str:
    """Say when what was set counts, and whether it is saved."""
    waits = [one for one in reply.settings if one.value != one.next]
    said = ["It counts at once."] if len(waits) < len(reply.settings) else []
    if waits:
        said.append("It counts the next time the robot is started.")
    if all(one.saved for one in reply.settings):
        said.append("It is saved.")
    else:
        said.append("It could not be saved. A restart ends it.")
    return " ".join(said)
