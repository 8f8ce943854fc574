"""What is driven: commands and stops come in, one velocity goes out to the motors."""

from trolley import codes, requests, topics
from trolley.geometry import Twist2D
from trolley.messages import BaseState, VelocityCommand
from trolley.messages.request_params import Nothing
from trolley.runtime.service import Later, Service, answers, on
from trolley_base.device_inputs import DeviceInputs
from trolley_base.drivers import Hardware
from trolley_base.motion_watch import MotionWatch
from trolley_base.odometry.wheel_scales import WheelScales
from trolley_base.robot_clock import RobotClock
from trolley_base.safety.arbiter import WHY
from trolley_base.safety.estop_latch import EstopLatch
from trolley_base.safety.own_pauses import OwnPauses
from trolley_base.safety.safety_state import find_restriction
from trolley_base.safety.velocity_limiter import Decision, VelocityLimiter
from trolley_base.state_reporter import StateReporter


class DriveControl:
    """Decides which velocity the motors get, in each control period and at each stop.

    Args:
        cannot_drive: why commands go nowhere, "" where they drive.
        limiter: chooses the command, and limits it.
        scales: between true and reported motion.
        inputs: what the devices report.
        watch: finds out whether the motors obey.
    """

    def __init__(
        self,
        service: Service,
        clock: RobotClock,
        cannot_drive: str,
        limiter: VelocityLimiter,
        scales: WheelScales,
        inputs: DeviceInputs,
        watch: MotionWatch,
    ) -> None:
        self._service = service
        self._clock = clock
        self._cannot_drive = cannot_drive
        self._limiter = limiter
        self._scales = scales
        self._inputs = inputs
        self._watch = watch
        self._estop = EstopLatch(service)
        self._own_pauses = OwnPauses()
        self.reporter = StateReporter(service, clock, inputs, watch, self._estop)
        """Publishes what was decided."""
        self.parts = (self, self._estop)
        self.decision = Decision(Twist2D.zero(), None, 0, "ok")
        """What is driven now, and why."""

    def begin(self, hardware: Hardware) -> None:
        """Begin a run with devices that have been opened; an earlier stop still holds."""
        self._chassis = hardware.chassis
        self._watch.begin(hardware)
        self._estop.load()

    def update(self, now_ns: int) -> None:
        """Decide what is driven until the next period."""
        own_pause_ns = self._own_pauses.note(now_ns)
        if own_pause_ns:
            seconds = round(own_pause_ns * 1e-9, 2)
            self._service.log.limited("held_up", "base was held up", seconds=seconds)
        self._watch.update(now_ns, self._inputs.measured)
        must_stop = self._inputs.is_button_pressed or self._watch.is_latched
        if must_stop and not self._estop.is_set:
            self._switch(is_stopped=True)
            self._estop.save()
        self._decide(now_ns)

    def _decide(self, now_ns: int) -> None:
        state = self._inputs.safety_state(
            now_ns,
            self._cannot_drive,
            is_stopped=self._estop.is_set,
            own_pause_ns=self._own_pauses.pause_ns,
        )
        restriction = self._watch.restriction or find_restriction(state)
        self.decision = self._limiter.decide(
            now_ns, self._inputs.echoes, restriction, self._inputs.unseen
        )
        self._chassis.drive(self._scales.reported_twist(self.decision.twist))
        self._inputs.command(now_ns, self.decision.twist)
        self._watch.command(now_ns, self.decision.twist, is_heard=state.chassis.link.state == "up")

    @on(topics.COMMAND, wakes=False)
    def take_command(self, command: VelocityCommand, source: str) -> None:
        """Keep a source's command until the next decision, or drop it and count why."""
        arrived_ns = self._clock.now(self._service.arrived_ns) or 0
        foremost_ns = self._clock.foremost(self._service.monotonic_ns)
        rejected = self._limiter.offer(source, command, arrived_ns, foremost_ns)
        if rejected is not None:
            name = f"cmd_vel/{rejected.value}"
            self._service.count(name)
            late_s = round((arrived_ns - command.stamp_ns) * 1e-9, 3)
            self._service.log.limited(
                name, "Command dropped", source=source, late_s=late_s, why=WHY[rejected]
            )

    @answers(requests.BASE_STOP)
    def stop(self, _: Nothing) -> Later[BaseState]:
        """Stop until resumed; answer when no crash can undo it any more."""
        later: Later[BaseState] = self._service.later()
        state = self._switch(is_stopped=True)
        self._estop.save(then=lambda: later.reply(state))
        return later

    @answers(requests.BASE_RESUME)
    def resume(self, _: Nothing) -> BaseState:
        """Let commands that arrive from now on drive again; not while it does not stop."""
        self._watch.clear()
        state = self._switch(is_stopped=self._watch.is_latched)
        self._estop.save()
        return state

    def _switch(self, *, is_stopped: bool) -> BaseState:
        """Stop, or let drive again, at once; what changes nothing is not published."""
        now_ns = self._service.stamp_ns
        if is_stopped == self._estop.is_set:
            self._decide(now_ns)
            return self.reporter.state_of(self.decision, now_ns)
        self._service.log.info("Stopped" if is_stopped else "Resumed")
        self._estop.is_set = is_stopped
        self._limiter.forget()
        self._decide(now_ns)
        return self.reporter.publish_state(self.decision, now_ns)

    def end(self) -> None:
        """Stop the motors, and say that base ends."""
        self._chassis.drive(Twist2D.zero())
        sentence = codes.SENTENCES[codes.SHUTDOWN]
        self.decision = Decision(Twist2D.zero(), None, 0, "held", codes.SHUTDOWN, sentence)
