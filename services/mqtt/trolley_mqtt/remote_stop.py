"""A stop over MQTT, requested repeatedly until the robot answers."""

from trolley import requests
from trolley.codes import Refused
from trolley.messages import BaseState
from trolley.messages.request_params import Nothing
from trolley.runtime.service import Service, every
from trolley_mqtt.state_report import StateReport

STOP_AGAIN_S = 0.5
"""A stop that was not answered is repeated this often."""
STOP_FOR_S = 60.0
"""A stop that nobody answers is repeated for this long."""


class RemoteStop:
    """The stop that has not been answered, if there is one."""

    def __init__(self, service: Service, report: StateReport) -> None:
        self._service = service
        self._report = report
        self._until_ns: int | None = None

    def begin(self) -> None:
        """Stop the robot."""
        self._until_ns = self._service.monotonic_ns + int(STOP_FOR_S * 1e9)
        self._ask()

    @every(STOP_AGAIN_S, clock="local")
    def _repeat(self) -> None:
        if self._until_ns is None:
            return
        if self._service.monotonic_ns < self._until_ns:
            self._ask()
        else:
            self._until_ns = None
            self._report.calm()

    def _ask(self) -> None:
        self._service.request(
            requests.BASE_STOP, Nothing(), self._update_reply, timeout_s=STOP_AGAIN_S
        )

    def _update_reply(self, reply: object) -> None:
        if not isinstance(reply, Refused):
            self._until_ns = None
            self._report.calm()
            if isinstance(reply, BaseState) and reply.may_still_move:
                self._report.answer(reply.message)
            else:
                self._report.answer("Stop: done.")
        elif self._until_ns is not None:
            self._report.alarm()
