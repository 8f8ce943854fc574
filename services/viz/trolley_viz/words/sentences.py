"""Sentences for people: the state of robot, drive and trip in everyday words."""

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Literal

from trolley import codes
from trolley.codes import Refused
from trolley.geometry import Pose2D
from trolley.messages import (
    BaseState,
    GoalStatus,
    MappingStatus,
    PoseEstimate,
    SavedPose,
    StopResult,
    Tour,
    TourStatus,
)
from trolley_viz.words.plain_words import said

Tone = Literal["good", "busy", "warn", "bad", "idle"]

Tell = Callable[[str, str, Tone], None]
"""Shows a person a title and a sentence."""

STALE_S = 1.0
SPOT = "the place on the map"
"""What a goal is called that is none of the places."""
SAME_PLACE_M = 0.1
"""A goal this near to a saved pose is called by its name."""
NEARLY_THERE_M = 0.1
"""From this near on, figures of how far and how long it still is would only flicker [m]."""

WAITS = (
    codes.WAITING,
    codes.SCAN_LOST,
    codes.LINK_LOST,
    codes.STALE,
    codes.LOST,
    codes.NOT_READY,
    codes.OUTSIDE_MAP,
)
"""Reasons of `recovering` for which the robot waits: for others that pass, or for its inputs."""
EXPLORES_WELL = ("exploring", "homing", "done")
"""States of exploring that need nobody."""


@dataclass(frozen=True)
class StatusLine:
    """One line of the status: a short headline, a tone for its colour, and the details."""

    headline: str
    tone: Tone
    detail: str = ""


SERVICES = {
    "base": "The motor service",
    "localizer": "The localizer",
    "mapper": "The mapper",
    "planner": "The planner",
    "tour": "The tour service",
}
"""What the services are called at the beginning of a sentence."""


def refusal(reply: Refused) -> str:
    """Say why something was refused, also where nobody was there to refuse it."""
    service = SERVICES.get(str(reply.details.get("service", "")))
    if service is not None and reply.code == codes.NOT_READY:
        return f"{service} is not running. If the robot has just started, try again in a moment."
    if service is not None and reply.code == codes.TIMEOUT:
        return f"{service} did not answer in time. Check whether it was done before you try again."
    if reply.code == codes.STOPPED and reply.message in ("", codes.SENTENCES[codes.STOPPED]):
        return STOPPED
    return said(reply.message, reply.code)


UNCONFIRMED = "The robot was told to stop, but the motor board is silent: it may still be moving."
GOES_ON = "It will continue by itself."
STOPPED = "The robot is stopped. Press “Drive on” first."
NO_CONTACT = "No contact with the robot. It may be switched off or out of range."
AWAY = StatusLine("Away", "bad", NO_CONTACT)


def away_line(age_s: float | None) -> StatusLine:
    """Say that nothing is heard of a robot, and for how long [s], None if it never was."""
    return AWAY if age_s is None else replace(AWAY, detail=no_contact(age_s))


def no_contact(age_s: float) -> str:
    """Say for how long [s] nothing has been heard of a robot, once that is a second."""
    if round(age_s) < 1:
        return NO_CONTACT
    return f"No contact with the robot for {_whole(age_s)}. It may be switched off or out of range."


def aged(words: StatusLine, age_s: float | None) -> StatusLine:
    """Say how old [s] that is what is said; None where it holds now."""
    if age_s is None:
        return words
    tone: Tone = "idle" if words.tone in ("good", "busy") else words.tone
    return replace(words, headline=with_age(words.headline, age_s), tone=tone)


def with_age(text: str, age_s: float) -> str:
    """Put behind a text how old [s] it is."""
    return f"{text.removesuffix('.')} · {age_text(age_s, 0.0)} ago"


def position_line(estimate: PoseEstimate | None, age_s: float | None) -> StatusLine:
    """Say how well the robot knows where it is; `age_s` [s] of the estimate, None if unknown."""
    if estimate is None:
        return StatusLine("No position", "idle", "The localizer is still starting.")
    if estimate.map is None:
        return StatusLine("No position", "idle", "There is no map: make one in the “Map” tab.")
    if age_s is None or age_s > STALE_S:
        stale = StatusLine("Stale", "bad", "The last position is too old to rely on.")
        return aged(stale, age_s)
    why = said(estimate.message)
    detail = _join(why, _where(estimate))
    match estimate.state:
        case "localized":
            return StatusLine(f"Localized {percent(estimate.match)}", "good", detail)
        case "unsure":
            return StatusLine(f"Unsure {percent(estimate.match)}", "warn", detail)
        case "searching":
            places = len(estimate.candidates)
            could = f"It could be in {places} places." if places > 1 else ""
            turn = "A turn on the spot would help." if estimate.wants_turn else ""
            return StatusLine("Searching", "busy", _join(why, could, turn))
        case "lost":
            return StatusLine("Lost", "bad", said(estimate.message, codes.LOST))
        case "mapping":
            return StatusLine("Mapping", "busy", detail)


def mapping_line(mapping: MappingStatus | None) -> StatusLine | None:
    """Say how mapping is going, or what came of it."""
    if mapping is None:
        return None
    why = said(mapping.message)
    if mapping.state == "idle":
        return StatusLine("No map is being made", "idle", why) if why else None
    loops = "1 loop" if mapping.loops == 1 else f"{mapping.loops} loops"
    loops = f", {loops} closed" if mapping.loops else ""
    scans = "1 scan" if mapping.scans == 1 else f"{mapping.scans} scans"
    detail = f"{duration(mapping.seconds // 1.0)}, {scans}{loops}."
    if mapping.loose:
        detail += " 1 scan hangs" if mapping.loose == 1 else f" {mapping.loose} scans hang"
        detail += " loose."
    name = mapping.name or ""
    match mapping.state:
        case "starting":
            return StatusLine("Getting ready", "busy", why)
        case "saving":
            return StatusLine(f"Saving “{name}”", "busy", why)
        case "paused":
            return StatusLine(f"“{name}” is paused", "warn", _join(detail, why))
        case _:
            what = f"Extending “{name}”" if mapping.extends else f"Mapping “{name}”"
            goes_well = mapping.exploring in EXPLORES_WELL
            tone: Tone = "warn" if why and not goes_well else "busy"
            return StatusLine(what, tone, _join(detail, why))


def base_line(base: BaseState | None, *, goes_on: bool = False) -> StatusLine | None:
    """Say what keeps the robot from driving; None where nothing does.

    Args:
        base: its state.
        goes_on: whether it is certain to drive on by itself once it may.
    """
    if base is None or (base.mode == "ok" and not base.reason):
        return None
    why = said(base.message, base.reason)
    match base.mode:
        case "ok":
            return StatusLine("Creeping", "warn", why)
        case "stopped" if base.is_stop_unconfirmed:
            return StatusLine("Stop not confirmed", "bad", why)
        case "stopped":
            remedy = "" if "“Drive on”" in why else "Press “Drive on” to let it drive again."
            return StatusLine("Stopped", "bad", _join(why.removeprefix("Stopped. "), remedy))
        case "held":
            return StatusLine("Held", "warn", _join(why, GOES_ON if goes_on else ""))
        case _:
            return StatusLine("NOT STOPPED" if base.not_stopped else "Fault", "bad", why)


def goal_line(goal: GoalStatus | None, places: list[SavedPose]) -> StatusLine:
    """Say where the robot is going and how far it still is."""
    if goal is None:
        return StatusLine("No planner", "idle", "The planner is still starting.")
    to = where_to(goal, places)
    why = said(goal.message, goal.reason)
    match goal.state:
        case "idle":
            return StatusLine("Standing by", "idle", why)
        case "planning":
            return StatusLine(f"Planning a path to {to}", "busy", why)
        case "driving":
            careful = said("", goal.warning)
            rest = _join(_remaining(goal), said(goal.message), careful)
            return StatusLine(f"Driving to {to}", "busy", rest)
        case "recovering":
            does = "Waiting" if goal.reason in WAITS else "Freeing itself"
            return StatusLine(f"{does} on the way to {to}", "warn", _join(why, _remaining(goal)))
        case "paused":
            return StatusLine(f"Paused on the way to {to}", "warn", why)
        case "arrived":
            return StatusLine(f"Arrived at {to}", "good", f"It took {duration(goal.elapsed)}.")
        case "failed":
            return StatusLine(f"Did not reach {to}", "bad", why)
        case "canceled":
            return StatusLine(f"Drive to {to} canceled", "idle", why)


def trip_line(trip: TourStatus | None, tour: Tour | None) -> StatusLine | None:
    """Say how the trip goes; `tour` is the stored tour of its name, None if there is none."""
    if trip is None or trip.state == "idle":
        return None
    name = f"“{trip.name}”" if trip.name else "Tour"
    stop = _stop_text(trip, tour)
    why = said(trip.message, trip.reason)
    if trip.state in ("driving", "dwelling") and not trip.reason:
        why = ""  # it only says again where the trip is
    match trip.state:
        case "driving":
            return StatusLine(f"{name}: {stop}", "busy", _join(_lap(trip, tour), why))
        case "dwelling":
            return StatusLine(f"{name}: at {stop}", "busy", _join(_lap(trip, tour), why))
        case "waiting":
            return StatusLine(f"{name} waiting: {stop}", "warn", why)
        case "paused":
            return StatusLine(f"{name} paused: {stop}", "warn", why)
        case "done":
            return StatusLine(f"{name} done", "good", _count(trip))
        case "failed":
            return StatusLine(f"{name} failed", "bad", _join(why, _count(trip)))
        case "stopped":
            return StatusLine(f"{name} stopped", "idle", _join(why, _count(trip)))


def result_line(result: StopResult) -> StatusLine:
    """Say how one stop of the trip ended."""
    name = result.name or f"stop {result.stop + 1}"
    why = said(result.message, result.code)
    match result.state:
        case "reached":
            return StatusLine(f"{name} reached", "good", duration(result.seconds))
        case "skipped":
            return StatusLine(f"{name} skipped", "warn", why)
        case "failed":
            return StatusLine(f"{name} not reached", "bad", why)


def stops_text(names: Sequence[str | None]) -> str:
    """Name stops in order; what has no name is a point, and of many the first are named."""
    stops = [name or "a point" for name in names]
    return " → ".join(stops if len(stops) <= 5 else [*stops[:4], f"{len(stops) - 4} more"])


def goal_name(goal: GoalStatus, places: list[SavedPose]) -> str:
    """Call the goal by whom it follows, by the saved pose that it is, or by its coordinates."""
    if goal.person is not None:
        return "the person"
    if goal.pose is None:
        return "the goal"
    if goal.frame == "map":
        near = [one for one in places if one.pose.distance_to(goal.pose) < SAME_PLACE_M]
        if near:
            return min(near, key=lambda one: one.pose.distance_to(goal.pose or one.pose)).name
    return f"({goal.pose.x:.2f}, {goal.pose.y:.2f})"


def where_to(goal: GoalStatus, places: list[SavedPose]) -> str:
    """Call the goal as people do, who know no coordinates."""
    name = goal_name(goal, places)
    return SPOT if name.startswith("(") else name


def remaining(goal: GoalStatus) -> str:
    """Say how far it still is and how long that takes; "" where neither is known."""
    parts: list[str] = []
    if goal.distance_remaining is not None:
        if goal.distance_remaining < NEARLY_THERE_M:
            return "nearly there"
        parts.append(f"{goal.distance_remaining:.1f} m to go")
    if goal.eta is not None:
        parts.append(estimate_text(goal.eta))
    return ", ".join(parts)


def pose_text(pose: Pose2D) -> str:
    """Write a pose for people: metres and degrees."""
    return f"x {pose.x:.2f} m, y {pose.y:.2f} m, {math.degrees(pose.yaw):.0f}°"


def percent(share: float) -> str:
    """Write a share as percent; 100 only where nothing is missing."""
    return f"{min(round(100 * share), 99) if share < 1.0 else 100} %"


def duration(seconds: float) -> str:
    """Write a time span for people."""
    if seconds < 9.95:
        return f"{seconds:.1f} s"
    whole = round(seconds)
    if whole < 120:
        return f"{whole} s"
    minutes = whole // 60
    return f"{minutes} min" if minutes < 120 else f"{minutes // 60} h {minutes % 60} min"


def estimate_text(seconds: float) -> str:
    """Write how long something will take for people: not more exactly than anybody knows."""
    return f"about {_whole(max(seconds, 1.0))}"


def age_text(age_s: float | None, live_s: float = 1.5) -> str:
    """Write how old something is, coarsely, so that it does not change all the time."""
    if age_s is None:
        return "no data"
    if age_s < live_s:
        return "now"
    return _whole(age_s)


def _whole(seconds: float) -> str:
    """Write a time span without parts of a second."""
    return f"{round(seconds)} s" if seconds < 120.0 else duration(seconds)


def _where(estimate: PoseEstimate) -> str:
    if estimate.pose is None:
        return ""
    if estimate.covariance is None:
        return pose_text(estimate.pose)
    std_m = math.sqrt(max(estimate.covariance[0] + estimate.covariance[4], 0.0))
    return f"{pose_text(estimate.pose)} (± {100 * std_m:.0f} cm)"


def _remaining(goal: GoalStatus) -> str:
    words = remaining(goal)
    return words[:1].upper() + words[1:]


def _stop_text(trip: TourStatus, tour: Tour | None) -> str:
    if trip.stop is None:
        return "between stops"
    of = f" of {len(tour.stops)}" if tour is not None and trip.stop < len(tour.stops) else ""
    name = tour.stops[trip.stop].name if of and tour is not None else None
    return f"stop {trip.stop + 1}{of}" + (f" ({name})" if name else "")


def _lap(trip: TourStatus, tour: Tour | None) -> str:
    if tour is None or tour.repeat == 1:
        return ""
    return f"round {trip.lap + 1}" + (f" of {tour.repeat}" if tour.repeat else "")


def _count(trip: TourStatus) -> str:
    ended = trip.num_ended
    return f"{ended - trip.num_missed} of {ended} stops reached." if ended else ""


def _join(*parts: str) -> str:
    """Put sentences one behind the other, each with its full stop; the last may go without."""
    said = [part for part in parts if part]
    return " ".join(part if part[-1] in ".!?…" or part is said[-1] else f"{part}." for part in said)
