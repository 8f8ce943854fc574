"""Following a drive or a tour until it has ended, telling how it goes."""

import asyncio
import contextlib
from collections.abc import Awaitable, Callable
from typing import TypeVar

import anyio

from trolley import codes, requests, topics
from trolley.cli.show import seconds_text
from trolley.codes import Refused
from trolley.messages import GoalStatus, TourStatus
from trolley.messages.request_params import Nothing, SendGoal, StartTour, WhichGoal
from trolley.under_way import GOAL_GOES, TRIP_GOES
from trolley_mcp.robot_link import RobotLink

M = TypeVar("M")

Progress = Callable[[float, float | None, str], Awaitable[None]]
"""Tells how far it is, of how much (None: unknown), and in a sentence."""

SILENCE_S = 5.0
"""Silence after which the owner is asked whether it still knows the drive."""
GIVE_UP_S = 2.0
"""How long a cancel may take while the session ends."""
LONGEST_WAIT_NS = 45_000_000_000
"""Robot time after which a call is answered although the drive goes on: usual clients give up on a
call after 60 s whatever progress is told, and giving up ends the drive."""


async def follow_goal(robot: RobotLink, goal: SendGoal, name: str, tell: Progress) -> GoalStatus:
    """Send a goal and wait until it has ended or stands still, paused, or has taken too long.

    Where nobody waits any more, the goal is canceled.

    Raises:
        Refused: It was refused, replaced or forgotten.
    """
    async with robot.heard(topics.GOAL) as statuses:
        try:
            status = await robot.ask(requests.GOAL_SEND, goal)
            sent_ns, longest_m = status.stamp_ns, 0.0
            while status.state in GOAL_GOES and status.stamp_ns - sent_ns < LONGEST_WAIT_NS:
                left_m = status.distance_remaining
                longest_m = max(longest_m, left_m or 0.0)
                await tell(longest_m - (left_m or 0.0), longest_m or None, goal_text(status, name))
                heard = await _next(statuses)
                if heard is None and (heard := await robot.latest(topics.GOAL)) is None:
                    raise Refused(codes.NOT_READY, "The planner has fallen silent.")
                if heard.id == goal.id:
                    status = heard
                elif heard.stamp_ns > sent_ns:  # not an earlier one's last word
                    raise Refused(codes.RESTARTED if heard.id is None else codes.REPLACED)
        except anyio.get_cancelled_exc_class():
            with anyio.move_on_after(GIVE_UP_S, shield=True):
                await _let_go(robot.ask(requests.GOAL_CANCEL, WhichGoal(id=goal.id)))
            raise
    return status


async def follow_trip(robot: RobotLink, start: StartTour, tell: Progress) -> TourStatus:
    """Start a tour and wait until it has ended or stands still, paused, or has taken too long.

    Where nobody waits any more, the tour is ended.

    Raises:
        Refused: It was refused, replaced or forgotten.
    """
    async with robot.heard(topics.TOUR) as statuses:
        trip: str | None = None
        try:
            status = await _started(robot, start)
            trip, sent_ns = status.trip, status.stamp_ns
            while status.state in TRIP_GOES and status.stamp_ns - sent_ns < LONGEST_WAIT_NS:
                stops = None if status.tour is None else float(len(status.tour.stops))
                await tell(float(status.num_ended), stops, status.message)
                heard = await _next(statuses)
                if heard is None and (heard := await robot.latest(topics.TOUR)) is None:
                    raise Refused(codes.NOT_READY, "The tour service has fallen silent.")
                if heard.trip == trip:
                    status = heard
                elif heard.stamp_ns > sent_ns:
                    raise Refused(codes.REPLACED, "Another tour took its place.")
        except anyio.get_cancelled_exc_class():
            if trip is not None:
                with anyio.move_on_after(GIVE_UP_S, shield=True):
                    await _end_trip(robot, trip)
            raise
    return status


async def _started(robot: RobotLink, start: StartTour) -> TourStatus:
    """Start a tour, even if the call is canceled now: else nobody knew which one to end."""
    status: TourStatus | None = None
    with anyio.CancelScope(shield=True):
        status = await robot.ask(requests.TOUR_START, start)
    assert status is not None
    return status


async def _end_trip(robot: RobotLink, trip: str) -> None:
    now = await robot.latest(topics.TOUR)
    if now is not None and now.trip == trip:  # not somebody else's
        await _let_go(robot.ask(requests.TOUR_STOP, Nothing()))


async def _let_go(asked: Awaitable[object]) -> None:
    with contextlib.suppress(Refused):  # it has ended by itself
        await asked


async def _next(queue: "asyncio.Queue[M]") -> M | None:
    """The newest that was heard, None after a silence."""
    with anyio.move_on_after(SILENCE_S):
        newest = await queue.get()
        while not queue.empty():
            newest = queue.get_nowait()
        return newest
    return None


def goal_text(status: GoalStatus, name: str) -> str:
    """How far a drive is, in a sentence."""
    if status.state == "recovering":
        return f"On the way to {name}: {status.message or codes.SENTENCES.get(status.reason, '')}"
    text = f"Driving to {name}"
    if status.distance_remaining is not None:
        text += f", {status.distance_remaining:.1f} m to go"
    return f"{text}, {seconds_text(status.eta)} left." if status.eta is not None else f"{text}."
