"""The tools that an assistant has: what each takes, and what it does."""

import dataclasses
import math
from collections.abc import Awaitable, Callable
from typing import Annotated, Any, Literal

import anyio
import numpy as np
from msgspec import Meta, Struct, to_builtins

from trolley import codes, requests, topics
from trolley.cli.robot_sentence import robot_sentence
from trolley.cli.show import pose_text, seconds_text
from trolley.client import STALE_AFTER_S
from trolley.codes import Refused
from trolley.config.mcp import McpConfig
from trolley.gridmap.wire import grid_of
from trolley.laser_scan import LaserScan
from trolley.messages import MappingStatus, PoseEstimate, SavedPose
from trolley.messages.request_params import (
    AskHistory,
    Capture,
    MapNamed,
    Nothing,
    SaveMap,
    SendGoal,
    StartTour,
    WhichGoal,
)
from trolley.names import canonical
from trolley.picture import MapPicture
from trolley.under_way import GOAL_GOES, TRIP_GOES, TRIP_UNDER_WAY, what_is_under_way
from trolley.zones import room_at, room_of
from trolley_mcp.answers import NOT_ALLOWED, NOT_STOPPED, Answer
from trolley_mcp.drives import (
    Progress,
    follow_goal,
    follow_trip,
    goal_text,
    send_goal,
    start_trip,
)
from trolley_mcp.robot_link import RobotLink

Role = Literal["viewer", "operator"]
Name = Annotated[str, Meta(min_length=1, max_length=200)]
MOST_LISTED = 200
MOST_PLACES, MOST_BYTES = 100, 1_000_000
"""Of a picture: places that are drawn, and how large its file may be."""
Speed = Annotated[
    Annotated[float, Meta(gt=0.0, le=5.0)] | None,
    Meta(description="Highest speed [m/s]; the settings may limit it further."),
]
Wait = Annotated[bool, Meta(description="Whether to answer only when it has ended.")]
Replace = Annotated[
    bool, Meta(description="Whether to give up what the robot is doing: ask a person first.")
]
GOES_ON = "It goes on: call `status` to see how it ends, `cancel` to end it."
SILENT = {
    "localizer": "It has no map yet, or the localizer is not running.",
    "planner": "The planner is not running.",
    "tour": "The tour service, which keeps the places, is not running.",
}
"""What it means that a service says nothing."""
STOP_S, STOP_WITHIN_S, STOP_AGAIN_S = 0.7, 2.0, 0.1
"""How long a stop waits for an answer, how long it is tried, and how long after a refusal."""


@dataclasses.dataclass(frozen=True)
class Call:
    """What a tool is given: the robot, the settings, and how to report progress."""

    robot: RobotLink
    settings: McpConfig
    progress: Progress


class _Params(Struct, kw_only=True, forbid_unknown_fields=True):
    pass


class NoParams(_Params):
    """Nothing."""


class NewPlaceParams(_Params):
    """A name."""

    name: Annotated[Name, Meta(description="1 to 64 letters, digits, single spaces, _ - .")]


class WhereParams(_Params):
    """A saved place, or the robot."""

    place: Annotated[
        Name | None, Meta(description="The name of a saved place; without one, the robot.")
    ] = None


class DriveParams(_Params):
    """Where to, and how."""

    place: Annotated[Name, Meta(description="The name of a saved place.")]
    speed: Speed = None
    wait: Annotated[bool, Meta(description="Whether to answer only when the drive has ended.")] = (
        True
    )
    replace: Replace = False


class TourParams(_Params):
    """Which tour, and how."""

    tour: Annotated[Name, Meta(description="The name of a stored tour.")]
    speed: Speed = None
    wait: Wait = False
    replace: Replace = False


class HistoryParams(_Params):
    """How many trips."""

    limit: Annotated[int, Meta(ge=1, le=20, description="How many, the newest.")] = 5


class MapParams(_Params):
    """How large a picture."""

    pixels: Annotated[int, Meta(ge=64, le=1024, description="Its longest side.")] = 768


class MapNameParams(_Params):
    """A map."""

    name: Annotated[str, Meta(min_length=1, max_length=64, description="Letters, digits, _ . -")]


@dataclasses.dataclass(frozen=True)
class Tool:
    """A row of the table of tools: name, description, parameters, and what it calls."""

    name: str
    about: str
    params: type[_Params]
    run: Callable[[Call, Any], Awaitable[Answer]]
    role: Role = "viewer"
    """The least role that may call it: an operator's tools ask the robot to do something."""


# Looking.
async def _status(call: Call, _: NoParams) -> Answer:
    robot = call.robot
    base, pose = await robot.latest(topics.BASE), await robot.latest(topics.POSE)
    goal, trip = await robot.latest(topics.GOAL), await robot.latest(topics.TOUR)
    mapping, zones = await robot.latest(topics.MAPPING), await robot.latest(topics.ZONES)
    if robot.now_ns is None:
        base = None  # what was left behind by one that is gone
    is_stale = _age_s(call, pose) > STALE_AFTER_S
    said = {"localizer": pose, "planner": goal, "tour": trip}
    silent = [words for name, words in SILENT.items() if base is not None and said[name] is None]
    sentence = robot_sentence(base, pose, goal, trip, is_stale=is_stale)
    if silent and sentence == "Ready.":
        sentence = "The robot cannot be sent to a place now."
    room = None if is_stale else room_of(pose, zones)
    battery = None if base is None or base.battery is None else base.battery.fraction
    data: dict[str, Any] = {
        "robot": robot.robot,
        "mode": None if base is None else base.mode,
        "reason": "" if base is None else base.reason,
        "position": None if pose is None else "stale" if is_stale else pose.state,
        "room": room,
        "battery": battery,
        "goal": None if goal is None else {"state": goal.state, "reason": goal.reason},
        "tour": None
        if trip is None
        else {"name": trip.name, "state": trip.state, "reason": trip.reason},
        "map_making": _mapping_data(mapping),
    }
    lines = [sentence, *silent]
    if pose is not None and pose.state != "localized" and pose.message and not is_stale:
        lines.append(f"Its pose is {pose.state}: {pose.message}.")
    if room:
        lines.append(f"It is in {room}.")
    if battery is not None:
        lines.append(f"Battery {battery:.0%}.")
    if mapping is not None and mapping.state != "idle" and mapping.message:
        lines.append(mapping.message)
    return Answer("\n".join(lines), data)


async def _places(call: Call, _: NoParams) -> Answer:
    places = await _known_places(call)
    if not places:
        return Answer("No places are saved on this map.")
    data = [_place_data(place) for place in places[:MOST_LISTED]]
    more = f" and {len(places) - MOST_LISTED} more" if len(places) > MOST_LISTED else ""
    return Answer(
        ", ".join(place.name for place in places[:MOST_LISTED]) + more + ".", {"places": data}
    )


async def _where_is(call: Call, params: WhereParams) -> Answer:
    pose, zones = await call.robot.latest(topics.POSE), await call.robot.latest(topics.ZONES)
    is_known = pose is not None and pose.pose is not None and _age_s(call, pose) <= STALE_AFTER_S
    if params.place is not None:
        place = _find(await _known_places(call), params.place)
        rooms = [] if zones is None or zones.map != place.map else zones.zones
        room = room_at(rooms, place.pose.x, place.pose.y)
        text = f"{place.name} is at {pose_text(place.pose)}"
        text += f" in {room}" if room else ""
        data = {**_place_data(place), "room": room, "distance_m": None}
        if is_known and pose is not None and pose.pose is not None:
            data["distance_m"] = distance_m = pose.pose.distance_to(place.pose)
            text += f", {distance_m:.1f} m from the robot as the crow flies"
        return Answer(f"{text}.", data)
    if pose is None or pose.pose is None or not is_known:
        raise Refused(codes.LOST if is_known else codes.STALE)
    here, places = pose.pose, await _places_here(call) or []
    near = min(places, key=lambda one: one.pose.distance_to(here), default=None)
    room = room_of(pose, zones)
    text = f"The robot is at {pose_text(here)} on {pose.map} ({pose.state})"
    text += f", in {room}" if room else ""
    if near is not None:
        text += f", {near.pose.distance_to(here):.1f} m from {near.name}"
    data = {"pose": to_builtins(here), "map": pose.map, "state": pose.state, "room": room}
    return Answer(f"{text}.", data | {"near": None if near is None else near.name})


async def _tours(call: Call, _: NoParams) -> Answer:
    stored = await call.robot.latest(topics.TOURS)
    if stored is None:
        raise Refused(codes.NOT_READY, "The tour service is not running.")
    estimate = await call.robot.latest(topics.POSE)
    on_map = None if estimate is None else estimate.map
    tours = [tour for tour in stored.tours if tour.is_for(on_map)][:MOST_LISTED]
    data = [
        {"name": tour.name, "stops": [stop.name or "a point" for stop in tour.stops[:MOST_LISTED]]}
        for tour in tours
    ]
    names = ", ".join(tour.name for tour in tours)
    text = f"{names}." if names else "No tours are stored for this map."
    return Answer(text, {"tours": data})


async def _zones(call: Call, _: NoParams) -> Answer:
    zones = await call.robot.latest(topics.ZONES)
    if zones is None:
        raise Refused(codes.NOT_READY, "The localizer is not running.")
    data = [{"name": one.name, "kind": one.kind, "speed": one.speed} for one in zones.zones]
    text = ", ".join(f"{one.name} ({one.kind})" for one in zones.zones[:MOST_LISTED])
    return Answer(f"{text}." if text else "There are no zones.", {"zones": data[:MOST_LISTED]})


async def _history(call: Call, params: HistoryParams) -> Answer:
    trips = await call.robot.ask(requests.TOUR_HISTORY, AskHistory(limit=params.limit))
    lines = [
        f"{trip.started_at or 'at an unknown time'}: {trip.name or 'a tour'} {trip.state}, "
        f"{trip.reached} reached, {trip.missed} missed. {trip.message}"
        for trip in trips
    ]
    data = [
        {
            "name": trip.name,
            "state": trip.state,
            "reason": trip.reason,
            "started_at": trip.started_at,
            "seconds": trip.seconds,
            "reached": trip.reached,
            "missed": trip.missed,
        }
        for trip in trips
    ]
    return Answer("\n".join(lines) or "No trip was driven yet.", {"trips": data})


async def _map(call: Call, params: MapParams) -> Answer:
    robot = call.robot
    message = await robot.latest(topics.MAP)
    if message is None:
        raise Refused(codes.NOT_READY, "There is no map yet, or the localizer is not running.")
    grid = grid_of(message)
    pose, scan = await robot.latest(topics.POSE), await robot.latest(topics.SCAN)
    mount = await robot.latest(topics.TF, "laser")
    places = [one for one in await _places_here(call) or [] if one.map == message.name]
    at = None if pose is None or _age_s(call, pose) > STALE_AFTER_S else pose.pose
    about, zones = await robot.latest(topics.ROBOT), await robot.latest(topics.ZONES)
    points = np.empty((0, 2))
    if at is not None and scan is not None and mount is not None:
        points = (at @ mount.pose).transform_points(LaserScan.of(scan).points())
    picture = MapPicture(
        grid,
        at,
        () if about is None else about.footprint,
        points,
        places=places[:MOST_PLACES],
        zones=() if zones is None else zones.zones,
    )
    width_m, height_m = grid.size_m
    text = (
        f"The map {message.name}, {width_m:.1f} x {height_m:.1f} m: walls black, floor white, "
        "unknown grey, places blue, what the lidar sees red, "
        + ("the robot green." if at is not None else "and it is not known where the robot is.")
    )
    data = {"map": message.name, "width_m": width_m, "height_m": height_m}
    return Answer(text, data, picture.png(params.pixels, MOST_BYTES))


# Stopping.
async def _stop(call: Call, _: NoParams) -> Answer:
    until_s = call.robot.monotonic_s + STOP_WITHIN_S
    while call.robot.monotonic_s < until_s:
        try:
            state = await call.robot.ask(requests.BASE_STOP, Nothing(), STOP_S, urgent=True)
        except Refused:
            await anyio.sleep(STOP_AGAIN_S)  # while the connection is down, it is refused at once
            continue
        if state.may_still_move:
            raise Refused(codes.DOES_NOT_OBEY, state.message)
        return Answer("Stopped. It stays stopped until a person lets it drive again.")
    raise Refused(NOT_STOPPED, "The robot does not answer, and may drive on.")


async def _resume(call: Call, _: NoParams) -> Answer:
    if not call.settings.may_resume:
        raise Refused(
            NOT_ALLOWED, "An assistant may not let a stopped robot drive again ([mcp] may_resume)."
        )
    state = await call.robot.ask(requests.BASE_RESUME, Nothing())
    if state.mode != "ok":
        why = state.message or codes.SENTENCES.get(state.reason, "")
        return Answer(f"Resumed, but it cannot drive yet: {why}")
    return Answer("It can drive again; nothing sets off by itself.")


# Driving.
async def _go(call: Call, params: DriveParams) -> Answer:
    place = _find(await _known_places(call), params.place)
    if not params.replace:
        await _check_is_free(call)
    goal = SendGoal(id=call.robot.new_id(), name=place.name, speed=_speed(call, params.speed))
    if not params.wait:
        await send_goal(call.robot, goal)
        return Answer(f"On its way to {place.name}. {GOES_ON}")
    status = await follow_goal(call.robot, goal, place.name, call.progress)
    if status.state in GOAL_GOES:
        return Answer(f"{goal_text(status, place.name)} {GOES_ON}")
    if status.state != "arrived":
        code = status.reason or status.state
        raise Refused(code, status.message or codes.SENTENCES.get(code, f"It {status.state}."))
    return Answer(f"Arrived at {place.name} after {seconds_text(status.elapsed)}.")


async def _start_tour(call: Call, params: TourParams) -> Answer:
    if not params.replace:
        await _check_is_free(call)
    base = await call.robot.latest(topics.BASE)
    if base is not None and base.mode == "stopped":  # it would begin once the robot is resumed
        raise Refused(codes.STOPPED)
    start = StartTour(name=params.tour, speed=_speed(call, params.speed))
    if not params.wait:
        await start_trip(call.robot, start)
        return Answer(f"The tour {params.tour} has begun. {GOES_ON}")
    status = await follow_trip(call.robot, start, call.progress)
    data = {
        "state": status.state,
        "stops": [
            {"name": one.name, "state": one.state, "code": one.code, "message": one.message}
            for one in status.results
        ],
    }
    if status.state in TRIP_GOES:
        return Answer(f"{status.message or 'The tour goes on.'} {GOES_ON}", data)
    if status.state != "done":
        raise Refused(status.reason or status.state, status.message or f"The tour {status.state}.")
    return Answer(status.message or "The tour is done.", data)


async def _cancel(call: Call, _: NoParams) -> Answer:
    trip, goal = await call.robot.latest(topics.TOUR), await call.robot.latest(topics.GOAL)
    what = what_is_under_way(goal, trip)
    if what == "trip":
        ended = await call.robot.ask(requests.TOUR_STOP, Nothing())
        return Answer(ended.message or "The tour has ended.")
    if what == "goal" and goal is not None:
        await call.robot.ask(requests.GOAL_CANCEL, WhichGoal(id=goal.id))
        return Answer("The drive is canceled; the robot stands.")
    if goal is None or trip is None:
        silent = "planner" if goal is None else "tour service"
        why = f"The {silent} does not answer: it is not known whether anything is under way."
        raise Refused(codes.NOT_READY, why)
    raise Refused(codes.NOT_DRIVING, "The robot is not going anywhere.")


async def _save_place(call: Call, params: NewPlaceParams) -> Answer:
    saved = await call.robot.ask(requests.POSE_CAPTURE, Capture(name=params.name))
    return Answer(
        f"Saved {saved.name} at {pose_text(saved.pose)} on {saved.map}.",
        {"name": saved.name, "map": saved.map, "pose": to_builtins(saved.pose)},
    )


# Map making.
async def _start_map(call: Call, params: MapNameParams) -> Answer:
    await _check_is_free(call)
    named = MapNamed(name=params.name, explore=True, speed=_speed(call, None))
    await call.robot.ask(requests.MAP_NEW, named)
    return Answer(
        f"The robot begins the map {params.name} and explores. Call `status` to see how far it is."
    )


async def _finish_map(call: Call, _: NoParams) -> Answer:
    status = await call.robot.ask(requests.MAP_SAVE, SaveMap())
    return Answer(status.message or "The map is being saved.")


async def _cancel_map(call: Call, _: NoParams) -> Answer:
    status = await call.robot.ask(requests.MAP_CANCEL, Nothing())
    return Answer(status.message or "The unfinished map is gone.")


# What several need.
async def _known_places(call: Call) -> list[SavedPose]:
    """The same as `_places_here`.

    Raises:
        Refused: `not_ready` where nobody says.
    """
    places = await _places_here(call)
    if places is None:
        raise Refused(codes.NOT_READY, SILENT["tour"])
    return places


async def _places_here(call: Call) -> list[SavedPose] | None:
    """The saved places on the robot's map, all of them while that is unknown; None: nobody says."""
    poses, estimate = await call.robot.latest(topics.POSES), await call.robot.latest(topics.POSE)
    if poses is None:
        return None
    on_map = None if estimate is None else estimate.map
    return [one for one in poses.poses if on_map is None or one.map == on_map]


def _find(places: list[SavedPose], name: str) -> SavedPose:
    """A place by its name, in capitals or not.

    Raises:
        Refused: `unknown_name`.
    """
    name = canonical(name.strip())
    for one in places:
        if one.name == name:
            return one
    alike = [one for one in places if one.name.casefold() == name.casefold()]
    if len(alike) == 1:
        return alike[0]
    known = ", ".join(one.name for one in places[:20]) or "none"
    raise Refused(
        codes.UNKNOWN_NAME, f"There is no place {name[:64]!r} on this map. Places here: {known}."
    )


async def _check_is_free(call: Call) -> None:
    """Refuse to interrupt what somebody wanted.

    Raises:
        Refused: `busy`.
    """
    goal, trip = await call.robot.latest(topics.GOAL), await call.robot.latest(topics.TOUR)
    if trip is not None and trip.state in TRIP_UNDER_WAY:
        paused = ", which is paused" if trip.state == "paused" else ""
        tour = f"the tour {trip.name}" if trip.name else "a tour without a name"
        raise Refused(codes.BUSY, f"The robot is on {tour}{paused}.")
    if goal is not None and goal.state in GOAL_GOES:
        raise Refused(codes.BUSY)


def _speed(call: Call, asked: float | None) -> float:
    most = call.settings.max_speed_mps
    return most if asked is None else min(asked, most)


def _age_s(call: Call, pose: PoseEstimate | None) -> float:
    now_ns = call.robot.now_ns
    return math.inf if pose is None or now_ns is None else (now_ns - pose.stamp_ns) * 1e-9


def _place_data(place: SavedPose) -> dict[str, Any]:
    return {"name": place.name, "pose": to_builtins(place.pose), "note": place.note}


def _mapping_data(status: MappingStatus | None) -> dict[str, Any] | None:
    if status is None or status.state == "idle":
        return None
    return {
        "map": status.name,
        "state": status.state,
        "exploring": status.exploring,
        "area_m2": status.area,
        "message": status.message,
    }


_TABLE = (
    Tool("status", "What the robot is doing, in a sentence, and why it is not.", NoParams, _status),
    Tool("places", "List the saved places that the robot can drive to.", NoParams, _places),
    Tool("where_is", "Where the robot or a saved place is.", WhereParams, _where_is),
    Tool("tours", "List the stored tours.", NoParams, _tours),
    Tool("zones", "List rooms, no-go areas, mirrors and the like.", NoParams, _zones),
    Tool(
        "history", "The trips that were driven last, and how they ended.", HistoryParams, _history
    ),
    Tool(
        "map",
        "A picture of the map with the robot, its places and what its lidar sees.",
        MapParams,
        _map,
    ),
    Tool(
        "stop",
        "Stop the robot at once. Always allowed. It stays stopped until a person resumes it.",
        NoParams,
        _stop,
    ),
    Tool(
        "go",
        "Drive to a saved place. Waits until the robot has arrived or says why not; after 45 s it "
        "answers that the drive goes on. Canceling the call cancels the drive.",
        DriveParams,
        _go,
        "operator",
    ),
    Tool(
        "start_tour",
        "Drive a stored tour. With `wait`, answers when it has ended, after 45 s at most.",
        TourParams,
        _start_tour,
        "operator",
    ),
    Tool(
        "cancel",
        "End the drive or tour under way; the robot stands and may be sent elsewhere.",
        NoParams,
        _cancel,
        "operator",
    ),
    Tool(
        "save_place",
        "Save the spot where the robot stands under a new name.",
        NewPlaceParams,
        _save_place,
        "operator",
    ),
    Tool(
        "resume",
        "Let a stopped robot drive again, if the settings allow it. Ask a person first.",
        NoParams,
        _resume,
        "operator",
    ),
    Tool(
        "start_map",
        "Begin a new map: the robot explores by itself.",
        MapNameParams,
        _start_map,
        "operator",
    ),
    Tool(
        "finish_map",
        "Save the map that is being made, and use it.",
        NoParams,
        _finish_map,
        "operator",
    ),
    Tool(
        "cancel_map",
        "Throw away the map that is being made.",
        NoParams,
        _cancel_map,
        "operator",
    ),
)
TOOLS: dict[str, Tool] = {tool.name: tool for tool in _TABLE}
"""By name, in the order in which they are listed."""
