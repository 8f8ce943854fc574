"""Publishes what base does: the command that is driven, its state, and its health."""

import msgspec

from trolley import codes, topics
from trolley.messages import BaseState, VelocityCommand
from trolley.runtime.service import Service
from trolley_base.device_inputs import DeviceInputs
from trolley_base.motion_watch import MotionWatch
from trolley_base.robot_clock import Beat, RobotClock
from trolley_base.safety.estop_latch import EstopLatch
from trolley_base.safety.safety_state import SCAN_SILENCE_NS
from trolley_base.safety.velocity_limiter import Decision

COMMAND_S = 0.1
"""Period of the command that is driven."""
STATE_S = 1.0
"""Longest pause between two states; what changes is published at once."""
NO_ECHO_MESSAGE = (
    "The lidar reports open floor all around, with hardly an echo: that is not believed. Does it "
    "look into the air, or is its window off? In a hall wider than its reach, creep by hand "
    "towards a wall."
)


class StateReporter:
    """Publishes decisions.

    Args:
        inputs: what the devices report.
        watch: knows whether the motors obey.
        estop: knows whether a stop is saved.
    """

    def __init__(
        self,
        service: Service,
        clock: RobotClock,
        inputs: DeviceInputs,
        watch: MotionWatch,
        estop: EstopLatch,
    ) -> None:
        self._service = service
        self._clock = clock
        self._inputs = inputs
        self._watch = watch
        self._estop = estop
        self._published: BaseState | None = None
        self._command_beat, self._state_beat = Beat(COMMAND_S), Beat(STATE_S)

    def publish_due(self, decision: Decision, now_ns: int) -> None:
        """Publish the command when its time has come, the state also when it has changed."""
        if self._command_beat.is_due(now_ns):
            self.publish_command(decision, now_ns)
        if self._state_beat.is_due(now_ns) or self._has_changed(decision, now_ns):
            self.publish_state(decision, now_ns)

    def publish_command(self, decision: Decision, now_ns: int) -> None:
        """Publish what is driven."""
        command = VelocityCommand(
            stamp_ns=now_ns, twist=decision.twist, valid_for=COMMAND_S, scan_ns=decision.scan_ns
        )
        self._service.publish(topics.CMD_VEL, command)

    def publish_state(self, decision: Decision, now_ns: int) -> BaseState:
        """Publish the state, and say the same in `health`."""
        state = self._published = self.state_of(decision, now_ns)
        self._service.publish(topics.BASE, state)
        self._set_health(decision, now_ns)
        return state

    def state_of(self, decision: Decision, now_ns: int) -> BaseState:
        """Return the state as it is published."""
        return BaseState(
            stamp_ns=now_ns,
            mode=decision.mode,
            source=decision.source,
            reason=decision.reason,
            message=decision.message,
            links=self._inputs.links,
            battery=self._inputs.battery,
            not_stopped=self._watch.not_stopped,
        )

    def _has_changed(self, decision: Decision, now_ns: int) -> bool:
        """Whether there is something new; the charge alone waits for the next second."""
        last = self._published
        state = self.state_of(decision, now_ns)
        return last is None or state != msgspec.structs.replace(
            last, stamp_ns=now_ns, battery=state.battery
        )

    def _set_health(self, decision: Decision, now_ns: int) -> None:
        view = self._inputs.sight.view
        self._service.set_figure("lidar/seen", round(view.share, 3))
        for side, share in view.shares.items():
            self._service.set_figure(f"lidar/seen/{side.replace(' ', '_')}", round(share, 3))
        # The first scan takes a revolution, which is no trouble yet.
        has_begun = now_ns - self._clock.epoch > SCAN_SILENCE_NS
        is_lost = decision.reason in (codes.SCAN_LOST, codes.LINK_LOST, codes.OVERLOADED)
        if decision.mode == "fault" or (has_begun and is_lost):
            self._service.set_health("degraded", decision.message)
        elif self._estop.problem:
            self._service.set_health("degraded", self._estop.problem)
        elif view.lacks_echoes:
            self._service.set_health("degraded", NO_ECHO_MESSAGE)
        elif view.closed:
            sides = " and ".join(view.closed)
            self._service.set_health(
                "degraded",
                f"The lidar's view to the {sides} is blocked; look for a cable, dirt or "
                "something that covers it.",
            )
        elif self._clock.is_slowed:
            self._service.set_health(
                "degraded",
                "This machine is too slow for the configured rate; "
                f"it runs at {self._clock.rate:.2g}.",
            )
        elif self._inputs.trouble:
            self._service.set_health("degraded", self._inputs.trouble)
        elif self._inputs.silent_sensors:
            names = " and ".join(f"scan/{name}" for name in self._inputs.silent_sensors)
            self._service.set_health(
                "degraded", f"Nothing comes from {names} any more: does its program still run?"
            )
        elif self._inputs.has_ended:
            self._service.set_health(
                "ok", "The recording has ended; the robot stands where it ended."
            )
        else:
            self._service.set_health("ok")
