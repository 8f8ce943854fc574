"""`trolley.Robot` for asyncio: the same methods, each awaited, and its iterators by `async for`.

    from trolley import AsyncRobot

    async with AsyncRobot() as robot:
        await robot.go_to("kitchen")
        async for pose in robot.poses():
            print(pose.state)

There is one implementation, `trolley.client`: here each call runs on a thread of its own. A task
that is cancelled ends what it waits for; a goal that `go_to` waits for is cancelled with it.
"""

import asyncio
import functools
from collections.abc import AsyncGenerator, Callable, Coroutine, Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from types import TracebackType
from typing import Any, Concatenate, ParamSpec, Self, TypeVar

from trolley.client import Robot
from trolley.connection import RobotUnreachable

P = ParamSpec("P")
R = TypeVar("R")

MOST_CALLS = 1000
"""So many calls may wait at the same time: a stop must not have to queue behind streams."""
_END = object()


def _awaited(
    method: Callable[Concatenate[Robot, P], R],
) -> "Callable[Concatenate[AsyncRobot, P], Coroutine[Any, Any, R]]":
    """The method as a coroutine."""

    @functools.wraps(method)
    async def call(self: "AsyncRobot", *args: P.args, **kwargs: P.kwargs) -> R:
        apart = self.robot.apart()
        return await self.run(apart, lambda: method(apart, *args, **kwargs))

    return call


def _iterated(
    method: Callable[Concatenate[Robot, P], Iterator[R]],
) -> "Callable[Concatenate[AsyncRobot, P], AsyncGenerator[R]]":
    """The method as an asynchronous generator."""

    @functools.wraps(method)
    async def iterate(self: "AsyncRobot", *args: P.args, **kwargs: P.kwargs) -> AsyncGenerator[R]:
        apart = self.robot.apart()
        try:
            items = method(apart, *args, **kwargs)
            while (item := await self.run(apart, lambda: next(items, _END))) is not _END:
                yield item  # pyrefly: ignore[invalid-yield]  # it is not the end
        finally:
            apart.close()

    return iterate


class AsyncRobot:
    """One robot, for asyncio: `async with AsyncRobot(...) as robot`. See `trolley.Robot`.

    It takes the same arguments, which count when it is entered. What of `Robot` is not here
    (`on`, `subscribe`) is for threads: use a task with `async for` instead.
    """

    def __init__(
        self,
        name: str | None = None,
        connect: str | Sequence[str] | None = None,
        config: Path | str | None = None,
        connect_timeout: float = 5.0,
    ) -> None:
        self._connect = functools.partial(Robot, name, connect, config, connect_timeout)
        self._threads: ThreadPoolExecutor
        self._robot: Robot | None = None

    async def __aenter__(self) -> Self:
        """Connect; what `Robot` raises, this raises, too."""
        loop = asyncio.get_running_loop()
        self._threads = ThreadPoolExecutor(MOST_CALLS, "robot")
        self._robot = await loop.run_in_executor(self._threads, self._connect)
        return self

    async def __aexit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        robot, self._robot = self.robot, None
        await asyncio.get_running_loop().run_in_executor(self._threads, robot.close)
        self._threads.shutdown(wait=False)

    @property
    def robot(self) -> Robot:
        """The robot below, for threads."""
        if self._robot is None:
            raise RobotUnreachable("this AsyncRobot is not open; use `async with`")
        return self._robot

    @property
    def name(self) -> str:
        """The robot's name."""
        return self.robot.name

    async def run(self, apart: Robot, call: Callable[[], R]) -> R:
        """Run a call on a thread; where the task is cancelled, what `apart` waits for is ended."""
        future = asyncio.get_running_loop().run_in_executor(self._threads, call)
        try:
            return await asyncio.shield(future)
        except asyncio.CancelledError:
            apart.close()
            await asyncio.wait([future])  # at most as long as a request takes
            if not future.cancelled():
                future.exception()  # whoever asked no longer waits for it
            raise

    ask = _awaited(Robot.ask)
    get = _awaited(Robot.get)
    latest = _awaited(Robot.latest)
    stream = _iterated(Robot.stream)
    publish = _awaited(Robot.publish)

    pose = _awaited(Robot.pose)
    poses = _iterated(Robot.poses)
    set_pose = _awaited(Robot.set_pose)
    find = _awaited(Robot.find)
    wait_until_localized = _awaited(Robot.wait_until_localized)
    capture = _awaited(Robot.capture)

    scan = _awaited(Robot.scan)
    scans = _iterated(Robot.scans)
    battery = _awaited(Robot.battery)
    map = _awaited(Robot.map)
    maps = _awaited(Robot.maps)
    load_map = _awaited(Robot.load_map)
    zones = _awaited(Robot.zones)
    put_zone = _awaited(Robot.put_zone)
    delete_zone = _awaited(Robot.delete_zone)
    places = _awaited(Robot.places)
    put_place = _awaited(Robot.put_place)
    delete_place = _awaited(Robot.delete_place)
    tours = _awaited(Robot.tours)
    put_tour = _awaited(Robot.put_tour)
    delete_tour = _awaited(Robot.delete_tour)

    go_to = _awaited(Robot.go_to)
    follow = _iterated(Robot.follow)
    follow_person = _awaited(Robot.follow_person)
    cancel = _awaited(Robot.cancel)
    tour = _awaited(Robot.tour)
    follow_tour = _iterated(Robot.follow_tour)
    now_ns = _awaited(Robot.now_ns)
    drive = _awaited(Robot.drive)

    put_marker = _awaited(Robot.put_marker)
    delete_marker = _awaited(Robot.delete_marker)
    put_overlay = _awaited(Robot.put_overlay)
    delete_overlay = _awaited(Robot.delete_overlay)
    config = _awaited(Robot.config)
    set_config = _awaited(Robot.set_config)
    picture = _awaited(Robot.picture)

    stop = _awaited(Robot.stop)
    resume = _awaited(Robot.resume)
