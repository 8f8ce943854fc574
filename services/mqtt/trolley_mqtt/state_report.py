"""Tells the broker how the robot is, and what became of the last command."""

import msgspec
from msgspec import structs

from trolley_mqtt.outbox import OFFLINE, ONLINE, Outbox
from trolley_mqtt.robot_inputs import RobotInputs
from trolley_mqtt.state import state_of, vacuum_of

NOT_STOPPED = "NOT STOPPED: no connection to the robot."


class StateReport:
    """Publishes the broker's topics `state`, `robot` and `vacuum`."""

    def __init__(self, robot: RobotInputs, outbox: Outbox) -> None:
        self._robot = robot
        self._outbox = outbox
        self._answer: str | None = None
        self._is_alarm = False

    def answer(self, sentence: str) -> None:
        """Say what became of a command."""
        self._answer = sentence
        self.update()

    def alarm(self) -> None:
        """Say instead of anything else that a stop has not been answered, until `calm`."""
        self._answer, self._is_alarm = NOT_STOPPED, True
        self.update()

    def calm(self) -> None:
        """A stop has been answered, or is no longer waited for."""
        self._is_alarm = False

    def update(self) -> None:
        """Send what has changed."""
        if not self._outbox.is_open:
            return
        view = self._robot.view
        state = state_of(view, self._answer)
        if self._is_alarm:
            state = structs.replace(state, message=NOT_STOPPED, problem=True)
        is_away = state.activity == "away"
        self._outbox.keep(self._outbox.topic("robot"), OFFLINE if is_away else ONLINE)
        self._outbox.keep(self._outbox.topic("state"), msgspec.json.encode(state))
        if not is_away:
            vacuum = vacuum_of(view, state)
            self._outbox.keep(self._outbox.topic("vacuum"), msgspec.json.encode(vacuum))
