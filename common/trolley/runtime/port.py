"""What a node offers to its service; the methods of `Service` of the same names explain it."""

from collections.abc import Callable
from typing import Any, Protocol, TypeVar

import msgspec

from trolley.codes import Refused
from trolley.requests import Request
from trolley.runtime.log import Log
from trolley.runtime.robot_time import TimeSource
from trolley.runtime.state import StateFolder
from trolley.runtime.watch import Watch
from trolley.topics import Topic

M = TypeVar("M", bound=msgspec.Struct)
R = TypeVar("R")
T = TypeVar("T")


class Port(Protocol):
    """The node, as its service sees it."""

    @property
    def robot(self) -> str: ...
    @property
    def log(self) -> Log: ...
    @property
    def state(self) -> StateFolder: ...
    @property
    def maps(self) -> StateFolder: ...
    @property
    def monotonic_ns(self) -> int: ...
    @property
    def arrived_ns(self) -> int: ...
    def time_of(self, robot: str) -> TimeSource: ...
    @property
    def unix_ns(self) -> int: ...
    def utc_now(self) -> str | None: ...
    def new_id(self) -> str: ...
    def publish(
        self, topic: Topic[Any], message: Any, parts: tuple[str, ...], robot: str | None
    ) -> None: ...
    def withdraw(self, topic: Topic[Any], parts: tuple[str, ...]) -> None: ...
    def put_wish(
        self, topic: Topic[Any], message: Any, parts: tuple[str, ...], robot: str | None
    ) -> None: ...
    def watch(
        self,
        topic: Topic[M],
        parts: tuple[str, ...],
        seconds: float,
        robot: str | None,
        then: Callable[..., None] | None,
    ) -> Watch[M]: ...
    def request(
        self,
        request: Request[Any, R],
        params: Any,
        then: Callable[[R | Refused], None],
        timeout_s: float,
        robot: str | None,
    ) -> None: ...
    def get(
        self,
        topic: Topic[M],
        parts: tuple[str, ...],
        then: Callable[[dict[tuple[str, ...], M]], None],
        robot: str | None,
    ) -> None: ...
    def work(self, fn: Callable[[], T], then: Callable[[T], None] | None) -> None: ...
    def call_soon(self, fn: Callable[[], None], *, urgent: bool) -> None: ...
    def count(self, name: str, number: int) -> None: ...
    def set_health(self, state: str, message: str) -> None: ...
    def close_watch(self, watch: Watch[Any]) -> None: ...
