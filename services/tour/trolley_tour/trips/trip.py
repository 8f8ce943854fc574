"""A trip under way: which goal to send when, and what becomes of it.

A state machine without clock or wire. It takes what people, the planner, the base and the time say,
changes its record, and leaves actions for its runner to carry out.
"""

import dataclasses
from collections.abc import Callable

from trolley import codes
from trolley.codes import Refused
from trolley.geometry import Pose2D
from trolley.messages import BaseState, GoalStatus
from trolley.messages.request_params import SendGoal
from trolley.messages.touring import TripState
from trolley.under_way import GOAL_GOES, trip_of
from trolley_tour import sentences
from trolley_tour.robot_state import PLANNER
from trolley_tour.trips.actions import Action, Cancel, Pause, Send
from trolley_tour.trips.goal_attempt import GoalAttempt
from trolley_tour.trips.record import Moment, TripRecord
from trolley_tour.trips.trip_params import TripParams


@dataclasses.dataclass(frozen=True, slots=True)
class Held:
    """Loaded after a restart of this service: nothing moves until `go_on`."""


@dataclasses.dataclass(frozen=True, slots=True)
class Driving:
    """The present goal is the planner's, or sent again until it is."""


@dataclasses.dataclass(frozen=True, slots=True)
class Waiting:
    """Robot time passes until the next goal: a retry, the next stop or the next lap."""

    left_s: float


@dataclasses.dataclass(frozen=True, slots=True)
class Dwelling:
    """The robot stays at a stop that it reached."""

    left_s: float


@dataclasses.dataclass(frozen=True, slots=True)
class Paused:
    """A person must go on, by the trip or by its goal."""

    goal_stands: bool = False
    """Whether the planner has said that the goal stands; if it drives then, it was resumed."""


@dataclasses.dataclass(frozen=True, slots=True)
class Over:
    """Nothing is left to do."""


Phase = Held | Driving | Waiting | Dwelling | Paused | Over


class Trip:
    """The state machine of one trip: told of time, goal and base, it returns actions.

    Args:
        record: Where it stands; changed in place.
        find: The pose of a saved name on the present map; raises `Refused`.
        params: Its numbers.
    """

    def __init__(
        self, record: TripRecord, find: Callable[[str], Pose2D], params: TripParams | None = None
    ) -> None:
        self.record = record
        self.actions: list[Action] = []
        """What is to be done, in order; the runner takes them out."""
        self.needs_saving = False
        self._find = find
        self._params = params or TripParams()
        self._phase: Phase = _phase_of(record)
        self._attempt = GoalAttempt(self._params)
        self._source: str | None = None
        """Whose commands the base follows."""
        self._asked_ns = 0
        """Robot time at which a person last set it off; what the base said before is ignored."""
        self._ticked_ns: int | None = None
        self._corrected_ns: int | None = None

    def set_params(self, params: TripParams) -> None:
        """Wait and give up by other numbers from now on."""
        self._params = params

    # People.
    def begin(self, at: Moment, goal_before: str | None, source: str | None = None) -> None:
        """Set off.

        Args:
            at: Now.
            goal_before: The planner's present goal, which this trip replaces.
            source: Who drove the robot until now.
        """
        self._source, self._asked_ns = source, at.robot_ns or 0
        self.record.started_at, self.record.map = at.utc, self.record.tour.map or at.map
        self.record.goal_before = goal_before
        self._drive(at)

    def pause(self, reason: str, message: str) -> None:
        """Stand still until `resume`; a trip that is paused or over stays as it is."""
        record = self.record
        if record.is_under_way:
            if record.goal is not None and not record.reached_here:
                self.actions.append(Pause(record.goal))
            self._enter(Paused(), "paused", reason, message)

    def resume(self, at: Moment, goal_before: str | None) -> None:
        """Drive to the same stop again."""
        if self.record.state == "paused":
            self._asked_ns = at.robot_ns or 0
            self.record.goal_before = goal_before
            self._drive(at)

    def skip(self, at: Moment) -> None:
        """Leave this stop out; a paused trip stays paused before the next one, a held one held."""
        record, phase = self.record, self._phase
        self._cancel_goal()
        if not record.reached_here:
            message = sentences.about_stop(record.title, "skipped by a person")
            record.note("skipped", codes.SKIPPED, message, at)
        self._advance(at)
        if record.is_over:
            return
        match phase:
            case Paused():
                self._enter(phase, "paused", codes.PAUSED, f"Paused before {record.title}.")
            case Held():
                self._phase = phase
            case _:
                pass

    def stop(self, at: Moment, reason: str = "", message: str = "") -> None:
        """End the trip."""
        self._cancel_goal()
        self._end("stopped", reason, message or f"Stopped before {self.record.title}.", at)

    # The planner.
    def wants(self, goal_id: str | None) -> bool:
        """Whether a goal that waits to be sent is still wanted."""
        return goal_id == self.record.goal and self.record.state in ("driving", "waiting")

    def update_reply(self, goal_id: str, result: GoalStatus | Refused, at: Moment) -> None:
        """Take the planner's answer to a goal that was sent."""
        if goal_id == self.record.goal:
            self._attempt.answered()
        if isinstance(result, GoalStatus):
            self.update_goal(result, at)
            return
        if not self.wants(goal_id):
            return
        self._attempt.refused()
        if result.code in codes.UNANSWERED:  # it is sent again until the planner takes it
            is_absent = result.details.get("service") == PLANNER
            code = codes.NO_PLANNER if is_absent else codes.NOT_READY
            self._tell("waiting", code, codes.SENTENCES[code] if is_absent else result.message)
        elif result.code == codes.NOT_LOCALIZED:
            message = sentences.about_stop(self.record.title, result.message)
            self._tell("waiting", result.code, message)
        elif result.code == codes.STOPPED:
            self.pause(codes.STOPPED, sentences.PAUSES[codes.STOPPED])
        else:
            self._fail(result.code, result.message, at)

    def update_goal(self, status: GoalStatus, at: Moment) -> None:
        """Take what the planner reports of its goal."""
        record = self.record
        if self.is_held:
            return
        if status.id is not None and status.id == record.goal:
            self._attempt.update(status, at)
            self._update_own_goal(status, at)
        elif status.id is None:
            self._attempt.update_idle(status, at)
        elif (trip := trip_of(status.id)) is not None:
            is_ours = record.is_under_way or trip == record.trip
            if is_ours and status.state in GOAL_GOES:
                self._correct(Cancel(status.id), at)
        elif status.id != record.goal_before:
            record.goal_before = status.id
            self.pause(codes.OTHER_GOAL, sentences.PAUSES[codes.OTHER_GOAL])

    def _update_own_goal(self, status: GoalStatus, at: Moment) -> None:
        match self._phase:
            case Paused(goal_stands):
                self._update_paused_goal(goal_stands, status, at)
            case Driving():
                self._update_driven_goal(status, at)
            case _:
                pass

    def _update_driven_goal(self, status: GoalStatus, at: Moment) -> None:
        match status.state:
            case "arrived":
                self._reach(at)
            case "failed":
                self._fail(status.reason, status.message or sentences.of(status.reason), at)
            case "paused":
                self._stand(status.reason or codes.PAUSED, status.message)
            case "canceled":
                is_replaced = status.reason == codes.REPLACED
                self._stand(codes.OTHER_GOAL if is_replaced else codes.CANCELED, "")
            case "recovering":
                why = status.message or sentences.of(status.reason)
                message = sentences.about_stop(self.record.title, why)
                self._enter(Driving(), "driving", status.reason, message)
            case "planning" | "driving":
                self._enter_driving()
            case "idle":
                self._attempt.lost(at)

    def _update_paused_goal(self, goal_stands: bool, status: GoalStatus, at: Moment) -> None:
        """Notice that somebody resumed the goal by itself, or that it ignored the pause."""
        if status.state not in GOAL_GOES:
            self._phase = Paused(goal_stands=True)
        elif goal_stands:
            self._enter_driving()
        elif status.id is not None:
            self._correct(Pause(status.id), at)

    # The base.
    def update_base(self, base: BaseState) -> None:
        """A stop or a hand on the robot pauses the trip, whatever it is doing."""
        if base.is_from_before(self._asked_ns):
            return
        is_taken = base.source not in (None, PLANNER) and base.source != self._source
        self._source = base.source
        if base.is_halted:
            why = base.message.rstrip(".") or "The robot was stopped"
            if base.reason == codes.DOES_NOT_OBEY:
                why = codes.SENTENCES[base.reason].rstrip(".")
            self.pause(codes.STOPPED, f"{why}; resume the robot, then the tour.")
        elif is_taken:
            self.pause(codes.TAKEN_OVER, sentences.PAUSES[codes.TAKEN_OVER])

    def epoch_began(self, epoch_ns: int) -> None:
        """A restart of `base` pauses the trip (one that is held waits for `go_on`)."""
        self._ticked_ns = None
        if not self.is_held and self.record.epoch_ns != epoch_ns:
            if self.record.epoch_ns is not None:
                self.pause(codes.RESTARTED, sentences.PAUSES[codes.RESTARTED])
            self.record.epoch_ns = epoch_ns
            self.needs_saving = True

    # A restart of this service.
    @property
    def is_held(self) -> bool:
        """Whether it was loaded and waits for `go_on`."""
        return isinstance(self._phase, Held)

    def hold(self) -> None:
        """Say after loading that it waits for `go_on`: the robot may have been restarted too."""
        if self.is_held:
            message = "The tour service was restarted and is waiting for the robot."
            self._tell("waiting", codes.RESTARTED, message)

    def go_on(self, at: Moment, epoch_ns: int, goal: GoalStatus | None) -> None:
        """Go on after a restart of this service, with what the planner says of its goal.

        In the same run of `base` the goal is adopted, or sent again where the planner lost it. In
        another one the robot was restarted: only a tour with `resume` goes on.
        """
        record = self.record
        is_rebooted = record.epoch_ns not in (None, epoch_ns)
        record.epoch_ns = epoch_ns
        self.needs_saving = True
        if not record.is_under_way:
            return
        if is_rebooted:
            record.goal_before = None if goal is None else goal.id
            if record.tour.resume:
                self._drive(at)
            else:
                self.pause(codes.RESTARTED, sentences.PAUSES[codes.RESTARTED])
            return
        if record.reached_here:
            self._dwell()
        else:
            self._enter_driving()
            if record.goal is None:
                self._phase = Waiting(0.0)
        if goal is not None:
            if goal.id == record.goal:
                self._attempt.seconds = goal.elapsed
                record.visit_seconds = max(record.visit_seconds, goal.elapsed)
            self.update_goal(goal, at)

    # Time.
    def tick(self, at: Moment) -> None:
        """Let time pass: dwell, wait, time out, ask again."""
        step_s, record = self._step(at), self.record
        if record.state == "paused" and record.paused_at is None and at.utc is not None:
            record.paused_at, self.needs_saving = at.utc, True
        if self.is_held or not record.is_under_way:
            return
        record.seconds += step_s
        match self._phase:
            case Dwelling(left_s):
                self._phase = Dwelling(left_s - step_s)
                if left_s - step_s <= 0.0:
                    self._advance(at)
            case Waiting(left_s):
                self._phase = Waiting(left_s - step_s)
                if left_s - step_s <= 0.0:
                    self._drive(at)
            case _:
                self._watch_drive(at, step_s)

    def _step(self, at: Moment) -> float:
        """Robot seconds since the last tick, 0 where unknown."""
        before_ns, self._ticked_ns = self._ticked_ns, at.robot_ns
        if before_ns is None or at.robot_ns is None:
            return 0.0
        return min(max(0.0, (at.robot_ns - before_ns) * 1e-9), self._params.longest_step_s)

    def _watch_drive(self, at: Moment, step_s: float) -> None:
        """Time out, and ask the planner again where it is silent or has not accepted the goal.

        Time spent waiting for a planner does not count; time spent waiting for a pose does.
        """
        record = self.record
        is_unlocalized = record.state == "waiting" and record.reason == codes.NOT_LOCALIZED
        if record.state == "driving" or is_unlocalized:
            self._attempt.seconds += step_s
            record.visit_seconds += step_s
        limit_s = record.stop.timeout or self._params.stop_timeout_s
        if self._attempt.seconds >= limit_s:
            why = f"not reached within {sentences.seconds(limit_s)}"
            self._cancel_goal()
            self._fail(codes.TIMEOUT, f"{why}; {record.message}" if is_unlocalized else why, at)
            return
        if self._attempt.is_due(at):
            self._send(at)

    # Steps of the trip.
    def _drive(self, at: Moment) -> None:
        """Send a new goal for the present stop."""
        record = self.record
        record.next_goal()
        record.visit_started_at = record.visit_started_at or at.utc
        self._attempt = GoalAttempt(self._params)
        self._enter_driving()
        self.needs_saving = True
        self._send(at)

    def _send(self, at: Moment) -> None:
        """Ask for the present goal; the same id twice is one goal."""
        record = self.record
        record.map = record.map or at.map
        try:
            pose = self._stop_pose(at)
        except Refused as refused:
            self._cancel_goal()
            self._fail(refused.code, refused.message, at)
            return
        record.visit_pose = pose
        self._attempt.sent(at)
        goal = SendGoal(id=record.goal, pose=pose, frame="map", via=record.via, speed=record.speed)
        self.actions.append(Send(goal))

    def _stop_pose(self, at: Moment) -> Pose2D | None:
        """Where the present stop is.

        Raises:
            Refused: It is not known, or on another map than the robot.
        """
        record, stop = self.record, self.record.stop
        is_by_numbers = stop.name is None or bool(record.via)
        if is_by_numbers and at.map is not None and at.map != record.map:
            why = f"it is on the map {record.map}, the robot is on {at.map}"
            raise Refused(codes.WRONG_MAP, why)
        return stop.pose if stop.name is None else self._find(stop.name)

    def _reach(self, at: Moment) -> None:
        record = self.record
        if not record.reached_here:
            record.note("reached", "", sentences.about_stop(record.title, "reached"), at)
        self._dwell()

    def _dwell(self) -> None:
        dwell_s = self.record.stop.dwell
        stay = f" for {sentences.seconds(dwell_s)}" if dwell_s > 0.0 else ""
        self._enter(Dwelling(dwell_s), "dwelling", "", f"At {self.record.title}{stay}.")

    def _stand(self, reason: str, message: str) -> None:
        """Pause because the goal is paused or gone at the planner already."""
        message = sentences.PAUSES.get(reason) or message or sentences.of(reason)
        self._enter(Paused(goal_stands=True), "paused", reason, message)

    def _fail(self, code: str, why: str, at: Moment) -> None:
        """Try again, skip the stop or give up, as the tour says."""
        record, stop = self.record, self.record.stop
        record.failures += 1
        record.goal = None
        is_endless = stop.on_failure == "retry" and stop.retries == 0
        if record.failures <= stop.retries or is_endless:
            wait_s = self._params.retry_wait_after(record.failures)
            again = f"trying again in {sentences.seconds(wait_s)}"
            message = sentences.about_stop(record.title, why, again)
            self._enter(Waiting(wait_s), "waiting", code, message)
            return
        skips = stop.on_failure == "skip"
        then = "skipped" if skips else "the trip was given up"
        message = sentences.about_stop(record.title, why, then)
        if not record.reached_here:
            record.note("skipped" if skips else "failed", code, message, at)
        if skips:
            self._advance(at)
        else:
            self._end("failed", codes.ABORTED, message, at)

    def _advance(self, at: Moment) -> None:
        """Turn to the next visit, which begins at a later tick."""
        record = self.record
        came = record.advance()
        if came == "end":
            self._end("done", *record.done_reason_and_message, at)
            return
        pause_s = self._params.lap_pause_after(record.barren_laps) if came == "lap" else 0.0
        self._enter(Waiting(pause_s), "driving", *record.driving_reason_and_message)
        self.needs_saving = True

    def _end(self, state: TripState, reason: str, message: str, at: Moment) -> None:
        self.record.goal = None
        self.record.ended_at = at.utc
        self._enter(Over(), state, reason, message)

    def _cancel_goal(self) -> None:
        """Cancel the goal, unless it has ended by arriving."""
        record = self.record
        if record.goal is None or record.state == "dwelling":
            return
        self.actions.append(Cancel(record.goal))
        before = record.goal_before
        if before is not None and trip_of(before) == record.trip:
            # The planner may have refused the goal of a `resume`, and kept the one before it.
            self.actions.append(Cancel(before))

    def _correct(self, action: Action, at: Moment) -> None:
        """Repeat, once a second, what a goal of ours ignored."""
        last_ns = self._corrected_ns
        again_ns = int(self._params.ask_again_s * 1e9)
        if last_ns is None or at.monotonic_ns - last_ns >= again_ns:
            self._corrected_ns = at.monotonic_ns
            self.actions.append(action)

    def _enter_driving(self) -> None:
        self._enter(Driving(), "driving", *self.record.driving_reason_and_message)

    def _enter(self, phase: Phase, state: TripState, reason: str, message: str) -> None:
        self._phase = phase
        self._tell(state, reason, message)

    def _tell(self, state: TripState, reason: str, message: str) -> None:
        """Set what the record says, which is saved where the state changes."""
        record = self.record
        if state != record.state:
            record.paused_at, self.needs_saving = None, True
        record.state, record.reason, record.message = state, reason, message


def _phase_of(record: TripRecord) -> Phase:
    """The phase of a trip that is loaded or about to begin."""
    if record.is_under_way:
        return Held()
    return Over() if record.is_over else Paused()
