"""A trip under way: which goal to send when, and what becomes of it.

A state machine without clock or wire. It hears people, the planner, the base and the time, changes
its record, and leaves actions for its service to carry out.
"""

import re
from collections.abc import Callable

from trolley import codes
from trolley.codes import Refused
from trolley.geometry import Pose2D
from trolley.messages import BaseState, GoalStatus
from trolley.messages.request_params import SendGoal
from trolley.messages.touring import TripState
from trolley_tour import sentences
from trolley_tour.trips.actions import Action, Cancel, Limits, Pause, Send
from trolley_tour.trips.goal_attempt import Asking
from trolley_tour.trips.record import Moment, TripRecord

PLANNER = "planner"
ACTIVE = ("planning", "driving", "recovering")
TRIP_GOAL = re.compile(r"tour-[a-z0-9]{1,12}-\d+-\d+")
WAITS_FOR_PLANNER = (codes.NOT_READY, codes.TIMEOUT)

LONGEST_WAIT_S = 60.0
LAP_PAUSE_S = 1.0
"""Between laps, so that a tour whose stops are all where the robot stands does not spin."""
LONGEST_STEP_S = 10.0
"""Robot time that counts at most between two ticks."""


class Trip:
    """A trip.

    Args:
        record: Where it stands; changed in place.
        find: The pose of a saved name on the present map; raises `Refused`.
        limits: From the configuration.
    """

    def __init__(
        self, record: TripRecord, find: Callable[[str], Pose2D], limits: Limits | None = None
    ) -> None:
        self.record = record
        self.actions: list[Action] = []
        """What is to be done, in order; the service takes them out."""
        self.needs_saving = False
        self._find = find
        self._limits = limits or Limits()
        self._held = False
        self._source: str | None = None
        self._asking = Asking()
        self._asked_ns = 0
        # Robot seconds.
        self._robot_ns: int | None = None
        self._wait_s: float | None = None
        self._dwell_s = 0.0
        self._try_s = 0.0

    # People.
    def begin(self, at: Moment, goal_before: str | None, source: str | None = None) -> None:
        """Set off.

        Args:
            at: Now.
            goal_before: The planner's present goal, which this trip replaces.
            source: Who drove the robot until now.
        """
        self._source, self._asked_ns = source, at.robot_ns or 0
        self.record.started_at, self.record.map = at.utc, at.map
        self.record.goal_before = goal_before
        self._drive(at)

    def pause(self, reason: str, message: str) -> None:
        """Stand still until `resume`; a trip that does not go on by itself stays as it is."""
        record = self.record
        if record.is_under_way:
            if record.goal is not None and not record.reached_here:
                self.actions.append(Pause(record.goal))
            self._asking.is_standing = False
            self._set("paused", reason, message)

    def resume(self, at: Moment, goal_before: str | None) -> None:
        """Drive to the same stop again."""
        if self.record.state == "paused":
            self._held, self._asked_ns = False, at.robot_ns or 0
            self.record.goal_before = goal_before
            self._drive(at)

    def skip(self, at: Moment) -> None:
        """Leave this stop out; a paused trip stays paused, before the next one."""
        record, was_paused = self.record, self.record.state == "paused"
        self._let_go()
        if not record.reached_here:
            message = sentences.opened(record.title, "skipped by a person")
            record.note("skipped", codes.SKIPPED, message, at)
        self._advance(at)
        if was_paused and not record.is_over:
            self._set("paused", codes.PAUSED, f"Paused before {record.title}.")

    def stop(self, at: Moment, reason: str = "", message: str = "") -> None:
        """End the trip."""
        self._let_go()
        self._end("stopped", reason, message or f"Stopped before {self.record.title}.", at)

    # The planner.
    def wants(self, goal_id: str | None) -> bool:
        """Whether a goal that waits to be sent is still wanted."""
        return goal_id == self.record.goal and self.record.state in ("driving", "waiting")

    def hear_reply(self, goal_id: str, result: GoalStatus | Refused, at: Moment) -> None:
        """Take the planner's answer to a goal that was sent."""
        self._asking.answered(goal_id)
        if isinstance(result, GoalStatus):
            self.hear_goal(result, at)
            return
        if not self.wants(goal_id):
            return
        self._asking.is_accepted = False
        if result.code in WAITS_FOR_PLANNER:
            absent = result.details.get("service") == PLANNER
            code = codes.NO_PLANNER if absent else codes.NOT_READY
            self._set("waiting", code, codes.SENTENCES[code] if absent else result.message)
        elif result.code == codes.NOT_LOCALIZED:
            self._set("waiting", result.code, sentences.opened(self.record.title, result.message))
        elif result.code == codes.STOPPED:
            self.pause(codes.STOPPED, sentences.PAUSES[codes.STOPPED])
        else:
            self._fail(result.code, result.message, at)

    def hear_goal(self, status: GoalStatus, at: Moment) -> None:
        """Take what the planner says of its goal."""
        record = self.record
        if self._held:
            return
        if status.id is not None and status.id == record.goal:
            self._asking.heard(status, at)
            self._hear_own(status, at)
        elif status.id is None:
            self._asking.heard_nothing(status, at)
        elif TRIP_GOAL.fullmatch(status.id):
            is_ours = record.is_under_way or status.id.startswith(f"tour-{record.trip}-")
            if is_ours and status.state in ACTIVE:
                self._correct(Cancel(status.id), at)
        elif status.id != record.goal_before:
            record.goal_before = status.id
            self.pause(codes.OTHER_GOAL, sentences.PAUSES[codes.OTHER_GOAL])

    def _hear_own(self, status: GoalStatus, at: Moment) -> None:
        if self.record.state == "paused":
            self._hear_paused(status, at)
        elif self.record.state in ("driving", "waiting"):
            match status.state:
                case "arrived":
                    self._reach(at)
                case "failed":
                    self._fail(status.reason, status.message or sentences.of(status.reason), at)
                case "paused":
                    self._stand(status.reason or codes.PAUSED, status.message)
                case "canceled":
                    replaced = status.reason == codes.REPLACED
                    self._stand(codes.OTHER_GOAL if replaced else codes.CANCELED, "")
                case "recovering":
                    why = status.message or sentences.of(status.reason)
                    self._set("driving", status.reason, sentences.opened(self.record.title, why))
                case "planning" | "driving":
                    self._set_driving()
                case "idle":
                    self._asking.lost(at)

    def _hear_paused(self, status: GoalStatus, at: Moment) -> None:
        """Hear of the goal of a paused trip, which somebody may resume or cancel by itself."""
        if status.state not in ACTIVE:
            self._asking.is_standing = True
        elif self._asking.is_standing:
            self._set_driving()
        elif status.id is not None:
            self._correct(Pause(status.id), at)

    # The base.
    def hear_base(self, base: BaseState) -> None:
        """A stop or a hand on the robot pauses the trip, whatever it is doing."""
        if base.is_from_before(self._asked_ns):
            return
        taken = base.source not in (None, PLANNER) and base.source != self._source
        self._source = base.source
        if base.mode == "stopped":
            why = base.message.rstrip(".") or "The robot was stopped"
            self.pause(codes.STOPPED, f"{why}; resume the robot, then the tour.")
        elif taken:
            self.pause(codes.TAKEN_OVER, sentences.PAUSES[codes.TAKEN_OVER])

    def epoch_began(self, epoch_ns: int) -> None:
        """A restart of `base` pauses the trip (one that was loaded waits for `go_on`)."""
        self._robot_ns = None
        if not self._held and self.record.epoch_ns != epoch_ns:
            if self.record.epoch_ns is not None:
                self.pause(codes.RESTARTED, sentences.PAUSES[codes.RESTARTED])
            self.record.epoch_ns = epoch_ns
            self.needs_saving = True

    # A restart of this service.
    @property
    def is_held(self) -> bool:
        """Whether it was loaded and waits for `go_on`."""
        return self._held

    def hold(self) -> None:
        """Wait after loading until `go_on`: the robot may have been restarted too."""
        if self.record.is_under_way:
            self._held = True
            message = "The tour service was restarted and waits for the robot."
            self._set("waiting", codes.RESTARTED, message)

    def go_on(self, at: Moment, epoch_ns: int, goal: GoalStatus | None) -> None:
        """Go on after a restart of this service, with what the planner says of its goal.

        In the same run of `base` the goal is adopted, or sent again where the planner lost it. In
        another one the robot was restarted: only a tour with `resume` goes on.
        """
        record, self._held = self.record, False
        rebooted = record.epoch_ns not in (None, epoch_ns)
        record.epoch_ns = epoch_ns
        self.needs_saving = True
        if not record.is_under_way:
            return
        if rebooted:
            record.goal_before = None if goal is None else goal.id
            if record.tour.resume:
                self._drive(at)
            else:
                self.pause(codes.RESTARTED, sentences.PAUSES[codes.RESTARTED])
            return
        if record.reached_here:
            self._dwell()
        else:
            self._set_driving()
            self._wait_s = 0.0 if record.goal is None else None
        if goal is not None:
            if goal.id == record.goal:
                self._try_s = goal.elapsed
                record.visit_seconds = max(record.visit_seconds, goal.elapsed)
            self.hear_goal(goal, at)

    # Time.
    def tick(self, at: Moment) -> None:
        """Let time pass: dwell, wait, time out, ask again."""
        step_s = self._step(at)
        record = self.record
        if self._held or not record.is_under_way:
            return
        record.seconds += step_s
        if record.state == "dwelling":
            self._dwell_s -= step_s
            if self._dwell_s <= 0.0:
                self._advance(at)
        elif self._wait_s is not None:
            self._wait_s -= step_s
            if self._wait_s <= 0.0:
                self._drive(at)
        else:
            self._watch_drive(at, step_s)

    def _step(self, at: Moment) -> float:
        """Robot seconds since the last tick, 0 where unknown."""
        before, self._robot_ns = self._robot_ns, at.robot_ns
        if before is None or at.robot_ns is None:
            return 0.0
        return min(max(0.0, (at.robot_ns - before) * 1e-9), LONGEST_STEP_S)

    def _watch_drive(self, at: Moment, step_s: float) -> None:
        """Time out, and ask the planner again where it is silent or has not taken the goal.

        Time spent waiting for a planner does not count; time spent waiting for a pose does.
        """
        record = self.record
        unlocalized = record.state == "waiting" and record.reason == codes.NOT_LOCALIZED
        if record.state == "driving" or unlocalized:
            self._try_s += step_s
            record.visit_seconds += step_s
        limit_s = record.stop.timeout or self._limits.stop_timeout_s
        if self._try_s >= limit_s:
            why = f"not reached within {sentences.seconds(limit_s)}"
            self._let_go()
            self._fail(codes.TIMEOUT, f"{why}; {record.message}" if unlocalized else why, at)
            return
        if self._asking.is_due(at):
            self._send(at)

    # Steps of the trip.
    def _drive(self, at: Moment) -> None:
        """Send a new goal for the present stop."""
        record = self.record
        record.next_goal()
        record.visit_started_at = record.visit_started_at or at.utc
        self._asking.renew()
        self._try_s = 0.0
        self._set_driving()
        self.needs_saving = True
        self._send(at)

    def _send(self, at: Moment) -> None:
        """Ask for the present goal; the same id twice is one goal."""
        record = self.record
        stop = record.stop
        try:
            pose = stop.pose if stop.name is None else self._find(stop.name)
        except Refused as refused:
            self._let_go()
            self._fail(refused.code, refused.message, at)
            return
        record.visit_pose = pose
        self._asking.sent(record.goal, at)
        self.actions.append(Send(SendGoal(id=record.goal, pose=pose, frame="map", via=record.via)))

    def _reach(self, at: Moment) -> None:
        record = self.record
        if not record.reached_here:
            record.note("reached", "", sentences.opened(record.title, "reached"), at)
        self._dwell()

    def _dwell(self) -> None:
        self._dwell_s = self.record.stop.dwell
        stay = f" for {sentences.seconds(self._dwell_s)}" if self._dwell_s > 0.0 else ""
        self._set("dwelling", "", f"At {self.record.title}{stay}.")

    def _stand(self, reason: str, message: str) -> None:
        """Pause because the goal is paused or gone at the planner already."""
        self._set("paused", reason, sentences.PAUSES.get(reason) or message or sentences.of(reason))
        self._asking.is_standing = True

    def _fail(self, code: str, why: str, at: Moment) -> None:
        """Try again, skip the stop or give up, as the tour says."""
        record, stop = self.record, self.record.stop
        record.failures += 1
        record.goal = None
        endless = stop.on_failure == "retry" and stop.retries == 0
        if record.failures <= stop.retries or endless:
            doubled_s = self._limits.retry_wait_s * 2.0 ** min(record.failures - 1, 10)
            wait_s = min(doubled_s, max(LONGEST_WAIT_S, self._limits.retry_wait_s))
            again = f"tried again in {sentences.seconds(wait_s)}"
            self._set("waiting", code, sentences.opened(record.title, why, again))
            self._wait_s = wait_s
            return
        skips = stop.on_failure == "skip"
        then = "skipped" if skips else "the trip was given up"
        message = sentences.opened(record.title, why, then)
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
            self._end("done", *record.done_words, at)
            return
        self._set_driving()
        self._wait_s = 0.0
        if came == "lap":
            self._wait_s = min(LAP_PAUSE_S * 2.0 ** min(record.barren_laps, 10), LONGEST_WAIT_S)
        self.needs_saving = True

    def _end(self, state: TripState, reason: str, message: str, at: Moment) -> None:
        self.record.goal = None
        self.record.ended_at = at.utc
        self._held = False
        self._set(state, reason, message)

    def _let_go(self) -> None:
        """Give up the goal, unless it has ended by arriving."""
        if self.record.goal is not None and self.record.state != "dwelling":
            self.actions.append(Cancel(self.record.goal))

    def _correct(self, action: Action, at: Moment) -> None:
        """Repeat what a goal of ours did not heed."""
        if self._asking.may_correct(at):
            self.actions.append(action)

    def _set_driving(self) -> None:
        self._set("driving", *self.record.driving_words)

    def _set(self, state: TripState, reason: str, message: str) -> None:
        record = self.record
        self._wait_s = None
        self.needs_saving |= state != record.state
        record.state, record.reason, record.message = state, reason, message
