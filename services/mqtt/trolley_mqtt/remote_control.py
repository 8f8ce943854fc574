"""Carries out commands that arrive over MQTT, and drops those that must not be carried out."""

from collections.abc import Callable

from trolley.codes import Refused
from trolley.runtime.service import Service
from trolley_mqtt.connection import Arrived
from trolley_mqtt.freshness import Freshness
from trolley_mqtt.remote_commands import (
    LOCATE,
    NAMED,
    STOP,
    VACUUM,
    VACUUM_VERBS,
    VERBS,
    Order,
    name_in,
    order_of,
)
from trolley_mqtt.remote_stop import RemoteStop
from trolley_mqtt.robot_inputs import RobotInputs
from trolley_mqtt.state_report import StateReport

MAX_EACH_SECOND = 8
"""Commands that are carried out in a second, and answers to those that are not."""


class RemoteControl:
    """Handles the broker's topics `do/<verb>`."""

    def __init__(
        self,
        service: Service,
        robot: RobotInputs,
        report: StateReport,
        stop: RemoteStop,
        freshness: Freshness,
        start_tour: str,
        locate: Callable[[], None],
    ) -> None:
        self._service = service
        self._robot = robot
        self._report = report
        self._stop = stop
        self._freshness = freshness
        self._start_tour = start_tour
        self._locate = locate
        self._num_carried_out = self._num_answered = 0
        """In this second: junk takes nothing from what the robot is to do."""

    def begin_second(self) -> None:
        """Allow as many commands and answers again."""
        self._num_carried_out = self._num_answered = 0

    def execute(self, verb: str, message: Arrived) -> None:
        """Carry out a command, or drop it and say why."""
        if verb == VACUUM:
            word = message.payload.decode(errors="replace")
            verb = word if word in VACUUM_VERBS else f"{VACUUM}: {word}"
        if verb == STOP:
            self._stop.begin()
            return
        if verb not in VERBS:
            self._drop("unknown", verb, "There is no such command.")
        elif message.is_retained:
            # A broker could give it to the robot repeatedly, days later too.
            self._drop("retained", verb, "A command must not be a retained message.")
        elif not self._freshness.is_fresh(self._service.monotonic_ns):
            self._drop("stale", verb, "The command may have waited too long on its way.")
        elif self._num_carried_out >= MAX_EACH_SECOND:
            self._drop("flood", verb, "There are too many commands at once.")
        else:
            self._ask(verb, message.payload)

    def _drop(self, reason: str, verb: str, why: str) -> None:
        self._service.count(f"command/{reason}")
        name = verb[:40]
        self._service.log.limited(f"command/{reason}", "Command dropped", command=name, why=why)
        if reason != "flood":
            self._answer_not_done(why)

    def _answer_not_done(self, why: str) -> None:
        self._num_answered += 1
        if self._num_answered <= MAX_EACH_SECOND:  # so that a flood costs nothing
            self._report.answer(f"Not done: {why}")

    def _ask(self, verb: str, payload: bytes) -> None:
        if verb == LOCATE:
            self._num_carried_out += 1
            self._locate()
            return
        robot = self._robot
        try:
            name = name_in(payload) if verb in NAMED else ""
            known = (robot.goal.latest, robot.trip.latest)
            order = order_of(
                verb, name, known, robot.names, self._service.new_id(), self._start_tour
            )
        except Refused as refused:
            self._service.count("command/refused")
            self._answer_not_done(refused.message)
            return
        self._num_carried_out += 1
        self._service.log.info("Command", command=order.title)
        self._service.request(
            order.request, order.params, lambda reply: self._update_reply(order, reply)
        )

    def _update_reply(self, order: Order, reply: object) -> None:
        if isinstance(reply, Refused):
            self._service.count("command/refused")
            self._report.answer(f"{order.title}: not done: {reply.message}")
        else:
            self._report.answer(f"{order.title}: {order.done}.")
