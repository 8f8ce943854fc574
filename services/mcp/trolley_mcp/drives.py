"""Following a drive or a tour until it has ended, telling how it goes."""

import asyncio
import contextlib
from collections.abc import AsyncGenerator, Awaitable, Callable
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
SILENT = "{0} has fallen silent; the {1} is canceled as soon as it answers."
AGAIN_S = 1.0
"""How often a cancel is repeated that nobody answers."""
LONGEST_WAIT_S = 45.0
"""After this a call is answered although the drive goes on: usual clients give up on a call after
60 s whatever progress is told, and giving up ends the drive."""


async def send_goal(robot: RobotLink, goal: SendGoal) -> GoalStatus:
    """Send a goal without waiting for its end; one whose answer does not come is canceled.

    Raises:
        Refused: It was refused.
    """
    async with _ended_where_nobody_waits(robot, lambda: _cancel(robot, goal)):
        return await robot.ask(requests.GOAL_SEND, goal)


async def follow_goal(robot: RobotLink, goal: SendGoal, name: str, tell: Progress) -> GoalStatus:
    """Send a goal and wait until it has ended or stands still, paused, or has taken too long.

    Where nobody waits any more, the goal is canceled.

    Raises:
        Refused: It was refused, replaced or forgotten.
    """
    until_s, longest_m = robot.monotonic_s + LONGEST_WAIT_S, 0.0
    async with (
        robot.heard(topics.GOAL) as statuses,
        _ended_where_nobody_waits(robot, lambda: _cancel(robot, goal)),
    ):
        status = await robot.ask(requests.GOAL_SEND, goal)
        sent_ns = status.stamp_ns
        while status.state in GOAL_GOES and robot.monotonic_s < until_s:
            left_m = status.distance_remaining
            longest_m = max(longest_m, left_m or 0.0)
            await tell(longest_m - (left_m or 0.0), longest_m or None, goal_text(status, name))
            heard = await _next(statuses)
            if heard is None and (heard := await robot.latest(topics.GOAL)) is None:
                raise Refused(codes.NOT_READY, SILENT.format("The planner", "drive"))
            if heard.id == goal.id:
                status = heard
            elif heard.stamp_ns > sent_ns:  # not an earlier one's last word
                raise Refused(codes.RESTARTED if heard.id is None else codes.REPLACED)
    return status


async def start_trip(robot: RobotLink, start: StartTour) -> TourStatus:
    """Start a tour without waiting for its end; one whose answer does not come is ended.

    Raises:
        Refused: It was refused.
    """
    before = await robot.latest(topics.TOUR)
    known = None if before is None else before.trip

    def is_it(now: TourStatus) -> bool:
        return now.name == start.name and now.trip not in (None, known)

    async with _ended_where_nobody_waits(robot, lambda: _end_trip(robot, is_it)):
        return await robot.ask(requests.TOUR_START, start)


async def follow_trip(robot: RobotLink, start: StartTour, tell: Progress) -> TourStatus:
    """Start a tour and wait until it has ended or stands still, paused, or has taken too long.

    Where nobody waits any more, the tour is ended.

    Raises:
        Refused: It was refused, replaced or forgotten.
    """
    until_s = robot.monotonic_s + LONGEST_WAIT_S
    status = await start_trip(robot, start)
    trip, sent_ns = status.trip, status.stamp_ns

    def is_it(now: TourStatus) -> bool:
        return now.trip == trip  # not somebody else's

    async with (
        robot.heard(topics.TOUR) as statuses,
        _ended_where_nobody_waits(robot, lambda: _end_trip(robot, is_it)),
    ):
        while status.state in TRIP_GOES and robot.monotonic_s < until_s:
            stops = None if status.tour is None else float(len(status.tour.stops))
            await tell(float(status.num_ended), stops, status.message)
            heard = await _next(statuses)
            if heard is None and (heard := await robot.latest(topics.TOUR)) is None:
                raise Refused(codes.NOT_READY, SILENT.format("The tour service", "tour"))
            if heard.trip == trip:
                status = heard
            elif heard.stamp_ns > sent_ns and heard.trip is None:
                raise Refused(codes.RESTARTED, "The tour service no longer knows the tour.")
            elif heard.stamp_ns > sent_ns:
                raise Refused(codes.REPLACED, "Another tour took its place.")
    return status


@contextlib.asynccontextmanager
async def _ended_where_nobody_waits(
    robot: RobotLink, end: Callable[[], Awaitable[None]]
) -> AsyncGenerator[None]:
    """Call `end` if the wait is canceled or nobody answers: until somebody does."""
    try:
        yield
    except anyio.get_cancelled_exc_class():
        ending = robot.see_to(_answered(end))
        with anyio.move_on_after(GIVE_UP_S, shield=True):  # the session may end with the call
            await asyncio.wait([ending])
        raise
    except Refused as refused:
        if refused.code in codes.UNANSWERED:
            robot.see_to(_answered(end))
        raise


async def _answered(ask: Callable[[], Awaitable[None]]) -> None:
    """Ask until somebody answers, whatever it is: a refusal says that it has ended by itself."""
    while True:
        try:
            await ask()
        except Refused as refused:
            if refused.code in codes.UNANSWERED:
                await anyio.sleep(AGAIN_S)
                continue
        return


async def _cancel(robot: RobotLink, goal: SendGoal) -> None:
    await robot.ask(requests.GOAL_CANCEL, WhichGoal(id=goal.id))


async def _end_trip(robot: RobotLink, is_it: Callable[[TourStatus], bool]) -> None:
    now = await robot.latest(topics.TOUR)
    if now is None:
        raise Refused(codes.NOT_READY)
    if is_it(now):
        await robot.ask(requests.TOUR_STOP, Nothing())


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
