"""What `trolley teleop` hears of the robot, and asks it."""

import math
import time
from concurrent.futures import Future, ThreadPoolExecutor
from typing import Generic, TypeVar

import msgspec

from trolley import codes
from trolley.client import Robot
from trolley.codes import Refused
from trolley.connection import Arrival, RobotUnreachable
from trolley.messages import BaseState
from trolley.topics import Topic

M = TypeVar("M", bound=msgspec.Struct)

_COLOURS = {"ok": None, "held": "yellow", "stopped": "red", "fault": "red"}


class Latest(Generic[M]):
    """The newest message of a topic of the robot."""

    def __init__(self, robot: Robot, topic: Topic[M]) -> None:
        self._arrivals = robot.subscribe(topic)
        self._newest: Arrival[M] | None = None

    def message(self, most_age_s: float = math.inf) -> M | None:
        """Return it, None where there is none or it came too long ago."""
        while (arrival := self._arrivals.next(0.0)) is not None:
            self._newest = arrival
        newest = self._newest
        if newest is None or time.monotonic() - newest.arrived_s > most_age_s:
            return None
        return newest.message


class Wishes:
    """Stop and resume, asked aside: driving does not wait for the answer."""

    def __init__(self, robot: Robot, aside: ThreadPoolExecutor) -> None:
        self._robot = robot
        self._aside = aside
        self._asked: Future[BaseState] | None = None
        self._wants_resume = False
        self.wants_stop = False
        """Whether a stop is not answered yet; it is asked again until it is."""
        self.trouble = ""
        """Why the last wish was not fulfilled, "" if it was."""

    def stop(self) -> None:
        """Stop the robot until it is resumed."""
        self.wants_stop, self._wants_resume = True, False
        self.tick()

    def resume(self) -> None:
        """Let it drive again."""
        self.wants_stop, self._wants_resume, self.trouble = False, True, ""
        self.tick()

    def tick(self) -> None:
        """Take the answer if it is there, and ask what is to be asked next."""
        if self._asked is not None and self._asked.done():
            self.settle()
        if self._asked is None and self.wants_stop:
            self._asked = self._aside.submit(self._robot.stop)
        elif self._asked is None and self._wants_resume:
            self._wants_resume = False
            self._asked = self._aside.submit(self._robot.resume)

    def settle(self) -> None:
        """Wait for the answer to what was asked."""
        if self._asked is None:
            return
        asked, self._asked = self._asked, None
        try:
            state = asked.result()
        except (Refused, RobotUnreachable) as error:
            self.trouble = str(error)
        else:
            self.trouble = ""
            self.wants_stop = self.wants_stop and state.mode != "stopped"


def base_line(base: BaseState | None) -> tuple[str, str | None]:
    """Say how base is, in words and a colour."""
    if base is None:
        return "", None
    text = "Ready."
    if base.mode != "ok":
        why = base.message or codes.SENTENCES.get(base.reason, base.reason)
        text = f"{base.mode.capitalize()}: {why}" if why else f"{base.mode.capitalize()}."
    if base.mode == "stopped":
        text += " R lets it drive again."
    if base.battery is not None and base.battery.fraction is not None:
        text += f"  Battery {base.battery.fraction:.0%}."
    return text, _COLOURS[base.mode]
