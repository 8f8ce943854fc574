"""From the session's event loop to the service's thread and back."""

import asyncio
import contextlib
from collections.abc import AsyncGenerator, Callable, Coroutine
from typing import Any, TypeVar

import anyio
import msgspec

from trolley import codes, requests
from trolley.codes import Refused
from trolley.messages.request_params import Nothing
from trolley.requests import Request
from trolley.runtime.receiving import GET_TIMEOUT_S
from trolley.runtime.service import Service, Watch
from trolley.topics import Topic

M = TypeVar("M", bound=msgspec.Struct)
P = TypeVar("P", bound=msgspec.Struct)
R = TypeVar("R")

ANSWER_S = 2.0
MARGIN_S = 1.0
"""How much later than the wire the session gives up, so that the wire's own word comes first."""


class RobotLink:
    """What the tools need of the robot; all of it is called on the event loop."""

    def __init__(self, service: Service) -> None:
        self._service = service
        self._errands: set[asyncio.Task[None]] = set()

    @property
    def now_ns(self) -> int | None:
        """Robot time [ns], None while unknown."""
        return self._service.now_ns

    @property
    def monotonic_s(self) -> float:
        """The time of the assistant's own clock [s], which goes on without the robot."""
        return self._service.monotonic_ns * 1e-9

    @property
    def robot(self) -> str:
        """The robot's name."""
        return self._service.robot

    def new_id(self) -> str:
        """A fresh id for a goal."""
        return f"mcp-{self._service.new_id()}"

    def stop_now(self) -> None:
        """Ask for a stop before everything that waits, on any thread; the tool then tells of it."""
        self._service.call_soon(
            lambda: self._service.request(requests.BASE_STOP, Nothing(), lambda _: None),
            urgent=True,
        )

    async def ask(
        self,
        request: Request[P, R],
        params: P,
        timeout_s: float = ANSWER_S,
        *,
        urgent: bool = False,
    ) -> R:
        """Ask a request; an `urgent` one goes before everything that waits.

        Raises:
            Refused: With the robot's code.
        """
        result = await self._call(
            lambda then: self._service.request(request, params, then, timeout_s), timeout_s, urgent
        )
        if isinstance(result, Refused):
            raise result
        return result

    def see_to(self, errand: Coroutine[Any, Any, None]) -> "asyncio.Task[None]":
        """Do something while other calls go on, until the session ends."""
        task = asyncio.create_task(errand)
        self._errands.add(task)
        task.add_done_callback(self._errands.discard)
        return task

    async def get(self, topic: Topic[M], *parts: str) -> dict[tuple[str, ...], M]:
        """The latest values of a topic, by the chunks of their keys that vary."""
        return await self._call(
            lambda then: self._service.get(topic, *parts, then=then), GET_TIMEOUT_S, False
        )

    async def latest(self, topic: Topic[M], *parts: str) -> M | None:
        """The latest value of one key, None if nobody has it."""
        return next(iter((await self.get(topic, *parts)).values()), None)

    @contextlib.asynccontextmanager
    async def heard(self, topic: Topic[M]) -> AsyncGenerator["asyncio.Queue[M]"]:
        """Everything that is published on a topic meanwhile, the latest value first."""
        loop = asyncio.get_running_loop()
        queue: asyncio.Queue[M] = asyncio.Queue()
        opened: list[Watch[M]] = []

        def take(message: M) -> None:
            _tell(loop, lambda: queue.put_nowait(message))

        def close() -> None:
            for one in opened:
                self._service.close_watch(one)

        self._service.call_soon(lambda: opened.append(self._service.watch(topic, then=take)))
        try:
            yield queue
        finally:
            self._service.call_soon(close)

    async def _call(
        self, begin: Callable[[Callable[[Any], None]], None], timeout_s: float, urgent: bool
    ) -> Any:
        loop = asyncio.get_running_loop()
        answer: asyncio.Future[Any] = loop.create_future()

        def settle(result: Any) -> None:
            if not answer.done():
                answer.set_result(result)

        self._service.call_soon(
            lambda: begin(lambda result: _tell(loop, lambda: settle(result))), urgent=urgent
        )
        try:
            with anyio.fail_after(timeout_s + MARGIN_S):
                return await answer
        except TimeoutError:
            raise Refused(codes.TIMEOUT) from None


def _tell(loop: asyncio.AbstractEventLoop, call: Callable[[], None]) -> None:
    with contextlib.suppress(RuntimeError):  # the session has ended: nobody waits for it any more
        loop.call_soon_threadsafe(call)
